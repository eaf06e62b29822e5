#include "formats/4dgs_write.h"

#include <math.h>

#include "base/text.h"
#include "formats/planes.h"
#include "io/sound.h"
#include "io/file.h"
#include "io/gzip.h"

enum { RAW, DIFFERENCE, CONSTANT };
enum { STATISTICS = 12, SOUND_ID = 1, SH_CODES = 7, PLUS_Y = 1, MINUS_Z = 5, RIGHT_HANDED = 1 };

/* Relative errors of scales and sigmas that the file states. */
#define RELATIVE (1 / 256.0)

struct spin_4dgs_entry {
    double interval[2];
    uint64_t at, bytes;
    size_t n, n_live;   /* numbers of splats in the chunk and in the state */
    uint64_t reference; /* offset of the chunk that a delta changes */
    uint64_t key;       /* offset of the keyframe */
    unsigned depth;     /* number of deltas since the keyframe, including this one */
    int n_bands;
    struct {
        uint64_t at, bytes;
    } band[3];
};

/* ---- Records --------------------------------------------------------------------------------- */

static void put_number(FILE *to, uint64_t value, int bytes)
{
    for (int b = 0; b < bytes; b++)
        fputc((int)(value >> (8 * b) & 255), to);
}

static void put_double(FILE *to, double value)
{
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    put_number(to, bits, 8);
}

static void put_doubles(FILE *to, const double *value, int n)
{
    for (int k = 0; k < n; k++)
        put_double(to, value[k]);
}

static void put_text(FILE *to, const char *text)
{
    put_number(to, strlen(text), 4);
    fputs(text, to);
}

static spin_status begin_record(struct spin_4dgs_writer *w)
{
    w->record = spin_text_open(&w->text, &w->n_text);
    return w->record ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "no memory for a record");
}

/* Ends the current record and writes it to the end of the file. */
static spin_status end_record(struct spin_4dgs_writer *w, unsigned opcode)
{
    unsigned char head[9] = {(unsigned char)opcode};
    bool failed = fclose(w->record) != 0;
    spin_status status = SPIN_OK;

    w->record = NULL;
    if (failed)
        status = spin_fail(SPIN_E_MEMORY, "no memory for a record");
    for (int b = 0; b < 8; b++)
        head[1 + b] = (unsigned char)((uint64_t)w->n_text >> (8 * b));
    if (status == SPIN_OK)
        status = spin_out_write(w->out, head, sizeof head);
    if (status == SPIN_OK)
        status = spin_out_write(w->out, w->text, w->n_text);
    free(w->text);
    w->text = NULL;
    return status;
}

/* ---- Streams --------------------------------------------------------------------------------- */

/* A stream as it is stored. */
struct packed {
    unsigned mode, symbol;
    unsigned char *data;
    size_t n;
};

/* Maps n integers, `back` of them in each row, to unsigned symbols: their zigzag codes or, with
 * mode DIFFERENCE, those of the differences from the row before. Returns the bytes that each symbol
 * needs; 0: a difference does not fit into 32 bits. */
static unsigned zigzag(const int32_t *value, size_t n, size_t back, unsigned mode, uint32_t *symbol)
{
    uint32_t all = 0;

    for (size_t i = 0; i < n; i++) {
        int64_t v = value[i] - (mode == DIFFERENCE && i >= back ? (int64_t)value[i - back] : 0);

        if (v < INT32_MIN || v > INT32_MAX)
            return 0;
        symbol[i] = spin_zigzag((int32_t)v);
        all |= symbol[i];
    }
    return all < 1u << 8 ? 1 : all < 1u << 16 ? 2 : 4;
}

static spin_status pack(const int32_t *value, size_t n, size_t channels, unsigned mode,
                        struct packed *out)
{
    size_t n_symbols = mode == CONSTANT ? channels : n * channels;
    SPIN_FREED uint32_t *symbol = NULL;
    SPIN_FREED unsigned char *planes = NULL;

    *out = (struct packed){.mode = mode};
    SPIN_TRY(spin_alloc(n_symbols, sizeof *symbol, (void **)&symbol));
    out->symbol = zigzag(value, n_symbols, channels, mode, symbol);
    if (out->symbol == 0)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n_symbols, out->symbol, (void **)&planes));
    for (size_t b = 0; b < out->symbol; b++)
        for (size_t i = 0; i < n_symbols; i++)
            planes[b * n_symbols + i] = (unsigned char)(symbol[i] >> (8 * b));
    return spin_zlib_write(planes, n_symbols * out->symbol, &out->data, &out->n);
}

/* Packs integers in the mode that needs the fewest bytes. */
static spin_status pack_smallest(const int32_t *value, size_t n, size_t channels,
                                 struct packed *out)
{
    struct packed other;
    size_t i = channels;

    while (i < n * channels && value[i] == value[i - channels])
        i++;
    if (i == n * channels)
        return pack(value, n, channels, CONSTANT, out);
    SPIN_TRY(pack(value, n, channels, RAW, out));
    SPIN_TRY(pack(value, n, channels, DIFFERENCE, &other));
    if (other.data && other.n < out->n) {
        free(out->data);
        *out = other;
    } else
        free(other.data);
    return SPIN_OK;
}

static spin_status put_stream(FILE *to, unsigned attribute, const int32_t *value, size_t n,
                              size_t channels)
{
    struct packed packed = {0};
    spin_status status = pack_smallest(value, n, channels, &packed);

    put_number(to, attribute, 1);
    put_number(to, packed.symbol, 1);
    put_number(to, packed.mode, 1);
    put_number(to, 0, 1); /* codec: zlib */
    put_number(to, channels, 1);
    put_number(to, n, 4);
    put_number(to, packed.n, 8);
    if (packed.data)
        fwrite(packed.data, 1, packed.n, to);
    free(packed.data);
    return status;
}

/* ---- Chunks ---------------------------------------------------------------------------------- */

/* Writes the ids of n splats, which are `bytes` apart. */
static spin_status put_ids(FILE *to, const uint32_t *id, size_t n, size_t bytes)
{
    SPIN_FREED int32_t *value = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *value, (void **)&value));
    for (size_t i = 0; i < n; i++)
        memcpy(value + i, (const char *)id + i * bytes, sizeof *value);
    return put_stream(to, SPIN_4DGS_ID, value, n, 1);
}

static spin_status put_attributes(FILE *to, bool ids, const struct spin_4dgs_splat *splat, size_t n)
{
    SPIN_FREED int32_t *value = NULL;
    size_t from = 0;

    if (n == 0)
        return SPIN_OK;
    if (ids)
        SPIN_TRY(put_ids(to, &splat->id, n, sizeof *splat));
    SPIN_TRY(spin_alloc(n, 3 * sizeof *value, (void **)&value));
    for (unsigned a = 0; a < SPIN_4DGS_N_ATTRIBUTES; a++) {
        size_t channels = (size_t)spin_4dgs_attributes[a].channels;

        for (size_t i = 0; i < n; i++)
            memcpy(value + channels * i, splat[i].bin + from, channels * sizeof *value);
        SPIN_TRY(put_stream(to, a, value, n, channels));
        from += channels;
    }
    return SPIN_OK;
}

static spin_status write_attributes(struct spin_4dgs_writer *w, const double interval[2],
                                    const struct spin_4dgs_splat *splat, size_t n)
{
    SPIN_FREED char *streams = NULL;
    size_t size = 0;
    FILE *to = spin_text_open(&streams, &size);
    spin_status status;

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "no memory for a chunk");
    status = put_attributes(to, w->coding->key_every > 0, splat, n);
    if (fclose(to) != 0 && status == SPIN_OK)
        status = spin_fail(SPIN_E_MEMORY, "no memory for a chunk");
    SPIN_TRY(status);
    SPIN_TRY(begin_record(w));
    put_doubles(w->record, interval, 2);
    put_number(w->record, 0, 4); /* level */
    put_number(w->record, n, 4);
    put_text(w->record, ""); /* no codec: only the streams are compressed */
    put_number(w->record, size, 8);
    put_number(w->record, size, 8);
    fwrite(streams, 1, size, w->record);
    return end_record(w, SPIN_4DGS_REC_CHUNK);
}

/* Writes SH band b: all coefficients of red, then green, then blue. */
static spin_status write_band(struct spin_4dgs_writer *w, const struct spin_4dgs_splat *splat,
                              size_t n, size_t b)
{
    size_t width = 2 * b + 1;
    SPIN_FREED int32_t *code = NULL;

    SPIN_TRY(spin_alloc(n, 3 * width * sizeof *code, (void **)&code));
    for (size_t k = 0; k < 3 * width * n; k++) {
        size_t channel = k / width % 3, m = k % width;

        code[k] = splat[k / (3 * width)].sh[3 * (b * b + m - 1) + channel];
    }
    SPIN_TRY(begin_record(w));
    put_number(w->record, b, 1);
    SPIN_TRY(put_stream(w->record, SH_CODES, code, n, 3 * width));
    return end_record(w, SPIN_4DGS_REC_SH_BAND);
}

static spin_status begin_chunk(struct spin_4dgs_writer *w, const double interval[2],
                               struct spin_4dgs_entry **entry)
{
    SPIN_TRY(spin_grow(w->n_entries + 1, sizeof *w->entry, (void **)&w->entry));
    *entry = &w->entry[w->n_entries++];
    **entry = (struct spin_4dgs_entry){{interval[0], interval[1]}, .at = w->out->bytes};
    return SPIN_OK;
}

/* Ends a chunk with the SH bands of its n new splats. */
static spin_status end_chunk(struct spin_4dgs_writer *w, struct spin_4dgs_entry *entry,
                             const struct spin_4dgs_splat *splat, size_t n)
{
    entry->bytes = w->out->bytes - entry->at;
    entry->n_bands = n > 0 ? w->coding->sh_degree : 0;
    for (int b = 0; b < entry->n_bands; b++) {
        entry->band[b].at = w->out->bytes;
        SPIN_TRY(write_band(w, splat, n, (size_t)b + 1));
        entry->band[b].bytes = w->out->bytes - entry->band[b].at;
    }
    return SPIN_OK;
}

spin_status spin_4dgs_write_chunk(struct spin_4dgs_writer *w, const double interval[2],
                                  const struct spin_4dgs_splat *splat, size_t n)
{
    struct spin_4dgs_entry *entry;

    SPIN_TRY(begin_chunk(w, interval, &entry));
    entry->key = entry->at;
    entry->n = entry->n_live = n;
    SPIN_TRY(write_attributes(w, interval, splat, n));
    return end_chunk(w, entry, splat, n);
}

/* ---- Deltas ---------------------------------------------------------------------------------- */

/* Sets value[n][channels] to the integers of an update: for rotations the new integers, for other
 * attributes the differences from the old ones. Returns whether any integer has changed. */
static bool find_differences(const struct spin_4dgs_changes *c, size_t from, size_t channels,
                             bool whole, int32_t *value)
{
    bool differs = false;

    for (size_t i = 0; i < c->n_updates; i++)
        for (size_t k = 0; k < channels; k++) {
            int32_t is = c->after[i].bin[from + k], was = c->before[i].bin[from + k];

            value[channels * i + k] = whole ? is : is - was;
            differs |= is != was;
        }
    return differs;
}

/* Writes those attributes that change in at least one splat. The two attributes of a rotation are
 * always written together. */
static spin_status put_updates(FILE *to, const struct spin_4dgs_changes *c)
{
    SPIN_FREED int32_t *value = NULL;
    bool rotates = false;
    size_t from = 0;

    SPIN_TRY(spin_alloc(c->n_updates, 4 * sizeof *value, (void **)&value));
    SPIN_TRY(put_ids(to, &c->after->id, c->n_updates, sizeof *c->after));
    for (unsigned a = 0; a < SPIN_4DGS_SIGMA; a++) {
        size_t channels = (size_t)spin_4dgs_attributes[a].channels;
        bool whole = a == SPIN_4DGS_LARGEST || a == SPIN_4DGS_ROTATION;

        if (a == SPIN_4DGS_LARGEST)
            rotates = find_differences(c, from, 4, true, value);
        if (find_differences(c, from, channels, whole, value) || (whole && rotates))
            SPIN_TRY(put_stream(to, a, value, c->n_updates, channels));
        from += channels;
    }
    return SPIN_OK;
}

enum { UPDATES, BIRTHS, DEATHS };

static spin_status put_group(FILE *to, const struct spin_4dgs_changes *c, int group)
{
    if (group == BIRTHS)
        return put_attributes(to, true, c->born, c->n_births);
    if (group == DEATHS && c->n_deaths > 0)
        return put_ids(to, c->death, c->n_deaths, sizeof *c->death);
    return group == UPDATES && c->n_updates > 0 ? put_updates(to, c) : SPIN_OK;
}

/* Writes the three groups to memory, each after its length. */
static spin_status put_groups(FILE *to, const struct spin_4dgs_changes *c)
{
    for (int group = UPDATES; group <= DEATHS; group++) {
        SPIN_FREED char *streams = NULL;
        size_t size = 0;
        FILE *part = spin_text_open(&streams, &size);
        spin_status status = part ? put_group(part, c, group) : SPIN_E_MEMORY;

        if (!part || (fclose(part) != 0 && status == SPIN_OK))
            return spin_fail(SPIN_E_MEMORY, "no memory for a chunk");
        SPIN_TRY(status);
        put_number(to, size, 8);
        fwrite(streams, 1, size, to);
    }
    return SPIN_OK;
}

static spin_status write_groups(struct spin_4dgs_writer *w, const struct spin_4dgs_changes *c)
{
    SPIN_FREED char *groups = NULL;
    size_t size = 0;
    FILE *to = spin_text_open(&groups, &size);
    spin_status status = to ? put_groups(to, c) : SPIN_E_MEMORY;

    if (!to || (fclose(to) != 0 && status == SPIN_OK))
        return spin_fail(SPIN_E_MEMORY, "no memory for a chunk");
    SPIN_TRY(status);
    put_text(w->record, ""); /* no codec: only the streams are compressed */
    put_number(w->record, size, 8);
    put_number(w->record, size, 8);
    fwrite(groups, 1, size, w->record);
    return SPIN_OK;
}

spin_status spin_4dgs_write_delta(struct spin_4dgs_writer *w, const double interval[2],
                                  const struct spin_4dgs_changes *c)
{
    struct spin_4dgs_entry *entry;

    SPIN_TRY(begin_chunk(w, interval, &entry));
    entry->n = c->n_updates + c->n_births + c->n_deaths;
    entry->n_live = c->n_live;
    entry->reference = entry[-1].at;
    entry->key = entry[-1].key;
    entry->depth = entry[-1].depth + 1;
    SPIN_TRY(begin_record(w));
    put_doubles(w->record, interval, 2);
    put_number(w->record, 0, 4); /* level */
    put_number(w->record, SPIN_4DGS_CHAINED, 1);
    put_number(w->record, entry->reference, 8);
    put_number(w->record, entry->key, 8);
    put_number(w->record, entry->depth, 2);
    put_number(w->record, c->n_updates, 4);
    put_number(w->record, c->n_births, 4);
    put_number(w->record, c->n_deaths, 4);
    SPIN_TRY(write_groups(w, c));
    SPIN_TRY(end_record(w, SPIN_4DGS_REC_DELTA_CHUNK));
    return end_chunk(w, entry, c->born, c->n_births);
}

/* ---- The beginning --------------------------------------------------------------------------- */

/* Returns the largest power of 2 that is at most x. */
static double power_of_2(double x) { return exp2(floor(log2(x))); }

void spin_4dgs_choose_steps(struct spin_4dgs_coding *c, double scale)
{
    double size = 1e-6, step;

    for (int k = 0; k < 3; k++) {
        c->origin[k] = 0.5 * (c->box[k] + c->box[3 + k]);
        size = fmax(size, c->box[3 + k] - c->box[k]);
    }
    /* The finest step keeps positions well within 32 bits. */
    step = power_of_2(fmax(scale / 16, ldexp(size, -28)));
    c->step[SPIN_4DGS_STEP_POSITION] = step;
    c->step[SPIN_4DGS_STEP_SCALE] = c->step[SPIN_4DGS_STEP_SIGMA] = 2 * log1p(RELATIVE);
    c->step[SPIN_4DGS_STEP_ROTATION] = ldexp(1, -10);
    c->step[SPIN_4DGS_STEP_COLOUR] = c->step[SPIN_4DGS_STEP_OPACITY] = ldexp(1, -9);
    /* A splat moves away from its centre in time for as long as it is visible, at most the whole
     * clip. */
    c->step[SPIN_4DGS_STEP_MOTION] = 2 * step / fmax(1, power_of_2(c->duration));
    c->step[SPIN_4DGS_STEP_TIME] = ldexp(1, -10);
}

/* The profile "keyframed" promises two or more states, and a limited number of deltas after each
 * keyframe. */
static const char *profile_of(const struct spin_4dgs_coding *c)
{
    return c->key_every > 0 && c->duration * c->fps > 1.5 ? "keyframed" : "";
}

static spin_status write_header(struct spin_4dgs_writer *w)
{
    const struct spin_4dgs_coding *c = w->coding;

    SPIN_TRY(begin_record(w));
    put_text(w->record, profile_of(c));
    put_text(w->record, "spin4d " SPIN_VERSION);
    put_double(w->record, c->duration);
    put_number(w->record, c->n, 8);
    put_double(w->record, c->cutoff);
    put_text(w->record, c->key_every > 0 ? SPIN_4DGS_STATES : SPIN_4DGS_MODEL);
    put_doubles(w->record, c->box, 6);
    put_number(w->record, (uint64_t)c->sh_degree, 1);
    put_number(w->record, c->sound != NULL, 1); /* flags */
    put_number(w->record, 0, 4);                /* attributes */
    return end_record(w, SPIN_4DGS_REC_HEADER);
}

/* Prints the stated errors, which are half of the steps. */
static void print_bounds(FILE *to, const struct spin_4dgs_coding *coding)
{
    static const struct {
        const char *name;
        int step;
    } bound[] = {{"alpha", SPIN_4DGS_STEP_OPACITY},
                 {"motion", SPIN_4DGS_STEP_MOTION},
                 {"pos", SPIN_4DGS_STEP_POSITION},
                 {"rgb", SPIN_4DGS_STEP_COLOUR},
                 {"rot", SPIN_4DGS_STEP_ROTATION},
                 {"scale_rel", SPIN_4DGS_STEP_SCALE},
                 {"sh", -1},
                 {"sigma_rel", SPIN_4DGS_STEP_SIGMA},
                 {"time", SPIN_4DGS_STEP_TIME}};
    char text[40];

    for (size_t k = 0; k < sizeof bound / sizeof *bound; k++) {
        int s = bound[k].step;
        bool relative = s == SPIN_4DGS_STEP_SCALE || s == SPIN_4DGS_STEP_SIGMA;

        snprintf(text, sizeof text, "%.17g", s < 0 ? 0 : relative ? RELATIVE : coding->step[s] / 2);
        put_text(to, bound[k].name);
        put_text(to, text);
    }
}

/* Writes a map to the current record: its size, and its pairs of texts. */
static spin_status put_map(FILE *to, void (*print)(FILE *to, const struct spin_4dgs_coding *coding),
                           const struct spin_4dgs_coding *coding)
{
    SPIN_FREED char *text = NULL;
    size_t n = 0;
    FILE *map = spin_text_open(&text, &n);

    if (map)
        print(map, coding);
    if (!map || fclose(map) != 0)
        return spin_fail(SPIN_E_MEMORY, "no memory for a record");
    put_number(to, n, 4);
    fwrite(text, 1, n, to);
    return SPIN_OK;
}

static spin_status write_quantization(struct spin_4dgs_writer *w)
{
    const struct spin_4dgs_coding *c = w->coding;

    SPIN_TRY(begin_record(w));
    put_text(w->record, SPIN_4DGS_SCHEME);
    put_doubles(w->record, c->origin, 3);
    put_doubles(w->record, c->step, SPIN_4DGS_N_STEPS);
    put_number(w->record, 1, 1); /* SH codes are not coarsened */
    SPIN_TRY(put_map(w->record, print_bounds, c));
    return end_record(w, SPIN_4DGS_REC_QUANTIZATION);
}

static spin_status write_windows(struct spin_4dgs_writer *w)
{
    SPIN_TRY(begin_record(w));
    put_number(w->record, w->coding->n_windows, 4);
    put_doubles(w->record, w->coding->window[0], (int)(2 * w->coding->n_windows));
    return end_record(w, SPIN_4DGS_REC_WINDOWS);
}

/* Writes the coordinate frame: right-handed, +y up, -z forward. The scale in metres is unknown,
 * which is written as 0. */
static spin_status write_frame(struct spin_4dgs_writer *w)
{
    static const unsigned char axes[4] = {RIGHT_HANDED, PLUS_Y, MINUS_Z, 0};

    SPIN_TRY(begin_record(w));
    put_text(w->record, "");
    fwrite(axes, 1, sizeof axes, w->record);
    put_double(w->record, 0);
    return end_record(w, SPIN_4DGS_REC_FRAME);
}

static void print_keyframes(FILE *to, const struct spin_4dgs_coding *coding)
{
    char text[32];

    put_text(to, "keyframe_interval_sec");
    snprintf(text, sizeof text, "%.9g", coding->key_every / coding->fps);
    put_text(to, text);
    put_text(to, "gop_max_depth");
    snprintf(text, sizeof text, "%d", coding->key_every - 1);
    put_text(to, text);
}

static void print_metadata(FILE *to, const struct spin_4dgs_coding *coding)
{
    char fps[32];

    snprintf(fps, sizeof fps, "%.9g", coding->fps);
    if (coding->key_every > 0)
        print_keyframes(to, coding);
    put_text(to, "color_space");
    put_text(to, "srgb-rec709-display");
    put_text(to, SPIN_4DGS_FPS);
    put_text(to, fps);
    if (coding->antialias) {
        put_text(to, SPIN_4DGS_ANTIALIAS);
        put_text(to, "true");
    }
    if (coding->sound && coding->sound->start < 0) {
        char start[32];

        snprintf(start, sizeof start, "%.9g", coding->sound->start);
        put_text(to, SPIN_4DGS_SOUND_START);
        put_text(to, start);
    }
}

static spin_status write_metadata(struct spin_4dgs_writer *w)
{
    SPIN_TRY(begin_record(w));
    put_text(w->record, SPIN_4DGS_METADATA);
    SPIN_TRY(put_map(w->record, print_metadata, w->coding));
    return end_record(w, SPIN_4DGS_REC_METADATA);
}

/* Writes the source of the sound. It has no place in the scene, but the record has one. */
static spin_status write_source(struct spin_4dgs_writer *w, const struct spin_sound *s)
{
    static const double pose[7] = {0, 0, 0, 0, 0, 0, 1};

    SPIN_TRY(begin_record(w));
    put_number(w->record, SOUND_ID, 4);
    put_text(w->record, s->name);
    put_text(w->record, s->type);
    put_text(w->record, "unspecified"); /* layout of the channels */
    put_number(w->record, s->size, 8);
    put_double(w->record, fmax(s->start, 0));
    put_double(w->record, spin_sound_seconds(s));
    put_double(w->record, s->gain);
    put_number(w->record, 0, 1); /* flags */
    put_doubles(w->record, pose, 7);
    put_number(w->record, 0, 4); /* keyframes */
    put_text(w->record, "linear");
    return end_record(w, SPIN_4DGS_REC_SOUND_SOURCE);
}

static spin_status write_sound(struct spin_4dgs_writer *w, const struct spin_sound *s)
{
    if (!s)
        return SPIN_OK;
    SPIN_TRY(write_source(w, s));
    SPIN_TRY(begin_record(w));
    put_number(w->record, SOUND_ID, 4);
    put_number(w->record, s->size, 8);
    fwrite(s->data, 1, s->size, w->record);
    return end_record(w, SPIN_4DGS_REC_SOUND_DATA);
}

spin_status spin_4dgs_write_begin(struct spin_4dgs_writer *w)
{
    SPIN_TRY(spin_out_write(w->out, SPIN_4DGS_MAGIC, SPIN_4DGS_MAGIC_BYTES));
    SPIN_TRY(write_header(w));
    SPIN_TRY(write_quantization(w));
    SPIN_TRY(write_windows(w));
    if (w->coding->up)
        SPIN_TRY(write_frame(w));
    SPIN_TRY(write_metadata(w));
    return write_sound(w, w->coding->sound);
}

/* ---- The end --------------------------------------------------------------------------------- */

/* Writes the fields of the index that describe a state. */
static void put_state(FILE *to, const struct spin_4dgs_entry *entry)
{
    put_number(to, entry->depth > 0, 1);
    put_number(to, entry->depth > 0 ? SPIN_4DGS_CHAINED : 0, 1);
    put_number(to, entry->reference, 8);
    put_number(to, entry->key, 8);
    put_number(to, entry->depth, 2);
    put_number(to, entry->n_live, 8);
}

static spin_status write_entry(struct spin_4dgs_writer *w, const struct spin_4dgs_entry *entry)
{
    int n_bands = entry->n_bands;

    SPIN_TRY(begin_record(w));
    put_doubles(w->record, entry->interval, 2);
    put_number(w->record, entry->at, 8);
    put_number(w->record, entry->bytes, 8);
    put_number(w->record, entry->n, 4);
    put_number(w->record, (uint64_t)n_bands, 4);
    for (int b = 0; b < n_bands; b++) {
        put_number(w->record, (uint64_t)b + 1, 1);
        put_number(w->record, entry->band[b].at, 8);
        put_number(w->record, entry->band[b].bytes, 8);
    }
    if (w->coding->key_every > 0)
        put_state(w->record, entry);
    return end_record(w, SPIN_4DGS_REC_INDEX);
}

static spin_status write_statistics(struct spin_4dgs_writer *w)
{
    SPIN_TRY(begin_record(w));
    put_number(w->record, w->coding->n, 8);
    put_number(w->record, w->n_entries, 4);
    put_double(w->record, w->coding->duration);
    put_doubles(w->record, w->coding->box, 6);
    return end_record(w, STATISTICS);
}

/* Sets *crc to the checksum of the file from `start` on. */
static spin_status checksum(struct spin_4dgs_writer *w, uint64_t start, uint32_t *crc)
{
    size_t n = (size_t)(w->out->bytes - start);
    SPIN_FREED unsigned char *bytes = NULL;

    SPIN_TRY(spin_alloc(n, 1, (void **)&bytes));
    if (fseek(w->out->file, (long)start, SEEK_SET) != 0 || fread(bytes, 1, n, w->out->file) != n ||
        fseek(w->out->file, 0, SEEK_END) != 0)
        return spin_fail(SPIN_E_IO, "'%s' cannot be read back", w->out->path);
    *crc = spin_crc32(0, bytes, n);
    return SPIN_OK;
}

/* Replaces the header, whose length does not change. */
static spin_status write_header_again(struct spin_4dgs_writer *w)
{
    uint64_t bytes = w->out->bytes;
    spin_status status;

    if (fseek(w->out->file, SPIN_4DGS_MAGIC_BYTES, SEEK_SET) != 0)
        return spin_fail(SPIN_E_IO, "cannot write the header of '%s'", w->out->path);
    status = write_header(w);
    w->out->bytes = bytes;
    if (status == SPIN_OK && fseek(w->out->file, 0, SEEK_END) != 0)
        return spin_fail(SPIN_E_IO, "cannot write the header of '%s'", w->out->path);
    return status;
}

spin_status spin_4dgs_write_end(struct spin_4dgs_writer *w)
{
    uint64_t start = w->out->bytes;
    uint32_t crc = 0;

    for (size_t k = 0; k < w->n_entries; k++)
        SPIN_TRY(write_entry(w, &w->entry[k]));
    SPIN_TRY(write_statistics(w));
    SPIN_TRY(checksum(w, start, &crc));
    SPIN_TRY(begin_record(w));
    put_number(w->record, start, 8);
    put_number(w->record, 0, 8); /* no summary offsets */
    put_number(w->record, crc, 4);
    SPIN_TRY(end_record(w, SPIN_4DGS_REC_FOOTER));
    SPIN_TRY(spin_out_write(w->out, SPIN_4DGS_MAGIC, SPIN_4DGS_MAGIC_BYTES));
    return write_header_again(w);
}

void spin_4dgs_write_free(struct spin_4dgs_writer *w)
{
    if (w->record)
        fclose(w->record);
    free(w->text);
    free(w->entry);
}
