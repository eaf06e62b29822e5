/* Writes 4D splats with a Gaussian window in time as a single PLY. Values are stored as floats and
 * not quantised, so these files suit the exchange of models between programs. There are three
 * layouts:
 *
 * .ftgs.ply of FreeTimeGS, version 1: paths are linear. Time is normalised to 0..1 over the clip
 * (frame i of F is at i/(F-1)) and velocity is in world units per clip; sigma and opacity are
 * stored as logarithm and logit. Readers clamp sigma to at least the value of min_duration in the
 * header, so this value is written as just below the smallest sigma of the file.
 *
 * .sogst.ply, the input of .sogst encoders (formats/sogst.h): paths of degree 1 or 2. Time is in
 * seconds from the first frame, and sigma is not stored as a logarithm. The reference encoder
 * accepts only SH of degree 0 or 3, so missing coefficients are written as 0.
 *
 * STG-lite, a PLY with motion_0..2 for SuperSplat-4D and OpenSplat4D: paths are linear. Time is in
 * seconds from the first frame. The two viewers read different properties for sigma: trbf_scale of
 * SuperSplat-4D is log(sqrt(2) sigma), since the exponent of its window lacks the factor 1/2;
 * scale_t of OpenSplat4D is log(sigma). */
#include "base/base.h"
#include "exporters/lib/time_windows.h"
#include "formats/gs_ply.h"
#include "io/ply.h"
#include "math/sh.h"

/* The largest sigma to write, as a multiple of the clip's duration. A splat that does not fade is
 * written with this sigma: even one duration of the clip before or after its centre, the window is
 * 0.9998. */
#define MOST_SIGMA 50
#define MOST_SECONDS 1e6 /* largest sigma in seconds, for STG-lite */
enum { BATCH = 4096 };   /* number of rows that are written at a time */

struct export;

struct layout {
    const char *name;     /* name of the format in messages */
    const char *importer; /* the importer that reads the format */
    int degree;           /* highest degree of a path */
    /* True: the file has times in seconds; false: as shares of the clip's duration. */
    bool seconds;
    /* True: the format stores cov2d of struct spin_splats_4d, and requires SH of degree 0 or 3. */
    bool cov2d;
    double most_seconds; /* the largest sigma to write; 0: MOST_SIGMA durations of the clip */
    void (*print_header)(struct export *x);
    /* Converts row i. All floats of `to` are 0 before the call. */
    void (*fill_row)(const struct export *x, size_t i, float *to);
};

struct export
{
    const struct layout *layout;
    struct spin_time_windows windows;
    struct spin_splat_rows rows;
    struct spin_sort_rows order; /* the kept rows of windows.clip in the order of the file */
    double fps;
    int sh_degree; /* SH degree in the file */
    size_t width;  /* floats per row */
    struct spin_out out;
};

static size_t n_rest(const struct export *x) { return spin_n_rest(x->sh_degree); }

/* ---- Header ---------------------------------------------------------------------------------- */

static void print_property(struct export *x, const char *name, size_t n_name)
{
    fprintf(x->out.file, "property float %.*s\n", (int)n_name, name);
    x->width++;
}

/* Prints one property for each word of `names`. */
static void print_properties(struct export *x, const char *names)
{
    for (; *names; names += strspn(names, " ")) {
        size_t n = strcspn(names, " ");

        print_property(x, names, n);
        names += n;
    }
}

static void print_rest(struct export *x)
{
    char name[32];

    for (size_t k = 0; k < n_rest(x); k++) {
        snprintf(name, sizeof name, "f_rest_%zu", k);
        print_property(x, name, strlen(name));
    }
}

static void print_ftgs(struct export *x)
{
    const struct spin_splats_4d *s = &x->windows.clip;
    double least = MOST_SIGMA;

    for (size_t j = 0; j < x->order.n; j++)
        least = fmin(least, (double)s->sigmas[x->order.item[j].row]);
    fprintf(x->out.file,
            "comment ftgs_version 1\ncomment time_units normalized\ncomment sh_degree %d\n"
            "comment use_velocity %d\ncomment min_duration %.9g\ncomment opacity_floor 0\n"
            "comment n_frames %d\n",
            x->sh_degree, s->degree > 0, least * (1 - 1e-6), x->windows.job->n_frames);
    /* The line "comment fps" is not part of the format. Only spin-import reads it. */
    if (x->windows.job->fps > 0)
        fprintf(x->out.file, "comment fps %.9g\n", x->windows.job->fps);
    fprintf(x->out.file, "element vertex %zu\n", x->order.n);
    print_properties(x, "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2");
    print_rest(x);
    print_properties(x, "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 time log_duration "
                        "velocity_0 velocity_1 velocity_2");
}

static void print_sogst(struct export *x)
{
    const struct spin_splats_4d *s = &x->windows.clip;
    const double *cov2d = x->windows.job->splats_4d->cov2d;

    fprintf(x->out.file,
            "comment sogst.version 1\ncomment sogst.time_min 0\ncomment sogst.time_max %.9g\n"
            "comment sogst.fps %.9g\ncomment sogst.motion_degree %d\n",
            x->windows.length, x->fps, s->degree);
    if (cov2d[0] > 0)
        fprintf(x->out.file, "comment sogst.cov2d_scale %.9g %.9g\n", cov2d[0], cov2d[1]);
    fprintf(x->out.file, "element vertex %zu\n", x->order.n);
    print_properties(x, "x y z rot_0 rot_1 rot_2 rot_3 scale_0 scale_1 scale_2 opacity "
                        "f_dc_0 f_dc_1 f_dc_2 vx vy vz t_center t_sigma");
    print_rest(x);
    if (s->degree > 1)
        print_properties(x, "ax ay az");
}

static void print_stglite(struct export *x)
{
    fprintf(x->out.file,
            "comment " SPIN_PLY_TWO_VIEWERS
            "\ncomment cfg_args: start=0 duration=%.9g fps=%.9g sh_degree=%d\nelement vertex %zu\n",
            x->windows.job->n_frames / x->fps, x->fps, x->sh_degree, x->order.n);
    print_properties(x, "x y z scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 f_dc_0 f_dc_1 "
                        "f_dc_2 opacity trbf_center trbf_scale motion_0 motion_1 motion_2 t "
                        "scale_t");
    print_rest(x);
}

static void print_header(struct export *x)
{
    fprintf(x->out.file,
            "ply\nformat binary_little_endian 1.0\ncomment generator spin4d " SPIN_VERSION "\n%s",
            x->windows.job->antialias ? SPIN_PLY_ANTIALIASED : "");
    x->width = 0;
    x->layout->print_header(x);
    fprintf(x->out.file, "end_header\n");
}

/* ---- Rows ------------------------------------------------------------------------------------ */

/* Writes the SH coefficients of degree 0 to `dc`, and those above to `rest`: first all coefficients
 * of red, then those of green, then those of blue. */
static void fill_sh(const struct export *x, size_t i, float *dc, float *rest)
{
    size_t n_there = (size_t)spin_splat_rows_n_sh(&x->rows), n_file = n_rest(x) / 3;
    float room[3 * SPIN_SH_MAX];
    const float *sh = spin_splat_rows_sh(&x->rows, i, room);

    memcpy(dc, sh, 3 * sizeof *dc);
    for (size_t k = 1; k < n_there; k++)
        for (size_t c = 0; c < 3; c++)
            rest[n_file * c + k - 1] = sh[3 * k + c];
}

/* Sets `to` to the coefficient of d^(power + 1) in the path of row i, where d is the time relative
 * to the centre of the row's window. If the path has a lower degree, `to` is not changed. */
static void fill_path(const struct export *x, size_t i, int power, float to[3])
{
    const struct spin_splats_4d *s = &x->windows.clip;

    if (power < s->degree)
        spin_splat_rows_direction(&x->rows, s->paths + 3 * (size_t)s->degree * i + 3 * power, to);
}

static void fill_ftgs(const struct export *x, size_t i, float *to)
{
    const struct spin_splats_4d *s = &x->windows.clip;

    spin_splat_rows_place(&x->rows, i, to);
    fill_sh(x, i, to + 6, to + 9);
    to += 9 + n_rest(x);
    to[0] = spin_finite_logit(s->logit_opacities[i]);
    memcpy(to + 1, s->log_scales + 3 * i, 3 * sizeof *to);
    spin_splat_rows_turned(&x->rows, i, to + 4);
    to[8] = s->times[i];
    to[9] = (float)log((double)s->sigmas[i]);
    fill_path(x, i, 0, to + 10);
}

static void fill_sogst(const struct export *x, size_t i, float *to)
{
    const struct spin_splats_4d *s = &x->windows.clip;

    spin_splat_rows_place(&x->rows, i, to);
    spin_splat_rows_turned(&x->rows, i, to + 3);
    memcpy(to + 7, s->log_scales + 3 * i, 3 * sizeof *to);
    to[10] = spin_finite_logit(s->logit_opacities[i]);
    fill_sh(x, i, to + 11, to + 19);
    fill_path(x, i, 0, to + 14);
    to[17] = s->times[i];
    to[18] = s->sigmas[i];
    fill_path(x, i, 1, to + 19 + n_rest(x));
}

static void fill_stglite(const struct export *x, size_t i, float *to)
{
    const struct spin_splats_4d *s = &x->windows.clip;
    double sigma = (double)s->sigmas[i];

    spin_splat_rows_place(&x->rows, i, to);
    memcpy(to + 3, s->log_scales + 3 * i, 3 * sizeof *to);
    spin_splat_rows_turned(&x->rows, i, to + 6);
    fill_sh(x, i, to + 10, to + 21);
    to[13] = spin_finite_logit(s->logit_opacities[i]);
    to[14] = to[19] = s->times[i];
    to[15] = (float)log(sigma * sqrt(2));
    fill_path(x, i, 0, to + 16);
    to[20] = (float)log(sigma);
}

static spin_status write_rows(struct export *x)
{
    SPIN_FREED float *rows = NULL;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(BATCH, x->width * sizeof *rows, (void **)&rows));
    for (size_t j = 0; j < x->order.n && status == SPIN_OK; j += BATCH) {
        size_t n = x->order.n - j < BATCH ? x->order.n - j : BATCH;

        memset(rows, 0, n * x->width * sizeof *rows);
        for (size_t k = 0; k < n; k++)
            x->layout->fill_row(x, x->order.item[j + k].row, rows + x->width * k);
        status = spin_cancelled() ? spin_fail_cancelled()
                                  : spin_out_write(&x->out, rows, n * x->width * sizeof *rows);
    }
    return status;
}

/* ---- The plug-ins ---------------------------------------------------------------------------- */

static void free_export(void *self)
{
    struct export *x = self;

    spin_out_abandon(&x->out);
    spin_splat_rows_end(&x->rows);
    spin_sort_rows_free(&x->order);
    spin_time_windows_free(&x->windows);
    free(x);
}

static spin_status choose_length(struct export *x)
{
    const struct spin_export_job *job = x->windows.job;

    x->windows.length = 1;
    if (!x->layout->seconds)
        return SPIN_OK;
    SPIN_TRY(spin_time_windows_fps(&x->windows, &x->fps));
    x->windows.length = (job->n_frames - 1) / x->fps;
    return SPIN_OK;
}

static spin_status begin_export(struct export *x, const struct spin_export_job *job,
                                const struct layout *layout)
{
    x->layout = layout;
    x->windows = (struct spin_time_windows){.job = job,
                                            .name = layout->name,
                                            .says_cov2d = layout->cov2d,
                                            .least_degree = layout->seconds ? 1 : 0,
                                            .degree = layout->degree};
    SPIN_TRY(spin_time_windows_can(&x->windows));
    SPIN_TRY(choose_length(x));
    x->windows.most_sigma =
        layout->most_seconds > 0 ? layout->most_seconds / x->windows.length : MOST_SIGMA;
    SPIN_TRY(spin_splat_rows_begin(&x->rows, job, NULL));
    x->sh_degree = x->layout->cov2d && x->rows.sh_degree > 0 ? 3 : x->rows.sh_degree;
    SPIN_TRY(spin_out_open(job->output, job->force, &x->out));
    x->out.sync = job->sync;
    return SPIN_OK;
}

static spin_status write_file(struct export *x)
{
    const struct spin_export_job *job = x->windows.job;
    struct spin_time_windows_check of = {
        .windows = &x->windows, .rows = &x->rows, .importer = x->layout->importer};

    SPIN_TRY(spin_time_windows_convert(&x->windows));
    SPIN_TRY(spin_splat_rows_choose(&x->rows, &x->windows.view));
    SPIN_TRY(spin_sort_rows_fill(&x->order, &x->rows));
    if (x->order.n == 0)
        return spin_unsupported("no splats are left to write: relax the options that drop "
                                "splats");
    SPIN_TRY(spin_splat_rows_report_4d(&x->rows, job, x->windows.from, job->times, job->n_frames));
    print_header(x);
    SPIN_TRY(write_rows(x));
    if (job->report)
        job->report->bytes = (uint64_t)ftell(x->out.file);
    SPIN_TRY(spin_out_commit(&x->out));
    spin_time_windows_warn(&x->windows);
    of.order = x->order.item;
    of.n = x->order.n;
    return job->check ? spin_time_windows_check(&of) : SPIN_OK;
}

static spin_status prepare_ftgs(struct export *x, const struct spin_export_job *job)
{
    static const struct layout ftgs = {.name = "a .ftgs.ply",
                                       .importer = "freetimegs",
                                       .degree = 1,
                                       .print_header = print_ftgs,
                                       .fill_row = fill_ftgs};

    return begin_export(x, job, &ftgs);
}

static spin_status prepare_sogst(struct export *x, const struct spin_export_job *job)
{
    static const struct layout sogst = {.name = "a .sogst.ply",
                                        .importer = "sogst",
                                        .degree = 2,
                                        .seconds = true,
                                        .cov2d = true,
                                        .print_header = print_sogst,
                                        .fill_row = fill_sogst};

    return begin_export(x, job, &sogst);
}

static spin_status prepare_stglite(struct export *x, const struct spin_export_job *job)
{
    static const struct layout stglite = {.name = "an STG-lite PLY",
                                          .importer = "stglite",
                                          .degree = 1,
                                          .seconds = true,
                                          .most_seconds = MOST_SECONDS,
                                          .print_header = print_stglite,
                                          .fill_row = fill_stglite};

    return begin_export(x, job, &stglite);
}

static const struct spin_plugin_option ftgs_options[] = {
    SPIN_ROWS_OPTIONS, SPIN_ROWS_OPTION_SH, {0}};

static const struct spin_plugin_option seconds_options[] = {
    SPIN_ROWS_OPTIONS,
    {"fps", "F", "frames per second of the clip; default: the bundle's", NULL},
    SPIN_ROWS_OPTION_SH,
    {0}};

SPIN_OWN_EXPORTER(ftgs, "ftgs", prepare_ftgs, write_file, free_export,
                  .summary = "4D splats as one .ftgs.ply of FreeTimeGS, without loss",
                  .options = ftgs_options, .checks = true, .splats_4d = true);

SPIN_OWN_EXPORTER(sogst_ply, "sogst-ply", prepare_sogst, write_file, free_export,
                  .summary = "4D splats as the PLY that encoders of .sogst read, without loss",
                  .options = seconds_options, .checks = true, .splats_4d = true);

SPIN_OWN_EXPORTER(stglite, "stglite", prepare_stglite, write_file, free_export,
                  .summary = "4D splats as one PLY for SuperSplat-4D and OpenSplat4D, without loss",
                  .options = seconds_options, .checks = true, .splats_4d = true);
