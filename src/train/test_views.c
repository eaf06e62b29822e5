/* Measures the quality of the test views, and writes previews of them. */
#include "train/test_views.h"

#include "base/base.h"
#include "io/image.h"

spin_status spin_test_views_measure(const struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const size_t *live_counts,
                                    const char *what, struct spin_quality *out)
{
    struct spin_metrics m = {.player = shown,
                             .clip = &plan->clip,
                             .pixels = &photos->cache,
                             .pairs = plan->test,
                             .n_pairs = plan->n_test,
                             .background = plan->o->background,
                             .live_counts = live_counts,
                             .what = what};

    memset(out, 0, sizeof *out);
    return plan->n_test > 0 ? spin_metrics_run(&m, out) : SPIN_OK;
}

/* With --method 4d, makes the player of the input render the falloffs that were learned with the
 * input. */
static spin_status set_lenses(const struct spin_plan *plan, struct spin_player *input,
                              struct spin_lenses *lenses)
{
    if (plan->o->method != SPIN_METHOD_4D)
        return SPIN_OK;
    SPIN_TRY(spin_lenses_from_json(spin_json_get(plan->clip.bundle.json, "lenses"),
                                   plan->o->image_scale, lenses));
    return spin_player_set_lenses(input, lenses);
}

spin_status spin_test_views_measure_input(struct spin_plan *plan, struct spin_photos *photos,
                                          struct spin_device *device, struct spin_quality *out)
{
    bool trained = plan->o->method == SPIN_METHOD_4D;
    SPIN_LEAVES(spin_lenses_free) struct spin_lenses lenses = {0};
    SPIN_LEAVES(spin_player_close) struct spin_player input = {0};

    memset(out, 0, sizeof *out);
    if (!trained && !spin_plan_has_source(plan))
        return SPIN_OK;
    SPIN_TRY(spin_player_open(&input, device, &plan->clip.bundle,
                              trained ? SPIN_FROM_TRAINED : SPIN_FROM_SOURCE));
    SPIN_TRY(set_lenses(plan, &input, &lenses));
    return spin_test_views_measure(plan, photos, &input, NULL,
                                   trained ? "evaluating the clip" : "evaluating the source", out);
}

/* Writes the preview of one view as a PNG. With `source` NULL it does not show the source. */
static spin_status preview_view(struct spin_plan *plan, struct spin_photos *photos,
                                struct spin_player *shown, struct spin_player *source,
                                const struct spin_pair *pair, const char *label)
{
    const struct spin_view *view = &plan->clip.views.view[pair->view];
    size_t pixels = 3 * (size_t)view->camera.width * (size_t)view->camera.height;
    const float *picture[3];
    char name[SPIN_IMAGE_NAME];
    SPIN_FREED char *path = NULL;
    SPIN_FREED float *values = NULL;
    int n = 0;

    SPIN_TRY(spin_alloc(3 * pixels, sizeof(float), (void **)&values));
    SPIN_TRY(spin_image_cache_get(&photos->cache, pair->view, values));
    picture[n++] = values;
    if (source) {
        SPIN_TRY(spin_player_show(source, spin_plan_index(plan, pair->frame)));
        SPIN_TRY(spin_player_draw(source, &view->camera, plan->o->background, values + pixels));
        picture[n++] = values + pixels;
    }
    SPIN_TRY(spin_player_draw(shown, &view->camera, plan->o->background, values + 2 * pixels));
    picture[n++] = values + 2 * pixels;
    spin_image_name(&plan->clip.views, pair->view, spin_plan_info(plan, pair->frame)->number, label,
                    name);
    SPIN_TRY(spin_path_join(plan->o->preview, name, &path));
    return spin_write_beside(path, view->camera.width, view->camera.height, picture, n);
}

static spin_status write_previews(struct spin_plan *plan, struct spin_photos *photos,
                                  struct spin_player *shown, const char *label)
{
    SPIN_LEAVES(spin_player_close) struct spin_player source = {0};
    bool with_source = spin_plan_has_source(plan);
    int middle = plan->clip.n_frames / 2;

    if (!plan->o->preview || plan->n_test == 0)
        return SPIN_OK;
    if (with_source)
        SPIN_TRY(spin_player_open(&source, shown->device, &plan->clip.bundle, SPIN_FROM_SOURCE));
    SPIN_TRY(spin_player_show_live(shown, middle, plan->counts[middle]));
    for (size_t i = 0; i < plan->n_test; i++)
        if (plan->test[i].frame == middle)
            SPIN_TRY(preview_view(plan, photos, shown, with_source ? &source : NULL, &plan->test[i],
                                  label));
    return SPIN_OK;
}

spin_status spin_test_views_preview(struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const char *label)
{
    return spin_plan_beside(plan, write_previews(plan, photos, shown, label));
}
