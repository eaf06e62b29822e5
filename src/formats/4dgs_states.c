/* Reads the keyframes and deltas of .4dgs files. A delta contains differences of quantised
 * integers, so rounding errors do not accumulate. */
#include "formats/4dgs_states.h"

/* STATE_BYTES: size of the additional fields that the model keyframe-delta has in an entry of the
 * index. */
enum { MOST_CHUNKS = 1 << 24, STATE_BYTES = 28 };
enum { TO_KEYFRAME, CHAINED = SPIN_4DGS_CHAINED };
/* States count as evenly spaced if each begins at the expected time, with a tolerance of this
 * fraction of a state's duration. */
#define EVEN 1e-3

/* ---- States ---------------------------------------------------------------------------------- */

static void free_state(struct spin_4dgs_state *state)
{
    free(state->splat);
    free(state->since);
    *state = (struct spin_4dgs_state){0};
}

void spin_4dgs_states_free(struct spin_4dgs_states *s)
{
    free_state(&s->shown);
    free_state(&s->keyframe);
    free_state(&s->next);
    free(s->row);
    free(s->order);
    free(s->chunk);
}

/* Sets *out to a copy of the splats of a state, with capacity for n_more. */
static spin_status copy_state(const struct spin_4dgs_state *from, size_t n_more,
                              struct spin_4dgs_state *out)
{
    free_state(out);
    SPIN_TRY(spin_alloc(from->n + n_more + 1, sizeof *out->splat, (void **)&out->splat));
    SPIN_TRY(spin_alloc(from->n + n_more + 1, sizeof *out->since, (void **)&out->since));
    if (from->n > 0)
        memcpy(out->splat, from->splat, from->n * sizeof *out->splat);
    out->n = from->n;
    return SPIN_OK;
}

static int by_id(const void *a, const void *b)
{
    const struct spin_4dgs_splat *x = a, *y = b;

    return (x->id > y->id) - (x->id < y->id);
}

static spin_status sort_state(struct spin_4dgs_state *state)
{
    qsort(state->splat, state->n, sizeof *state->splat, by_id);
    for (size_t i = 1; i < state->n; i++)
        if (state->splat[i].id == state->splat[i - 1].id)
            return spin_malformed("gaussian_id %u occurs twice in a state", state->splat[i].id);
    return SPIN_OK;
}

static struct spin_4dgs_splat *find_splat(const struct spin_4dgs_state *state, uint32_t id)
{
    struct spin_4dgs_splat key = {.id = id};

    return state->n ? bsearch(&key, state->splat, state->n, sizeof key, by_id) : NULL;
}

static spin_status add_row(struct spin_4dgs_states *s, const struct spin_4dgs_splat *splat,
                           double first, double end)
{
    if (s->n_rows == s->capacity) {
        s->capacity = s->capacity ? 2 * s->capacity : 256;
        SPIN_TRY(spin_grow(s->capacity, sizeof *s->row, (void **)&s->row));
    }
    s->row[s->n_rows++] = (struct spin_4dgs_row){*splat, {first, end}};
    return SPIN_OK;
}

int32_t *spin_4dgs_bin(struct spin_4dgs_splat *splat, int attribute)
{
    int from = 0;

    for (int a = 0; a < attribute; a++)
        from += spin_4dgs_attributes[a].channels;
    return splat->bin + from;
}

static bool moves(struct spin_4dgs_splat *splat)
{
    const int32_t *bin = spin_4dgs_bin(splat, SPIN_4DGS_MOTION);

    return bin[0] != 0 || bin[1] != 0 || bin[2] != 0;
}

/* Returns whether a splat looks the same in two states. The centre in time, which keyframes may set
 * anew, is ignored if the splat neither moves nor fades. */
static bool same_splat(struct spin_4dgs_splat *a, const struct spin_4dgs_splat *b)
{
    struct spin_4dgs_splat copy = *b;

    if (!moves(a) && *spin_4dgs_bin(a, SPIN_4DGS_FLAGS) & SPIN_4DGS_NEVER_FADES)
        *spin_4dgs_bin(&copy, SPIN_4DGS_MU) = *spin_4dgs_bin(a, SPIN_4DGS_MU);
    return memcmp(a->bin, copy.bin, sizeof a->bin) == 0 && memcmp(a->sh, b->sh, sizeof a->sh) == 0;
}

/* Completes the state s->next and makes it the last complete state, s->shown. Adds rows for those
 * splats of the previous state that are different or absent in the new state: their intervals end
 * when the new state begins. */
static spin_status show_next(struct spin_4dgs_states *s)
{
    size_t i = 0;

    if (s->n_chunks == 0)
        return SPIN_OK;
    if (s->n_order > 0 && s->bands != (1u << s->sh_degree) - 1)
        return spin_malformed("chunk %zu: an SH band is missing, expected bands 1 to %d",
                              s->n_chunks - 1, s->sh_degree);
    for (size_t k = 0; k < s->next.n; k++) {
        const struct spin_4dgs_splat *splat = &s->next.splat[k];
        bool kept;

        for (; i < s->shown.n && s->shown.splat[i].id < splat->id; i++)
            SPIN_TRY(add_row(s, &s->shown.splat[i], s->shown.since[i], s->begin));
        kept = i < s->shown.n && s->shown.splat[i].id == splat->id;
        s->next.since[k] = s->begin;
        if (kept && same_splat(&s->shown.splat[i], splat))
            s->next.since[k] = s->shown.since[i];
        else if (kept)
            SPIN_TRY(add_row(s, &s->shown.splat[i], s->shown.since[i], s->begin));
        i += kept;
    }
    for (; i < s->shown.n; i++)
        SPIN_TRY(add_row(s, &s->shown.splat[i], s->shown.since[i], s->begin));
    free_state(&s->shown);
    s->shown = s->next;
    s->next = (struct spin_4dgs_state){0};
    s->chunk[s->n_chunks - 1].n_live = s->shown.n;
    return s->chunk[s->n_chunks - 1].depth > 0 ? SPIN_OK : copy_state(&s->shown, 0, &s->keyframe);
}

/* Completes the previous state and begins the state of a chunk. n: number of splats or changes in
 * the chunk. */
static spin_status begin_chunk(struct spin_4dgs_states *s, const double interval[2],
                               const struct spin_4dgs_chunk *chunk, uint64_t n)
{
    SPIN_TRY(show_next(s));
    if (!(interval[1] > interval[0]) || interval[0] != (s->n_chunks ? s->end : 0))
        return spin_malformed("chunk %zu lasts from %.17g to %.17g, but the previous chunk ends at "
                              "%.17g",
                              s->n_chunks, interval[0], interval[1], s->n_chunks ? s->end : 0.0);
    s->n_read += n;
    if (s->n_read > s->most_rows || s->n_chunks == MOST_CHUNKS)
        return spin_malformed("a file of this size cannot contain %llu changes",
                              (unsigned long long)s->n_read);
    if (s->n_chunks == s->chunk_capacity) {
        s->chunk_capacity = s->chunk_capacity ? 2 * s->chunk_capacity : 64;
        SPIN_TRY(spin_grow(s->chunk_capacity, sizeof *s->chunk, (void **)&s->chunk));
    }
    s->chunk[s->n_chunks] = *chunk;
    s->chunk[s->n_chunks++].begin = interval[0];
    s->begin = interval[0];
    s->end = interval[1];
    s->n_order = 0;
    s->bands = 0;
    return SPIN_OK;
}

/* ---- Groups of streams ----------------------------------------------------------------------- */

enum kind { WHOLE, CHANGES, DEATHS };

struct group {
    int32_t *id, *bins[SPIN_4DGS_N_ATTRIBUTES];
};

static void free_group(struct group *g)
{
    free(g->id);
    for (int a = 0; a < SPIN_4DGS_N_ATTRIBUTES; a++)
        free(g->bins[a]);
}

static spin_status check_group(const struct group *g, enum kind kind)
{
    if (!g->id)
        return spin_malformed("stream 'gaussian_id' is missing");
    for (int a = 0; a < SPIN_4DGS_N_ATTRIBUTES; a++) {
        bool fixed = a == SPIN_4DGS_SIGMA || a == SPIN_4DGS_FLAGS || a == SPIN_4DGS_WINDOW;

        if (kind == WHOLE && !g->bins[a])
            return spin_malformed("stream '%s' is missing", spin_4dgs_attributes[a].name);
        if (g->bins[a] && (kind == DEATHS || (kind == CHANGES && fixed)))
            return spin_malformed("stream '%s' is not allowed in %s", spin_4dgs_attributes[a].name,
                                  kind == DEATHS ? "deaths" : "updates");
    }
    if (!g->bins[SPIN_4DGS_LARGEST] != !g->bins[SPIN_4DGS_ROTATION])
        return spin_malformed(
            "one of the streams 'rotation_index' and 'rotation' is missing, expected both or none");
    return SPIN_OK;
}

/* Reads a group: the streams of n splats. Unknown attributes are skipped. */
static spin_status read_group(struct spin_4dgs_cursor *c, size_t n, enum kind kind,
                              struct group *out)
{
    while (c->left > 0) {
        struct spin_4dgs_stream stream = spin_4dgs_stream_head(c);
        bool is_id = stream.attribute == SPIN_4DGS_ID;
        int32_t **to;

        if (c->cut)
            return spin_malformed("a stream extends beyond the chunk");
        if (!is_id && stream.attribute >= SPIN_4DGS_N_ATTRIBUTES)
            continue;
        to = is_id ? &out->id : &out->bins[stream.attribute];
        if (*to)
            return spin_malformed("stream %u occurs twice", stream.attribute);
        SPIN_TRY_IN(
            spin_4dgs_stream_read(&stream, n,
                                  is_id ? 1 : spin_4dgs_attributes[stream.attribute].channels, to),
            "stream '%s'", is_id ? "gaussian_id" : spin_4dgs_attributes[stream.attribute].name);
    }
    return n > 0 ? check_group(out, kind) : SPIN_OK;
}

/* Applies row k of a group to a splat. If `add` is true, the integers are added to those of the
 * splat, except for rotations, which are replaced; otherwise all integers are replaced. */
static spin_status apply_row(const struct group *g, size_t k, bool add,
                             struct spin_4dgs_splat *splat)
{
    for (int a = 0, at = 0; a < SPIN_4DGS_N_ATTRIBUTES; at += spin_4dgs_attributes[a++].channels) {
        int width = spin_4dgs_attributes[a].channels;
        bool whole = !add || a == SPIN_4DGS_LARGEST || a == SPIN_4DGS_ROTATION;

        for (int c = 0; g->bins[a] && c < width; c++) {
            int64_t v = g->bins[a][(size_t)width * k + (size_t)c];

            v += whole ? 0 : splat->bin[at + c];
            if (v < INT32_MIN || v > INT32_MAX)
                return spin_malformed("'%s' of splat %u does not fit in 32 bits",
                                      spin_4dgs_attributes[a].name, splat->id);
            splat->bin[at + c] = (int32_t)v;
        }
    }
    return SPIN_OK;
}

/* Adds new splats to s->next: those of a keyframe, or the births of a delta. The SH bands that
 * follow in the file belong to these splats, in this order. */
static spin_status add_splats(struct spin_4dgs_states *s, const struct group *g, size_t n)
{
    free(s->order);
    s->order = NULL;
    SPIN_TRY(spin_alloc(n + 1, sizeof *s->order, (void **)&s->order));
    s->n_order = n;
    for (size_t k = 0; k < n; k++) {
        struct spin_4dgs_splat *splat = &s->next.splat[s->next.n++];

        *splat = (struct spin_4dgs_splat){.id = (uint32_t)g->id[k]};
        s->order[k] = splat->id;
        SPIN_TRY(apply_row(g, k, false, splat));
    }
    return sort_state(&s->next);
}

static spin_status change_splats(struct spin_4dgs_states *s, const struct group *g, size_t n)
{
    for (size_t k = 0; k < n; k++) {
        struct spin_4dgs_splat *splat = find_splat(&s->next, (uint32_t)g->id[k]);

        if (!splat)
            return spin_malformed("gaussian_id %u is updated, but no splat has this id",
                                  (uint32_t)g->id[k]);
        SPIN_TRY(apply_row(g, k, true, splat));
    }
    return SPIN_OK;
}

static int by_number(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;

    return (x > y) - (x < y);
}

static spin_status remove_splats(struct spin_4dgs_states *s, const struct group *g, size_t n)
{
    uint32_t *ids = (uint32_t *)(void *)g->id;
    size_t kept = 0, k = 0;

    if (n == 0)
        return SPIN_OK;
    qsort(ids, n, sizeof *ids, by_number);
    for (size_t i = 0; i < s->next.n; i++) {
        if (k < n && s->next.splat[i].id == ids[k])
            k++;
        else
            s->next.splat[kept++] = s->next.splat[i];
    }
    s->next.n = kept;
    return k == n
               ? SPIN_OK
               : spin_malformed("gaussian_id %u is removed twice, or no splat has this id", ids[k]);
}

/* ---- Records --------------------------------------------------------------------------------- */

static spin_status read_keyframe(struct spin_4dgs_states *s, struct spin_4dgs_cursor *block,
                                 size_t n)
{
    static const struct spin_4dgs_state empty = {0};
    struct group group = {0};
    spin_status status = read_group(block, n, WHOLE, &group);

    if (status == SPIN_OK)
        status = copy_state(&empty, n, &s->next);
    if (status == SPIN_OK)
        status = add_splats(s, &group, n);
    free_group(&group);
    return status;
}

spin_status spin_4dgs_states_keyframe(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c,
                                      size_t at)
{
    struct spin_4dgs_chunk chunk = {.offset = at};
    SPIN_FREED unsigned char *plain = NULL;
    struct spin_4dgs_cursor codec, block;
    double interval[2];
    uint64_t n, bytes;

    interval[0] = spin_4dgs_double(c);
    interval[1] = spin_4dgs_double(c);
    chunk.level = (uint32_t)spin_4dgs_number(c, 4);
    n = spin_4dgs_number(c, 4);
    codec = spin_4dgs_block(c, 4);
    bytes = spin_4dgs_number(c, 8);
    block = spin_4dgs_block(c, 8);
    if (c->cut)
        return SPIN_OK;
    SPIN_TRY(begin_chunk(s, interval, &chunk, n));
    SPIN_TRY_IN(spin_4dgs_open(&block, &codec, bytes, &plain), "chunk %zu", s->n_chunks - 1);
    return spin_fail_context(read_keyframe(s, &block, (size_t)n), "chunk %zu", s->n_chunks - 1);
}

/* Reads the groups of a delta, which are updates, births and deaths, and applies them in the order
 * deaths, updates, births. n, group: in the order of the file. */
static spin_status apply_groups(struct spin_4dgs_states *s, struct spin_4dgs_cursor *block,
                                const size_t n[3], struct group group[3])
{
    static const enum kind kinds[3] = {CHANGES, WHOLE, DEATHS};
    static const char *const names[3] = {"updates", "births", "deaths"};

    for (int k = 0; k < 3; k++) {
        struct spin_4dgs_cursor streams = spin_4dgs_block(block, 8);

        if (block->cut)
            return spin_malformed("the %s extend beyond the chunk", names[k]);
        SPIN_TRY_IN(read_group(&streams, n[k], kinds[k], &group[k]), "%s", names[k]);
    }
    SPIN_TRY(remove_splats(s, &group[2], n[2]));
    SPIN_TRY(change_splats(s, &group[0], n[0]));
    return add_splats(s, &group[1], n[1]);
}

/* Checks that a delta refers to the right chunk: in mode CHAINED to the previous chunk, otherwise
 * to the last keyframe. */
static spin_status check_reference(const struct spin_4dgs_states *s,
                                   const struct spin_4dgs_chunk *chunk, uint64_t reference,
                                   uint64_t keyframe)
{
    const struct spin_4dgs_chunk *last = s->n_chunks ? &s->chunk[s->n_chunks - 1] : NULL, *key;

    if (!last)
        return spin_malformed("the first chunk is a delta, expected a keyframe");
    for (key = last; key->depth > 0;)
        key--;
    if (chunk->mode > CHAINED)
        return spin_unsupported("delta mode %u, expected 0 or 1", chunk->mode);
    if (keyframe != key->offset ||
        reference != (chunk->mode == CHAINED ? last->offset : key->offset))
        return spin_malformed("the delta at byte %llu refers to byte %llu, expected %s",
                              (unsigned long long)chunk->offset, (unsigned long long)reference,
                              chunk->mode == CHAINED ? "the previous chunk" : "the last keyframe");
    if (chunk->depth != (chunk->mode == CHAINED ? last->depth + 1 : 1))
        return spin_malformed("the delta at byte %llu has depth %u, expected %u",
                              (unsigned long long)chunk->offset, chunk->depth,
                              chunk->mode == CHAINED ? last->depth + 1 : 1);
    if (chunk->level != key->level)
        return spin_malformed("the delta at byte %llu has level %u, but the last keyframe has %u",
                              (unsigned long long)chunk->offset, chunk->level, key->level);
    return SPIN_OK;
}

spin_status spin_4dgs_states_delta(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c,
                                   size_t at)
{
    struct spin_4dgs_chunk chunk = {.offset = at};
    SPIN_FREED unsigned char *plain = NULL;
    struct spin_4dgs_cursor codec, block;
    uint64_t reference, keyframe, bytes;
    struct group group[3] = {{0}};
    double interval[2];
    size_t n[3];
    spin_status status;

    interval[0] = spin_4dgs_double(c);
    interval[1] = spin_4dgs_double(c);
    chunk.level = (uint32_t)spin_4dgs_number(c, 4);
    chunk.mode = (unsigned)spin_4dgs_number(c, 1);
    reference = spin_4dgs_number(c, 8);
    keyframe = spin_4dgs_number(c, 8);
    chunk.depth = (unsigned)spin_4dgs_number(c, 2);
    for (int k = 0; k < 3; k++)
        n[k] = (size_t)spin_4dgs_number(c, 4);
    codec = spin_4dgs_block(c, 4);
    bytes = spin_4dgs_number(c, 8);
    block = spin_4dgs_block(c, 8);
    if (c->cut)
        return SPIN_OK;
    SPIN_TRY(check_reference(s, &chunk, reference, keyframe));
    SPIN_TRY(begin_chunk(s, interval, &chunk, (uint64_t)n[0] + n[1] + n[2]));
    SPIN_TRY(copy_state(chunk.mode == CHAINED ? &s->shown : &s->keyframe, n[1], &s->next));
    SPIN_TRY_IN(spin_4dgs_open(&block, &codec, bytes, &plain), "chunk %zu", s->n_chunks - 1);
    status = apply_groups(s, &block, n, group);
    for (int k = 0; k < 3; k++)
        free_group(&group[k]);
    return spin_fail_context(status, "chunk %zu", s->n_chunks - 1);
}

/* The band belongs to the splats that the preceding chunk has added. It contains, for each splat,
 * the codes of all coefficients of red, then of green, then of blue. */
spin_status spin_4dgs_states_band(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c)
{
    size_t b = (size_t)spin_4dgs_number(c, 1), width = 2 * b + 1;
    struct spin_4dgs_stream stream = spin_4dgs_stream_head(c);
    SPIN_FREED int32_t *codes = NULL;

    if (c->cut || s->n_order == 0)
        return SPIN_OK;
    if (b < 1 || b > (size_t)s->sh_degree || s->bands & 1u << (b - 1))
        return spin_malformed("SH band %zu occurs twice or is above the SH degree %d", b,
                              s->sh_degree);
    s->bands |= 1u << (b - 1);
    SPIN_TRY_IN(spin_4dgs_stream_read(&stream, s->n_order, (int)(3 * width), &codes),
                "chunk %zu: SH band %zu", s->n_chunks - 1, b);
    for (size_t k = 0; k < 3 * width * s->n_order; k++) {
        struct spin_4dgs_splat *splat = find_splat(&s->next, s->order[k / (3 * width)]);
        size_t channel = k / width % 3, m = k % width;

        if (codes[k] < 0 || codes[k] > 255)
            return spin_malformed("chunk %zu: SH band %zu: code %d, expected 0 to 255",
                                  s->n_chunks - 1, b, codes[k]);
        splat->sh[3 * (b * b + m - 1) + channel] = (unsigned char)codes[k];
    }
    return SPIN_OK;
}

spin_status spin_4dgs_states_index(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c)
{
    const struct spin_4dgs_chunk *chunk;
    uint64_t offset, n_live;
    unsigned depth, kind, mode;

    spin_4dgs_bytes(c, 16);
    offset = spin_4dgs_number(c, 8);
    spin_4dgs_bytes(c, 16);
    if (c->left > STATE_BYTES) /* skip the offsets of the SH bands */
        spin_4dgs_bytes(c, c->left - STATE_BYTES);
    kind = (unsigned)spin_4dgs_number(c, 1);
    mode = (unsigned)spin_4dgs_number(c, 1);
    spin_4dgs_bytes(c, 16);
    depth = (unsigned)spin_4dgs_number(c, 2);
    n_live = spin_4dgs_number(c, 8);
    if (s->n_indexed == 0) {
        SPIN_TRY(show_next(s));
        s->next.n = 0;
    }
    if (c->cut || s->n_indexed >= s->n_chunks)
        return SPIN_OK;
    chunk = &s->chunk[s->n_indexed++];
    if (offset != chunk->offset || depth != chunk->depth || (kind != 0) != (depth > 0) ||
        (kind && mode != chunk->mode))
        return spin_malformed("entry %zu of the index has offset %llu and depth %u, but its chunk "
                              "has offset %llu and depth %u",
                              s->n_indexed - 1, (unsigned long long)offset, depth,
                              (unsigned long long)chunk->offset, chunk->depth);
    if (n_live != chunk->n_live)
        spin_warn("entry %zu of the index declares %llu splats, but its chunk results in %zu",
                  s->n_indexed - 1, (unsigned long long)n_live, chunk->n_live);
    return SPIN_OK;
}

/* ---- The end --------------------------------------------------------------------------------- */

static int by_row(const void *a, const void *b)
{
    const struct spin_4dgs_row *x = a, *y = b;

    if (x->splat.id != y->splat.id)
        return x->splat.id > y->splat.id ? 1 : -1;
    return (x->interval[0] > y->interval[0]) - (x->interval[0] < y->interval[0]);
}

spin_status spin_4dgs_states_end(struct spin_4dgs_states *s, double duration, uint64_t n_ids)
{
    uint64_t n = 0;

    if (s->n_indexed == 0)
        SPIN_TRY(show_next(s));
    if (s->n_chunks == 0 || s->end != duration)
        return spin_malformed("the chunks end at %.17g, but the clip lasts until %.17g", s->end,
                              duration);
    for (size_t i = 0; i < s->shown.n; i++)
        SPIN_TRY(add_row(s, &s->shown.splat[i], s->shown.since[i], duration));
    if (s->n_rows == 0)
        return spin_malformed("the file contains no splats");
    qsort(s->row, s->n_rows, sizeof *s->row, by_row);
    for (size_t i = 0; i < s->n_rows; i++)
        n += i == 0 || s->row[i].splat.id != s->row[i - 1].splat.id;
    return n == n_ids ? SPIN_OK
                      : spin_malformed("the chunks contain %llu splats, the header declares %llu",
                                       (unsigned long long)n, (unsigned long long)n_ids);
}

double spin_4dgs_states_rate(const struct spin_4dgs_states *s, double duration)
{
    double rate = (double)s->n_chunks / duration, whole = rint(rate);

    for (size_t k = 0; k < s->n_chunks; k++)
        if (fabs(s->chunk[k].begin * rate - (double)k) > EVEN)
            return 0;
    for (size_t i = 0; i < s->n_rows; i++)
        if (moves(&s->row[i].splat))
            return 0;
    if (s->n_chunks < 2)
        return 0;
    return fabs(rate - whole) < EVEN / duration ? whole : rate;
}
