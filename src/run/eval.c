/* spin_eval(): measures a bundle against the images of its data set. */
#include "base/base.h"
#include "spin_run.h"
#include "eval/flicker.h"
#include "eval/metrics.h"
#include "eval/report/report.h"
#include "io/image.h"
#include "io/output.h"
#include "io/ranks.h"
#include "render/draw_renders.h"
#include "run/run.h"
#include "scene/clip.h"

struct eval {
    const struct spin_eval_options *o;
    struct spin_compare *compare; /* receives the images of a comparison; NULL: no comparison */
    struct spin_eval_report *report;
    struct spin_clip clip;
    struct spin_image_cache pixels;
    struct spin_dynamic_mask dynamic, subject;
    struct spin_mattes mattes;
    struct spin_lpips *lpips[SPIN_N_LPIPS];
    struct spin_device device;
    struct spin_player player, source;
    struct spin_lenses lenses; /* lenses that were learned with the measured splats */
    /* true: `source` is open, and renders the imported splats for a comparison */
    bool has_source;
    enum spin_splat_source from;
    struct spin_pair *pairs;
    size_t n_pairs;
    struct spin_output_folder images; /* folder of --images; open on rank 0 only */
    struct spin_flicker_strip strip;  /* for the report; empty without --temporal */
};

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status open_clip(struct eval *e)
{
    const struct spin_eval_options *o = e->o;
    struct spin_clip_options c = {.input = o->input,
                                  .data = o->data,
                                  .data_from = o->data_from,
                                  .pair = o->pair,
                                  .range = o->range,
                                  .test_cameras = o->test_cameras,
                                  .n_test_cameras = o->n_test_cameras,
                                  .image_scale = o->image_scale,
                                  .needs_views = true,
                                  .as_trained = true};

    SPIN_TRY(spin_clip_open(&c, &e->clip));
    SPIN_TRY(spin_player_choose(&e->clip.bundle, o->source, &e->from));
    SPIN_TRY(spin_lenses_from_json(spin_json_get(e->clip.bundle.json, "lenses"), o->image_scale,
                                   &e->lenses));
    e->report->trained = e->from == SPIN_FROM_TRAINED;
    e->report->refined = e->from == SPIN_FROM_REFINED;
    SPIN_TRY(spin_clip_pairs(&e->clip, o->split, &e->pairs, &e->n_pairs));
    if (e->n_pairs == 0 && o->split == SPIN_SPLIT_OUTER)
        return spin_not_found(
            "no held-out camera is outside the range of directions of the training "
            "cameras: hold outer cameras out with spin-retrain --test-outer");
    if (e->n_pairs == 0)
        return spin_not_found(
            "the data set has no views in this split: choose another with --split");
    SPIN_TRY(spin_image_cache_open(&e->clip.views, spin_memory_available() / 4, o->background,
                                   &e->pixels));
    if (o->n_threads != 1)
        SPIN_TRY(spin_image_cache_read_ahead(&e->pixels));
    if (o->mask)
        SPIN_TRY(
            spin_subject_mask_open(&e->clip.views, &e->pixels, e->pairs, e->n_pairs, &e->subject));
    e->report->subject = !o->mask ? NULL : e->subject.alpha ? "alpha" : "masks";
    return spin_dynamic_mask_open(&e->clip.views, &e->pixels,
                                  o->mask ? SPIN_DYNAMIC_OFF : o->dynamic, e->pairs, e->n_pairs,
                                  &e->dynamic);
}

/* Warns if the measured views include training cameras whose exposure was learned. Their scores are
 * too low, since all views are rendered with the mean exposure: test cameras have no learned
 * exposure. */
static void warn_exposures(const struct eval *e)
{
    const spin_json *cameras = spin_json_get(spin_training_of(&e->clip.bundle, e->from), "cameras");
    size_t n = 0;

    for (size_t i = 0; i < e->n_pairs; i++)
        for (size_t k = 0; k < spin_json_length(cameras); k++) {
            double id = NAN;

            spin_json_number(spin_json_get(spin_json_at(cameras, k), "camera"), &id);
            n += id == e->clip.views.view[e->pairs[i].view].camera_id;
        }
    if (n > 0)
        spin_warn("%s to cameras whose exposure was learned; these views are rendered with the "
                  "mean exposure, so their scores are too low",
                  spin_text_share(n, e->n_pairs, "view", "belongs", "belong", (char[96]){0}));
}

static spin_status open_players(struct eval *e)
{
    const struct spin_eval_options *o = e->o;

    if (spin_rank() == 0) {
        spin_training_warn_background(&e->clip.bundle, e->from, o->background, "measures");
        spin_training_warn_scale(&e->clip.bundle, e->from, o->image_scale);
    }
    if (spin_rank() == 0 && spin_training_of(&e->clip.bundle, e->from) &&
        o->split == SPIN_SPLIT_TEST)
        spin_training_warn_test_cameras(&e->clip, o->n_test_cameras);
    SPIN_TRY(spin_device_open(o->device, o->n_threads, &e->device));
    SPIN_TRY(spin_player_open(&e->player, &e->device, &e->clip.bundle, e->from));
    if (spin_bundle_has_lenses(&e->clip.bundle, e->from)) {
        SPIN_TRY(spin_player_set_lenses(&e->player, &e->lenses));
        if (spin_rank() == 0) {
            spin_lenses_warn(&e->lenses, &e->clip.views, e->pairs, e->n_pairs);
            warn_exposures(e);
        }
    }
    if (e->compare || (!o->images && !o->report) || e->from == SPIN_FROM_SOURCE ||
        (SPIN_COL_ATTRIBUTES & ~e->clip.bundle.meta.columns))
        return SPIN_OK;
    SPIN_TRY(spin_player_open(&e->source, &e->device, &e->clip.bundle, SPIN_FROM_SOURCE));
    e->has_source = true;
    return SPIN_OK;
}

/* Loads the weights of the LPIPS networks before anything is rendered, so that errors are reported
 * early. */
static spin_status open_lpips(struct eval *e)
{
    const struct spin_eval_options *o = e->o;
    struct spin_lpips *one = NULL;
    int network;

    if (o->lpips)
        SPIN_TRY(spin_lpips_find(o->lpips, o->n_threads, e->lpips));
    if (!o->lpips_backbone && !o->lpips_lin)
        return SPIN_OK;
    if (!o->lpips_backbone || !o->lpips_lin)
        return spin_misuse("LPIPS needs both --lpips-backbone and --lpips-lin");
    SPIN_TRY(spin_lpips_open(o->lpips_backbone, o->lpips_lin, o->n_threads, &one));
    network = spin_lpips_network(one);
    spin_lpips_close(e->lpips[network]);
    e->lpips[network] = one;
    return SPIN_OK;
}

/* ---- The report ------------------------------------------------------------------------------ */

/* Checks before any view is measured that the page of --report can be written and that the file of
 * --log exists, to fail early. */
static spin_status check_report(const struct spin_eval_options *o)
{
    if (o->log && !o->report)
        return spin_misuse("--log is only for the report: give --report too");
    if (o->report)
        SPIN_TRY(spin_report_check_name(o->report));
    if (o->log && !spin_path_exists(o->log))
        return spin_not_found("the log '%s' does not exist", o->log);
    SPIN_TRY(spin_output_check_distinct((const char *[]){o->report, o->images}, 2));
    SPIN_TRY(spin_inputs_add_path(o->input));
    SPIN_TRY(spin_inputs_add_path(o->log));
    return o->report ? spin_output_check_file(o->report, o->force) : SPIN_OK;
}

/* Writes the page of --report. If the imported splats are compared too, they are measured first. */
static spin_status write_report(struct eval *e, const struct spin_metrics *after)
{
    struct spin_eval_report before = {.n_views = e->n_pairs,
                                      .n_frames = e->clip.n_frames,
                                      .dynamic = e->dynamic.from,
                                      .subject = e->report->subject};
    struct spin_report r = {.path = e->o->report,
                            .log = e->o->log,
                            .trained_psnr = NAN,
                            .force = e->o->force,
                            .input = e->o->input,
                            .split = e->o->split,
                            .background = e->o->background,
                            .clip = &e->clip,
                            .pixels = &e->pixels,
                            .pairs = e->pairs,
                            .player = &e->player,
                            .after = e->report,
                            .strip = &e->strip};
    struct spin_metrics m = *after;
    spin_status status = SPIN_OK;

    spin_json_number(
        spin_json_get(spin_json_get(spin_training_of(&e->clip.bundle, e->from), "test"), "psnr"),
        &r.trained_psnr);
    if (e->has_source) {
        SPIN_TRY(spin_alloc(e->n_pairs, sizeof *before.view, (void **)&before.view));
        m.player = &e->source;
        m.source = NULL;
        m.images = NULL;
        m.opposite = false;
        m.view = before.view;
        m.what = "evaluating the source";
        status = spin_metrics_run(&m, &before.mean);
        if (status == SPIN_OK && e->o->temporal)
            status = spin_flicker_run(&m, &before.flicker, &before.n_flicker, NULL);
        r.source = &e->source;
        r.before = &before;
    }
    if (status == SPIN_OK && spin_rank() == 0)
        status = spin_report_write(&r);
    spin_eval_report_free(&before);
    return status;
}

/* ---- Measuring ------------------------------------------------------------------------------- */

/* Counts the splats that could not be drawn, on all ranks together. */
static spin_status sum_left_out(struct eval *e)
{
    SPIN_FREED uint64_t *n = NULL;

    SPIN_TRY(spin_alloc((size_t)spin_n_ranks(), sizeof *n, (void **)&n));
    n[spin_rank()] = e->player.n_bad;
    SPIN_TRY(spin_ranks_gather(n, sizeof *n));
    for (int r = 0; r < spin_n_ranks(); r++)
        e->report->left_out += n[r];
    return SPIN_OK;
}

/* Lists the images that all ranks wrote, and removes the images of an earlier run. */
static spin_status list_images(struct eval *e)
{
    char name[SPIN_IMAGE_NAME];

    if (!e->images.path)
        return SPIN_OK;
    for (size_t i = 0; i < e->n_pairs; i++) {
        const struct spin_pair *pair = &e->pairs[i];
        int number = e->report->view[i].frame;

        spin_image_name(&e->clip.views, pair->view, number, NULL, name);
        spin_output_folder_add(&e->images, name, number);
    }
    SPIN_TRY(spin_output_folder_list(&e->images, "images", false));
    spin_output_folder_remove_former(&e->images);
    return SPIN_OK;
}

static spin_status run_eval(struct eval *e)
{
    const struct spin_eval_options *o = e->o;
    struct spin_eval_report *report = e->report;
    struct spin_metrics m = {.player = &e->player,
                             .clip = &e->clip,
                             .pixels = &e->pixels,
                             .dynamic = &e->dynamic,
                             .subject = o->mask ? &e->subject : NULL,
                             .background = o->background,
                             .images = o->images,
                             .what = "evaluating"};

    SPIN_TRY(check_report(o));
    if (o->mask && o->dynamic != SPIN_DYNAMIC_AUTO && o->dynamic != SPIN_DYNAMIC_OFF)
        return spin_misuse("--mask and --dynamic exclude each other");
    if (o->mask && o->temporal)
        return spin_misuse("--mask and --temporal exclude each other");
    SPIN_TRY(open_lpips(e));
    SPIN_TRY(open_clip(e));
    SPIN_TRY(open_players(e));
    SPIN_TRY(spin_alloc(e->n_pairs, sizeof *report->view, (void **)&report->view));
    if (o->images)
        SPIN_TRY(spin_ranks_agree(
            spin_rank() == 0 ? spin_output_folder_begin(o->images, o->force, ".png", &e->images)
                             : SPIN_OK));
    m.source = e->has_source ? &e->source : NULL;
    m.pairs = e->pairs;
    m.n_pairs = e->n_pairs;
    m.view = report->view;
    memcpy(m.lpips, e->lpips, sizeof m.lpips);
    if (!e->compare && !o->mask) {
        enum spin_surroundings surroundings;

        SPIN_TRY(spin_mattes_open(&e->clip.views, &e->pixels, e->pairs, e->n_pairs, &e->mattes,
                                  &surroundings));
        m.mattes = e->mattes.views ? &e->mattes : NULL;
        /* Rendering also over the opposite background makes holes in the scene visible. If the
         * images show a subject in front of a flat colour, the region around the subject would
         * count as a hole, unless the alpha of the images is known. */
        m.opposite = surroundings == SPIN_SURROUNDED_BY_SCENE || m.mattes;
        report->alpha_known = m.mattes != NULL;
    }
    SPIN_TRY(spin_metrics_run(&m, &report->mean));
    if (!report->mean.valid)
        return spin_not_found(
            "--mask: the subject is in no view of this split: choose another with --split");
    if (o->temporal)
        SPIN_TRY(spin_flicker_run(&m, &report->flicker, &report->n_flicker,
                                  o->report && !e->compare ? &e->strip : NULL));
    SPIN_TRY(spin_ranks_agree(list_images(e)));
    SPIN_TRY(sum_left_out(e));
    report->n_views = e->n_pairs;
    report->n_frames = e->clip.n_frames;
    report->n_bundle_frames = e->clip.bundle.meta.n_frames;
    report->dynamic = e->dynamic.from;
    report->seconds_decode = m.seconds_decode / m.n_decoded;
    report->seconds_draw = m.seconds_draw / (double)e->n_pairs;
    spin_bundle_sizes(&e->clip.bundle, &report->storage, &report->unpacked);
    if (e->compare)
        return spin_ranks_agree(spin_rank() > 0
                                    ? SPIN_OK
                                    : spin_compare_draw(e->compare, &e->clip, &e->pixels, e->pairs,
                                                        report, &e->player, o->background));
    return o->report ? write_report(e, &m) : SPIN_OK;
}

spin_status spin_evaluate_for(const struct spin_eval_options *o, struct spin_compare *compare,
                              struct spin_eval_report *report)
{
    SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin();
    SPIN_LEAVES(spin_renders_end) int renders = spin_renders_begin(o->n_threads);
    struct eval e = {.o = o, .compare = compare, .report = report};
    spin_status status;

    (void)inputs;
    (void)renders;
    memset(report, 0, sizeof *report);
    status = run_eval(&e);
    spin_player_close(&e.player);
    spin_player_close(&e.source);
    spin_device_close(&e.device);
    spin_dynamic_mask_close(&e.dynamic);
    spin_dynamic_mask_close(&e.subject);
    for (int i = 0; i < SPIN_N_LPIPS; i++)
        spin_lpips_close(e.lpips[i]);
    spin_lenses_free(&e.lenses);
    spin_flicker_strip_free(&e.strip);
    spin_mattes_close(&e.mattes);
    spin_image_cache_close(&e.pixels);
    spin_clip_close(&e.clip);
    spin_output_folder_abandon(&e.images); /* removes the folder if it is empty */
    free(e.pairs);
    if (status != SPIN_OK)
        spin_eval_report_free(report);
    return spin_fail_context(status, "cannot evaluate '%s'", o->input);
}

spin_status spin_evaluate(const struct spin_eval_options *o, struct spin_eval_report *report)
{
    return spin_evaluate_for(o, NULL, report);
}

spin_status spin_eval(const struct spin_eval_options *o, char **report)
{
    struct spin_eval_report r;
    spin_json *document;

    *report = NULL;
    SPIN_TRY(spin_evaluate(o, &r));
    document = spin_eval_json(&r, o->split);
    spin_eval_report_free(&r);
    return spin_json_finish(document, report);
}

void spin_eval_report_free(struct spin_eval_report *report)
{
    free(report->view);
    free(report->flicker);
    memset(report, 0, sizeof *report);
}
