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
#include "exporters/lib/bells.h"
#include "math/sh.h"

/* Clips that a splat which never fades lasts for, as sigma: its weight is 0.9998 at the ends of the clip. */
#define MOST_SIGMA 50
enum { BATCH = 4096 }; /* rows written at a time */

struct export
{
    struct spin_bells bells;
    struct spin_out out;
    bool open;
};

/* ---- Rows ------------------------------------------------------------------------------------ */

static size_t width_of(const struct spin_splats_4d *s)
{
    return 19 + 3 * (size_t)spin_sh_count(s->sh_degree);
}

static void fill_row(const struct spin_splats_4d *s, size_t i, float *to)
{
    size_t n_sh = (size_t)spin_sh_count(s->sh_degree);

    memcpy(to, s->centres + 3 * i, 3 * sizeof *to);
    memset(to + 3, 0, 3 * sizeof *to);
    for (size_t k = 0; k < n_sh; k++) /* f_dc, then f_rest: all rows of red, of green, of blue */
        for (size_t c = 0; c < 3; c++)
            to[6 + (k == 0 ? c : 3 + (n_sh - 1) * c + k - 1)] = s->sh[3 * (n_sh * i + k) + c];
    to += 6 + 3 * n_sh;
    *to++ = s->logit_opacities[i];
    memcpy(to, s->log_scales + 3 * i, 3 * sizeof *to);
    memcpy(to + 3, s->quats + 4 * i, 4 * sizeof *to);
    to[7] = s->times[i];
    to[8] = (float)log((double)s->sigmas[i]);
    for (size_t c = 0; c < 3; c++)
        to[9 + c] = s->degree > 0 ? s->paths[3 * i + c] : 0;
}

static spin_status write_header(struct export *x)
{
    const struct spin_splats_4d *s = &x->bells.clip;
    double least = MOST_SIGMA;
    FILE *f = x->out.file;

    for (size_t i = 0; i < s->n; i++)
        least = fmin(least, (double)s->sigmas[i]);
    fprintf(f,
            "ply\nformat binary_little_endian 1.0\ncomment ftgs_version 1\n"
            "comment time_units normalized\ncomment sh_degree %d\ncomment use_velocity %d\n"
            "comment min_duration %.9g\ncomment opacity_floor 0\ncomment n_frames %d\n"
            "comment generator spin4d " SPIN_VERSION "\nelement vertex %zu\n",
            s->sh_degree, s->degree > 0, least * (1 - 1e-6), x->bells.job->n_frames, s->n);
    for (const char *c = "xyz"; *c; c++)
        fprintf(f, "property float %c\n", *c);
    for (const char *c = "xyz"; *c; c++)
        fprintf(f, "property float n%c\n", *c);
    for (int k = 0; k < 3; k++)
        fprintf(f, "property float f_dc_%d\n", k);
    for (int k = 0; k < 3 * (spin_sh_count(s->sh_degree) - 1); k++)
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
    const struct spin_splats_4d *s = &x->bells.clip;
    size_t width = width_of(s);
    float *rows;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(BATCH, width * sizeof *rows, (void **)&rows));
    for (size_t i = 0; i < s->n && status == SPIN_OK; i += BATCH) {
        size_t n = s->n - i < BATCH ? s->n - i : BATCH;

        for (size_t k = 0; k < n; k++)
            fill_row(s, i + k, rows + width * k);
        status = spin_out_write(&x->out, rows, n * width * sizeof *rows);
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
    spin_bells_free(&x->bells);
    free(x);
}

static spin_status ftgs_begin(const struct spin_export_job *job, void **self)
{
    struct export *x;

    SPIN_TRY(spin_bells_can(job, "a .ftgs.ply"));
    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->bells = (struct spin_bells){
        .job = job, .name = "a .ftgs.ply", .length = 1, .most_sigma = MOST_SIGMA, .degree = 1};
    *self = x;
    return SPIN_OK;
}

static spin_status ftgs_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats)
{
    (void)self;
    (void)frame;
    (void)info;
    (void)splats;
    return SPIN_OK;
}

static spin_status write_file(struct export *x)
{
    const struct spin_export_job *job = x->bells.job;

    SPIN_TRY(spin_bells_convert(&x->bells));
    SPIN_TRY(spin_out_open(job->output, job->force, &x->out));
    x->open = true;
    x->out.sync = job->sync;
    SPIN_TRY(write_header(x));
    SPIN_TRY(write_rows(x));
    if (job->report)
        job->report->bytes = (uint64_t)ftell(x->out.file);
    x->open = false;
    SPIN_TRY(spin_out_commit(&x->out));
    spin_bells_warn(&x->bells);
    return SPIN_OK;
}

static spin_status ftgs_end(void *self)
{
    spin_status status = write_file(self);

    ftgs_abort(self);
    return status;
}

const struct spin_exporter spin_exporter_ftgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "ftgs",
    .summary = "4D splats as one .ftgs.ply of FreeTimeGS, without loss",
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .antialias = false,
    .splats_4d = true,
    .begin = ftgs_begin,
    .frame = ftgs_frame,
    .end = ftgs_end,
    .abort = ftgs_abort,
};
