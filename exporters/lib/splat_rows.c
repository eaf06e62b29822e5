/* The rows of a frame, see splat_rows.h. Infinite logits, of opacities of exactly 0 or 1, are
 * written as large finite logits. */
#include "exporters/lib/splat_rows.h"

#include "base/base.h"
#include "io/file.h"
#include "math/approx.h"
#include "math/drawable.h"

/* The mapped memory of a frame with fewer bytes than this is not released early. */
#define SMALL ((size_t)64 << 20)

struct spin_splat_rows_block {
    size_t n_before; /* number of kept rows in all blocks before this one */
    uint32_t n_kept;
};

/* ---- Blocks ---------------------------------------------------------------------------------- */

size_t spin_splat_rows_blocks(const struct spin_splat_rows *rows)
{
    return (rows->splats->n + SPIN_ROWS_BLOCK - 1) / SPIN_ROWS_BLOCK;
}

size_t spin_splat_rows_before(const struct spin_splat_rows *rows, size_t block)
{
    return rows->block[block].n_before;
}

void spin_splat_rows_each(const struct spin_splat_rows *rows, spin_task_fn fn, void *context)
{
    spin_pool_run(rows->pool, (int)spin_splat_rows_blocks(rows), fn, context);
}

static size_t end_of(const struct spin_splat_rows *rows, size_t block)
{
    size_t end = (block + 1) * SPIN_ROWS_BLOCK;

    return end < rows->splats->n ? end : rows->splats->n;
}

void spin_splat_rows_release(const struct spin_splat_rows *rows, size_t block, unsigned columns)
{
    const struct spin_splats *s = rows->splats;
    size_t first = block * SPIN_ROWS_BLOCK, n = end_of(rows, block) - first;
    size_t n_sh = 3 * (size_t)spin_sh_count(s->sh_degree);

    /* madvise() briefly stalls all threads: do not use it for small frames. */
    if (!s->mapped || (11 + n_sh) * sizeof(float) * s->n < SMALL)
        return;
    if (columns & SPIN_COL_MEANS)
        spin_map_release(s->means + 3 * first, 3 * n * sizeof(float));
    if (columns & SPIN_COL_QUATS)
        spin_map_release(s->quats + 4 * first, 4 * n * sizeof(float));
    if (columns & SPIN_COL_LOG_SCALES)
        spin_map_release(s->log_scales + 3 * first, 3 * n * sizeof(float));
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        spin_map_release(s->logit_opacities + first, n * sizeof(float));
    if (columns & SPIN_COL_SH)
        spin_map_release(s->sh + n_sh * first, n_sh * n * sizeof(float));
}

/* Counts the kept rows of the whole frame, and for each block the kept rows before the block. */
static void add_up(struct spin_splat_rows *rows)
{
    rows->n_kept = 0;
    for (size_t b = 0; b < spin_splat_rows_blocks(rows); b++) {
        rows->block[b].n_before = rows->n_kept;
        rows->n_kept += rows->block[b].n_kept;
    }
}

spin_status spin_splat_rows_choose(struct spin_splat_rows *rows, const struct spin_splats *s)
{
    if (s->n > UINT32_MAX)
        return spin_unsupported("%zu splats in one frame, at most %u are supported", s->n,
                                UINT32_MAX);
    rows->splats = s;
    SPIN_TRY(spin_grow(s->n + 1, 1, (void **)&rows->keep));
    SPIN_TRY(
        spin_grow(spin_splat_rows_blocks(rows) + 1, sizeof *rows->block, (void **)&rows->block));
    memset(rows->keep, 1, s->n);
    for (size_t b = 0; b < spin_splat_rows_blocks(rows); b++)
        rows->block[b].n_kept = (uint32_t)(end_of(rows, b) - b * SPIN_ROWS_BLOCK);
    add_up(rows);
    return SPIN_OK;
}

void spin_splat_rows_keep(struct spin_splat_rows *rows, const unsigned char *keep)
{
    for (size_t b = 0; b < spin_splat_rows_blocks(rows); b++) {
        rows->block[b].n_kept = 0;
        for (size_t i = b * SPIN_ROWS_BLOCK; i < end_of(rows, b); i++)
            rows->block[b].n_kept += rows->keep[i] = keep[i];
    }
    add_up(rows);
}

/* ---- One row --------------------------------------------------------------------------------- */

void spin_splat_rows_direction(const struct spin_splat_rows *rows, const float v[3], float out[3])
{
    spin_vec3 turned;

    memcpy(out, v, 3 * sizeof *out);
    if (rows->turn.kind == SPIN_TURN_NONE)
        return;
    turned = spin_scene_rotation_place(&rows->turn, spin_v3(v[0], v[1], v[2]));
    out[0] = turned.x;
    out[1] = turned.y;
    out[2] = turned.z;
}

void spin_splat_rows_place(const struct spin_splat_rows *rows, size_t i, float out[3])
{
    spin_splat_rows_direction(rows, rows->splats->means + 3 * i, out);
}

void spin_splat_rows_turned(const struct spin_splat_rows *rows, size_t i, float out[4])
{
    float q[4];

    spin_unit_rotation(rows->splats->quats + 4 * i, out);
    if (rows->turn.kind == SPIN_TURN_NONE)
        return;
    spin_scene_rotation_quat(&rows->turn, out, q);
    for (int k = 0; k < 4; k++)
        out[k] = q[0] < 0 ? -q[k] : q[k];
}

const float *spin_splat_rows_sh(const struct spin_splat_rows *rows, size_t i, float *room)
{
    const struct spin_splats *s = rows->splats;
    const float *sh = s->sh + i * 3 * (size_t)spin_sh_count(s->sh_degree);

    if (rows->turn.kind == SPIN_TURN_NONE)
        return sh;
    spin_scene_rotation_sh(&rows->turn, spin_splat_rows_n_sh(rows), sh, room);
    return room;
}

float spin_splat_rows_opacity(const struct spin_splat_rows *rows, size_t i)
{
    return spin_sigmoid(spin_finite_logit(rows->splats->logit_opacities[i]));
}

void spin_splat_rows_colour(const struct spin_splat_rows *rows, size_t i, float out[3])
{
    const struct spin_splats *s = rows->splats;
    const float *dc = s->sh + i * 3 * (size_t)spin_sh_count(s->sh_degree);

    for (int c = 0; c < 3; c++)
        out[c] = 0.5f + (float)SPIN_SH_C0 * dc[c];
}

void spin_splat_rows_get(const struct spin_splat_rows *rows, size_t i, struct spin_gaussian *out)
{
    spin_splat_rows_place(rows, i, out->place);
    memcpy(out->log_scale, rows->splats->log_scales + 3 * i, sizeof out->log_scale);
    spin_splat_rows_turned(rows, i, out->rotation);
    out->opacity = spin_splat_rows_opacity(rows, i);
    spin_splat_rows_colour(rows, i, out->colour);
}

/* ---- Options --------------------------------------------------------------------------------- */

spin_status spin_splat_rows_parse_sh(const char *text, int kept, int *out)
{
    *out = kept < 0 ? 0 : kept;
    if (strcmp(text, "keep") == 0)
        return SPIN_OK;
    if (text[0] < '0' || text[0] > '3' || text[1])
        return spin_misuse("--sh '%s': expected 0, 1, 2, 3 or keep", text);
    *out = text[0] - '0';
    return SPIN_OK;
}

/* Sets q to the rotation with the smallest angle that maps this axis to y. For -y, this is the
 * rotation by 180 degrees about z, as in the glTF exporter. */
static spin_status parse_up(const char *text, double q[4])
{
    static const double r = 0.70710678118654752;
    static const struct {
        const char *axis;
        double q[4];
    } turns[] = {{"x", {r, 0, 0, r}},  {"-x", {r, 0, 0, -r}}, {"y", {1, 0, 0, 0}},
                 {"-y", {0, 0, 0, 1}}, {"z", {r, -r, 0, 0}},  {"-z", {r, r, 0, 0}}};

    for (size_t i = 0; i < sizeof turns / sizeof turns[0]; i++) {
        if (strcmp(text, turns[i].axis) == 0) {
            memcpy(q, turns[i].q, sizeof turns[i].q);
            return SPIN_OK;
        }
    }
    return spin_misuse("--up '%s': expected x, y, z, -x, -y or -z", text);
}

spin_status spin_splat_rows_parse_rotate(const char *text, double q[4])
{
    const char *at = text;
    double turned[4] = {1, 0, 0, 0};

    for (int axis = 0; axis < 3; axis++) {
        char *end;
        double degrees = strtod(at, &end), half = fmod(degrees, 720) * 0.00872664625997164788;
        double one[4] = {cos(half), 0, 0, 0};

        if (end == at || !isfinite(degrees) || *end != (axis < 2 ? ',' : '\0'))
            return spin_misuse("--rotate '%s': expected three angles in degrees, X,Y,Z", text);
        one[1 + axis] = sin(half);
        spin_scene_rotation_join(turned, one, turned);
        at = end + 1;
    }
    memcpy(q, turned, sizeof turned);
    return SPIN_OK;
}

static spin_status parse_turn(struct spin_splat_rows *rows, const struct spin_plugin_values *v,
                              const double *axes)
{
    const char *up = spin_plugin_value(v, "up", NULL),
               *rotate = spin_plugin_value(v, "rotate", NULL);
    double q[4] = {1, 0, 0, 0}, more[4] = {1, 0, 0, 0};

    if (axes)
        memcpy(q, axes, sizeof q);
    if (up)
        SPIN_TRY(parse_up(up, q));
    if (rotate)
        SPIN_TRY(spin_splat_rows_parse_rotate(rotate, more));
    spin_scene_rotation_join(q, more, rows->turn_q);
    spin_scene_rotation_from(rows->turn_q, &rows->turn);
    rows->up = up && !rotate;
    return SPIN_OK;
}

spin_status spin_splat_rows_begin(struct spin_splat_rows *rows, const struct spin_export_job *job,
                                  const double *axes)
{
    const struct spin_plugin_values *v = job->values;

    rows->report = job->report;
    SPIN_TRY(spin_splat_rows_parse_sh(spin_plugin_value(v, "sh", "keep"), job->sh_degree,
                                      &rows->sh_degree));
    SPIN_TRY(parse_turn(rows, v, axes));
    return spin_pool_create(job->n_threads, &rows->pool);
}

void spin_splat_rows_warn_empty(size_t n_empty, size_t n_frames)
{
    if (n_empty > 0)
        spin_warn("%zu of %zu frames are written without any splat", n_empty, n_frames);
}

spin_status spin_splat_rows_report_4d(const struct spin_splat_rows *rows,
                                      const struct spin_export_job *job, const size_t *from,
                                      const double *times, int n_frames)
{
    const double *spans = job->splats_4d->spans;
    /* spin_splats_4d_counts() reads only the members n and spans */
    struct spin_splats_4d kept = {0};
    SPIN_FREED double *kept_spans = NULL;
    SPIN_FREED size_t *counts = NULL;
    size_t n_empty = 0;
    double sum = 0;

    SPIN_TRY(spin_alloc(rows->n_kept + 1, 2 * sizeof *kept_spans, (void **)&kept_spans));
    SPIN_TRY(spin_alloc((size_t)n_frames, sizeof *counts, (void **)&counts));
    for (size_t k = 0; k < rows->splats->n; k++)
        if (rows->keep[k])
            memcpy(kept_spans + 2 * kept.n++, spans + 2 * (from ? from[k] : k), 2 * sizeof *spans);
    kept.spans = kept_spans;
    SPIN_TRY(spin_splats_4d_counts(&kept, times, (size_t)n_frames, counts));
    for (int f = 0; f < n_frames; f++) {
        sum += (double)counts[f];
        n_empty += counts[f] == 0;
    }
    if (job->report)
        job->report->splats_mean = sum / n_frames;
    spin_splat_rows_warn_empty(n_empty, (size_t)n_frames);
    return SPIN_OK;
}

void spin_splat_rows_end(struct spin_splat_rows *rows)
{
    if (rows->pool)
        spin_pool_free(rows->pool);
    free(rows->keep);
    free(rows->block);
    *rows = (struct spin_splat_rows){0};
}
