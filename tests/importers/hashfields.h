/* Shared by the tests of Grid4D and DASH: missing or wrong settings, and incomplete folders. */
#ifndef SPIN_TESTS_IMPORTERS_HASHFIELDS_H
#define SPIN_TESTS_IMPORTERS_HASHFIELDS_H

#include "tests/importers/edits.h"

#define CLOUD "point_cloud/*/point_cloud.ply"
#define NETWORK "deform/*/deform.pth"

/* A copy of a model with this cfg_args; "": none. */
static inline const char *with_settings(const char *model, const char *cfg)
{
    const char *copy = copy_of(model), *path = path_in(copy, "cfg_args");

    unlink(path);
    if (*cfg)
        write_text(path, cfg);
    return copy;
}

static inline void test_hash_settings(const char *from, const char *model)
{
    static const struct {
        const char *cfg, *word, *what;
    } bad[] = {
        {"", "--bound", "no cfg_args"},
        {"Namespace(sh_degree=3)", "--bound", "cfg_args without grid_args"},
        {"Namespace(grid_args={'bound': 0})", "above 0", "a bound of 0"},
        {"Namespace(grid_args={'bound': -1.5})", "above 0", "a negative bound"},
        {"Namespace(grid_args={'bound': 'x'})", "not a number", "a bound in words"},
        {"Namespace(grid_args={'bound': 1.6}, scale_xyz=[1, 2])", "scale_xyz", "two scales"},
        {"Namespace(grid_args={'bound': 1.6)", "cut short", "brackets that do not match"},
    };
    const char *zero[] = {"bound", "0", NULL}, *word[] = {"bound", "wide", NULL};
    const char *scales[] = {"bound", "1", "scale-xyz", "1,2", NULL};
    const char *missing[] = {"iteration", "12345", NULL};
    const char *copy = copy_of(model);
    struct run run;

    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        model_fails(from, with_settings(model, bad[i].cfg), NULL, *bad[i].cfg ? "cfg_args" : NULL,
                    bad[i].word, bad[i].what);
    model_fails(from, model, zero, "--bound", "above 0", "--bound 0");
    model_fails(from, model, word, "--bound", "expected a number", "--bound of a word");
    model_fails(from, model, scales, "--scale-xyz", "expected", "--scale-xyz of two numbers");
    model_fails(from, model, missing, model, "iteration_12345", "a save that is not there");
    if (ok(run_open(from, with_settings(model, "Namespace(grid_args={'a': 1})"), &run) == SPIN_OK,
           "the method's bound when grid_args has none"))
        ok(strstr(run.sequence.notes, "1.6") != NULL, "which is noted");
    run_close(&run);
    refuse_cuts(from, model, NULL, NETWORK);
    refuse_cuts(from, model, NULL, CLOUD);
    while (golden_path(copy, CLOUD))
        unlink(golden_path(copy, CLOUD));
    model_fails(from, copy, NULL, copy, "both", "a network without its cloud");
    model_fails(from, new_folder(), NULL, NULL, "no folder 'point_cloud'", "an empty folder");
    model_fails(from, path_in(model, "../manifest.json"), NULL, "manifest.json", "model's folder",
                "a file of another kind");
}

#endif
