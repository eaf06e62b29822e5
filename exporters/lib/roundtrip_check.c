#include "exporters/lib/roundtrip_check.h"

#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "exporters/lib/initial_view.h"

/* What is left of a value after float arithmetic there and back: of positions as a share of the farthest coordinate. */
static const double SLACK[SPIN_QUANT_PARTS] = {1e-6, 1e-5, 1e-2, 1e-6, 1e-5, 1e-5};

/* ---- Values ---------------------------------------------------------------------------------- */

static void widen(double box[6], const float *place)
{
    for (int c = 0; c < 3; c++) {
        box[c] = fmin(box[c], (double)place[c]);
        box[3 + c] = fmax(box[3 + c], (double)place[c]);
    }
}

static void empty_box(double box[6])
{
    for (int c = 0; c < 6; c++)
        box[c] = c < 3 ? HUGE_VAL : -HUGE_VAL;
}

/* Row j of the file, as spin_splat_filter_take() gives those of the bundle. */
static void take_back(const struct spin_splats *back, size_t j, struct spin_gaussian *out)
{
    struct spin_splat_filter plain = {.splats = back};

    spin_splat_filter_take(&plain, j, out);
}

static bool is_finite(const struct spin_splats *s, size_t j)
{
    size_t n_sh = 3 * (size_t)spin_sh_count(s->sh_degree);
    float sum = 0;

    for (int c = 0; c < 3; c++)
        sum += s->means[3 * j + (size_t)c] * 0 + s->log_scales[3 * j + (size_t)c] * 0;
    for (int k = 0; k < 4; k++)
        sum += s->quats[4 * j + (size_t)k] * 0;
    for (size_t k = 0; k < n_sh; k++)
        sum += s->sh[n_sh * j + k] * 0;
    return sum + s->logit_opacities[j] * 0 == 0;
}

/* Coefficients above degree 0; what the bundle does not have should read as zero. */
static void compare_sh(struct spin_quant_error *quant, const struct spin_splat_filter *rows,
                       size_t i, const struct spin_splats *back, size_t j)
{
    int n = 3 * spin_sh_count(back->sh_degree), n_there = 3 * spin_splat_filter_n_sh(rows);
    float room[3 * SPIN_SH_MAX], error[3 * SPIN_SH_MAX];
    const float *is = spin_splat_filter_sh(rows, i, room), *shown = back->sh + (size_t)n * j;

    for (int k = 3; k < n; k++)
        error[k - 3] = (k < n_there ? is[k] : 0) - shown[k];
    spin_quant_error_add_all(quant, SPIN_QUANT_SH, error, (size_t)n - 3);
}

spin_status spin_roundtrip_check_frame(struct spin_roundtrip_check *check,
                                       const struct spin_splat_filter *rows, const char *path,
                                       const struct spin_splats *back, const uint32_t *row)
{
    double is_box[6], back_box[6];
    size_t next = 0;

    if (back->n != rows->n_kept)
        return spin_fail(SPIN_E_IO, "check: '%s' holds %zu splats, expected %zu", path, back->n,
                         rows->n_kept);
    empty_box(is_box);
    empty_box(back_box);
    for (size_t j = 0; j < back->n; j++) {
        struct spin_gaussian is, shown;
        size_t i;

        while (!row && !rows->keep[next])
            next++;
        i = row ? row[j] : next++;
        if (!is_finite(back, j))
            return spin_fail(SPIN_E_IO, "check: '%s' holds NaN or infinity in splat %zu", path, j);
        spin_splat_filter_take(rows, i, &is);
        take_back(back, j, &shown);
        spin_quant_error_row(&check->quant, &is, &shown);
        compare_sh(&check->quant, rows, i, back, j);
        widen(is_box, is.place);
        widen(back_box, shown.place);
        for (int c = 0; c < 3; c++)
            check->reach = fmax(check->reach, fabs((double)is.place[c]));
    }
    for (int c = 0; c < 6 && back->n > 0; c++)
        check->bounds = fmax(check->bounds, fabs(is_box[c] - back_box[c]));
    check->n_splats += back->n;
    check->n_frames++;
    return SPIN_OK;
}

/* ---- A picture ------------------------------------------------------------------------------- */

/* A camera of the data set that saw the frame, a held-out one if there is; else the front, as in a page. */
static spin_status choose_camera(const struct spin_export_job *job, int frame,
                                 const struct spin_splats *s, struct spin_camera *out)
{
    int row = job->dataset_frame_of ? job->dataset_frame_of[frame] : -1;
    const struct spin_view *found = NULL;
    struct spin_initial_view front;
    double middle[3], size;

    for (size_t v = 0; job->views && row >= 0 && v < job->views->n; v++)
        if (job->views->view[v].dataset_frame == row &&
            (!found || (job->views->view[v].test && !found->test)))
            found = &job->views->view[v];
    if (found) {
        *out = found->camera;
        return SPIN_OK;
    }
    SPIN_TRY(spin_initial_view_middle(s, middle, &size));
    spin_initial_view_first(NULL, 0, false, middle, size, &front);
    *out = (struct spin_camera){
        .width = 400,
        .height = 400,
        .fx = spin_initial_view_focal(&front, 400),
        .fy = spin_initial_view_focal(&front, 400),
        .cx = 200,
        .cy = 200,
        .w2c = {1, 0, 0, -front.eye[0], 0, 1, 0, -front.eye[1], 0, 0, 1, -front.eye[2]}};
    return SPIN_OK;
}

static void turn_back(const struct spin_splat_filter *rows, struct spin_splats *back)
{
    const double *q = rows->turn_q, inverse[4] = {q[0], -q[1], -q[2], -q[3]};
    struct spin_splat_filter turning = {.splats = back, .sh_degree = back->sh_degree};
    size_t n_sh = 3 * (size_t)spin_sh_count(back->sh_degree);

    spin_scene_rotation_from(inverse, &turning.turn);
    if (turning.turn.kind == SPIN_TURN_NONE)
        return;
    for (size_t i = 0; i < back->n; i++) {
        float place[3], rotation[4], room[3 * SPIN_SH_MAX];

        spin_splat_filter_place(&turning, i, place);
        spin_splat_filter_turned(&turning, i, rotation);
        memcpy(back->sh + n_sh * i, spin_splat_filter_sh(&turning, i, room), n_sh * sizeof *room);
        memcpy(back->means + 3 * i, place, sizeof place);
        memcpy(back->quats + 4 * i, rotation, sizeof rotation);
    }
}

static double psnr_of(const float *a, const float *b, size_t n)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++) {
        double d = fmin(fmax((double)a[i], 0), 1) - fmin(fmax((double)b[i], 0), 1);

        sum += d * d;
    }
    return sum > 0 ? 10 * log10((double)n / sum) : HUGE_VAL;
}

spin_status spin_roundtrip_check_render(struct spin_roundtrip_check *check,
                                        const struct spin_splat_filter *rows,
                                        const struct spin_export_job *job, int frame, int number,
                                        struct spin_splats *back)
{
    struct spin_camera camera;
    size_t n;
    float *image = NULL;
    spin_status status;

    SPIN_TRY(choose_camera(job, frame, rows->splats, &camera));
    n = 3 * (size_t)camera.width * (size_t)camera.height;
    turn_back(rows, back);
    back->antialias = rows->splats->antialias;
    SPIN_TRY(spin_alloc(n, 2 * sizeof *image, (void **)&image));
    SPIN_TRY_OUT(spin_render(job->renderer, rows->splats, &camera, job->background, image));
    if (spin_initial_view_is_blank(image, n / 3, job->background)) {
        spin_warn("check: the camera sees no splat of frame %d: no picture was compared", number);
        goto out;
    }
    SPIN_TRY_OUT(spin_render(job->renderer, back, &camera, job->background, image + n));
    check->psnr = psnr_of(image, image + n, n);
    check->rendered = number;
out:
    free(image);
    return status;
}

spin_status spin_roundtrip_check_judge(const struct spin_roundtrip_check *check,
                                       const struct spin_quant_error *written, const char *output)
{
    static const char *const name[] = {"positions", "log scales", "rotations (degrees)",
                                       "opacities", "colours",    "SH"};

    for (int p = 0; p < SPIN_QUANT_PARTS; p++) {
        enum spin_quant_error_part part = (enum spin_quant_error_part)p;
        double slack = SLACK[p] * (p == SPIN_QUANT_PLACE ? check->reach : 1);
        double largest = check->quant.part[p].largest, most = written->part[p].largest + slack;
        double rms = spin_quant_error_rms(&check->quant, part);
        double most_rms = spin_quant_error_rms(written, part) * 1.001 + slack;

        if (!(largest <= most) || !(rms <= most_rms))
            return spin_fail(SPIN_E_IO,
                             "check: what is in '%s' is not what was written: %s are off by %.3g, "
                             "rms %.3g, expected at most %.3g, rms %.3g",
                             output, name[p], largest, rms, most, most_rms);
    }
    return SPIN_OK;
}

void spin_roundtrip_check_report(const struct spin_roundtrip_check *check,
                                 struct spin_export_report *report)
{
    struct spin_export_check *out = &report->check;

    out->frames = check->n_frames;
    out->splats = check->n_splats;
    out->bounds = check->bounds;
    for (int p = 0; p < SPIN_QUANT_PARTS; p++) {
        out->rms[p] = spin_quant_error_rms(&check->quant, (enum spin_quant_error_part)p);
        out->largest[p] = check->quant.part[p].largest;
    }
    out->rendered = check->psnr > 0 ? check->rendered : -1;
    out->psnr = check->psnr > 0 ? check->psnr : (double)NAN;
}
