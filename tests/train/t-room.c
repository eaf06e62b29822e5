/* A disk that is too small is told before the first step.  K: retrain outputs */
#include <sys/statvfs.h>

#include "spin_run.h"
#include "run/run.h"
#include "tests/check.h"
#include "tests/tap.h"

/* In place of the C library's. */
static uint64_t n_free;

int statvfs(const char *restrict path, struct statvfs *restrict fs)
{
    (void)path;
    *fs = (struct statvfs){.f_bavail = n_free, .f_frsize = 1};
    return 0;
}

TAP_MAIN
{
    struct spin_import_options in = {.from = "d3dgs"};
    struct spin_retrain_options o;
    struct spin_retrain_report report;
    char bundle[300], output[300];
    const char *clip = check_fixture("court-mini"), *folder = check_folder();

    snprintf(bundle, sizeof bundle, "%s/in.spin", folder);
    snprintf(output, sizeof output, "%s/out.spin", folder);
    n_free = (uint64_t)1 << 40;
    in.input = in.data = clip;
    in.output = bundle;
    if (!ok(clip && spin_import(&in, NULL) == SPIN_OK, "imports the clip"))
        return;
    spin_set_verbosity(-1);
    spin_retrain_preset("paper", &o);
    o.input = bundle;
    o.output = output;
    o.image_scale = 0.1;
    o.iterations = 1;
    o.levels = 2;
    o.hash_log2 = 8;
    o.finest_resolution[0] = o.finest_resolution[1] = o.finest_resolution[2] = 32;
    o.hidden = 8;
    o.n_threads = 1;
    n_free = 4 * 3 * sizeof(float) * 2940 * 6; /* the positions, but no network */
    ok(spin_train(&o, &report) == SPIN_E_IO && strstr(spin_last_error(), output) &&
           strstr(spin_last_error(), "the disk has 847 kB free"),
       "too small a disk is an error");
    ok(!spin_path_exists(output) && report.iterations == 1 && report.seconds == 0,
       "before the first step");
    n_free += 1 << 20;
    ok(spin_train(&o, &report) == SPIN_OK && spin_path_exists(output), "with more it goes on");

    spin_retrain_preset("quick", &o); /* no table, and splats share what they have */
    o.input = bundle;
    o.output = output;
    o.image_scale = 0.1;
    o.iterations = 1;
    o.force = true;
    n_free = 4 * (3 + 11) * sizeof(float) * 2940;
    ok(spin_train(&o, &report) == SPIN_OK, "without a network one frame's values are enough");
    n_free--;
    ok(spin_train(&o, &report) == SPIN_E_IO, "and less is not");
}
