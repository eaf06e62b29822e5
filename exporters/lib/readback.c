#include "exporters/lib/readback.h"

#include "base/number.h"

/* Tolerances for the rounding of float arithmetic in writing and reading. The tolerance of
 * positions is relative to the largest coordinate. */
static const double SLACK[SPIN_QUANT_PARTS] = {1e-6, 1e-5, 1e-2, 1e-6, 1e-5, 1e-5};

void spin_readback_begin(struct spin_readback *e) { *e = (struct spin_readback){.pixels = -1}; }

void spin_readback_frame(struct spin_readback *e, const struct spin_export_job *job, int frame)
{
    const struct spin_views *views = job->views;
    int row = job->dataset_frame_of ? job->dataset_frame_of[frame] : -1;

    e->view = NULL;
    e->n_views = 0;
    for (int c = 0; c < 6; c++)
        e->is_box[c] = e->there_box[c] = c < 3 ? HUGE_VAL : -HUGE_VAL;
    for (size_t i = 0; views && row >= 0 && i < views->n; i++)
        if (views->view[i].dataset_frame == row) { /* views of a data-set frame are consecutive */
            e->view = e->view ? e->view : &views->view[i];
            e->n_views++;
        }
}

/* Returns the largest distance in pixels by which the image of a splat at `mean` can move if the
 * splat is displaced by `off`. -1: the position is not visible. */
static double pixels_of(const struct spin_camera *c, const float mean[3], double off)
{
    double p[3];

    if (!spin_camera_project_visible(c, mean, p) || p[2] < spin_camera_near(c))
        return -1;
    return fmax(c->fx, c->fy) * off / p[2];
}

void spin_readback_add(struct spin_readback *e, const float mean[3], const float log_scale[3],
                       double off)
{
    double largest = fmax(fmax((double)log_scale[0], (double)log_scale[1]), (double)log_scale[2]);

    e->sizes = fmax(e->sizes, off / exp(largest));
    for (size_t i = 0; i < e->n_views; i++)
        e->pixels = fmax(e->pixels, pixels_of(&e->view[i].camera, mean, off));
}

static void widen_box(double box[6], const float place[3])
{
    for (int c = 0; c < 3; c++) {
        box[c] = fmin(box[c], (double)place[c]);
        box[3 + c] = fmax(box[3 + c], (double)place[c]);
    }
}

/* Adds the errors of the SH coefficients above degree 0 of row i. */
static void compare_sh(struct spin_readback *e, const struct spin_splat_rows *rows, size_t i,
                       const float *sh, int degree)
{
    int n = 3 * spin_sh_count(degree), n_is = 3 * spin_splat_rows_n_sh(rows);
    float room[3 * SPIN_SH_MAX], error[3 * SPIN_SH_MAX];
    const float *is = spin_splat_rows_sh(rows, i, room);
    bool lost = false;

    for (int k = 3; k < n; k++)
        error[k - 3] = (k < n_is ? is[k] : 0) - sh[k];
    spin_quant_error_add_sh(&e->quant, error, (size_t)n - 3);
    for (int k = n; k < n_is; k++)
        lost = lost || is[k] != 0;
    e->sh_lost += lost;
}

void spin_readback_row(struct spin_readback *e, const struct spin_splat_rows *rows, size_t i,
                       const struct spin_gaussian *there, const float *sh, int degree)
{
    struct spin_gaussian is;

    spin_splat_rows_get(rows, i, &is);
    spin_quant_error_row(&e->quant, &is, there);
    spin_readback_add(e, rows->splats->means + 3 * i, rows->splats->log_scales + 3 * i,
                      spin_quant_error_distance(is.place, there->place));
    compare_sh(e, rows, i, sh, degree);
    widen_box(e->is_box, is.place);
    widen_box(e->there_box, there->place);
    for (int c = 0; c < 3; c++)
        e->reach = fmax(e->reach, fabs((double)is.place[c]));
    e->n++;
}

void spin_readback_end(struct spin_readback *e)
{
    for (int c = 0; c < 6 && e->is_box[0] < HUGE_VAL; c++)
        e->bounds = fmax(e->bounds, fabs(e->is_box[c] - e->there_box[c]));
}

void spin_readback_fill_check(const struct spin_readback *e, int n_frames,
                              struct spin_export_check *out)
{
    *out = (struct spin_export_check){.frames = n_frames,
                                      .splats = e->n,
                                      .bounds = e->bounds,
                                      .place_sizes = e->sizes,
                                      .place_pixels = e->pixels < 0 ? (double)NAN : e->pixels,
                                      .sh_lost = e->sh_lost,
                                      .rendered = -1,
                                      .psnr = (double)NAN};
    for (int p = 0; p < SPIN_QUANT_PARTS; p++) {
        out->rms[p] = spin_quant_error_rms(&e->quant, (enum spin_quant_error_part)p);
        out->largest[p] = e->quant.part[p].largest;
    }
}

spin_status spin_readback_verify(const struct spin_readback *e,
                                 const struct spin_quant_error *written, const char *output)
{
    static const char *const name[] = {"positions", "log scales", "rotations (degrees)",
                                       "opacities", "colours",    "SH"};

    for (int p = 0; p < SPIN_QUANT_PARTS; p++) {
        enum spin_quant_error_part part = (enum spin_quant_error_part)p;
        double slack = SLACK[p] * (p == SPIN_QUANT_PLACE ? e->reach : 1);
        double largest = e->quant.part[p].largest, most = written->part[p].largest + slack;
        double rms = spin_quant_error_rms(&e->quant, part);
        double most_rms = spin_quant_error_rms(written, part) * 1.001 + slack;

        if (!(largest <= most) || !(rms <= most_rms))
            return spin_fail(SPIN_E_IO,
                             "check: '%s' differs from the written values: %s have errors of up to "
                             "%.3g, RMS %.3g, expected at most %.3g, RMS %.3g",
                             output, name[p], largest, rms, most, most_rms);
    }
    return SPIN_OK;
}
