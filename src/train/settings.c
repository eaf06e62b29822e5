/* Options to JSON. */
#include "train/settings.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

/* All that decides a frame's result besides the frame. */
spin_json *spin_settings_refine(const struct spin_plan *plan)
{
    const struct spin_retrain_options *o = plan->o;
    spin_json *j = spin_json_object(), *back = spin_json_array();
    char seed[32];

    for (int c = 0; c < 3; c++)
        spin_json_push_number(back, (double)o->background[c]);
    snprintf(seed, sizeof seed, "%" PRIu64, o->seed);
    spin_json_set_integer(j, "iterations", o->refine);
    spin_json_set_string(j, "start",
                         o->refine_start == SPIN_REFINE_FROM_SOURCE ? "source" : "points");
    spin_json_set_bool(j, "densify", !o->no_densify);
    spin_json_set_integer(j, "max_points", o->max_points);
    spin_json_set_number(j, "lambda_dssim", o->lambda_dssim);
    spin_json_set(j, "background", back);
    spin_json_set_string(j, "seed", seed);
    spin_json_set_number(j, "image_scale", o->image_scale);
    spin_json_set_number(j, "spatial_extent", plan->extent);
    if (o->learn_exposure) /* said only where it is not as 3DGS does it, as what follows */
        spin_json_set_number(j, "lr_exposure", o->lr_exposure);
    if (o->lambda_scale > 0)
        spin_json_set_number(j, "lambda_scale", o->lambda_scale);
    if (o->lambda_opacity > 0)
        spin_json_set_number(j, "lambda_opacity", o->lambda_opacity);
    if (o->antialias)
        spin_json_set_bool(j, "antialias", true);
    if (o->dynamic_weight != 1)
        spin_json_set_number(j, "dynamic_weight", o->dynamic_weight);
    return j;
}

spin_json *spin_settings_network(const struct spin_plan *plan, double init_log_scale)
{
    const struct spin_retrain_options *o = plan->o;
    spin_json *j = spin_json_object(), *base = spin_json_array(), *finest = spin_json_array();
    spin_json *back = spin_json_array(), *test = spin_json_array();
    char seed[32];

    for (int d = 0; d < 4; d++) {
        spin_json_push_number(base, o->base_resolution[d]);
        spin_json_push_number(finest, o->finest_resolution[d]);
    }
    for (int c = 0; c < 3; c++)
        spin_json_push_number(back, (double)o->background[c]);
    for (size_t i = 0; i < plan->clip.views.n; i++)
        if (plan->clip.views.view[i].test &&
            plan->clip.views.view[i].dataset_frame == plan->clip.dataset_frame[0])
            spin_json_push_number(test, plan->clip.views.view[i].camera_id);
    spin_json_set_integer(j, "iterations", o->iterations);
    spin_json_set_integer(j, "batch", o->batch);
    spin_json_set_integer(j, "hash_log2", o->hash_log2);
    spin_json_set(j, "base_resolution", base);
    spin_json_set(j, "finest_resolution", finest);
    spin_json_set_number(j, "lambda_dssim", o->lambda_dssim);
    snprintf(seed, sizeof seed, "%" PRIu64, o->seed);
    spin_json_set_string(j, "seed", seed);
    spin_json_set_integer(j, "warmup", o->warmup);
    spin_json_set_number(j, "lr_table", o->lr_table);
    spin_json_set_number(j, "lr_sh", o->lr_sh);
    spin_json_set_number(j, "lr_scale", o->lr_scale);
    spin_json_set_number(j, "lr_rotation", o->lr_rotation);
    spin_json_set_number(j, "lr_opacity", o->lr_opacity);
    spin_json_set_number(j, "lr_position", o->lr_position);
    spin_json_set_number(j, "lr_head_factor", o->lr_head_factor);
    if (o->sh_increase_every > 0) /* said only where it is not as in the paper, as what follows */
        spin_json_set_integer(j, "sh_increase_every", o->sh_increase_every);
    if (o->hash_init_range != SPIN_HASH_INIT_RANGE)
        spin_json_set_number(j, "hash_init_range", o->hash_init_range);
    if (o->lambda_scale > 0)
        spin_json_set_number(j, "lambda_scale", o->lambda_scale);
    if (o->lambda_opacity > 0)
        spin_json_set_number(j, "lambda_opacity", o->lambda_opacity);
    if (o->dynamic_weight != 1)
        spin_json_set_number(j, "dynamic_weight", o->dynamic_weight);
    if (spin_plan_has_residual(plan)) {
        bool source = o->residual == SPIN_RESIDUAL_SOURCE;

        spin_json_set_string(j, "residual", source ? "source" : "points");
        spin_json_set_number(j, "lr_residual", o->lr_residual);
    }
    spin_json_set_bool(j, "learn_exposure", o->learn_exposure);
    spin_json_set_number(j, "lr_exposure", o->lr_exposure);
    if (isnan(init_log_scale))
        spin_json_set_string(j, "init_log_scale", "auto");
    else
        spin_json_set_number(j, "init_log_scale", init_log_scale);
    spin_json_set_integer(j, "views_per_frame", o->views_per_frame);
    spin_json_set_number(j, "image_scale", o->image_scale);
    spin_json_set_number(j, "spatial_extent", plan->extent);
    spin_json_set(j, "background", back);
    spin_json_set(j, "test_cameras", test);
    if (o->refine > 0)
        spin_json_set(j, "refine", spin_settings_refine(plan));
    return j;
}
