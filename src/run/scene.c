/* Implements the functions of spin.h that read and render the clip of a bundle. */
#include "base/base.h"
#include "io/file.h"
#include "run/run.h"
#include "scene/bundle.h"

void spin_set_verbosity(int level) { spin_log_set_level(level); }

/* ---- A clip, open for reading ---------------------------------------------------------------- */

struct spin_scene {
    struct spin_bundle bundle;
    struct spin_device device;
    /* player of the trained splats, which is opened when it is first needed */
    struct spin_player player;
    bool is_trained, device_open, player_open;
};

spin_status spin_scene_open(const char *path, struct spin_scene **out)
{
    struct spin_scene *scene;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *scene, (void **)&scene));
    status = spin_bundle_open(path, &scene->bundle);
    if (status != SPIN_OK) {
        free(scene);
        return status;
    }
    scene->is_trained = spin_bundle_is_trained(&scene->bundle);
    *out = scene;
    return SPIN_OK;
}

void spin_scene_close(struct spin_scene *scene)
{
    if (!scene)
        return;
    if (scene->player_open)
        spin_player_close(&scene->player);
    if (scene->device_open)
        spin_device_close(&scene->device);
    spin_bundle_close(&scene->bundle);
    free(scene);
}

int spin_scene_n_frames(const struct spin_scene *scene) { return scene->bundle.meta.n_frames; }

const struct spin_frame_info *spin_scene_frame(const struct spin_scene *scene, int frame)
{
    return &scene->bundle.meta.frame[frame];
}

bool spin_scene_is_trained(const struct spin_scene *scene) { return scene->is_trained; }

unsigned spin_scene_columns(const struct spin_scene *scene) { return scene->bundle.meta.columns; }

spin_status spin_scene_read(struct spin_scene *scene, int frame, enum spin_splat_source from,
                            unsigned columns, struct spin_splats *out)
{
    const struct spin_bundle *bundle = &scene->bundle;

    if (from == SPIN_FROM_BEST)
        from = scene->is_trained                                ? SPIN_FROM_TRAINED
               : SPIN_COL_ATTRIBUTES & ~bundle->refined.columns ? SPIN_FROM_SOURCE
                                                                : SPIN_FROM_REFINED;
    if (from == SPIN_FROM_SOURCE)
        return spin_bundle_frame(&scene->bundle, frame, columns, out);
    if (from == SPIN_FROM_REFINED)
        return spin_bundle_refined_frame(&scene->bundle, frame, columns, out);
    if (!scene->is_trained)
        return spin_not_found("'%s' was not trained: run spin-retrain", scene->bundle.path);
    if (!scene->device_open) {
        SPIN_TRY(spin_device_open("auto", 0, &scene->device));
        scene->device_open = true;
    }
    if (!scene->player_open) {
        SPIN_TRY(
            spin_player_open(&scene->player, &scene->device, &scene->bundle, SPIN_FROM_TRAINED));
        scene->player_open = true;
    }
    return spin_player_splats(&scene->player, frame, columns, out);
}

/* ---- Rendering ------------------------------------------------------------------------------- */

spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image)
{
    SPIN_TRY(spin_player_show_splats(&r->player, splats));
    return spin_player_draw(&r->player, camera, background, image);
}

spin_status spin_render_layers(struct spin_renderer *r, float *alpha, float *depth)
{
    return spin_player_layers(&r->player, alpha, depth);
}
