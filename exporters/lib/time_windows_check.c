#include "exporters/lib/time_windows.h"

#include "base/base.h"
#include "exporters/lib/readback.h"
#include "math/activate.h"
#include "math/motion.h"

struct check {
    const struct spin_time_windows_check *of;
    const struct spin_importer *importer;
    void *self;
    const struct spin_splats_4d *back;
    struct spin_splats frame;
    /* [rows of the source, or of all frames] row of the file; UINT32_MAX: the row is not in the
     * file. */
    uint32_t *row_of;
    struct spin_readback values;
};

static spin_status read_back(struct check *check)
{
    const struct spin_time_windows_check *of = check->of;
    const char *path = of->windows->job->output;
    const struct spin_plugin_values values = {NULL};
    struct spin_sequence_info sequence;

    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++)
        if (strcmp((*i)->name, of->importer) == 0)
            check->importer = *i;
    SPIN_TRY(check->importer->open(path, &values, &check->self, &sequence));
    SPIN_TRY(check->importer->splats_4d(check->self, &check->back));
    if (!check->back || check->back->n != of->n)
        return spin_fail(SPIN_E_IO, "the file contains %zu splats, expected %zu",
                         check->back ? check->back->n : 0, of->n);
    return SPIN_OK;
}

/* Compares position, time and sigma of row j of the file with row k of the clip, within the
 * precision of the file. */
static spin_status check_row(const struct check *check, size_t j, size_t k)
{
    const struct spin_time_windows_check *of = check->of;
    const struct spin_splats_4d *back = check->back, *clip = &of->windows->clip;
    float place[3];
    bool good =
        fabs((double)back->times[j] - (double)clip->times[k]) <= 1e-6 * of->windows->length &&
        fabs((double)back->sigmas[j] / (double)clip->sigmas[k] - 1) <= 1e-5;

    spin_splat_rows_place(of->rows, k, place);
    for (size_t c = 0; c < 3; c++)
        good = good && fabs((double)back->centres[3 * j + c] - (double)place[c]) <=
                           (1 + fabs((double)place[c])) * (of->half[c] + 1e-6);
    return good ? SPIN_OK : spin_fail(SPIN_E_IO, "splat %zu differs from the written values", j);
}

static void slice_row(const struct spin_splats_4d *s, size_t j, double time,
                      struct spin_gaussian *out)
{
    size_t n_sh = 3 * (size_t)spin_sh_count(s->sh_degree);
    double place[3];

    spin_path_at(s->centres + 3 * j, s->paths ? s->paths + 3 * (size_t)s->degree * j : NULL,
                 s->degree, time - (double)s->times[j], place);
    for (size_t c = 0; c < 3; c++) {
        out->place[c] = (float)place[c];
        out->log_scale[c] = s->log_scales[3 * j + c];
        out->colour[c] = 0.5f + (float)SPIN_SH_C0 * s->sh[n_sh * j + c];
    }
    out->opacity =
        (float)(spin_sigmoid_of((double)s->logit_opacities[j]) * spin_splats_4d_weight(s, j, time));
    memcpy(out->rotation, s->quats + 4 * j, sizeof out->rotation);
}

/* Compares frame f of the source with the splats of the file at the time of this frame. */
static spin_status check_frame(struct check *check, int f)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    const struct spin_export_job *job = check->of->windows->job;
    const struct spin_splats_4d *s = job->splats_4d, *back = check->back;
    size_t n_sh = 3 * (size_t)spin_sh_count(back->sh_degree), row = 0, first = 0;
    double t = job->times[f];
    struct spin_splat_rows rows;
    struct spin_gaussian there;

    spin_readback_frame(&check->values, job, f);
    if (spin_cancelled())
        return spin_fail_cancelled();
    if (check->of->load)
        SPIN_TRY(check->of->load(check->of->context, f, &first));
    rows = *check->of->rows;
    SPIN_TRY(spin_splats_4d_slice(s, t, columns, &check->frame));
    rows.splats = &check->frame;
    for (size_t i = 0; i < s->n; i++)
        if (spin_splats_4d_is_visible(s, i, t)) {
            size_t j = check->row_of[first + i];

            if (j != UINT32_MAX) {
                if (check->of->load)
                    SPIN_TRY(check_row(check, j, i));
                slice_row(back, j, spin_time_windows_time(check->of->windows, t), &there);
                spin_readback_row(&check->values, &rows, row, &there, back->sh + n_sh * j,
                                  back->sh_degree);
            }
            row++;
        }
    spin_readback_end(&check->values);
    return SPIN_OK;
}

static spin_status check_all(struct check *check)
{
    const struct spin_time_windows_check *of = check->of;
    size_t n = of->load ? of->n : of->windows->job->splats_4d->n;

    SPIN_TRY(read_back(check));
    SPIN_TRY(spin_alloc(n + 1, sizeof *check->row_of, (void **)&check->row_of));
    for (size_t i = 0; i < n; i++)
        check->row_of[i] = UINT32_MAX;
    for (size_t j = 0; j < of->n; j++) {
        size_t k = of->order ? of->order[j].row : of->row[j];

        check->row_of[of->load ? k : of->windows->from[k]] = (uint32_t)j;
        if (!of->load)
            SPIN_TRY(check_row(check, j, k));
    }
    for (int f = 0; f < of->windows->job->n_frames; f++)
        SPIN_TRY(check_frame(check, f));
    return SPIN_OK;
}

spin_status spin_time_windows_check(const struct spin_time_windows_check *of)
{
    const struct spin_export_job *job = of->windows->job;
    struct check check = {.of = of};
    spin_status status;

    spin_readback_begin(&check.values);
    status = check_all(&check);
    if (status == SPIN_OK && job->report)
        spin_readback_fill_check(&check.values, job->n_frames, &job->report->check);
    if (check.self)
        check.importer->close(check.self);
    spin_splats_free(&check.frame);
    free(check.row_of);
    return spin_fail_context(status, "check: '%s'", job->output);
}
