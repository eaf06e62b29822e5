/* The library as a program uses it: import, open, read, evaluate, export, and what it says when
 * asked wrongly. Retraining is covered by tests/cli/t2*. K: api d3dgs */

#include <limits.h>

#include "spin_run.h"
#include "run/run.h"
#include "tests/check.h"
#include "tests/no_memory.h"
#include "tests/tap.h"

static char bundle[512], folder[600];

static void check_import(const char *run, const char *data)
{
    struct spin_import_options o = {.input = run, .output = bundle, .data = data};
    char *r;

    ok(spin_import(&o, &r) == SPIN_OK, "imports %s", run);
    ok(strstr(r, "\"from\": \"d3dgs\"") != NULL, "the importer was found");
    ok(check_report(r, "frames") == 6 && check_report(r, "splats.min") > 0 &&
           check_report(r, "splats.min") == check_report(r, "splats.max"),
       "six frames alike");
    free(r);
    ok(spin_import(&o, NULL) == SPIN_E_IO, "does not overwrite: %s", spin_last_error());
    o.force = true;
    o.plugin_pairs = (const char *const[]){"no-such-option", "1", NULL};
    ok(spin_import(&o, NULL) == SPIN_E_USAGE, "unknown option: %s", spin_last_error());
    o.plugin_pairs = NULL;
    o.n_frames = 3;
    ok(spin_import(&o, NULL) == SPIN_E_USAGE, "stored frames are not sampled: %s",
       spin_last_error());
}

/* A source of 4D splats, which the bundle stores rounded. */
static void check_precision(const char *run)
{
    char path[600];
    struct spin_import_options o = {.input = run, .output = path, .precision = 1};

    snprintf(path, sizeof path, "%s.4d", bundle);
    ok(spin_import(&o, NULL) == SPIN_OK, "imports %s with a precision: %s", run, spin_last_error());
    o.force = true;
    o.n_frames = 3;
    ok(spin_import(&o, NULL) == SPIN_E_USAGE && strstr(spin_last_error(), "--precision requires"),
       "sampled frames have none");
    o.n_frames = 0;
    o.positions_only = true;
    ok(spin_import(&o, NULL) == SPIN_E_USAGE && strstr(spin_last_error(), "--precision requires"),
       "nor have positions");
    o.positions_only = false;
    o.output = NULL;
    ok(spin_import(&o, NULL) == SPIN_E_USAGE && strstr(spin_last_error(), "--precision requires"),
       "nor has a description");
}

static void check_read(void)
{
    struct spin_scene *scene = NULL;
    struct spin_splats s = {0};

    ok(spin_scene_open(bundle, &scene) == SPIN_OK, "opens the bundle");
    ok(spin_scene_n_frames(scene) == 6 && !spin_scene_is_trained(scene), "six frames, no network");
    ok((spin_scene_columns(scene) & SPIN_COL_ATTRIBUTES) == SPIN_COL_ATTRIBUTES, "all attributes");
    ok(spin_scene_read(scene, 5, SPIN_FROM_BEST, SPIN_COL_MEANS | SPIN_COL_SH, &s) == SPIN_OK,
       "reads the last frame");
    ok(s.n == spin_scene_frame(scene, 5)->n && s.means && s.sh, "with the rows it announced");
    ok(spin_scene_read(scene, 0, SPIN_FROM_TRAINED, SPIN_COL_MEANS, &s) == SPIN_E_NOT_FOUND,
       "no network yet: %s", spin_last_error());
    spin_splats_free(&s);
    spin_scene_close(scene);
    ok(spin_scene_open("no/such.spin", &scene) != SPIN_OK, "no such bundle: %s", spin_last_error());
}

static void check_use(void)
{
    struct spin_eval_options e = {.input = bundle, .device = "cpu", .n_threads = 2};
    struct spin_export_options x = {
        .input = bundle, .output = folder, .to = "ply", .device = "cpu"};
    struct spin_eval_report er;
    struct spin_export_report xr;

    ok(spin_evaluate(&e, &er) == SPIN_OK && er.n_views == 12 && er.mean.valid && er.mean.psnr > 5,
       "evaluates 12 test views");
    spin_eval_report_free(&er);
    e.split = SPIN_SPLIT_ALL;
    ok(spin_evaluate(&e, &er) == SPIN_OK && er.n_views == 66, "or all 66");
    spin_eval_report_free(&er);
    e.split = SPIN_SPLIT_TRAIN;
    ok(spin_evaluate(&e, &er) == SPIN_OK && er.dynamic == SPIN_DYNAMIC_MASKS &&
           er.mean.dynamic > 0 && er.mean.dynamic < 0.5 && er.mean.psnr_dynamic > 5 &&
           er.mean.psnr_static > 5,
       "the training views have masks of what moves");
    ok(er.storage.source > 0 && er.storage.file > er.storage.source && er.storage.table == 0 &&
           er.seconds_decode > 0 && er.seconds_draw > 0,
       "storage and speed");
    spin_eval_report_free(&er);
    ok(spin_export_clip(&x, &xr) == SPIN_OK && xr.frames == 6, "exports six frames");
    x.to = "nothing";
    ok(spin_export_clip(&x, &xr) == SPIN_E_USAGE, "unknown exporter: %s", spin_last_error());
}

/* Opens and reads; a failure is followed by another read of the same scene. */
static spin_status read_twice(void *path)
{
    struct spin_scene *scene = NULL;
    struct spin_splats s = {0};
    spin_status status;

    SPIN_TRY(spin_scene_open(path, &scene));
    status = spin_scene_read(scene, 0, SPIN_FROM_TRAINED, SPIN_COL_MEANS | SPIN_COL_SH, &s);
    if (status == SPIN_E_MEMORY && (spin_scene_read(scene, 0, SPIN_FROM_TRAINED,
                                                    SPIN_COL_MEANS | SPIN_COL_SH, &s) != SPIN_OK ||
                                    s.n == 0))
        status = SPIN_E_MALFORMED;
    else if (status == SPIN_E_MEMORY)
        spin_fail(SPIN_E_MEMORY, "not enough memory");
    spin_splats_free(&s);
    spin_scene_close(scene);
    return status;
}

static void check_no_memory(void)
{
    struct spin_retrain_options o;
    char out[560], *r = NULL;

    snprintf(out, sizeof out, "%s.trained.spin", bundle);
    spin_retrain_preset("paper", &o);
    o.input = bundle;
    o.output = out;
    o.device = "cpu";
    o.iterations = 1;
    o.warmup = 0;
    o.levels = 4;
    o.hash_log2 = 10;
    o.hidden = 16;
    ok(spin_retrain(&o, &r) == SPIN_OK, "trains one step: %s", spin_last_error());
    free(r);
    without_memory(read_twice, out, "reading a scene", LONG_MAX);
    remove(out);
}

TAP_MAIN
{
    const char *run = check_fixture("d3dgs/trained"),
               *data = check_fixture("datasets/panoptic_mini");

    if (!run || !data) {
        skip("api", "no fixtures d3dgs/trained and datasets/panoptic_mini");
        return;
    }
    spin_set_verbosity(-1);
    snprintf(bundle, sizeof bundle, "%s/ball.spin", check_folder());
    snprintf(folder, sizeof folder, "%s.frames", bundle);
    check_import(run, data);
    check_precision(check_fixture("realtime4dgs/rot4d_noshfs"));
    check_read();
    check_use();
    check_no_memory();
}
