/* The cache of refined frames: a frame is found and read only by its key.
 * K: retrain refine */
#include <unistd.h>

#include "train/refinement.h"
#include "tests/check.h"
#include "tests/tap.h"

static struct spin_splats made(size_t n, float value)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_splats s = {0};

    if (spin_splats_reserve(&s, n, columns, 0) != SPIN_OK)
        exit(1);
    s.n = n;
    for (size_t i = 0; i < 3 * n; i++)
        s.means[i] = s.log_scales[i] = s.sh[i] = value;
    for (size_t i = 0; i < 4 * n; i++)
        s.quats[i] = 0.5f;
    for (size_t i = 0; i < n; i++)
        s.logit_opacities[i] = value;
    return s;
}

TAP_MAIN
{
    char folder[300];
    struct spin_splats a = made(3, 1), b = made(3, 2), out = {0};
    struct spin_shelved there;
    bool found = true;

    snprintf(folder, sizeof folder, "%s/x.parts", check_folder());
    ok(spin_frame_cache_find(folder, 0, "A", &found, &there) == SPIN_OK && !found,
       "an empty shelf");
    ok(spin_frame_cache_put(folder, 0, "A", "v3", &a) == SPIN_OK, "puts a frame");
    ok(spin_frame_cache_find(folder, 0, "A", &found, &there) == SPIN_OK && found && there.n == 3 &&
           !strcmp(there.path, "v3"),
       "finds it, with its splats and the code path that made it");
    ok(spin_frame_cache_get(folder, 0, "A", SPIN_COL_MEANS, &out) == SPIN_OK && out.n == 3 &&
           out.means[8] == 1,
       "reads it");
    ok(spin_frame_cache_find(folder, 0, "B", &found, &there) == SPIN_E_USAGE && !found &&
           strstr(spin_last_error(), "00000.spin"),
       "another key is an error");
    ok(spin_frame_cache_put(folder, 0, "B", "v3", &b) == SPIN_OK,
       "somebody puts another in its place");
    out.means[8] = 7;
    ok(spin_frame_cache_get(folder, 0, "A", SPIN_COL_MEANS, &out) == SPIN_E_USAGE &&
           out.means[8] == 7 && strstr(spin_last_error(), "00000.spin"),
       "which is not read for ours");
    spin_frame_cache_clear(folder);
    ok(!spin_path_exists(folder), "cleared, it is gone");
    spin_splats_free(&a);
    spin_splats_free(&b);
    spin_splats_free(&out);
}
