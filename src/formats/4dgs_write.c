#include "formats/4dgs_write.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/text.h"
#include "io/sound.h"
#include "io/file.h"

enum { STATISTICS = 12, SOUND_ID = 1, PLUS_Y = 1, MINUS_Z = 5, RIGHT_HANDED = 1 };

/* The bound that the file declares for the relative errors of scales and sigmas. */
#define RELATIVE (1 / 256.0)

/* ---- Records --------------------------------------------------------------------------------- */

void spin_4dgs_put_number(FILE *to, uint64_t value, int bytes)
{
    for (int b = 0; b < bytes; b++)
        fputc((int)(value >> (8 * b) & 255), to);
}

void spin_4dgs_put_double(FILE *to, double value)
{
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    spin_4dgs_put_number(to, bits, 8);
}

void spin_4dgs_put_doubles(FILE *to, const double *value, int n)
{
    for (int k = 0; k < n; k++)
        spin_4dgs_put_double(to, value[k]);
}

void spin_4dgs_put_text(FILE *to, const char *text)
{
    spin_4dgs_put_number(to, strlen(text), 4);
    fputs(text, to);
}

spin_status spin_4dgs_begin_record(struct spin_4dgs_writer *w)
{
    w->record = spin_text_open(&w->text, &w->n_text);
    return w->record ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "no memory for a record");
}

spin_status spin_4dgs_end_record(struct spin_4dgs_writer *w, unsigned opcode)
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
    /* At the lower limit of the step, positions need 28 of the 32 bits. */
    step = power_of_2(fmax(scale / 16, ldexp(size, -28)));
    c->step[SPIN_4DGS_STEP_POSITION] = step;
    c->step[SPIN_4DGS_STEP_SCALE] = c->step[SPIN_4DGS_STEP_SIGMA] = 2 * log1p(RELATIVE);
    c->step[SPIN_4DGS_STEP_ROTATION] = ldexp(1, -10);
    c->step[SPIN_4DGS_STEP_COLOUR] = c->step[SPIN_4DGS_STEP_OPACITY] = ldexp(1, -9);
    /* An error of the velocity becomes an error of the position, which grows for as long as the
     * splat is visible: at most for the whole clip. */
    c->step[SPIN_4DGS_STEP_MOTION] = 2 * step / fmax(1, power_of_2(c->duration));
    c->step[SPIN_4DGS_STEP_TIME] = ldexp(1, -10);
}

/* Returns the profile, a name for guaranteed properties of the file. "keyframed" guarantees at
 * least two states, and a limit on the number of deltas after each keyframe; "" guarantees nothing.
 */
static const char *profile_of(const struct spin_4dgs_coding *c)
{
    return c->key_every > 0 && c->duration * c->fps > 1.5 ? "keyframed" : "";
}

static spin_status write_header(struct spin_4dgs_writer *w)
{
    const struct spin_4dgs_coding *c = w->coding;

    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_text(w->record, profile_of(c));
    spin_4dgs_put_text(w->record, "spin4d " SPIN_VERSION);
    spin_4dgs_put_double(w->record, c->duration);
    spin_4dgs_put_number(w->record, c->n, 8);
    spin_4dgs_put_double(w->record, c->cutoff);
    spin_4dgs_put_text(w->record, c->key_every > 0 ? SPIN_4DGS_STATES : SPIN_4DGS_MODEL);
    spin_4dgs_put_doubles(w->record, c->box, 6);
    spin_4dgs_put_number(w->record, (uint64_t)c->sh_degree, 1);
    spin_4dgs_put_number(w->record, c->sound != NULL, 1); /* flags */
    spin_4dgs_put_number(w->record, 0, 4);                /* attributes */
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_HEADER);
}

/* Prints the error bounds that the file declares, which are half the quantisation steps. */
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
        spin_4dgs_put_text(to, bound[k].name);
        spin_4dgs_put_text(to, text);
    }
}

/* Writes a map of texts to the current record: its size in bytes, then pairs of key and value,
 * which `print` writes. */
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
    spin_4dgs_put_number(to, n, 4);
    fwrite(text, 1, n, to);
    return SPIN_OK;
}

static spin_status write_quantization(struct spin_4dgs_writer *w)
{
    const struct spin_4dgs_coding *c = w->coding;

    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_text(w->record, SPIN_4DGS_SCHEME);
    spin_4dgs_put_doubles(w->record, c->origin, 3);
    spin_4dgs_put_doubles(w->record, c->step, SPIN_4DGS_N_STEPS);
    spin_4dgs_put_number(w->record, 1, 1); /* SH codes are not coarsened */
    SPIN_TRY(put_map(w->record, print_bounds, c));
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_QUANTIZATION);
}

static spin_status write_windows(struct spin_4dgs_writer *w)
{
    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_number(w->record, w->coding->n_windows, 4);
    spin_4dgs_put_doubles(w->record, w->coding->window[0], (int)(2 * w->coding->n_windows));
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_WINDOWS);
}

/* Writes the coordinate frame: right-handed, +y up, -z forward. The scale of 0 means that the size
 * of a unit in metres is unknown. */
static spin_status write_frame(struct spin_4dgs_writer *w)
{
    static const unsigned char axes[4] = {RIGHT_HANDED, PLUS_Y, MINUS_Z, 0};

    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_text(w->record, "");
    fwrite(axes, 1, sizeof axes, w->record);
    spin_4dgs_put_double(w->record, 0);
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_FRAME);
}

static void print_keyframes(FILE *to, const struct spin_4dgs_coding *coding)
{
    char text[32];

    spin_4dgs_put_text(to, "keyframe_interval_sec");
    snprintf(text, sizeof text, "%.9g", coding->key_every / coding->fps);
    spin_4dgs_put_text(to, text);
    spin_4dgs_put_text(to, "gop_max_depth");
    snprintf(text, sizeof text, "%d", coding->key_every - 1);
    spin_4dgs_put_text(to, text);
}

static void print_metadata(FILE *to, const struct spin_4dgs_coding *coding)
{
    char fps[32];

    snprintf(fps, sizeof fps, "%.9g", coding->fps);
    if (coding->key_every > 0)
        print_keyframes(to, coding);
    spin_4dgs_put_text(to, "color_space");
    spin_4dgs_put_text(to, "srgb-rec709-display");
    spin_4dgs_put_text(to, SPIN_4DGS_FPS);
    spin_4dgs_put_text(to, fps);
    if (coding->antialias) {
        spin_4dgs_put_text(to, SPIN_4DGS_ANTIALIAS);
        spin_4dgs_put_text(to, "true");
    }
    if (coding->sound && coding->sound->start < 0) {
        char start[32];

        snprintf(start, sizeof start, "%.9g", coding->sound->start);
        spin_4dgs_put_text(to, SPIN_4DGS_SOUND_START);
        spin_4dgs_put_text(to, start);
    }
}

static spin_status write_metadata(struct spin_4dgs_writer *w)
{
    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_text(w->record, SPIN_4DGS_METADATA);
    SPIN_TRY(put_map(w->record, print_metadata, w->coding));
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_METADATA);
}

/* Writes the audio source record. The sound has no position in the scene, but the record requires
 * one: the origin is written. */
static spin_status write_source(struct spin_4dgs_writer *w, const struct spin_sound *s)
{
    static const double pose[7] = {0, 0, 0, 0, 0, 0, 1};

    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_number(w->record, SOUND_ID, 4);
    spin_4dgs_put_text(w->record, s->name);
    spin_4dgs_put_text(w->record, s->type);
    spin_4dgs_put_text(w->record, "unspecified"); /* layout of the channels */
    spin_4dgs_put_number(w->record, s->size, 8);
    spin_4dgs_put_double(w->record, fmax(s->start, 0));
    spin_4dgs_put_double(w->record, spin_sound_seconds(s));
    spin_4dgs_put_double(w->record, s->gain);
    spin_4dgs_put_number(w->record, 0, 1); /* flags */
    spin_4dgs_put_doubles(w->record, pose, 7);
    spin_4dgs_put_number(w->record, 0, 4); /* keyframes */
    spin_4dgs_put_text(w->record, "linear");
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_SOUND_SOURCE);
}

static spin_status write_sound(struct spin_4dgs_writer *w, const struct spin_sound *s)
{
    if (!s)
        return SPIN_OK;
    SPIN_TRY(write_source(w, s));
    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_number(w->record, SOUND_ID, 4);
    spin_4dgs_put_number(w->record, s->size, 8);
    fwrite(s->data, 1, s->size, w->record);
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_SOUND_DATA);
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

/* Writes the additional fields that an entry of the index has in files with keyframes. */
static void put_state(FILE *to, const struct spin_4dgs_entry *entry)
{
    spin_4dgs_put_number(to, entry->depth > 0, 1);
    spin_4dgs_put_number(to, entry->depth > 0 ? SPIN_4DGS_CHAINED : 0, 1);
    spin_4dgs_put_number(to, entry->reference, 8);
    spin_4dgs_put_number(to, entry->key, 8);
    spin_4dgs_put_number(to, entry->depth, 2);
    spin_4dgs_put_number(to, entry->n_live, 8);
}

static spin_status write_entry(struct spin_4dgs_writer *w, const struct spin_4dgs_entry *entry)
{
    int n_bands = entry->n_bands;

    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_doubles(w->record, entry->interval, 2);
    spin_4dgs_put_number(w->record, entry->at, 8);
    spin_4dgs_put_number(w->record, entry->bytes, 8);
    spin_4dgs_put_number(w->record, entry->n, 4);
    spin_4dgs_put_number(w->record, (uint64_t)n_bands, 4);
    for (int b = 0; b < n_bands; b++) {
        spin_4dgs_put_number(w->record, (uint64_t)b + 1, 1);
        spin_4dgs_put_number(w->record, entry->band[b].at, 8);
        spin_4dgs_put_number(w->record, entry->band[b].bytes, 8);
    }
    if (w->coding->key_every > 0)
        put_state(w->record, entry);
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_INDEX);
}

static spin_status write_statistics(struct spin_4dgs_writer *w)
{
    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_number(w->record, w->coding->n, 8);
    spin_4dgs_put_number(w->record, w->n_entries, 4);
    spin_4dgs_put_double(w->record, w->coding->duration);
    spin_4dgs_put_doubles(w->record, w->coding->box, 6);
    return spin_4dgs_end_record(w, STATISTICS);
}

/* Sets *crc to the checksum of the file from byte `start` to the end. */
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

/* Overwrites the header record in place, as the last step; its length is the same as before. */
static spin_status write_header_again(struct spin_4dgs_writer *w)
{
    uint64_t bytes = w->out->bytes;
    spin_status status;

    if (fseek(w->out->file, SPIN_4DGS_MAGIC_BYTES, SEEK_SET) != 0)
        return spin_fail(SPIN_E_IO, "cannot write the header of '%s'", w->out->path);
    status = write_header(w);
    w->out->bytes = bytes;
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
    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_number(w->record, start, 8);
    spin_4dgs_put_number(w->record, 0, 8); /* no summary offsets */
    spin_4dgs_put_number(w->record, crc, 4);
    SPIN_TRY(spin_4dgs_end_record(w, SPIN_4DGS_REC_FOOTER));
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
