/* Collects the settings as JSON, from the options and from values of the plan. */
#include "train/settings.h"

#include "train/options.h"

spin_json *spin_settings_refine(const struct spin_plan *plan)
{
    spin_json *j = spin_options_to_json(plan->o, SPIN_OPTIONS_OF_REFINEMENT);

    spin_json_set_number(j, "spatial_extent", plan->extent);
    if (spin_plan_frame_sh_degree(plan) > 0) {
        spin_json_set_integer(j, "sh_degree", spin_plan_frame_sh_degree(plan));
        spin_json_set_integer(j, "sh_increase_every", spin_plan_sh_increase_every(plan));
    }
    return j;
}

spin_json *spin_settings_network(const struct spin_plan *plan)
{
    spin_json *j = spin_options_to_json(plan->o, SPIN_OPTIONS_OF_NETWORK);
    spin_json *test = spin_json_array();

    for (size_t i = 0; i < plan->clip.views.n; i++)
        if (plan->clip.views.view[i].test &&
            plan->clip.views.view[i].dataset_frame == plan->clip.dataset_frame[0])
            spin_json_push_number(test, plan->clip.views.view[i].camera_id);
    spin_json_set_number(j, "spatial_extent", plan->extent);
    spin_json_set(j, "test_cameras", test);
    if (plan->o->refine > 0)
        spin_json_set(j, "refine", spin_settings_refine(plan));
    return j;
}
