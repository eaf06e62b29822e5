/* --check: reads the written files with their importer and compares them with the bundle: counts,
 * bounding boxes, the errors of all values, and a render of one frame. */
#include "base/base.h"
#include "exporters/lib/frames.h"
#include "exporters/lib/initial_view.h"
#include "exporters/lib/readback.h"

struct check {
    struct spin_frames *x;
    const struct spin_importer *importer;
    void *self; /* the importer's open file; NULL: none */
    struct spin_splats back;
    struct spin_readback values;
    int rendered; /* number of the rendered frame */
    double psnr;  /* PSNR of this frame; 0: no frame was rendered */
};

/* ---- Values ---------------------------------------------------------------------------------- */

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

/* Compares a frame that was read from its file with the kept rows of the bundle. row: row[j].row is
 * the row of the source that is row j of the file; NULL: the file contains the kept rows in the
 * order of the source. */
static spin_status compare_frame(struct check *check, const char *path,
                                 const struct spin_keyed *row)
{
    const struct spin_splat_rows *rows = &check->x->rows;
    const struct spin_splats *back = &check->back;
    /* no rotation: spin_splat_rows_get() keeps the axes of the file */
    const struct spin_splat_rows plain = {.splats = back};
    size_t n_sh = 3 * (size_t)spin_sh_count(back->sh_degree), next = 0;

    if (back->n != rows->n_kept)
        return spin_fail(SPIN_E_IO, "check: '%s' contains %zu splats, expected %zu", path, back->n,
                         rows->n_kept);
    for (size_t j = 0; j < back->n; j++) {
        struct spin_gaussian there;
        size_t i;

        while (!row && !rows->keep[next])
            next++;
        i = row ? row[j].row : next++;
        if (!is_finite(back, j))
            return spin_fail(SPIN_E_IO, "check: '%s' contains NaN or infinity in splat %zu", path,
                             j);
        spin_splat_rows_get(&plain, j, &there);
        spin_readback_row(&check->values, rows, i, &there, back->sh + n_sh * j, back->sh_degree);
    }
    spin_readback_end(&check->values);
    return SPIN_OK;
}

/* ---- A render -------------------------------------------------------------------------------- */

/* Chooses a camera of the data set for this frame, if possible that of a test view. Without a data
 * set, the camera is in front of the scene, as in the web page. */
static spin_status choose_camera(const struct spin_export_job *job, int frame,
                                 const struct spin_splats *s, struct spin_camera *out)
{
    int row = job->dataset_frame_of ? job->dataset_frame_of[frame] : -1;
    const struct spin_view *found = row >= 0 ? spin_initial_view_view(job->views, row, true) : NULL;
    struct spin_initial_view front;
    double middle[3], size;

    if (found) {
        *out = found->camera;
        return SPIN_OK;
    }
    SPIN_TRY(spin_initial_view_middle(s, middle, &size));
    spin_initial_view_first(NULL, NULL, 0, false, middle, size, &front);
    *out = (struct spin_camera){
        .width = 400,
        .height = 400,
        .fx = spin_initial_view_focal(&front, 400),
        .fy = spin_initial_view_focal(&front, 400),
        .cx = 200,
        .cy = 200,
        .w2c = {1, 0, 0, -front.eye[0], 0, 1, 0, -front.eye[1], 0, 0, 1, -front.eye[2]},
        .z_near = front.z_near};
    return SPIN_OK;
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

/* Renders the frame from the file, rotated back to the source's axes, and the frame from the
 * bundle, and measures the PSNR between the two images. */
static spin_status compare_pictures(struct check *check, int frame, int number)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    const struct spin_export_job *job = check->x->job;
    const struct spin_splats *is = check->x->rows.splats;
    const double *q = check->x->rows.turn_q;
    const struct spin_placement placement = {.q = {q[0], -q[1], -q[2], -q[3]}, .scale = 1};
    SPIN_LEAVES(spin_splats_free) struct spin_splats turned = {0};
    struct spin_camera camera;
    size_t n;
    SPIN_FREED float *image = NULL;

    SPIN_TRY(choose_camera(job, frame, is, &camera));
    n = 3 * (size_t)camera.width * (size_t)camera.height;
    SPIN_TRY(spin_splats_reserve(&turned, check->back.n, columns, check->back.sh_degree));
    spin_splats_place(&check->back, columns, &placement, 0, &turned);
    turned.antialias = is->antialias;
    SPIN_TRY(spin_alloc(n, 2 * sizeof *image, (void **)&image));
    SPIN_TRY(spin_render(job->renderer, is, &camera, job->background, image));
    if (spin_initial_view_is_blank(image, n / 3, job->background)) {
        spin_warn("check: no splat of frame %d is visible to the camera: no image was compared",
                  number);
        return SPIN_OK;
    }
    SPIN_TRY(spin_render(job->renderer, &turned, &camera, job->background, image + n));
    check->psnr = psnr_of(image, image + n, n);
    check->rendered = number;
    return SPIN_OK;
}

/* ---- All frames ------------------------------------------------------------------------------ */

static void close_file(struct check *check)
{
    if (check->self)
        check->importer->close(check->self);
    check->self = NULL;
}

static spin_status open_file(struct check *check, const char *path)
{
    static const char *const pairs[] = {"axes", "source", NULL};
    const struct spin_frames_format *format = check->x->format;
    const char *name = format->importer ? format->importer : format->name;
    const struct spin_plugin_values values = {pairs};
    struct spin_sequence_info sequence;
    spin_status status;

    close_file(check);
    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++)
        if (strcmp((*i)->name, name) == 0)
            check->importer = *i;
    status = check->importer->open(path, &values, &check->self, &sequence);
    if (status != SPIN_OK)
        close_file(check);
    return status;
}

/* Returns the index of the frame that is nearest to the middle of the clip among those with splats.
 * -1: no frame has splats. */
static int rendered_frame(const struct spin_frames *x)
{
    int middle = (int)x->n_entries / 2, best = -1;

    for (int f = 0; f < (int)x->n_entries; f++)
        if (x->entry[f].n > 0 && (best < 0 || abs(f - middle) < abs(best - middle)))
            best = f;
    return best;
}

/* Checks frame f of the export, which is frame number `within` of the file. Frames without splats
 * are not read, because importers refuse empty files. */
static spin_status check_frame(struct check *check, int f, const char *path, int within)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_frames *x = check->x;
    const struct spin_splats *splats;
    const struct spin_keyed *row = NULL;
    spin_status status = SPIN_OK;

    spin_readback_frame(&check->values, x->job, f);
    SPIN_TRY(x->job->again(x->job->context, f, &splats));
    SPIN_TRY(spin_splat_rows_choose(&x->rows, splats));
    if (!check->self || within == 0)
        status = open_file(check, path);
    if (!check->self && x->rows.n_kept == 0)
        return SPIN_OK;
    if (status == SPIN_OK)
        status = check->importer->frame(check->self, within, 0, columns, &check->back);
    SPIN_TRY_IN(status, "check: '%s'", path);
    if (x->format->order)
        SPIN_TRY(x->format->order(x, &row));
    else if (x->sort) {
        SPIN_TRY(spin_frames_order(x));
        row = x->order.item;
    }
    SPIN_TRY(compare_frame(check, path, row));
    return f == rendered_frame(x) && x->job->renderer
               ? compare_pictures(check, f, x->entry[f].number)
               : SPIN_OK;
}

spin_status spin_frames_check(struct spin_frames *x)
{
    struct spin_export_check *out = x->job->report ? &x->job->report->check : NULL;
    struct check check = {.x = x};
    spin_status status = SPIN_OK;

    spin_readback_begin(&check.values);
    for (size_t f = 0; f < x->n_entries && status == SPIN_OK; f++) {
        SPIN_FREED char *path = NULL;

        if (!x->file)
            SPIN_TRY_OUT(spin_pattern_path(&x->pattern, x->folder.path, x->entry[f].number, &path));
        status = check_frame(&check, (int)f, x->file ? x->file : path, x->file ? (int)f : 0);
    }
    if (status == SPIN_OK && out) {
        spin_readback_fill_check(&check.values, (int)x->n_entries, out);
        out->rendered = check.psnr > 0 ? check.rendered : -1;
        out->psnr = check.psnr > 0 ? check.psnr : (double)NAN;
    }
    if (status == SPIN_OK)
        status = spin_readback_verify(&check.values, &x->quant, x->job->output);
out:
    close_file(&check);
    spin_splats_free(&check.back);
    return status;
}
