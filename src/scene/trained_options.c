#include "scene/trained_options.h"

spin_json *spin_trained_options(const spin_json *trained)
{
    static const char *const of_network[] = {
        "levels",       "features",       "hash_log2",  "hidden",           "base_resolution",
        "lr_table",     "lr_sh",          "lr_scale",   "lr_rotation",      "finest_resolution",
        "residual",     "init_log_scale", "lr_opacity", "hash_init_range",  "lr_head_factor",
        "relu",         "activation",     "normalise",  "normalise_centre", "normalise_radius",
        "network_start"};
    spin_json *copy = json_copy((json_t *)(uintptr_t)spin_json_get(trained, "options"));

    for (size_t i = 0; i < sizeof of_network / sizeof *of_network && copy; i++)
        if (!spin_json_is_object(spin_json_get(trained, "field")))
            json_object_del(copy, of_network[i]);
    return copy;
}
