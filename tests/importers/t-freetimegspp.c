/* freetimegspp: the file of a folder, and the range of times. t-golden.c compares the values,
 * t-variants.c reads altered files.
 * K: freetimegspp import 4d gates */
#include "tests/importers/edits.h"

#define FROM "freetimegspp"

static void test_range(const char *model)
{
    const char *copy = copy_of(model), *config = path_in(copy, "config.toml");
    const struct spin_splats_4d *s = NULL;
    struct run run;

    replace_text(config, "start = 0, stop = 90", "start = 60, stop = 75");
    ok(run_open(NULL, copy, &run) == SPIN_OK && run.sequence.n_clip_frames == 15 &&
           run.sequence.fps == 30 && run.sequence.time_first == 2 &&
           fabs(run.sequence.time_last - 74 / 30.0) < 1e-12,
       "times are seconds from the first frame of the video");
    ok(run.importer->splats_4d(run.self, &s) == SPIN_OK && s && s->gates && s->degree == 1,
       "explicit velocities are 4D splats with gates");
    run_close(&run);
    replace_text(config, "[data]", "[date]");
    model_fails(NULL, copy, NULL, "config.toml", "data.fps", "settings of another section");
    remove(config);
    ok(run_open(NULL, copy, &run) == SPIN_OK && strstr(run.sequence.notes, "--time-range"),
       "without config.toml the range is a guess");
    run_close(&run);
    ok(model_open(NULL, copy, (const char *[]){"time-range", "2,4", NULL}, &run) == SPIN_OK &&
           run.sequence.time_first == 2 && run.sequence.time_last == 4 &&
           !strstr(run.sequence.notes, "guess"),
       "unless it is given");
    run_close(&run);
}

static void test_files(const char *model)
{
    const char *copy = copy_of(model);
    struct run run;

    copy_file(path_in(copy, "gaussians.pt"), path_in(copy, "separated.pt"));
    replace_text(path_in(copy, "gaussians.pt"), "P", "Q");
    ok(run_open(NULL, copy, &run) == SPIN_OK, "separated.pt comes first");
    run_close(&run);
    copy_file(path_in(copy, "separated.pt"), path_in(copy, "init.pt"));
    ok(run_open(NULL, path_in(copy, "init.pt"), &run) == SPIN_OK &&
           strstr(run.sequence.notes, "Gaussians before training"),
       "the state before the training is noted");
    run_close(&run);
    remove(path_in(copy, "separated.pt"));
    remove(path_in(copy, "gaussians.pt"));
    fails(FROM, copy, "neither separated.pt", "no file of splats");
    ok(read_truncations(FROM, path_in(model, "gaussians.pt")) == 0, "no truncation can be read");
    survive_flips(FROM, path_in(model, "gaussians.pt"));
}

TAP_MAIN
{
    const char *model = check_fixture("freetimegspp/gated_sh3");

    spin_log_set_level(-2);
    if (!model) {
        skip("freetimegspp fixtures", "there are none here");
        return;
    }
    test_range(model);
    test_files(model);
}
