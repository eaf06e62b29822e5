/* Writing the output's arrays and its meta.json. */
#include "train/output.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "train/settings.h"

/* ---- Arrays ------------------------------------------------------------------------------------- */

/* A frame's positions and residual values as the source has its rows. */
static spin_status write_frame(const struct spin_output *output, struct spin_bundle_writer *w,
                               int frame, bool residual)
{
    const struct spin_train_frame *from = &output->trainer->frame[frame];
    size_t width = residual ? SPIN_RESIDUAL : 3;
    uint64_t shape[2] = {from->n, width};
    struct spin_rows rows = {.stride = width}, none = {0};
    char name[64];
    void *block = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(width * from->n + 1, sizeof(float), &block));
    rows.at = block;
    SPIN_TRY_OUT(spin_train_frame_download(from, output->trainer->device, SPIN_TRAIN_VALUES,
                                           residual ? none : rows, residual ? rows : none,
                                           output->frames->permutation[frame]));
    snprintf(name, sizeof name, "network/%s/%05d", residual ? "residual" : "means", frame);
    status = spin_npz_write(&w->zip, name, "<f4", 2, shape, rows.at);
out:
    free(block);
    return status;
}

static spin_status write_network(const struct spin_output *output, struct spin_bundle_writer *w)
{
    struct spin_trainer *t = output->trainer;
    uint64_t features = (uint64_t)t->field.grid.n_features;
    uint64_t table[2] = {t->table.n / features, features}, heads[1] = {t->heads.n};
    spin_status status;

    for (int f = 0; f < output->plan->clip.n_frames; f++)
        SPIN_TRY(write_frame(output, w, f, false));
    for (int f = 0; spin_plan_has_residual(output->plan) && f < output->plan->clip.n_frames; f++)
        SPIN_TRY(write_frame(output, w, f, true));
    status = spin_write_device_array(t, &w->zip, "network/table", 2, table,
                                     spin_trainer_take_table(t), t->table.n);
    spin_trainer_put_back(t);
    SPIN_TRY(status);
    return spin_write_device_array(t, &w->zip, "network/heads", 1, heads, t->heads.p, t->heads.n);
}

/* The source's columns, those kept of refined frames, the network. */
static spin_status write_splats(const struct spin_output *output, struct spin_bundle_writer *w,
                                const struct spin_bundle_meta *meta)
{
    struct spin_plan *plan = output->plan;
    unsigned kept = spin_refinement_columns(plan);
    struct spin_splats splats = {0};
    spin_status status = SPIN_OK;

    for (int f = 0; f < plan->clip.n_frames; f++) {
        SPIN_TRY_OUT(spin_bundle_frame(&plan->clip.bundle, spin_plan_index(plan, f), meta->columns,
                                       &splats));
        SPIN_TRY_OUT(spin_bundle_write_frame(w, f, meta->columns, meta->static_columns, &splats));
    }
    for (int f = 0; output->refinement->frame && f < plan->clip.n_frames; f++) {
        SPIN_TRY_OUT(spin_refinement_read(output->refinement, plan, f, kept, &splats));
        SPIN_TRY_OUT(spin_bundle_write_refined(w, f, kept, &splats));
    }
    if (plan->o->method == SPIN_METHOD_NETWORK)
        status = write_network(output, w);
out:
    spin_splats_free(&splats);
    return status;
}

/* ---- meta.json ---------------------------------------------------------------------------------- */

static spin_status fill_meta(const struct spin_output *output, struct spin_bundle_meta *meta)
{
    const struct spin_bundle_meta *from = &output->plan->clip.bundle.meta;
    char *folder = NULL;
    spin_status status;

    SPIN_TRY(spin_bundle_meta_reserve(meta, output->plan->clip.n_frames));
    memcpy(meta->from, from->from, sizeof meta->from);
    memcpy(meta->upstream, from->upstream, sizeof meta->upstream);
    memcpy(meta->variant, from->variant, sizeof meta->variant);
    for (int f = 0; f < output->plan->clip.n_frames; f++) {
        meta->frame[f] = *spin_plan_info(output->plan, f);
        meta->source_index[f] = from->source_index[spin_plan_index(output->plan, f)];
    }
    meta->n_source_frames = from->n_source_frames;
    meta->numbered = from->numbered;
    meta->columns = from->columns;
    meta->static_columns = from->static_columns;
    meta->sh_degree = from->sh_degree;
    meta->antialias = from->antialias;
    memcpy(meta->data_from, output->plan->clip.data_from, sizeof meta->data_from);
    SPIN_TRY(spin_path_folder(output->plan->o->output, &folder));
    status = spin_path_relative(folder, output->plan->clip.data_path, &meta->data_path);
    free(folder);
    return status;
}

static void set_quality(spin_json *j, const char *key, const struct spin_quality *q)
{
    spin_json *value;

    if (!q->valid) {
        spin_json_set_null(j, key);
        return;
    }
    value = spin_json_object();
    spin_json_set_number(value, "psnr", q->psnr);
    spin_json_set_number(value, "ssim", q->ssim);
    spin_json_set(j, key, value);
}

/* What was learned of the cameras: by id, the log of the gain and the offset, r g b each. */
static spin_status cameras_to_json(const struct spin_output *output, spin_json **json)
{
    const struct spin_param *exposure = &output->trainer->exposures.param;
    struct spin_device *d = output->trainer->device;
    spin_json *all = NULL;
    void *block = NULL;
    spin_status status;

    SPIN_TRY_OUT(spin_alloc(exposure->n + 1, sizeof(float), &block));
    SPIN_TRY_OUT(d->op->download(d, block, exposure->p, exposure->n * sizeof(float)));
    all = spin_json_array();
    for (size_t i = 0; i < exposure->n / 6; i++) {
        spin_json *one = spin_json_object(), *gain = spin_json_array(), *offset = spin_json_array();
        const float *row = (const float *)block + 6 * i;

        for (int c = 0; c < 3; c++) {
            spin_json_push_number(gain, (double)row[c]);
            spin_json_push_number(offset, (double)row[3 + c]);
        }
        spin_json_set_integer(one, "camera", output->plan->camera[i]);
        spin_json_set(one, "log_gain", gain);
        spin_json_set(one, "offset", offset);
        spin_json_push(all, one);
    }
out:
    free(block);
    *json = all;
    return status;
}

/* The "network" object. */
static spin_status network_to_json(const struct spin_output *output, spin_json **json)
{
    const struct spin_retrain_report *report = output->plan->report;
    spin_json *j, *cameras = NULL;

    SPIN_TRY(cameras_to_json(output, &cameras));
    j = spin_field_to_json(&output->trainer->field);
    spin_json_set(j, "options",
                  spin_settings_network(output->plan, output->frames->init_log_scale));
    spin_json_set_string(j, "device", output->trainer->device->op->name);
    spin_json_set(j, "cameras", cameras);
    spin_json_set_string(j, "fingerprint", output->fingerprint);
    spin_json_set_string(j, "path", output->code_paths);
    set_quality(j, "before", &report->before);
    set_quality(j, "test", &report->test);
    *json = j;
    return SPIN_OK;
}

/* What the method adds to meta.json. */
static spin_status describe(const struct spin_output *output, spin_json *extra)
{
    const struct spin_plan *plan = output->plan;
    spin_json *refined = NULL, *network = NULL;

    if (output->refinement->frame) {
        refined = spin_refinement_to_json(output->refinement, plan);
        set_quality(refined, "test", &plan->report->refined);
        spin_json_set(extra, "refined", refined);
    }
    if (plan->o->method == SPIN_METHOD_NETWORK) {
        SPIN_TRY(network_to_json(output, &network));
        spin_json_set(extra, "network", network);
    } else {
        set_quality(refined, "before", &plan->report->before);
        spin_json_set_string(refined, "fingerprint", output->fingerprint);
        spin_json_set_string(refined, "path", output->code_paths);
    }
    return SPIN_OK;
}

/* ---- The whole ---------------------------------------------------------------------------------- */

spin_status spin_output_write(const struct spin_output *output)
{
    const struct spin_retrain_options *o = output->plan->o;
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta;
    spin_json *extra = spin_json_object();
    spin_status status;

    memset(&meta, 0, sizeof meta);
    status = spin_bundle_writer_open(o->output, o->force, true, &w);
    if (status != SPIN_OK) {
        spin_json_free(extra);
        return status;
    }
    SPIN_TRY_OUT(fill_meta(output, &meta));
    SPIN_TRY_OUT(write_splats(output, &w, &meta));
    SPIN_TRY_OUT(describe(output, extra));
    status = spin_bundle_writer_finish(&w, &meta, extra);
    spin_bundle_meta_free(&meta);
    return status;
out:
    spin_json_free(extra);
    spin_bundle_meta_free(&meta);
    spin_bundle_writer_abandon(&w);
    return status;
}

bool spin_output_is_done(const struct spin_plan *plan, const char *fingerprint)
{
    struct spin_bundle bundle;
    const char *method = plan->o->method == SPIN_METHOD_NETWORK ? "network" : "refined", *text;
    bool same;

    if (spin_bundle_open(plan->o->output, &bundle) != SPIN_OK)
        return false;
    text = spin_json_string(spin_json_get(spin_json_get(bundle.json, method), "fingerprint"));
    same = text && strcmp(text, fingerprint) == 0;
    spin_bundle_close(&bundle);
    return same;
}
