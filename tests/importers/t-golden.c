/* Every fixture with values computed by its method's own code, by the table of golden.h and the
 * tolerances of its manifest. TAP_PART is a folder of fixtures, or one of them:
 * ed3dgs/annealed_early.
 * K: golden import deformable3dgs motiongs grid4d dash ed3dgs 4dgaussian spacetimegs rotor4dgs
 * K: realtime4dgs hybrid4dgs omg4 modecgs ex4dgs freetimegs ftgs_ply freetimegspp scgs
 * shapeofmotion
 * K: gaussianflow stglite gifstream usd d3dgs pamosplat trackersplat tc3dgs threads */
#include "tests/importers/golden.h"

static void fixtures_of(const char *method)
{
    const char *root = check_fixture(method), *part = getenv("TAP_PART");
    const char *slash = part ? strchr(part, '/') : NULL, **names;
    size_t length = slash ? (size_t)(slash - part) : part ? strlen(part) : 0;

    if (part && (strlen(method) != length || strncmp(part, method, length) != 0))
        return;
    if (!root) {
        skip(method, "there are no fixtures here");
        return;
    }
    names = check_cases(method, "manifest.json");
    for (size_t i = 0; names[i]; i++) {
        for (size_t k = 0; k < N_GOLDENS; k++) {
            if (strcmp(goldens[k].fixtures, method) == 0 &&
                (!slash || !strcmp(slash + 1, names[i])))
                golden_fixture(&goldens[k], path_in(root, names[i]), names[i]);
        }
    }
    free(names);
}

#define METHOD_PART(method) fixtures_of(#method)

TAP_MAIN
{
    spin_log_set_level(-2);
    METHOD_PART(deformable3dgs);
    METHOD_PART(motiongs);
    METHOD_PART(grid4d);
    METHOD_PART(dash);
    METHOD_PART(ed3dgs);
    METHOD_PART(4dgaussian);
    METHOD_PART(spacetimegs);
    METHOD_PART(rotor4dgs);
    METHOD_PART(realtime4dgs);
    METHOD_PART(hybrid4dgs);
    METHOD_PART(omg4);
    METHOD_PART(modecgs);
    METHOD_PART(ex4dgs);
    METHOD_PART(freetimegs);
    METHOD_PART(ftgs_ply);
    METHOD_PART(freetimegspp);
    METHOD_PART(scgs);
    METHOD_PART(gaussianflow);
    METHOD_PART(shapeofmotion);
    METHOD_PART(4dgs);
    METHOD_PART(stglite);
    METHOD_PART(gifstream);
    METHOD_PART(usd);
    METHOD_PART(d3dgs);
    METHOD_PART(pamosplat);
    METHOD_PART(trackersplat);
    METHOD_PART(tc3dgs);
}
