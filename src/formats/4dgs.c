#include "formats/4dgs.h"

#include "formats/4dgs_states.h"
#include "formats/gaussian.h"
#include "io/file.h"
#include "io/sound.h"
#include "math/sh.h"

/* A splat has at least 34 bytes before compression, and positions compress badly, since no two
 * splats share a position. Files that would unpack to far more than 32 times their size
 * (SPIN_4DGS_RATIO) are therefore refused as decompression bombs. */
#define ROW_BYTES 34

/* ---- Sound ----------------------------------------------------------------------------------- */

/* An audio source record describes a sound, and an audio data record contains its sound file. */

/* KEYFRAME: bytes of a keyframe of a moving sound: time, position, rotation x y z w, as doubles. */
enum { KEYFRAME = 8 * 8, MOST_SOUNDS = 1000 };

struct sound_source {
    uint32_t id;
    struct spin_4dgs_cursor name, codec;
    uint64_t size;
    double start, gain;
    bool has_place, loops;
    const unsigned char *data; /* NULL: the audio data record has not been read yet */
};

/* The sounds of a file that have been read so far. */
struct sounds {
    struct sound_source *source; /* [n], allocated */
    size_t n;
    bool old;      /* true: there is a record 09, the older form of sound, which is not read */
    bool declared; /* true: the header declares that the file contains sound */
    bool late;     /* true: a sound record follows the first chunk */
    double start;  /* start in seconds, below 0, from the metadata; 0: the record has the start */
};

static struct sound_source *find_source(const struct sounds *sounds, uint32_t id)
{
    for (size_t i = 0; i < sounds->n; i++)
        if (sounds->source[i].id == id)
            return &sounds->source[i];
    return NULL;
}

/* Reads a position and a rotation. Returns false if they are invalid. Returns true if the record is
 * too short, since the caller checks the length itself. */
static bool read_pose(struct spin_4dgs_cursor *c)
{
    double place = 0, length = 0;

    for (int k = 0; k < 3; k++)
        place += fabs(spin_4dgs_double(c));
    for (int k = 0; k < 4; k++) {
        double v = spin_4dgs_double(c);

        length += v * v;
    }
    return c->cut || (isfinite(place) && fabs(length - 1) < 1e-3);
}

/* Reads the keyframes of a moving sound. Their times must increase and be within the clip. */
static spin_status check_keyframes(struct spin_4dgs_cursor *c, uint32_t id, double duration)
{
    uint64_t n = spin_4dgs_number(c, 4);
    double last = -INFINITY;

    if (c->cut || n > c->left / KEYFRAME) {
        c->cut = true;
        return SPIN_OK;
    }
    for (uint64_t k = 0; k < n; k++) {
        double time = spin_4dgs_double(c);

        if (!(time > last) || time < 0 || time > duration)
            return spin_malformed(
                "sound %u: the times of its keyframes are not in ascending order within the "
                "clip",
                id);
        if (!read_pose(c))
            return spin_malformed("sound %u: a keyframe has an invalid position or rotation", id);
        last = time;
    }
    return SPIN_OK;
}

static spin_status check_source(const struct sound_source *s, double duration, bool has_pose)
{
    if (!(duration > 0) || !isfinite(duration) || !isfinite(s->start))
        return spin_malformed("sound %u: start at %g s and duration of %g s, expected finite "
                              "values and a duration above 0",
                              s->id, s->start, duration);
    if (!(s->gain >= 0) || !isfinite(s->gain))
        return spin_malformed("sound %u: its gain is %g, expected 0 or more", s->id, s->gain);
    return has_pose ? SPIN_OK
                    : spin_malformed("sound %u has an invalid position or rotation", s->id);
}

/* Reads the content of record 11. A malformed record is an error. duration: length of the clip in
 * seconds. */
static spin_status read_sound_source(struct sounds *sounds, struct spin_4dgs_cursor *c,
                                     double duration)
{
    struct sound_source s = {.id = (uint32_t)spin_4dgs_number(c, 4)};
    struct spin_4dgs_cursor how;
    double length;
    unsigned flags;
    bool has_pose;

    s.name = spin_4dgs_block(c, 4);
    s.codec = spin_4dgs_block(c, 4);
    spin_4dgs_block(c, 4); /* the layout of the channels */
    s.size = spin_4dgs_number(c, 8);
    s.start = spin_4dgs_double(c);
    length = spin_4dgs_double(c);
    s.gain = spin_4dgs_double(c);
    flags = (unsigned)spin_4dgs_number(c, 1);
    s.has_place = flags & 1;
    s.loops = flags & SPIN_4DGS_LOOPS;
    has_pose = read_pose(c);
    SPIN_TRY(check_keyframes(c, s.id, duration));
    how = spin_4dgs_block(c, 4);
    if (c->cut)
        return SPIN_OK;
    SPIN_TRY(check_source(&s, length, has_pose));
    if (!spin_4dgs_is(&how, "linear") && !spin_4dgs_is(&how, "step"))
        return spin_malformed("sound %u: its interpolation is neither linear nor step", s.id);
    if (find_source(sounds, s.id))
        return spin_malformed("two sounds have the id %u", s.id);
    if (sounds->n == MOST_SOUNDS)
        return spin_unsupported("the file has more than %d sounds", MOST_SOUNDS);
    SPIN_TRY(spin_grow(sounds->n + 1, sizeof *sounds->source, (void **)&sounds->source));
    sounds->source[sounds->n++] = s;
    return SPIN_OK;
}

/* Reads the content of record 12. */
static spin_status read_sound_data(struct sounds *sounds, struct spin_4dgs_cursor *c)
{
    uint32_t id = (uint32_t)spin_4dgs_number(c, 4);
    struct spin_4dgs_cursor data = spin_4dgs_block(c, 8);
    struct sound_source *s = find_source(sounds, id);

    if (c->cut)
        return SPIN_OK;
    if (!s || s->data)
        return spin_malformed("sound %u has data %s", id, s ? "twice" : "but no source");
    if (data.left != s->size)
        return spin_malformed("sound %u has %zu bytes, its source declares %llu", id, data.left,
                              (unsigned long long)s->size);
    s->data = data.at;
    return SPIN_OK;
}

/* The output parameters of finish_sounds(). */
struct result {
    struct spin_sound *sound;
    char *notes;
    size_t n;
};

/* Adds a note for each property that the chosen sound loses. */
static void note_losses(const struct sounds *sounds, const struct sound_source *s,
                        const struct result *to)
{
    const char *name = to->sound->name;

    if (sounds->n > 1)
        spin_text_note(to->notes, to->n, "the file has %zu sounds, of which only '%s' is imported",
                       sounds->n, name);
    if (s->has_place)
        spin_text_note(to->notes, to->n,
                       "the sound '%s' is imported without its position in the scene", name);
    if (s->loops)
        spin_text_note(to->notes, to->n,
                       "the sound '%s' repeats in the file, but is imported to play only once",
                       name);
    if (!sounds->declared)
        spin_text_note(to->notes, to->n, "the header declares no sound, but the file has some");
    if (sounds->late)
        spin_text_note(
            to->notes, to->n,
            "a record of sound follows the first chunk, which the format does not allow");
}

/* Sets *to->sound to the source *s, or to no sound if the format of its file is unknown. */
static void choose_sound(const struct sounds *sounds, const struct sound_source *s,
                         const struct result *to)
{
    char name[64] = "";

    snprintf(name, sizeof name, "%.*s", (int)(s->name.left < 60 ? s->name.left : 60),
             (const char *)s->name.at);
    if (spin_sound_set(to->sound, name, s->data, (size_t)s->size) != SPIN_OK) {
        spin_text_note(to->notes, to->n, "the sound is not imported: %s", spin_last_error());
        *to->sound = (struct spin_sound){0};
        return;
    }
    to->sound->gain = s->gain;
    to->sound->start = sounds->start < 0 ? sounds->start : s->start;
    note_losses(sounds, s, to);
}

/* Checks that each source has its data, and sets *sound to the first sound that has no position in
 * the scene or, if all have one, to the first sound. *sound points into the memory of the records.
 * Adds a line to `notes` for each sound or property that is dropped. */
static spin_status finish_sounds(const struct sounds *sounds, struct spin_sound *sound, char *notes,
                                 size_t n_notes)
{
    const struct result to = {sound, notes, n_notes};
    const struct sound_source *chosen = NULL;

    if (sounds->old && sounds->n > 0)
        return spin_malformed("the file contains sound in record 09 and in record 11, expected "
                              "only one of these records");
    for (size_t i = 0; i < sounds->n; i++) {
        const struct sound_source *s = &sounds->source[i];

        if (!s->data)
            return spin_malformed("sound %u has no data", s->id);
        if (!chosen || (chosen->has_place && !s->has_place))
            chosen = s;
    }
    if (chosen)
        choose_sound(sounds, chosen, &to);
    else if (sounds->old)
        spin_text_note(
            notes, n_notes,
            "the sound is not imported: its form (record 09) is outdated and not supported");
    else if (sounds->declared)
        spin_text_note(notes, n_notes, "the header declares sound, but the file has none");
    return SPIN_OK;
}

/* ---- The reader ------------------------------------------------------------------------------ */

struct reader {
    const unsigned char *file;
    size_t size;
    struct spin_4dgs *info;
    struct spin_splats_4d *splats;
    unsigned seen;   /* bit k: record k was read, for records that must not occur twice */
    uint64_t n_said; /* number of splats that the header declares */
    double origin[3], step[SPIN_4DGS_N_STEPS];
    double *window; /* [n_windows][2] start and end of each window */
    size_t n_windows;
    uint64_t n; /* number of splats in the chunks read so far */
    size_t n_chunks;
    size_t first, n_in_chunk;       /* first row and number of rows of the current chunk */
    unsigned bands;                 /* bit k: SH band k + 1 of the current chunk was read */
    struct spin_4dgs_states states; /* for keyframe-delta */
    bool has_chunks;                /* true: a chunk was read */
    struct sounds sounds;
    int32_t *steps[SPIN_4DGS_N_ATTRIBUTES];
};

/* Returns the precision with which "%.*s" prints a text: its length, at most 80 characters. */
static int length_of(const struct spin_4dgs_cursor *text)
{
    return text->left < 80 ? (int)text->left : 80;
}

/* ---- Records that occur once ----------------------------------------------------------------- */

static spin_status read_header(struct reader *r, struct spin_4dgs_cursor *c)
{
    struct spin_4dgs_cursor model;
    unsigned degree;

    spin_4dgs_block(c, 4);
    spin_4dgs_block(c, 4);
    r->info->duration = spin_4dgs_double(c);
    r->n_said = spin_4dgs_number(c, 8);
    r->info->cutoff = spin_4dgs_double(c);
    model = spin_4dgs_block(c, 4);
    spin_4dgs_bytes(c, 48);
    degree = (unsigned)spin_4dgs_number(c, 1);
    r->sounds.declared = c->left > 0 && *c->at & 1; /* flags */
    if (c->cut)
        return SPIN_OK;
    r->info->keyframes = spin_4dgs_is(&model, SPIN_4DGS_STATES);
    if (!spin_4dgs_is(&model, SPIN_4DGS_MODEL) && !r->info->keyframes)
        return spin_unsupported("header: temporal model '%.*s', expected '" SPIN_4DGS_MODEL
                                "' or '" SPIN_4DGS_STATES "'",
                                length_of(&model), (const char *)model.at);
    if (!(r->info->duration > 0) || !isfinite(r->info->duration))
        return spin_malformed("header: the duration is %g, expected above 0", r->info->duration);
    if (!(r->info->cutoff > 0) || r->info->cutoff > 1)
        return spin_malformed("header: the cutoff is %g, expected above 0 and at most 1",
                              r->info->cutoff);
    if (degree > 3)
        return spin_unsupported("header: the SH degree is %u, expected 0 to 3", degree);
    r->splats->sh_degree = (int)degree;
    return SPIN_OK;
}

static spin_status read_quantization(struct reader *r, struct spin_4dgs_cursor *c)
{
    struct spin_4dgs_cursor scheme = spin_4dgs_block(c, 4);
    double sum = 0;

    if (!c->cut && !spin_4dgs_is(&scheme, SPIN_4DGS_SCHEME))
        return spin_unsupported("quantization: scheme '%.*s', expected '" SPIN_4DGS_SCHEME "'",
                                length_of(&scheme), (const char *)scheme.at);
    for (int k = 0; k < 3; k++)
        sum += fabs(r->origin[k] = spin_4dgs_double(c));
    for (int k = 0; k < SPIN_4DGS_N_STEPS; k++)
        sum += fabs(r->step[k] = spin_4dgs_double(c));
    return isfinite(sum) ? SPIN_OK
                         : spin_malformed("quantization: the origin or a step is not finite");
}

static spin_status read_windows(struct reader *r, struct spin_4dgs_cursor *c)
{
    uint64_t n = spin_4dgs_number(c, 4);

    if (c->cut || n > c->left / 16)
        return spin_malformed("window table: %llu windows do not fit into %zu bytes",
                              (unsigned long long)n, c->left);
    if (n == 0)
        return spin_malformed("the window table is empty, so no splat is visible");
    r->n_windows = (size_t)n;
    SPIN_TRY(spin_alloc(r->n_windows, 2 * sizeof *r->window, (void **)&r->window));
    for (size_t i = 0; i < 2 * r->n_windows; i++) {
        r->window[i] = spin_4dgs_double(c);
        if (isnan(r->window[i]))
            return spin_malformed("window table: the start or end of window %zu is NaN", i / 2);
    }
    return SPIN_OK;
}

/* Parses a text of at most 31 characters as a number above 0. Returns 0 for all other texts. */
static double read_rate(const struct spin_4dgs_cursor *text)
{
    char copy[32] = "", *end = copy;
    double rate;

    if (text->left == 0 || text->left >= sizeof copy)
        return 0;
    memcpy(copy, text->at, text->left);
    rate = strtod(copy, &end);
    return *end == '\0' && rate > 0 && isfinite(rate) ? rate : 0;
}

/* Reads antialiasing, frame rate and start of the sound from the metadata record that spin4d
 * writes. Metadata of other programs are ignored, even if they are malformed. */
static void read_metadata(struct reader *r, const struct spin_4dgs_cursor *record)
{
    struct spin_4dgs_cursor c = *record, name = spin_4dgs_block(&c, 4), map;

    map = spin_4dgs_block(&c, 4);
    while (spin_4dgs_is(&name, SPIN_4DGS_METADATA) && !c.cut && !map.cut && map.left > 0) {
        struct spin_4dgs_cursor key = spin_4dgs_block(&map, 4), value = spin_4dgs_block(&map, 4);

        if (spin_4dgs_is(&key, SPIN_4DGS_ANTIALIAS) && spin_4dgs_is(&value, "true"))
            r->splats->antialias = true;
        if (spin_4dgs_is(&key, SPIN_4DGS_FPS))
            r->info->fps = read_rate(&value);
        if (spin_4dgs_is(&key, SPIN_4DGS_SOUND_START) && value.left > 0 && *value.at == '-') {
            spin_4dgs_bytes(&value, 1);
            r->sounds.start = -read_rate(&value);
        }
    }
}

/* Verifies the checksum of the records from the index to the footer. at: offset of the footer. */
static spin_status read_footer(const struct reader *r, struct spin_4dgs_cursor *c, size_t at)
{
    uint64_t start = spin_4dgs_number(c, 8);
    uint32_t crc;

    spin_4dgs_number(c, 8);
    crc = (uint32_t)spin_4dgs_number(c, 4);
    if (c->cut || start == 0 || crc == 0)
        return SPIN_OK;
    if (start > at || spin_crc32(0, r->file + start, at - (size_t)start) != crc)
        return spin_malformed("footer: the checksum of the index is wrong");
    return SPIN_OK;
}

/* ---- Chunks ---------------------------------------------------------------------------------- */

/* Rounds the start or end of a window down to a float. A window is half-open, so rounding down
 * keeps a splat visible at its start and invisible at its end. */
static float round_down(double x)
{
    float f = (float)spin_4dgs_clamp(x, -(double)SPIN_FOREVER, (double)SPIN_FOREVER);

    return (double)f > x ? nextafterf(f, -INFINITY) : f;
}

static void fill_row(const struct reader *r, size_t k, const double interval[2])
{
    const struct spin_splats_4d *s = r->splats;
    int32_t *const *steps = r->steps;
    const double *window = r->window + 2 * steps[SPIN_4DGS_WINDOW][k];
    bool never_fades = steps[SPIN_4DGS_FLAGS][k] & SPIN_4DGS_NEVER_FADES;
    double sigma = exp(steps[SPIN_4DGS_SIGMA][k] * r->step[SPIN_4DGS_STEP_SIGMA]);
    double v = spin_4dgs_motion_step(
        r->step, never_fades ? window[1] - window[0] : sqrt(-2 * log(r->info->cutoff)) * sigma);
    const int32_t *colour = steps[SPIN_4DGS_COLOUR] + 3 * k;
    size_t i = r->first + k, n_sh = 3 + spin_n_rest(s->sh_degree);

    for (size_t c = 0; c < 3; c++) {
        double bin = c == 1 ? colour[0] : (double)colour[0] + colour[c == 0 ? 1 : 2];

        s->centres[3 * i + c] = (float)(r->origin[c] + steps[SPIN_4DGS_POSITION][3 * k + c] *
                                                           r->step[SPIN_4DGS_STEP_POSITION]);
        s->log_scales[3 * i + c] =
            (float)(steps[SPIN_4DGS_SCALE][3 * k + c] * r->step[SPIN_4DGS_STEP_SCALE]);
        s->paths[3 * i + c] = (float)(steps[SPIN_4DGS_MOTION][3 * k + c] * v);
        s->sh[n_sh * i + c] =
            (float)((spin_4dgs_clamp(bin * r->step[SPIN_4DGS_STEP_COLOUR], 0, 1) - 0.5) /
                    SPIN_SH_C0);
    }
    spin_4dgs_rotation(steps[SPIN_4DGS_ROTATION] + 3 * k, steps[SPIN_4DGS_LARGEST][k],
                       r->step[SPIN_4DGS_STEP_ROTATION], s->quats + 4 * i);
    s->logit_opacities[i] = spin_opacity_logit((float)spin_4dgs_clamp(
        steps[SPIN_4DGS_OPACITY][k] * r->step[SPIN_4DGS_STEP_OPACITY], 0, 1));
    s->times[i] =
        (float)(steps[SPIN_4DGS_MU][k] *
                (never_fades ? r->step[SPIN_4DGS_STEP_TIME] : spin_4dgs_time_step(r->step, sigma)));
    s->sigmas[i] = never_fades ? SPIN_FOREVER : (float)fmin(sigma, (double)SPIN_FOREVER);
    s->cuts[2 * i] = round_down(fmax(window[0], interval[0]));
    s->cuts[2 * i + 1] = round_down(fmin(window[1], interval[1]));
}

static spin_status check_row(const struct reader *r, size_t k)
{
    if (r->steps[SPIN_4DGS_WINDOW][k] < 0 || (size_t)r->steps[SPIN_4DGS_WINDOW][k] >= r->n_windows)
        return spin_malformed("'window_index' is %d in row %zu, but there are %zu windows",
                              r->steps[SPIN_4DGS_WINDOW][k], k, r->n_windows);
    if (r->steps[SPIN_4DGS_LARGEST][k] < 0 || r->steps[SPIN_4DGS_LARGEST][k] > 3)
        return spin_malformed("'rotation_index' is %d in row %zu, expected 0 to 3",
                              r->steps[SPIN_4DGS_LARGEST][k], k);
    return SPIN_OK;
}

static spin_status read_rows(struct reader *r, const double interval[2])
{
    for (size_t k = 0; k < r->n_in_chunk; k++) {
        SPIN_TRY(check_row(r, k));
        fill_row(r, k, interval);
    }
    return SPIN_OK;
}

static void free_steps(struct reader *r)
{
    for (int a = 0; a < SPIN_4DGS_N_ATTRIBUTES; a++) {
        free(r->steps[a]);
        r->steps[a] = NULL;
    }
}

/* Reads the streams of a chunk, in any order. Skips streams of unknown attributes. */
static spin_status read_streams(struct reader *r, struct spin_4dgs_cursor *c,
                                const double interval[2])
{
    while (c->left > 0) {
        struct spin_4dgs_stream s = spin_4dgs_stream_head(c);

        if (c->cut)
            return spin_malformed("a stream extends beyond the chunk");
        if (s.attribute >= SPIN_4DGS_N_ATTRIBUTES)
            continue;
        if (r->steps[s.attribute])
            return spin_malformed("stream '%s' occurs twice",
                                  spin_4dgs_attributes[s.attribute].name);
        SPIN_TRY_IN(spin_4dgs_stream_read(&s, r->n_in_chunk,
                                          spin_4dgs_attributes[s.attribute].channels,
                                          &r->steps[s.attribute]),
                    "stream '%s'", spin_4dgs_attributes[s.attribute].name);
    }
    for (int a = 0; a < SPIN_4DGS_N_ATTRIBUTES; a++)
        if (!r->steps[a])
            return spin_malformed("stream '%s' is missing", spin_4dgs_attributes[a].name);
    return read_rows(r, interval);
}

static spin_status read_chunk_block(struct reader *r, struct spin_4dgs_cursor *block,
                                    const struct spin_4dgs_cursor *codec, uint64_t bytes,
                                    const double interval[2])
{
    SPIN_FREED unsigned char *plain = NULL;

    SPIN_TRY(spin_4dgs_open(block, codec, bytes, &plain));
    return read_streams(r, block, interval);
}

/* Checks that the current chunk had all SH bands of the file's degree. */
static spin_status end_chunk(const struct reader *r)
{
    if (r->n_in_chunk > 0 && r->bands != (1u << r->splats->sh_degree) - 1)
        return spin_malformed("chunk %zu: an SH band is missing, expected bands 1 to %d",
                              r->n_chunks - 1, r->splats->sh_degree);
    return SPIN_OK;
}

/* Counts the splats of a chunk. In the second pass, in which the memory is allocated, also reads
 * the splats. */
static spin_status read_chunk(struct reader *r, struct spin_4dgs_cursor *c)
{
    double interval[2];
    struct spin_4dgs_cursor codec, block;
    uint64_t bytes, n;
    spin_status status;

    interval[0] = spin_4dgs_double(c);
    interval[1] = spin_4dgs_double(c);
    spin_4dgs_number(c, 4);
    n = spin_4dgs_number(c, 4);
    codec = spin_4dgs_block(c, 4);
    bytes = spin_4dgs_number(c, 8);
    block = spin_4dgs_block(c, 8);
    if (c->cut)
        return SPIN_OK;
    r->n += n;
    if (!r->splats->centres)
        return SPIN_OK;
    SPIN_TRY(end_chunk(r));
    r->first += r->n_in_chunk;
    r->n_in_chunk = (size_t)n;
    r->bands = 0;
    r->n_chunks++;
    if (n == 0)
        return SPIN_OK;
    if (isnan(interval[0]) || isnan(interval[1]))
        status = spin_malformed("the start or end of the interval is NaN");
    else
        status = read_chunk_block(r, &block, &codec, bytes, interval);
    free_steps(r);
    return spin_fail_context(status, "chunk %zu", r->n_chunks - 1);
}

/* Reads an SH band: for each splat all coefficients of red, then of green, then of blue. The codes
 * 0..255 are mapped to -4..4. */
static spin_status read_band(struct reader *r, struct spin_4dgs_cursor *c)
{
    const struct spin_splats_4d *s = r->splats;
    size_t n_sh = 3 + spin_n_rest(s->sh_degree), b = (size_t)spin_4dgs_number(c, 1),
           width = 2 * b + 1;
    struct spin_4dgs_stream stream = spin_4dgs_stream_head(c);
    SPIN_FREED int32_t *codes = NULL;
    spin_status status;

    if (c->cut || !s->centres || (r->n_chunks > 0 && r->n_in_chunk == 0))
        return SPIN_OK;
    if (b < 1 || b > (size_t)s->sh_degree || r->n_chunks == 0 || r->bands & 1u << (b - 1))
        return spin_malformed("SH band %zu occurs twice, precedes all chunks, or is above the SH "
                              "degree %d of the file",
                              b, s->sh_degree);
    r->bands |= 1u << (b - 1);
    status = spin_4dgs_stream_read(&stream, r->n_in_chunk, (int)(3 * width), &codes);
    for (size_t k = 0; status == SPIN_OK && k < 3 * width * r->n_in_chunk; k++) {
        size_t row = k / (3 * width), channel = k / width % 3, m = k % width;

        if (codes[k] < 0 || codes[k] > 255)
            status = spin_malformed("code %d in row %zu, expected 0 to 255", codes[k], row);
        s->sh[n_sh * (r->first + row) + 3 * (b * b + m) + channel] =
            (float)(codes[k] * 8 / 255.0 - 4);
    }
    return spin_fail_context(status, "chunk %zu: SH band %zu", r->n_chunks - 1, b);
}

/* ---- Keyframes and deltas -------------------------------------------------------------------- */

static spin_status read_state_record(struct reader *r, unsigned opcode, struct spin_4dgs_cursor *c,
                                     size_t at)
{
    struct spin_4dgs_states *states = &r->states;

    if (states->n_indexed > 0 && opcode != SPIN_4DGS_REC_INDEX)
        return spin_malformed("record %02x at byte %zu follows the index, expected before it",
                              opcode, at);
    states->sh_degree = r->splats->sh_degree;
    states->most_rows = (SPIN_4DGS_SLACK + (uint64_t)SPIN_4DGS_RATIO * r->size) / ROW_BYTES;
    return opcode == SPIN_4DGS_REC_CHUNK         ? spin_4dgs_states_keyframe(states, c, at)
           : opcode == SPIN_4DGS_REC_DELTA_CHUNK ? spin_4dgs_states_delta(states, c, at)
           : opcode == SPIN_4DGS_REC_SH_BAND     ? spin_4dgs_states_band(states, c)
                                                 : spin_4dgs_states_index(states, c);
}

/* Sets r->steps[a] to the integers of attribute a in all rows of the states. */
static spin_status gather_steps(struct reader *r, int a)
{
    const struct spin_4dgs_states *states = &r->states;
    size_t width = (size_t)spin_4dgs_attributes[a].channels, from = 0;

    for (int k = 0; k < a; k++)
        from += (size_t)spin_4dgs_attributes[k].channels;
    SPIN_TRY(spin_alloc(states->n_rows, width * sizeof(int32_t), (void **)&r->steps[a]));
    for (size_t i = 0; i < states->n_rows; i++)
        memcpy(r->steps[a] + width * i, states->row[i].splat.bin + from, width * sizeof(int32_t));
    return SPIN_OK;
}

/* Converts each row of the states to a 4D splat that is visible only in the interval of the row. */
static spin_status fill_states(struct reader *r)
{
    struct spin_4dgs_states *states = &r->states;
    struct spin_splats_4d *s = r->splats;
    size_t n_rest = spin_n_rest(s->sh_degree), n_sh = 3 + n_rest;

    SPIN_TRY(spin_4dgs_states_end(states, r->info->duration, r->n_said));
    SPIN_TRY(spin_splats_4d_reserve(s, states->n_rows, 1, s->sh_degree, SPIN_4D_CUTS));
    s->least_weight = r->info->cutoff;
    if (r->info->fps == 0)
        r->info->fps = spin_4dgs_states_rate(states, r->info->duration);
    for (int a = 0; a < SPIN_4DGS_N_ATTRIBUTES; a++)
        SPIN_TRY(gather_steps(r, a));
    for (size_t i = 0; i < states->n_rows; i++) {
        SPIN_TRY(check_row(r, i));
        fill_row(r, i, states->row[i].interval);
        for (size_t k = 0; k < n_rest; k++)
            s->sh[n_sh * i + 3 + k] = (float)(states->row[i].splat.sh[k] * 8 / 255.0 - 4);
    }
    return SPIN_OK;
}

/* ---- The file -------------------------------------------------------------------------------- */

/* Reads a sound record in the first pass, and skips it in the second pass. */
static spin_status read_sound(struct reader *r, unsigned opcode, struct spin_4dgs_cursor *c)
{
    if (r->splats->centres)
        return SPIN_OK;
    r->sounds.late |= r->has_chunks;
    if (opcode == SPIN_4DGS_REC_SOUND_SOURCE)
        return read_sound_source(&r->sounds, c, r->info->duration);
    if (opcode == SPIN_4DGS_REC_SOUND_DATA)
        return read_sound_data(&r->sounds, c);
    r->sounds.old = true;
    return SPIN_OK;
}

/* Reads a record in the first or second pass over the file. The first pass reads the records that
 * occur once and counts the splats; the second pass reads the splats. */
static spin_status read_record(struct reader *r, unsigned opcode, struct spin_4dgs_cursor *c,
                               size_t at)
{
    bool first_pass = !r->splats->centres, once = opcode <= SPIN_4DGS_REC_WINDOWS;

    if (once && first_pass) {
        if (opcode < SPIN_4DGS_REC_HEADER || r->seen & 1u << opcode)
            return spin_malformed("record %02x occurs twice or is invalid", opcode);
        if (opcode != SPIN_4DGS_REC_HEADER && !(r->seen & 1u << SPIN_4DGS_REC_HEADER))
            return spin_malformed("record %02x precedes the header", opcode);
        r->seen |= 1u << opcode;
    }
    r->has_chunks |= opcode == SPIN_4DGS_REC_CHUNK;
    if (r->info->keyframes && opcode != SPIN_4DGS_REC_HEADER)
        switch (opcode) {
        case SPIN_4DGS_REC_CHUNK:
        case SPIN_4DGS_REC_DELTA_CHUNK:
        case SPIN_4DGS_REC_SH_BAND:
        case SPIN_4DGS_REC_INDEX:
            return read_state_record(r, opcode, c, at);
        default:
            break;
        }
    switch (opcode) {
    case SPIN_4DGS_REC_HEADER:
        return first_pass ? read_header(r, c) : SPIN_OK;
    case SPIN_4DGS_REC_QUANTIZATION:
        return first_pass ? read_quantization(r, c) : SPIN_OK;
    case SPIN_4DGS_REC_WINDOWS:
        return first_pass ? read_windows(r, c) : SPIN_OK;
    case SPIN_4DGS_REC_FOOTER:
        return first_pass ? read_footer(r, c, at) : SPIN_OK;
    case SPIN_4DGS_REC_CHUNK:
        return read_chunk(r, c);
    case SPIN_4DGS_REC_SH_BAND:
        return read_band(r, c);
    case SPIN_4DGS_REC_DELTA_CHUNK:
        return spin_malformed("record 10 is a delta chunk, which the model '" SPIN_4DGS_MODEL
                              "' does not have");
    case SPIN_4DGS_REC_OBJECT_TRACK:
        spin_4dgs_bytes(c, 5);
        return spin_4dgs_number(c, 4) == 0 ? SPIN_OK
                                           : spin_unsupported("object tracks are not supported");
    case SPIN_4DGS_REC_CAMERA:
        r->info->camera = true;
        return SPIN_OK;
    case SPIN_4DGS_REC_METADATA:
        read_metadata(r, c);
        return SPIN_OK;
    case SPIN_4DGS_REC_SOUND:
    case SPIN_4DGS_REC_SOUND_SOURCE:
    case SPIN_4DGS_REC_SOUND_DATA:
        return read_sound(r, opcode, c);
    default:
        return SPIN_OK;
    }
}

static spin_status read_records(struct reader *r)
{
    struct spin_4dgs_cursor file = {r->file + SPIN_4DGS_MAGIC_BYTES,
                                    r->size - 2 * SPIN_4DGS_MAGIC_BYTES, false};
    unsigned opcode = 0;

    r->n = 0;
    while (file.left > 0) {
        size_t at = (size_t)(file.at - r->file);
        struct spin_4dgs_cursor record;

        opcode = (unsigned)spin_4dgs_number(&file, 1);
        record = spin_4dgs_block(&file, 8);
        if (file.cut)
            return spin_malformed("record %02x at byte %zu extends beyond the file", opcode, at);
        SPIN_TRY(read_record(r, opcode, &record, at));
        if (record.cut)
            return spin_malformed("record %02x at byte %zu is too short", opcode, at);
    }
    if (opcode != SPIN_4DGS_REC_FOOTER)
        return spin_malformed("the last record is not a footer");
    return r->splats->centres ? end_chunk(r) : SPIN_OK;
}

static spin_status read_all(struct reader *r)
{
    static const unsigned all = 1u << SPIN_4DGS_REC_HEADER | 1u << SPIN_4DGS_REC_QUANTIZATION |
                                1u << SPIN_4DGS_REC_WINDOWS | 1u << SPIN_4DGS_REC_FOOTER;

    if (r->size < 2 * SPIN_4DGS_MAGIC_BYTES ||
        memcmp(r->file, SPIN_4DGS_MAGIC, SPIN_4DGS_MAGIC_BYTES) != 0)
        return spin_malformed("not a .4dgs of version 1: the magic number is missing");
    if (memcmp(r->file + r->size - SPIN_4DGS_MAGIC_BYTES, SPIN_4DGS_MAGIC, SPIN_4DGS_MAGIC_BYTES) !=
        0)
        return spin_malformed("truncated: the magic number at the end of the file is missing");
    SPIN_TRY(read_records(r));
    if (r->seen != all)
        return spin_malformed("record '%s' is missing",
                              !(r->seen & 1u << SPIN_4DGS_REC_QUANTIZATION) ? "quantization"
                                                                            : "window table");
    SPIN_TRY(finish_sounds(&r->sounds, &r->info->sound, r->info->sound_notes,
                           sizeof r->info->sound_notes));
    if (r->info->keyframes)
        return fill_states(r);
    if (r->n != r->n_said)
        return spin_malformed("the chunks contain %llu splats, the header declares %llu",
                              (unsigned long long)r->n, (unsigned long long)r->n_said);
    if (r->n == 0)
        return spin_malformed("the file contains no splats");
    if (r->n * ROW_BYTES > SPIN_4DGS_SLACK + (uint64_t)SPIN_4DGS_RATIO * r->size)
        return spin_malformed("a file of %zu bytes cannot contain %llu splats", r->size,
                              (unsigned long long)r->n);
    SPIN_TRY(
        spin_splats_4d_reserve(r->splats, (size_t)r->n, 1, r->splats->sh_degree, SPIN_4D_CUTS));
    r->splats->least_weight = r->info->cutoff;
    return read_records(r);
}

spin_status spin_4dgs_read(const unsigned char *file, size_t size, struct spin_4dgs *out,
                           struct spin_splats_4d *splats)
{
    struct reader r = {.file = file, .size = size, .info = out, .splats = splats};
    spin_status status;

    *out = (struct spin_4dgs){0};
    status = read_all(&r);
    free_steps(&r);
    free(r.window);
    free(r.sounds.source);
    spin_4dgs_states_free(&r.states);
    return status;
}
