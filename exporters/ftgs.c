/* .ftgs.ply, version 1: 4D splats on straight lines with a bell in time, as one PLY of floats. Nothing is rounded but
 * to float, so it is the form in which such models are exchanged.
 *
 * Times run from 0 to 1 over the clip, frame i of F at i/(F-1), and velocities count in clips; sigma and opacity are
 * stored as their logarithm and logit. A reader holds sigma at min_duration, so that is the least there is. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "exporters/lib/bells_check.h"
#include "math/sh.h"

/* Clips that a splat which never fades lasts for, as sigma: its weight is 0.9998 at the ends of the clip. */
#define MOST_SIGMA 50
enum { BATCH = 4096 }; /* rows written at a time */

struct export
{
    struct spin_bells bells;
    struct spin_splat_filter rows;
    struct spin_sort_rows order; /* the kept rows */
    struct spin_out out;
    bool open;
};

/* ---- Rows ------------------------------------------------------------------------------------ */

static size_t width_of(const struct export *x)
{
    return 16 + 3 + 3 * (size_t)spin_sh_count(x->rows.sh_degree);
}

static void fill_row(const struct export *x, size_t i, float *to)
{
    const struct spin_splats_4d *s = &x->bells.clip;
    size_t n_sh = (size_t)spin_sh_count(x->rows.sh_degree);
    size_t n_there = (size_t)spin_splat_filter_n_sh(&x->rows);
    float room[3 * SPIN_SH_MAX];
    const float *sh = spin_splat_filter_sh(&x->rows, i, room);

    memset(to, 0, width_of(x) * sizeof *to);
    spin_splat_filter_place(&x->rows, i, to);
    for (size_t k = 0; k < n_there; k++) /* f_dc, then f_rest: all rows of red, of green, of blue */
        for (size_t c = 0; c < 3; c++)
            to[6 + (k == 0 ? c : 3 + (n_sh - 1) * c + k - 1)] = sh[3 * k + c];
    to += 6 + 3 * n_sh;
    *to++ = spin_finite_logit(s->logit_opacities[i]);
    memcpy(to, s->log_scales + 3 * i, 3 * sizeof *to);
    spin_splat_filter_turned(&x->rows, i, to + 3);
    to[7] = s->times[i];
    to[8] = (float)log((double)s->sigmas[i]);
    if (s->degree > 0)
        spin_splat_filter_direction(&x->rows, s->paths + 3 * i, to + 9);
}

static spin_status write_header(struct export *x)
{
    const struct spin_splats_4d *s = &x->bells.clip;
    double least = MOST_SIGMA;
    FILE *f = x->out.file;

    for (size_t j = 0; j < x->order.n; j++)
        least = fmin(least, (double)s->sigmas[x->order.item[j].row]);
    fprintf(f,
            "ply\nformat binary_little_endian 1.0\ncomment ftgs_version 1\n"
            "comment time_units normalized\ncomment sh_degree %d\ncomment use_velocity %d\n"
            "comment min_duration %.9g\ncomment opacity_floor 0\ncomment n_frames %d\n"
            "comment generator spin4d " SPIN_VERSION "\nelement vertex %zu\n",
            x->rows.sh_degree, s->degree > 0, least * (1 - 1e-6), x->bells.job->n_frames,
            x->order.n);
    for (const char *c = "xyz"; *c; c++)
        fprintf(f, "property float %c\n", *c);
    for (const char *c = "xyz"; *c; c++)
        fprintf(f, "property float n%c\n", *c);
    for (int k = 0; k < 3; k++)
        fprintf(f, "property float f_dc_%d\n", k);
    for (int k = 0; k < 3 * (spin_sh_count(x->rows.sh_degree) - 1); k++)
        fprintf(f, "property float f_rest_%d\n", k);
    fprintf(f, "property float opacity\n");
    for (int k = 0; k < 3; k++)
        fprintf(f, "property float scale_%d\n", k);
    for (int k = 0; k < 4; k++)
        fprintf(f, "property float rot_%d\n", k);
    fprintf(f, "property float time\nproperty float log_duration\n");
    for (int k = 0; k < 3; k++)
        fprintf(f, "property float velocity_%d\n", k);
    fprintf(f, "end_header\n");
    return SPIN_OK;
}

static spin_status write_rows(struct export *x)
{
    size_t width = width_of(x);
    float *rows;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(BATCH, width * sizeof *rows, (void **)&rows));
    for (size_t j = 0; j < x->order.n && status == SPIN_OK; j += BATCH) {
        size_t n = x->order.n - j < BATCH ? x->order.n - j : BATCH;

        for (size_t k = 0; k < n; k++)
            fill_row(x, x->order.item[j + k].row, rows + width * k);
        status = spin_cancelled() ? spin_fail_cancelled()
                                  : spin_out_write(&x->out, rows, n * width * sizeof *rows);
    }
    free(rows);
    return status;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static void ftgs_abort(void *self)
{
    struct export *x = self;

    if (x->open)
        spin_out_abandon(&x->out);
    spin_splat_filter_end(&x->rows);
    spin_sort_rows_free(&x->order);
    spin_bells_free(&x->bells);
    free(x);
}

static spin_status prepare(struct export *x)
{
    const struct spin_export_job *job = x->bells.job;

    SPIN_TRY(spin_bells_can(&x->bells));
    SPIN_TRY(spin_splat_filter_begin(&x->rows, job, NULL));
    SPIN_TRY(spin_out_open(job->output, job->force, &x->out));
    x->open = true;
    x->out.sync = job->sync;
    return SPIN_OK;
}

static spin_status ftgs_begin(const struct spin_export_job *job, void **self)
{
    struct export *x;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->bells = (struct spin_bells){
        .job = job, .name = "a .ftgs.ply", .length = 1, .most_sigma = MOST_SIGMA, .degree = 1};
    status = prepare(x);
    if (status != SPIN_OK) {
        ftgs_abort(x);
        return status;
    }
    *self = x;
    return SPIN_OK;
}

static spin_status write_file(struct export *x)
{
    const struct spin_export_job *job = x->bells.job;
    struct spin_bells_check of = {.bells = &x->bells, .rows = &x->rows, .importer = "freetimegs"};

    SPIN_TRY(spin_bells_convert(&x->bells));
    SPIN_TRY(spin_splat_filter_choose(&x->rows, &x->bells.view, 0));
    SPIN_TRY(spin_sort_rows_fill(&x->order, &x->rows));
    if (x->order.n == 0)
        return spin_fail(SPIN_E_UNSUPPORTED, "no splat of the clip is left to write");
    SPIN_TRY(write_header(x));
    SPIN_TRY(write_rows(x));
    if (job->report)
        job->report->bytes = (uint64_t)ftell(x->out.file);
    x->open = false;
    SPIN_TRY(spin_out_commit(&x->out));
    spin_bells_warn(&x->bells);
    of.order = x->order.item;
    of.n = x->order.n;
    return job->check ? spin_bells_check(&of) : SPIN_OK;
}

static spin_status ftgs_end(void *self)
{
    spin_status status = write_file(self);

    ftgs_abort(self);
    return status;
}

static const struct spin_plugin_option ftgs_options[] = {
    SPIN_ROWS_OPTIONS, SPIN_ROWS_OPTION_SH, {0}};

const struct spin_exporter spin_exporter_ftgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "ftgs",
    .summary = "4D splats as one .ftgs.ply of FreeTimeGS, without loss",
    .options = ftgs_options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .checks = true,
    .antialias = false,
    .splats_4d = true,
    .begin = ftgs_begin,
    .end = ftgs_end,
    .abort = ftgs_abort,
};
