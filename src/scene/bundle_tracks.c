/* Reads the tracks of a bundle. The values of all tracks are read by spin_bundle_tracks_open(), and
 * the values that belong to single splats frame by frame. */
#include "scene/bundle_tracks.h"

#include <inttypes.h>

#include "base/base.h"

/* number of floats per row of trained/residual: a row of a track without the displacement */
enum { ROW = SPIN_TRACK_WIDTH - 3 };

spin_status spin_bundle_tracks_open(struct spin_bundle *bundle, struct spin_bundle_tracks *out)
{
    const spin_json *json = spin_json_get(spin_json_get(bundle->json, "trained"), "tracks");
    int64_t n, moving, varying, backdrop = 0, shape[2] = {-1, SPIN_TRACK_WIDTH};
    SPIN_LEAVES(spin_bundle_values_close) struct spin_bundle_values v = {0};

    out->bundle = bundle;
    if (!json)
        return SPIN_OK;
    if (!spin_json_integer(spin_json_get(json, "n"), &n) ||
        !spin_json_integer(spin_json_get(json, "moving"), &moving) ||
        !spin_json_integer(spin_json_get(json, "varying"), &varying) || n < 0 || n > UINT32_MAX ||
        moving < 0 || moving > n || varying < 0 || varying > n)
        return spin_malformed(
            "meta.json: 'n', 'moving' or 'varying' of 'trained.tracks' is missing "
            "or out of range");
    if (spin_json_get(json, "backdrop") &&
        (!spin_json_integer(spin_json_get(json, "backdrop"), &backdrop) || backdrop < 0 ||
         backdrop > n))
        return spin_malformed("meta.json: 'trained.tracks.backdrop' is not an integer from 0 to "
                              "the number of tracks");
    spin_json_bool(spin_json_get(json, "same_rows"), &out->same_rows);
    shape[0] = n;
    SPIN_TRY(spin_bundle_values_open(bundle, "trained/tracks", -1, 'f', 2, shape, &v));
    SPIN_TRY(
        spin_alloc((size_t)n + 1, SPIN_TRACK_WIDTH * sizeof *out->values, (void **)&out->values));
    out->n = (size_t)n;
    out->n_moving = (size_t)moving;
    out->n_varying = (size_t)varying;
    out->n_backdrop = (size_t)backdrop;
    spin_bundle_values_get(&v, 0, (size_t)v.count, out->values);
    for (size_t i = 0; i < v.count; i++)
        if (!isfinite(out->values[i]))
            return spin_malformed(
                "array 'trained/tracks' has a value that is not finite in row %zu",
                i / SPIN_TRACK_WIDTH);
    return SPIN_OK;
}

void spin_bundle_tracks_close(struct spin_bundle_tracks *t)
{
    free(t->values);
    free(t->block);
    memset(t, 0, sizeof *t);
}

/* Reads array trained/<what>/<index>, of `width` floats per row, into the memory from `out` to
 * `room_end`. Fails if this memory is too small. Sets *n to the number of rows, or to 0 if the
 * array does not exist. */
static spin_status read_own(struct spin_bundle_tracks *t, const char *what, int index, int width,
                            const float *room_end, float *out, size_t *n)
{
    int64_t shape[2] = {-1, width};
    SPIN_LEAVES(spin_bundle_values_close) struct spin_bundle_values v = {0};
    char series[32], name[64];

    *n = 0;
    snprintf(series, sizeof series, "trained/%s", what);
    snprintf(name, sizeof name, "%s/%05d", series, index);
    if (!spin_npz_has(&t->bundle->npz, name))
        return SPIN_OK;
    SPIN_TRY(spin_bundle_values_open(t->bundle, series, index, 'f', 2, shape, &v));
    if (v.count > (uint64_t)(room_end - out))
        return spin_malformed("array '%s' has %" PRIu64 " rows, more than the frame has splats",
                              name, v.shape[0]);
    spin_bundle_values_get(&v, 0, (size_t)v.count, out);
    *n = (size_t)v.shape[0];
    return SPIN_OK;
}

spin_status spin_bundle_tracks_numbers(struct spin_bundle_tracks *t, int index, size_t n,
                                       uint32_t *track)
{
    int64_t shape[1] = {(int64_t)n};
    struct spin_bundle_values v;

    if (!t->values) {
        memset(track, 0xff, n * sizeof *track); /* SPIN_NOT_TRACKED */
        return SPIN_OK;
    }
    index = t->same_rows ? 0 : index;
    SPIN_TRY(spin_bundle_values_open(t->bundle, "trained/track", index, 'u', 1, shape, &v));
    spin_bundle_values_get(&v, 0, n, track);
    spin_bundle_values_close(&v);
    for (size_t i = 0; i < n; i++)
        if (track[i] != SPIN_NOT_TRACKED && track[i] >= t->n)
            return spin_malformed("array 'trained/track/%05d' contains track %" PRIu32
                                  ", but there are %zu tracks",
                                  index, track[i], t->n);
    return SPIN_OK;
}

/* Enlarges the block to hold track numbers, positions and residual values of n splats. */
static spin_status reserve_block(struct spin_bundle_tracks *t, size_t n)
{
    void *block = NULL;

    if (n <= t->capacity)
        return SPIN_OK;
    SPIN_TRY(
        spin_alloc(n + n / 8 + 64, sizeof(uint32_t) + SPIN_TRACK_WIDTH * sizeof(float), &block));
    free(t->block);
    t->block = block;
    t->capacity = n + n / 8 + 64;
    return SPIN_OK;
}

spin_status spin_bundle_tracks_frame(struct spin_bundle_tracks *t, int index, size_t n,
                                     float *means, float *rows)
{
    size_t n_pos, n_residual, need_pos = 0, need_residual = 0, pos = 0, residual = 0;
    uint32_t *track;
    float *own_pos, *own_residual;

    SPIN_TRY(reserve_block(t, n));
    track = t->block;
    own_pos = (float *)(track + t->capacity);
    own_residual = own_pos + 3 * n;
    SPIN_TRY(spin_bundle_tracks_numbers(t, index, n, track));
    SPIN_TRY(read_own(t, "means", index, 3, own_residual, own_pos, &n_pos));
    SPIN_TRY(
        read_own(t, "residual", index, ROW, own_residual + ROW * n, own_residual, &n_residual));
    for (size_t i = 0; i < n; i++) {
        bool none = track[i] == SPIN_NOT_TRACKED;

        need_pos += none || track[i] < t->n_moving;
        need_residual += none || track[i] < t->n_varying;
    }
    if (n_pos != need_pos || n_residual != need_residual)
        return spin_malformed(
            "frame %d has %zu positions and %zu residual values, expected %zu and %zu", index,
            n_pos, n_residual, need_pos, need_residual);
    for (size_t i = 0; i < n; i++) {
        bool none = track[i] == SPIN_NOT_TRACKED;
        const float *shared = none ? NULL : t->values + SPIN_TRACK_WIDTH * (size_t)track[i];
        const float *p = none || track[i] < t->n_moving ? own_pos + 3 * pos++ : NULL;
        const float *r = none || track[i] < t->n_varying ? own_residual + ROW * residual++ : NULL;

        for (size_t c = 0; c < 3; c++)
            means[3 * i + c] = (p ? p[c] : 0) + (shared ? shared[c] : 0);
        for (size_t c = 0; c < ROW; c++)
            rows[ROW * i + c] = (r ? r[c] : 0) + (shared ? shared[3 + c] : 0);
    }
    return SPIN_OK;
}
