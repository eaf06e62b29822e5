/* rotor4dgs: options, and malformed files.
 * K: rotor4dgs import */
#include "tests/importers/edits.h"

#define FROM "rotor4dgs"

static void test_options(const char *root)
{
    const char *path = path_in(root, "old_names"), *folder = copy_of(path), *file;
    const char *range[] = {"time-range", "0,5", NULL}, *odd[] = {"time-range", "x", NULL};
    const char *cull[] = {"cull", "some", NULL};
    struct run run;

    ok(model_open(FROM, path, range, &run) == SPIN_OK && run.sequence.time_first == 0 &&
           run.sequence.time_last == 5 && run.sequence.sh_degree == 3 &&
           !strstr(run.sequence.notes, "own times") && !strstr(run.sequence.notes, "degree 4"),
       "the range of times may be given");
    ok(strstr(run.sequence.variant, "step 2000") != NULL, "the step inside is told");
    run_close(&run);
    fails_with(FROM, path, odd, "expected A,B", "a range that is none");
    fails_with(FROM, path, cull, "expected opacity, time or none", "a rule that is none");

    file = path_in(folder, "nerfstudio_models/step-000002000.ckpt");
    ok(run_open(NULL, file, &run) == SPIN_OK && !strcmp(run.importer->name, FROM),
       "the file alone is recognised");
    run_close(&run);
    ok(read_truncations(FROM, file) == 0, "no truncation of a checkpoint can be read");
    survive_flips(FROM, file);
}

static void test_refused(void)
{
    const char *other = check_fixture("realtime4dgs/dim3_static/chkpnt7000.pth");

    fails(FROM, new_folder(), "contains no step-<N>.ckpt", "a folder without checkpoints");
    fails(FROM, "no/such.ckpt", "no/such.ckpt", "a missing file");
    if (other)
        fails(FROM, other, "no dict 'pipeline'", "a checkpoint of another method");
}

TAP_MAIN
{
    const char *root = check_fixture("rotor4dgs");

    spin_log_set_level(-2);
    test_refused();
    if (root)
        test_options(root);
    else
        skip("rotor4dgs fixtures", "there are none here");
}
