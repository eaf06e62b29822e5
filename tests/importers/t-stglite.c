/* stglite: range of times, the three layouts and malformed files. t-golden.c compares the
 * values.
 * K: stglite ply import 4d */
#include "tests/importers/edits.h"

#define FROM "stglite"
#define FILE_OF "scene.ply"

static void test_times(const char *model)
{
    const char *path = path_in(model, FILE_OF);
    struct run run;

    ok(run_open(NULL, path, &run) == SPIN_OK && !strcmp(run.importer->name, FROM) &&
           run.sequence.n_clip_frames == 60 && run.sequence.fps == 30 &&
           run.sequence.time_first == 0 && fabs(run.sequence.time_last - 59 / 30.0) < 1e-12,
       "60 frames of 30 a second, from the comment");
    run_close(&run);
    ok(model_open(NULL, path, (const char *[]){"time-range", "0.5,1.5", NULL}, &run) == SPIN_OK &&
           run.sequence.n_clip_frames == 0 && run.sequence.time_first == 0.5 &&
           run.sequence.time_last == 1.5,
       "--time-range overrides the comment");
    run_close(&run);
    path = with_line(path, "start=0 duration=2", "start=1.5 duration 2");
    ok(run_open(NULL, path, &run) == SPIN_OK && run.sequence.time_first == 1.5 &&
           run.sequence.n_clip_frames == 60,
       "a start, and a key without '='");
    run_close(&run);
    path = with_line(path, "fps=", "fqs=");
    ok(run_open(NULL, path, &run) == SPIN_OK && strstr(run.sequence.notes, "--time-range"),
       "a range that is guessed is noted");
    run_close(&run);
    model_fails(NULL, path, (const char *[]){"time-range", "1,1", NULL}, NULL, "expected A,B",
                "an empty range");
}

/* The same splats for OpenSplat4D, with a centre and a width of 0 and ln 1 unless edited. */
#define OPEN "drop trbf_center; drop trbf_scale; put t; put scale_t; "

static const struct spin_splats_4d *open_edited(const char *model, const char *edits,
                                                const char *const *pairs, struct run *run)
{
    const struct spin_splats_4d *s = NULL;
    spin_status status =
        model_open(NULL, path_in(edited(model, FILE_OF, edits), FILE_OF), pairs, run);

    if (status != SPIN_OK || strcmp(run->importer->name, FROM) != 0 ||
        run->importer->splats_4d(run->self, &s) != SPIN_OK)
        printf("# %s\n", spin_last_error());
    return s;
}

static void test_layouts(const char *model)
{
    static const char *const super[] = {"dialect", "supersplat4d", NULL};
    static const char *const open[] = {"dialect", "opensplat4d", NULL};
    static const char *const tsog[] = {"dialect", "tsog", NULL};
    static const char *const odd[] = {"dialect", "other", NULL};
    const struct spin_splats_4d *s;
    const char *both;
    struct run run;

    s = open_edited(model, OPEN "set scale_t * 0.5; set t * 0.25", NULL, &run);
    ok(s && s->degree == 1 && fabs((double)s->sigmas[0] - exp(0.5)) < 1e-6 && s->times[0] == 0.25f,
       "OpenSplat4D: sigma is the exponential itself");
    run_close(&run);
    s = open_edited(model, OPEN "drop scale_t", NULL, &run);
    ok(s && s->sigmas[0] == SPIN_FOREVER, "OpenSplat4D: without a width, splats are permanent");
    run_close(&run);
    s = open_edited(model, OPEN "drop t", NULL, &run);
    ok(s && s->times[0] == 0, "OpenSplat4D: without a centre, it is 0");
    run_close(&run);
    s = open_edited(model, OPEN "drop motion_ 0 2", NULL, &run);
    ok(s && s->degree == 0, "OpenSplat4D: splats may rest");
    run_close(&run);
    s = open_edited(model,
                    OPEN "put motion_3; put motion_4; put motion_5; put motion_6; "
                         "put motion_7; put motion_8",
                    NULL, &run);
    ok(s && s->degree == 1, "OpenSplat4D: powers of the time above the first are ignored");
    run_close(&run);
    s = open_edited(model, OPEN "drop scale_t; put t_scale", NULL, &run);
    ok(s && run.sequence.time_first == 0 && run.sequence.time_last == 1,
       "the columns of TSOG: times from 0 to 1");
    run_close(&run);
    both = path_in(edited(model, FILE_OF, "put t; put scale_t; set scale_t * 0.5"), FILE_OF);
    model_fails(NULL, both, NULL, FILE_OF, "--dialect", "two layouts in one file");
    model_fails(NULL, both, tsog, FILE_OF, "of dialect tsog", "a layout that it lacks");
    model_fails(NULL, both, odd, NULL, "dialect", "a layout that does not exist");
    ok(model_open(NULL, both, open, &run) == SPIN_OK &&
           run.importer->splats_4d(run.self, &s) == SPIN_OK &&
           fabs((double)s->sigmas[0] - exp(0.5)) < 1e-6,
       "and one of them");
    run_close(&run);
    ok(model_open(NULL, both, super, &run) == SPIN_OK && strstr(run.sequence.variant, "SuperSplat"),
       "and the other");
    run_close(&run);
}

static void test_rows(const char *model)
{
    struct run run;
    const struct spin_splats_4d *s =
        open_edited(model,
                    "set motion_0 0 nan; set rot_0 1 0; set rot_1 1 0; set rot_2 1 0; "
                    "set rot_3 1 0; set opacity 2 inf; set trbf_scale 3 -200; "
                    "set trbf_scale 4 200; set trbf_center 5 nan",
                    NULL, &run);

    ok(s && s->n == 147 && strstr(run.sequence.notes, "3 of 150 Gaussians are dropped"),
       "rows with NaN or without a rotation are dropped and counted");
    ok(s && s->logit_opacities[0] == 30, "an infinite logit is opaque");
    ok(s && fabs((double)s->sigmas[1] - 1e-6 / sqrt(2)) < 1e-12 && s->sigmas[2] == SPIN_FOREVER,
       "the narrowest and the widest window");
    run_close(&run);
}

static void test_lies(const char *model)
{
    static const struct lie lies[] = {
        {FILE_OF, "drop trbf_scale", "'trbf_scale'", "half a window"},
        {FILE_OF, "drop trbf_center", "'trbf_center'", "the other half"},
        {FILE_OF, "drop trbf_center; drop trbf_scale", "no time property", "no window"},
        {FILE_OF, "drop motion_1", "2 properties motion_*", "half a velocity"},
        {FILE_OF, "put motion_3", "4 properties motion_*", "a path beyond the velocity"},
        {FILE_OF, "drop motion_ 0 2", "0 properties motion_*", "no velocity"},
        {FILE_OF, "put rot_4", "'rot_4'", "a second quaternion"},
        {FILE_OF, "put scale_3", "'scale_3'", "a fourth scale"},
        {FILE_OF, "drop f_dc_1", "'f_dc_1'", "no green"},
        {FILE_OF, "drop f_rest_3", "f_rest_3", "SH with a hole"},
        {FILE_OF, "drop y", "'y'", "no y"},
        {FILE_OF, "set x * nan", "none of the 150", "no row that is finite"},
        {FILE_OF, "rows 0", "0 vertices", "no rows"},
    };

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++)
        model_fails(FROM, path_in(edited(model, FILE_OF, lies[i].edits), FILE_OF), NULL, FILE_OF,
                    lies[i].word, lies[i].what);
    ok(read_truncations(FROM, path_in(model, FILE_OF)) == 0, "no truncation can be read");
    survive_flips(FROM, path_in(model, FILE_OF));
}

TAP_MAIN
{
    const char *model = check_fixture("stglite/supersplat4d_sh1");

    spin_log_set_level(-2);
    if (!model) {
        skip("stglite fixtures", "there are none here");
        return;
    }
    test_times(model);
    test_layouts(model);
    test_rows(model);
    test_lies(model);
}
