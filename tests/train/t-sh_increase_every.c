/* SH degrees that are added one after the other: exactly zero before, trained afterwards; and
 * the degree of every iteration.
 * K: retrain sh */
#include "train/step.h"

#include "spin_run.h"
#include "run/run.h"
#include "tests/check.h"
#include "tests/tap.h"

static char in[600], out[600];

/* Largest coefficient of degrees first..last in the network's first frame. */
static float largest(int first, int last)
{
    struct spin_scene *scene = NULL;
    struct spin_splats s = {0};
    float most = 0;

    if (spin_scene_open(out, &scene) != SPIN_OK ||
        spin_scene_read(scene, 0, SPIN_FROM_TRAINED, SPIN_COL_SH, &s) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < s.n; i++)
        for (int k = first * first; k < (last + 1) * (last + 1); k++)
            for (size_t c = 0; c < 3; c++) {
                size_t row = (size_t)(s.sh_degree + 1) * (size_t)(s.sh_degree + 1);

                most = larger(most, fabsf(s.sh[(i * row + (size_t)k) * 3 + c]));
            }
    spin_splats_free(&s);
    spin_scene_close(scene);
    return most;
}

static bool retrain(int every, int iterations)
{
    struct spin_retrain_options o;
    struct spin_retrain_report r;

    spin_retrain_preset("paper", &o);
    o.input = in;
    o.output = out;
    o.device = "cpu";
    o.n_threads = 2;
    o.iterations = iterations;
    o.warmup = 0;
    o.levels = 4;
    o.hash_log2 = 10;
    o.hidden = 16;
    o.sh_degree = 2;
    o.finest_resolution[0] = o.finest_resolution[1] = o.finest_resolution[2] = 32;
    o.sh_increase_every = every;
    o.force = true;
    return spin_train(&o, &r) == SPIN_OK;
}

static void check_degrees(void)
{
    struct spin_trainer t = {.field.sh_degree = 3, .sh_increase_every = 10, .network = &t.field};
    int64_t iteration[] = {0, 1, 10, 11, 20, 21, 30, 31, 1000};
    int want[] = {0, 0, 0, 1, 1, 2, 2, 3, 3}, good = 1;

    for (int i = 0; i < 9; i++) {
        t.iteration = iteration[i];
        good &= spin_trainer_sh_degree(&t) == want[i];
    }
    ok(good, "degree 0 for ten steps, then one more every ten");
    t.sh_increase_every = 0;
    t.iteration = 1;
    ok(spin_trainer_sh_degree(&t) == 3, "or all from the start");
}

TAP_MAIN
{
    const char *run = check_fixture("d3dgs/trained");
    const char *data = check_fixture("datasets/panoptic_mini"), *folder = check_folder();
    struct spin_import_options o = {.output = in};

    check_degrees();
    if (!run || !data) {
        skip("degrees of SH in a run", "no fixtures");
        return;
    }
    spin_set_verbosity(-1);
    snprintf(in, sizeof in, "%s/in.spin", folder);
    snprintf(out, sizeof out, "%s/out.spin", folder);
    o.input = run;
    o.data = data;
    if (spin_import(&o, NULL) != SPIN_OK)
        exit(1);
    ok(retrain(0, 4) && largest(1, 2) > 1e-2f, "without: coefficients are there at once");
    ok(retrain(4, 4) && largest(1, 2) == 0 && largest(0, 0) > 0, "none but the first has joined");
    ok(retrain(4, 8) && largest(1, 1) > 0 && largest(2, 2) == 0, "the next has");
    ok(retrain(2, 8) && largest(2, 2) > 0, "all have");
}
