/* Writes the chunks of .4dgs files, which contain all splats of an interval or only the changes
 * since the previous state (see 4dgs_write.h). */
#include <math.h>

#include "base/text.h"
#include "formats/4dgs_write.h"
#include "formats/planes.h"
#include "io/compress.h"
#include "io/file.h"

enum { RAW, DIFFERENCE, CONSTANT };
enum { SH_CODES = 7 };
/* ---- Streams --------------------------------------------------------------------------------- */

/* A stream as stored in the file. */
struct packed {
    unsigned mode, symbol;
    unsigned char *data;
    size_t n;
};

/* Maps n integers, which are rows of `back` integers, to unsigned symbols: the zigzag codes of the
 * integers or, in mode DIFFERENCE, of their differences from the previous row. Returns the number
 * of bytes that each symbol needs, or 0 if a difference does not fit into 32 bits. */
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

/* Packs integers with mode CONSTANT if all rows are equal, otherwise with RAW or DIFFERENCE,
 * whichever gives the smaller stream. */
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

    spin_4dgs_put_number(to, attribute, 1);
    spin_4dgs_put_number(to, packed.symbol, 1);
    spin_4dgs_put_number(to, packed.mode, 1);
    spin_4dgs_put_number(to, 0, 1); /* codec: zlib */
    spin_4dgs_put_number(to, channels, 1);
    spin_4dgs_put_number(to, n, 4);
    spin_4dgs_put_number(to, packed.n, 8);
    if (packed.data)
        fwrite(packed.data, 1, packed.n, to);
    free(packed.data);
    return status;
}

/* ---- Chunks ---------------------------------------------------------------------------------- */

/* Writes a stream of n ids. bytes: distance in memory from one id to the next. */
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
    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_doubles(w->record, interval, 2);
    spin_4dgs_put_number(w->record, 0, 4); /* level */
    spin_4dgs_put_number(w->record, n, 4);
    spin_4dgs_put_text(w->record, ""); /* no codec: only the streams are compressed */
    spin_4dgs_put_number(w->record, size, 8);
    spin_4dgs_put_number(w->record, size, 8);
    fwrite(streams, 1, size, w->record);
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_CHUNK);
}

/* Writes SH band b: for each splat all coefficients of red, then of green, then of blue. */
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
    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_number(w->record, b, 1);
    SPIN_TRY(put_stream(w->record, SH_CODES, code, n, 3 * width));
    return spin_4dgs_end_record(w, SPIN_4DGS_REC_SH_BAND);
}

static spin_status begin_chunk(struct spin_4dgs_writer *w, const double interval[2],
                               struct spin_4dgs_entry **entry)
{
    SPIN_TRY(spin_grow(w->n_entries + 1, sizeof *w->entry, (void **)&w->entry));
    *entry = &w->entry[w->n_entries++];
    **entry = (struct spin_4dgs_entry){{interval[0], interval[1]}, .at = w->out->bytes};
    return SPIN_OK;
}

/* Ends a chunk: writes the SH bands of its n new splats, and completes its entry of the index. */
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

/* Sets value [n_updates][channels] to the integers of one attribute as a delta stores them. whole:
 * true for rotations, which are stored as new integers; false for other attributes, which are
 * stored as differences from the old integers. from: index of the attribute's first integer.
 * Returns whether any integer has changed. */
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

/* Writes the attributes that change in at least one splat. The two attributes of a rotation are
 * written together: both or none. */
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

/* Writes the groups of updates, births and deaths, each preceded by its length. */
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
        spin_4dgs_put_number(to, size, 8);
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
    spin_4dgs_put_text(w->record, ""); /* no codec: only the streams are compressed */
    spin_4dgs_put_number(w->record, size, 8);
    spin_4dgs_put_number(w->record, size, 8);
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
    SPIN_TRY(spin_4dgs_begin_record(w));
    spin_4dgs_put_doubles(w->record, interval, 2);
    spin_4dgs_put_number(w->record, 0, 4); /* level */
    spin_4dgs_put_number(w->record, SPIN_4DGS_CHAINED, 1);
    spin_4dgs_put_number(w->record, entry->reference, 8);
    spin_4dgs_put_number(w->record, entry->key, 8);
    spin_4dgs_put_number(w->record, entry->depth, 2);
    spin_4dgs_put_number(w->record, c->n_updates, 4);
    spin_4dgs_put_number(w->record, c->n_births, 4);
    spin_4dgs_put_number(w->record, c->n_deaths, 4);
    SPIN_TRY(write_groups(w, c));
    SPIN_TRY(spin_4dgs_end_record(w, SPIN_4DGS_REC_DELTA_CHUNK));
    return end_chunk(w, entry, c->born, c->n_births);
}
