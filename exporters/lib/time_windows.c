#include "exporters/lib/time_windows.h"

#include "base/base.h"
#include "math/activate.h"
#include "math/motion.h"
#include "math/sh.h"

enum { SAMPLES = 9 }; /* number of times per row at which the errors are measured */

static double first_time(const struct spin_time_windows *b) { return b->job->times[0]; }
static double last_time(const struct spin_time_windows *b)
{
    return b->job->times[b->job->n_frames - 1];
}

static bool is_visible(const struct spin_time_windows *b, size_t i)
{
    const double *span = b->job->splats_4d->spans + 2 * i;

    return span[0] <= last_time(b) && span[1] >= first_time(b);
}

/* Returns whether a visible row begins or ends abruptly within the clip, which a Gaussian window
 * cannot represent. */
static bool has_cuts(const struct spin_time_windows *b)
{
    const struct spin_splats_4d *s = b->job->splats_4d;

    for (size_t i = 0; s->cuts && !b->stores_cuts && i < s->n; i++)
        if (is_visible(b, i) &&
            ((double)s->cuts[2 * i] > first_time(b) || (double)s->cuts[2 * i + 1] <= last_time(b)))
            return true;
    return false;
}

spin_status spin_time_windows_can(const struct spin_time_windows *b)
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    bool cuts = has_cuts(b);

    if (s->plateaus || cuts || s->gates)
        return spin_unsupported(
            "%s stores Gaussian windows in time, which cannot represent splats that %s: "
            "choose another format",
            b->name,
            cuts          ? "begin or end abruptly"
            : s->plateaus ? "keep their full opacity for some time"
                          : "do not fade to 0");
    if (!(last_time(b) > first_time(b)))
        return spin_unsupported(
            "%s needs a clip of two or more frames, but one is selected: select more with --range",
            b->name);
    return SPIN_OK;
}

/* Returns the factor that converts a duration from the source's unit of time to the file's. */
static double per_time(const struct spin_time_windows *b)
{
    return b->length / (last_time(b) - first_time(b));
}

double spin_time_windows_time(const struct spin_time_windows *b, double time)
{
    return (time - first_time(b)) * per_time(b);
}

void spin_time_windows_warn(const struct spin_time_windows *b)
{
    const struct spin_splats_4d *s = b->job->splats_4d;

    if (s->degree > b->degree)
        spin_warn("%s cannot store paths of degree %d: they are approximated by degree %d, with "
                  "errors of up to %.2g world units while a splat has at least half of its opacity",
                  b->name, s->degree, b->degree, b->lost_place);
    if (s->spins)
        spin_warn("%s cannot represent rotations that change: each splat keeps the rotation that "
                  "it has at the centre of its time window, with an error of up to %.2g degrees",
                  b->name, b->lost_turn);
    if (s->cov2d[0] > 0 && !b->says_cov2d)
        spin_warn("%s cannot store the factors, %g and %g, by which the splats' screen-space "
                  "covariance was scaled in training",
                  b->name, s->cov2d[0], s->cov2d[1]);
    if (s->sh_cos)
        spin_warn("%s cannot represent colours that change: each splat keeps the colour that it "
                  "has at the centre of its time window, with an error of up to %.2g on a scale "
                  "from 0 to 1",
                  b->name, b->lost_colour);
}

/* ---- Conversion errors ----------------------------------------------------------------------- */

/* Sets d to SAMPLES evenly spaced times, from the first to the last time of the clip at which row i
 * is visible, as offsets from the centre of the row's window. */
static void sample_times(const struct spin_time_windows *b, size_t i, double d[SAMPLES])
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    double from = fmax(s->spans[2 * i], first_time(b));
    double to = fmin(s->spans[2 * i + 1], last_time(b));

    for (int k = 0; k < SAMPLES; k++)
        d[k] = from + (to - from) * k / (SAMPLES - 1) - (double)s->times[i];
}

/* Updates b->lost_colour with the colour error of row i at offset d from the centre of its window.
 * The file stores the colour at the centre, where both cosines are 1. */
static void measure_colour_error(struct spin_time_windows *b, size_t i, double d)
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    size_t width = 3 * (size_t)spin_sh_count(s->sh_degree);
    double turn = 6.283185307179586 * d / s->period;

    for (size_t c = 0; c < 3; c++) {
        const float *cosine = s->sh_cos + 2 * width * i + c;
        double off =
            (double)cosine[0] * (cos(turn) - 1) + (double)cosine[width] * (cos(2 * turn) - 1);

        b->lost_colour = fmax(b->lost_colour, SPIN_SH_C0 * fabs(off));
    }
}

/* Updates b->lost_turn with the rotation error of row i at offset d from the centre of its window.
 * The file stores the rotation at the centre. The angle between two rotations is 2 acos |dot|,
 * where dot is the dot product of their unit quaternions. */
static void measure_rotation_error(struct spin_time_windows *b, size_t i, double d)
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    double dot = 0, length = 0;

    for (size_t c = 0; c < 4; c++) {
        double q = (double)s->quats[4 * i + c], at = q + d * (double)s->spins[4 * i + c];

        dot += q * at;
        length += at * at;
    }
    if (length > 0)
        b->lost_turn =
            fmax(b->lost_turn, 360 / 3.141592653589793 * acos(fmin(fabs(dot) / sqrt(length), 1)));
}

static void measure_position_error(struct spin_time_windows *b, size_t i, double d,
                                   const float *centre, const float *path)
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    double is[3], fitted[3], off = 0;

    spin_path_at(s->centres + 3 * i, s->paths + 3 * (size_t)s->degree * i, s->degree, d, is);
    spin_path_at(centre, path, b->degree, d, fitted);
    for (int c = 0; c < 3; c++)
        off += (is[c] - fitted[c]) * (is[c] - fitted[c]);
    b->lost_place = fmax(b->lost_place, sqrt(off));
}

/* ---- Paths ----------------------------------------------------------------------------------- */

/* Solves the n equations a x = y, with three right-hand sides, by Gauss-Jordan elimination; a is
 * positive definite. Overwrites y with x. */
static void solve_equations(double a[3][3], double y[3][3], int n)
{
    for (int p = 0; p < n; p++)
        for (int r = 0; r < n; r++) {
            double share = r == p ? 0 : a[r][p] / a[p][p];

            for (int c = 0; c < 3; c++) {
                a[r][c] -= share * a[p][c];
                y[r][c] -= share * y[p][c];
            }
        }
    for (int p = 0; p < n; p++)
        for (int c = 0; c < 3; c++)
            y[p][c] /= a[p][p];
}

/* Fits a path of the file's degree to the path of row i, in the source's unit of time: minimises
 * the squared distances at the times d, weighted by the row's Gaussian window. If all times
 * coincide, `centre` and `path` are not changed: they contain the first terms of the row's own
 * path. */
static void fit_path(const struct spin_time_windows *b, size_t i, const double d[SAMPLES],
                     float centre[3], float *path)
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    const float *own = s->paths + 3 * (size_t)s->degree * i;
    double a[3][3] = {{0}}, y[3][3] = {{0}}, unit = fmax(fabs(d[0]), fabs(d[SAMPLES - 1]));

    if (d[SAMPLES - 1] - d[0] < 1e-3 * unit)
        return;
    for (int k = 0; k < SAMPLES; k++) {
        double w = spin_splats_4d_weight(s, i, (double)s->times[i] + d[k]), place[3];
        const double power[3] = {1, d[k] / unit, d[k] / unit * (d[k] / unit)};

        spin_path_at(s->centres + 3 * i, own, s->degree, d[k], place);
        for (int r = 0; r <= b->degree; r++)
            for (int c = 0; c < 3; c++) {
                a[r][c] += c <= b->degree ? w * power[r] * power[c] : 0;
                y[r][c] += w * power[r] * place[c];
            }
    }
    solve_equations(a, y, b->degree + 1);
    for (int c = 0; c < 3; c++) {
        centre[c] = (float)y[0][c];
        for (int p = 1; p <= b->degree; p++)
            path[3 * (p - 1) + c] = (float)(y[p][c] / pow(unit, p));
    }
}

/* ---- Rows ------------------------------------------------------------------------------------ */

void spin_time_windows_move(struct spin_splats_4d *s, size_t k, double time)
{
    double d = time - (double)s->times[k], place[3];
    float *path = s->paths ? s->paths + 3 * (size_t)s->degree * k : NULL;

    spin_path_at(s->centres + 3 * k, path, s->degree, d, place);
    for (size_t c = 0; c < 3; c++) {
        s->centres[3 * k + c] = (float)place[c];
        if (s->degree > 1)
            path[c] = (float)((double)path[c] + 2 * d * (double)path[3 + c]);
    }
    s->times[k] = (float)time;
}

/* Reduces the sigma of row k to `most`. Opacity and centre of the row's window change such that the
 * opacity in the middle of the clip keeps its value and its derivative. */
static void limit_sigma(struct spin_time_windows *b, size_t k, double sigma, double most)
{
    struct spin_splats_4d *s = &b->clip;
    double middle = b->length / 2, off = middle - (double)s->times[k], share = most / sigma;
    double z = off / sigma, z2 = z * share;
    double opacity = spin_sigmoid_of((double)s->logit_opacities[k]) * exp(0.5 * (z2 * z2 - z * z));

    s->logit_opacities[k] = spin_logit_of(opacity);
    s->sigmas[k] = (float)most;
    spin_time_windows_move(s, k, middle - off * share * share);
}

static void convert_path(struct spin_time_windows *b, size_t i, size_t k)
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    size_t step = 3 * (size_t)b->clip.degree, own = 3 * (size_t)s->degree;
    float *to = b->clip.paths ? b->clip.paths + step * k : NULL;
    double d[SAMPLES];

    for (size_t c = 0; c < step && c < own; c++)
        to[c] = s->paths[own * i + c];
    sample_times(b, i, d);
    if (s->degree > b->degree)
        fit_path(b, i, d, b->clip.centres + 3 * k, to);
    for (int n = 0; n < SAMPLES; n++) {
        if (s->sh_cos)
            measure_colour_error(b, i, d[n]);
        if (s->spins)
            measure_rotation_error(b, i, d[n]);
        if (s->degree > b->degree && spin_splats_4d_weight(s, i, (double)s->times[i] + d[n]) >= 0.5)
            measure_position_error(b, i, d[n], b->clip.centres + 3 * k, to);
    }
    for (size_t c = 0; c < step; c++)
        to[c] = (float)((double)to[c] / pow(per_time(b), c < 3 ? 1 : 2));
}

static void convert_row(struct spin_time_windows *b, size_t i, size_t k)
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    struct spin_splats_4d *to = &b->clip;
    size_t width = 3 * (size_t)spin_sh_count(s->sh_degree);
    double most = b->most_sigma > 0 ? b->most_sigma * b->length : (double)SPIN_FOREVER;
    double sigma = s->sigmas[i] < SPIN_FOREVER
                       ? fmin((double)s->sigmas[i] * per_time(b), (double)SPIN_FOREVER)
                   : b->most_sigma > 0 ? HUGE_VAL
                                       : (double)SPIN_FOREVER;

    memcpy(to->centres + 3 * k, s->centres + 3 * i, 3 * sizeof(float));
    memcpy(to->quats + 4 * k, s->quats + 4 * i, 4 * sizeof(float));
    memcpy(to->log_scales + 3 * k, s->log_scales + 3 * i, 3 * sizeof(float));
    to->logit_opacities[k] = s->logit_opacities[i];
    to->times[k] = (float)spin_time_windows_time(b, (double)s->times[i]);
    to->sigmas[k] = (float)fmin(sigma, most);
    for (size_t c = 0; c < width; c++) {
        const float *cosine = s->sh_cos ? s->sh_cos + 2 * width * i + c : NULL;

        to->sh[width * k + c] = s->sh[width * i + c] + (cosine ? cosine[0] + cosine[width] : 0);
    }
    convert_path(b, i, k);
    if (sigma > most)
        limit_sigma(b, k, sigma, most);
    for (size_t c = 0; to->cuts && c < 2; c++)
        to->cuts[2 * k + c] = (float)fmin(
            fmax(spin_time_windows_time(b, (double)s->cuts[2 * i + c]), -(double)SPIN_FOREVER),
            (double)SPIN_FOREVER);
    b->from[k] = i;
}

spin_status spin_time_windows_fps(const struct spin_time_windows *b, double *out)
{
    *out = b->job->fps;
    SPIN_TRY(spin_option_number(b->job->values, "fps", 0.001, 1e6, out));
    if (*out > 0)
        return SPIN_OK;
    *out = 30;
    spin_warn("the frame rate of the clip is unknown, assuming 30: set it with --fps");
    return SPIN_OK;
}

spin_status spin_time_windows_convert(struct spin_time_windows *b)
{
    const struct spin_splats_4d *s = b->job->splats_4d;
    size_t n = 0;
    int degree = s->degree < b->degree ? s->degree : b->degree;

    SPIN_TRY(spin_splats_4d_reserve(&b->clip, s->n,
                                    degree > b->least_degree ? degree : b->least_degree,
                                    s->sh_degree, s->cuts && b->stores_cuts ? SPIN_4D_CUTS : 0));
    SPIN_TRY(spin_alloc(s->n + 1, sizeof *b->from, (void **)&b->from));
    for (size_t i = 0; i < s->n; i++)
        if (is_visible(b, i))
            convert_row(b, i, n++);
    if (n == 0)
        return spin_unsupported("no splat is visible in the selected frames: check --range");
    b->clip.n = n;
    b->view = spin_splats_of_4d(&b->clip);
    return SPIN_OK;
}

void spin_time_windows_free(struct spin_time_windows *b)
{
    spin_splats_4d_free(&b->clip);
    free(b->from);
}
