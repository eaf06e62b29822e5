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
#include "math/sh.h"
#include "spin.h"

/* Clips that a splat which never fades lasts for, as sigma: its weight is 0.9998 at the ends of the clip. */
#define MOST_SIGMA 50
enum { BATCH = 4096 }; /* rows written at a time */

struct export
{
    const struct spin_export_job *job;
    struct spin_out out;
    bool open;
};

/* ---- What the file can hold ------------------------------------------------------------------ */

static spin_status check_clip(const struct spin_export_job *job)
{
    const struct spin_splats_4d *s = job->splats_4d;

    if (!s)
        return spin_fail(
            SPIN_E_UNSUPPORTED,
            "this clip is frames, and a .ftgs.ply holds 4D splats: import a source that has them, "
            "without --frames, or write another format");
    if (s->plateaus || s->cuts || s->gates || s->degree > 1)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "these 4D splats have %s, and a .ftgs.ply holds straight lines and bells "
                         "in time: write another format",
                         s->degree > 1 ? "curved paths"
                         : s->cuts     ? "a beginning and an end"
                         : s->gates    ? "opacities that do not fade to 0"
                                       : "times at which they do not fade");
    if (!(job->times[job->n_frames - 1] > job->times[0]))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "a .ftgs.ply holds a clip, and this is one frame: give more with --range");
    return SPIN_OK;
}

static void warn_lost(const struct spin_splats_4d *s)
{
    if (s->spins)
        spin_warn("these splats turn, which a .ftgs.ply cannot say: they keep the rotation of "
                  "their own time");
    if (s->sh_cos)
        spin_warn("colours change in time, which a .ftgs.ply cannot say: they keep those of their "
                  "own time");
    if (s->cov2d[0] > 0)
        spin_warn(
            "trained with %g and %g on the covariance on screen, which a .ftgs.ply cannot say",
            s->cov2d[0], s->cov2d[1]);
}

/* ---- Rows ------------------------------------------------------------------------------------ */

static double length_of(const struct spin_export_job *job)
{
    return job->times[job->n_frames - 1] - job->times[0];
}

static double sigma_of(const struct spin_export_job *job, size_t i)
{
    return fmin((double)job->splats_4d->sigmas[i] / length_of(job), MOST_SIGMA);
}

static size_t width_of(const struct spin_splats_4d *s)
{
    return 19 + 3 * (size_t)spin_sh_count(s->sh_degree);
}

static void fill_row(const struct spin_export_job *job, size_t i, float *to)
{
    const struct spin_splats_4d *s = job->splats_4d;
    size_t n_sh = (size_t)spin_sh_count(s->sh_degree);
    double length = length_of(job);

    memcpy(to, s->centres + 3 * i, 3 * sizeof *to);
    memset(to + 3, 0, 3 * sizeof *to);
    for (size_t k = 0; k < n_sh; k++) /* f_dc, then f_rest: all rows of red, of green, of blue */
        for (size_t c = 0; c < 3; c++) {
            const float *cosine = s->sh_cos ? s->sh_cos + 6 * n_sh * i + 3 * k + c : NULL;

            to[6 + (k == 0 ? c : 3 + (n_sh - 1) * c + k - 1)] =
                s->sh[3 * (n_sh * i + k) + c] + (cosine ? cosine[0] + cosine[3 * n_sh] : 0);
        }
    to += 6 + 3 * n_sh;
    *to++ = s->logit_opacities[i];
    memcpy(to, s->log_scales + 3 * i, 3 * sizeof *to);
    memcpy(to + 3, s->quats + 4 * i, 4 * sizeof *to);
    to[7] = (float)(((double)s->times[i] - job->times[0]) / length);
    to[8] = (float)log(sigma_of(job, i));
    for (size_t c = 0; c < 3; c++)
        to[9 + c] = s->degree > 0 ? (float)((double)s->paths[3 * i + c] * length) : 0;
}

static spin_status write_header(struct export *x)
{
    const struct spin_splats_4d *s = x->job->splats_4d;
    double least = MOST_SIGMA;
    FILE *f = x->out.file;

    for (size_t i = 0; i < s->n; i++)
        least = fmin(least, sigma_of(x->job, i));
    fprintf(f,
            "ply\nformat binary_little_endian 1.0\ncomment ftgs_version 1\n"
            "comment time_units normalized\ncomment sh_degree %d\ncomment use_velocity %d\n"
            "comment min_duration %.9g\ncomment opacity_floor 0\ncomment n_frames %d\n"
            "comment generator spin4d " SPIN_VERSION "\nelement vertex %zu\n",
            s->sh_degree, s->degree > 0, least * (1 - 1e-6), x->job->n_frames, s->n);
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
    const struct spin_splats_4d *s = x->job->splats_4d;
    size_t width = width_of(s);
    float *rows;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(BATCH, width * sizeof *rows, (void **)&rows));
    for (size_t i = 0; i < s->n && status == SPIN_OK; i += BATCH) {
        size_t n = s->n - i < BATCH ? s->n - i : BATCH;

        for (size_t k = 0; k < n; k++)
            fill_row(x->job, i + k, rows + width * k);
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
    free(x);
}

static spin_status ftgs_begin(const struct spin_export_job *job, void **self)
{
    struct export *x;

    SPIN_TRY(check_clip(job));
    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->job = job;
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
    SPIN_TRY(spin_out_open(x->job->output, x->job->force, &x->out));
    x->open = true;
    x->out.sync = x->job->sync;
    SPIN_TRY(write_header(x));
    SPIN_TRY(write_rows(x));
    if (x->job->report)
        x->job->report->bytes = (uint64_t)ftell(x->out.file);
    x->open = false;
    SPIN_TRY(spin_out_commit(&x->out));
    warn_lost(x->job->splats_4d);
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
