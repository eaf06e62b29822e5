#include "exporters/lib/static_rows.h"

#include "base/base.h"

#define NONE UINT32_MAX

/* A column with `width` floats per row; the first n floats of each row are written. */
struct column {
    const float *at;
    size_t width, n;
};

static void columns_of(const struct spin_splats *s, int n_sh, struct column c[5])
{
    c[0] = (struct column){s->means, 3, 3};
    c[1] = (struct column){s->quats, 4, 4};
    c[2] = (struct column){s->log_scales, 3, 3};
    c[3] = (struct column){s->logit_opacities, 1, 1};
    c[4] = (struct column){s->sh, 3 * (size_t)spin_sh_count(s->sh_degree), 3 * (size_t)n_sh};
}

static int by_hash(const void *a, const void *b)
{
    const struct spin_static_row *x = a, *y = b;
    int order = memcmp(x->hash, y->hash, sizeof x->hash);

    return order ? order : (x->row > y->row) - (x->row < y->row);
}

/* Lists the kept rows of the current frame in s->now, sorted by hash. */
static spin_status list_rows(struct spin_static_rows *s, const struct spin_splat_rows *rows)
{
    size_t room = rows->splats->n + 1, n = 0;
    struct column c[5];

    SPIN_TRY(spin_grow(room, sizeof *s->now, (void **)&s->now));
    SPIN_TRY(spin_grow(room, 1, (void **)&s->keep));
    SPIN_TRY(spin_grow(room, sizeof *s->order, (void **)&s->order));
    columns_of(rows->splats, spin_splat_rows_n_sh(rows), c);
    for (size_t i = 0; i < rows->splats->n; i++) {
        if (!rows->keep[i])
            continue;
        s->now[n] = (struct spin_static_row){.hash = {c[4].n}, .row = (uint32_t)i};
        for (int k = 0; k < 5; k++)
            spin_static_hash(s->now[n].hash, c[k].at + i * c[k].width, c[k].n);
        n++;
    }
    qsort(s->now, n, sizeof *s->now, by_hash);
    return SPIN_OK;
}

/* For each row of s->kept, sets s->mate to the row of the current frame that has the same values,
 * or to NONE if there is none. Rows with equal values are matched one to one. */
static void pair_rows(struct spin_static_rows *s, const struct spin_splat_rows *rows)
{
    size_t at = 0;

    for (size_t k = 0; k < s->n; k++) {
        const struct spin_static_row *kept = &s->kept[k];
        int order = 1;

        while (at < rows->n_kept &&
               (order = memcmp(s->now[at].hash, kept->hash, sizeof kept->hash)) < 0)
            at++;
        s->mate[kept->row] = at < rows->n_kept && order == 0 ? s->now[at++].row : NONE;
    }
}

static spin_status copy_first_frame(struct spin_static_rows *s, const struct spin_splat_rows *rows)
{
    s->n = rows->n_kept;
    s->n_first = rows->splats->n;
    SPIN_TRY(spin_alloc(s->n_first + 1, sizeof *s->mate, (void **)&s->mate));
    SPIN_TRY(spin_alloc(s->n + 1, sizeof *s->kept, (void **)&s->kept));
    memset(s->mate, 0xff, (s->n_first + 1) * sizeof *s->mate);
    memcpy(s->kept, s->now, s->n * sizeof *s->kept);
    return SPIN_OK;
}

/* Drops the rows of s->kept that the current frame does not contain. */
static void narrow_rows(struct spin_static_rows *s, const struct spin_splat_rows *rows)
{
    size_t n = 0;

    pair_rows(s, rows);
    for (size_t k = 0; k < s->n; k++) {
        if (s->mate[s->kept[k].row] != NONE)
            s->kept[n++] = s->kept[k];
    }
    s->n = n;
}

spin_status spin_static_rows_find(struct spin_static_rows *s, struct spin_splat_rows *rows,
                                  const struct spin_export_job *job)
{
    for (int f = 0; f < job->n_frames && (f == 0 || s->n > 0); f++) {
        const struct spin_splats *splats;

        SPIN_TRY(job->again(job->context, f, &splats));
        SPIN_TRY(spin_splat_rows_choose(rows, splats));
        SPIN_TRY(list_rows(s, rows));
        if (f == 0)
            SPIN_TRY(copy_first_frame(s, rows));
        else
            narrow_rows(s, rows);
    }
    return SPIN_OK;
}

/* Sets s->mate and s->keep for the current frame. */
static spin_status match_frame(struct spin_static_rows *s, const struct spin_splat_rows *rows,
                               int number)
{
    SPIN_TRY(list_rows(s, rows));
    pair_rows(s, rows);
    if (rows->splats->n > 0)
        memcpy(s->keep, rows->keep, rows->splats->n);
    for (size_t k = 0; k < s->n; k++) {
        uint32_t row = s->mate[s->kept[k].row];

        if (row == NONE)
            return spin_fail(SPIN_E_IO,
                             "frame %d: a splat that was the same in all frames is missing when "
                             "the frame is read again: the input has changed, repeat the export",
                             number);
        s->keep[row] = 0;
    }
    return SPIN_OK;
}

spin_status spin_static_rows_leave_out(struct spin_static_rows *s, struct spin_splat_rows *rows,
                                       int number)
{
    SPIN_TRY(match_frame(s, rows, number));
    spin_splat_rows_keep(rows, s->keep);
    return SPIN_OK;
}

void spin_static_rows_only(const struct spin_static_rows *s, struct spin_splat_rows *rows)
{
    memset(s->keep, 0, s->n_first);
    for (size_t k = 0; k < s->n; k++)
        s->keep[s->kept[k].row] = 1;
    spin_splat_rows_keep(rows, s->keep);
}

spin_status spin_static_rows_order(struct spin_static_rows *s, const struct spin_splat_rows *rows,
                                   int number, const struct spin_keyed **order)
{
    size_t n = 0;

    SPIN_TRY(match_frame(s, rows, number));
    for (size_t i = 0; i < rows->splats->n; i++) {
        if (s->keep[i])
            s->order[n++].row = (uint32_t)i;
    }
    for (size_t i = 0; i < s->n_first; i++) {
        if (s->mate[i] != NONE)
            s->order[n++].row = s->mate[i];
    }
    *order = s->order;
    return SPIN_OK;
}

void spin_static_rows_free(struct spin_static_rows *s)
{
    free(s->kept);
    free(s->now);
    free(s->keep);
    free(s->mate);
    free(s->order);
    *s = (struct spin_static_rows){0};
}
