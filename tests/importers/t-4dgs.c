/* .4dgs compared with the format's own reader.
 * K: 4dgs import */
#include "tests/importers/models.h"

#define C0 0.28209479177387814

static double colour(double dc) { return 0.5 + C0 * dc; }
static double code(double sh) { return (sh + 4) * 255 / 8; }

static void compare_colours(const struct expected *e, const struct spin_splats_4d *s)
{
    size_t k = (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    float *rgba = malloc(4 * s->n * sizeof *rgba), *codes = malloc(3 * k * s->n * sizeof *codes);
    struct expected steps = {e->npz, 1e-4, 0, e->name};

    for (size_t i = 0; i < s->n; i++) {
        const float *sh = s->sh + 3 * k * i;

        for (size_t c = 0; c < 3; c++) {
            rgba[4 * i + c] = (float)colour((double)sh[c]);
            for (size_t m = 1; m < k; m++)
                codes[3 * (k - 1) * i + (k - 1) * c + m - 1] = (float)code((double)sh[3 * m + c]);
        }
        rgba[4 * i + 3] = (float)sigmoid((double)s->logit_opacities[i]);
    }
    compare(e, "rgba", 0, 4 * s->n, rgba);
    if (k > 1)
        compare(&steps, "sh_bytes", 0, 3 * (k - 1) * s->n, codes);
    free(rgba);
    free(codes);
}

/* Infinite sigmas, and windows, which may only be narrower than those of the file, since chunks
 * clip them too. */
static void compare_windows(const struct expected *e, const struct spin_splats_4d *s)
{
    struct spin_array info;
    double *sigma = check_load(e->npz, "sigma_t", &info);
    double *lo = check_load(e->npz, "win_lo", &info), *hi = check_load(e->npz, "win_hi", &info);
    size_t n_sigmas = 0, n_windows = 0;

    for (size_t i = 0; sigma && lo && hi && info.count == s->n && i < s->n; i++) {
        double is = (double)s->sigmas[i], margin = e->abs + e->rel * fabs(lo[i]);

        n_sigmas += isinf(sigma[i]) ? s->sigmas[i] == SPIN_FOREVER
                                    : fabs(is - sigma[i]) <= e->abs + e->rel * sigma[i];
        n_windows +=
            (double)s->cuts[2 * i] >= lo[i] - margin && (double)s->cuts[2 * i + 1] <= hi[i];
    }
    ok(n_sigmas == s->n, "%s: sigma_t", e->name);
    ok(n_windows == s->n, "%s: windows", e->name);
    free(sigma);
    free(lo);
    free(hi);
}

static void compare_rows(const struct expected *e, const struct spin_splats_4d *s)
{
    float *scales = map_values(s->log_scales, 3 * s->n, exp);
    float *xyzw = malloc(4 * s->n * sizeof *xyzw);

    for (size_t i = 0; i < s->n; i++)
        for (size_t c = 0; c < 4; c++)
            xyzw[4 * i + c] = s->quats[4 * i + (c + 1) % 4];
    compare(e, "centre", 0, 3 * s->n, s->centres);
    compare(e, "scale", 0, 3 * s->n, scales);
    compare_quats(e, "rot_xyzw", 0, s->n, xyzw);
    compare(e, "velocity", 0, 3 * s->n, s->paths);
    compare(e, "mu_t", 0, s->n, s->times);
    compare_colours(e, s);
    compare_windows(e, s);
    free(scales);
    free(xyzw);
}

/* The slice at `time`, of which row t of the expected arrays has all rows of the file. */
static void compare_slice(const struct expected *e, struct run *run, double time, size_t t,
                          size_t n_all)
{
    struct spin_array info;
    double *visible = check_load(e->npz, "visible", &info);
    double *xyz = check_load(e->npz, "xyz", &info), *opacity = check_load(e->npz, "opacity", &info);
    struct spin_splats s = {0};
    size_t k = 0, n_good = 0;

    if (!visible || !xyz || !opacity || info.count < n_all * (t + 1) ||
        !ok(run->importer->frame(run->self, 0, time, run->sequence.columns, &s) == SPIN_OK,
            "%s: time %g", e->name, time)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    for (size_t i = 0; i < n_all; i++) {
        double *want = xyz + 3 * (n_all * t + i), o = opacity[n_all * t + i], worst = 0;

        if (visible[n_all * t + i] == 0)
            continue;
        for (size_t c = 0; c < 3 && k < s.n; c++)
            worst =
                larger(worst, fabs((double)s.means[3 * k + c] - want[c]) - e->rel * fabs(want[c]));
        n_good += k < s.n && worst <= e->abs &&
                  fabs(sigmoid((double)s.logit_opacities[k]) - o) <= e->abs + e->rel * o;
        k++;
    }
    ok(k == s.n && n_good == k, "%s: %zu splats at time %g", e->name, k, time);
    if (k != s.n || n_good != k)
        printf("#   %zu are read, %zu as they should be\n", s.n, n_good);
    spin_splats_free(&s);
    free(visible);
    free(xyz);
    free(opacity);
}

static void test_fixture(const char *folder, const char *name)
{
    const char *file = file_in(folder, ".4dgs");
    const struct spin_importer *found = NULL;
    const struct spin_splats_4d *s = NULL;
    struct expected e = {.name = name};
    spin_json *manifest = load_manifest(folder);
    double duration = NAN, *times;
    struct spin_array info;
    struct bound allowed;
    struct spin_npz npz;
    struct run run;

    bounds_of = folder;
    allowed = bound("all");
    e = (struct expected){&npz, allowed.abs, allowed.rel, name};
    spin_json_number(spin_json_get(manifest, "duration"), &duration);
    spin_json_free(manifest);
    if (!ok(run_open(NULL, folder, &run) == SPIN_OK && !strcmp(run.importer->name, "4dgs") &&
                run.importer->splats_4d(run.self, &s) == SPIN_OK && s &&
                spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK,
            "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    compare_rows(&e, s);
    times = check_load(&npz, "times", &info);
    for (size_t t = 0; times && t < info.count; t++)
        compare_slice(&e, &run, times[t], t, s->n);
    ok(run.sequence.continuous && !run.sequence.half_open && run.sequence.time_first == 0 &&
           run.sequence.fps == 30 && run.sequence.n_clip_frames == rint(30 * duration) &&
           fabs(duration - 1 / 30.0 - run.sequence.time_last) < 1e-9 &&
           strstr(run.sequence.notes, "does not store its frame rate"),
       "%s: 30 frames a second, the last before %g", name, duration);
    ok(strstr(run.sequence.notes, "window is at least ") &&
           strstr(run.sequence.notes, "clamps colours"),
       "%s: what differs is said", name);
    ok(spin_importer_find(file, NULL, false, &found) == SPIN_OK && found == run.importer,
       "%s: the file alone is recognised", name);
    ok(read_truncations("4dgs", file) == 0, "%s: no truncation can be read", name);
    free(times);
    run_close(&run);
    spin_npz_close(&npz);
}

static void test_refused(const char *file)
{
    const char *folder = new_folder(), *renamed = path_in(new_folder(), "scene.bin");
    const struct spin_importer *found = NULL;

    write_text(path_in(folder, "a.4dgs"), "");
    model_fails(NULL, path_in(folder, "a.4dgs"), NULL, "a.4dgs", "version 1", "an empty file");
    write_text(path_in(folder, "b.4dgs"), "\x89"
                                          "4DGS2\r\nand what version 2 has");
    model_fails(NULL, path_in(folder, "b.4dgs"), NULL, "b.4dgs", "version 1", "another version");
    model_fails(NULL, folder, NULL, folder, "2 clips", "a folder with two scenes");
    copy_file(file, renamed);
    ok(spin_importer_find(renamed, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "4dgs"),
       "a scene of another name is recognised by its first bytes");
}

static size_t length_at(const unsigned char *record)
{
    uint64_t n;

    memcpy(&n, record + 1, sizeof n);
    return 9 + (size_t)n;
}

/* Inserts an entry of the index before the last delta. */
static void test_late_chunk(const char *file)
{
    const char *late = path_in(new_folder(), "late.4dgs");
    struct spin_map map = {0};
    size_t delta = 0, index = 0;
    FILE *f = fopen(late, "wb");

    if (!ok(f && spin_map_open(file, &map) == SPIN_OK, "%s: opens", file))
        return;
    for (size_t at = 8; index == 0 && at + 17 < map.size; at += length_at(map.data + at)) {
        delta = map.data[at] == 0x10 ? at : delta;
        index = map.data[at] == 8 ? at : 0;
    }
    fwrite(map.data, 1, delta, f);
    fwrite(map.data + index, 1, length_at(map.data + index), f);
    fwrite(map.data + delta, 1, map.size - 12 - delta, f);
    fwrite("\0\0\0", 1, 4, f); /* no checksum */
    fwrite(map.data + map.size - 8, 1, 8, f);
    fclose(f);
    spin_map_close(&map);
    model_fails(NULL, late, NULL, "record 10 at byte", "follows the index", "a delta behind it");
}

/* The sound of an input, whose data are those of a file. */
static void test_sound(const char *root)
{
    const char *folder = path_in(root, "birth_sound");
    struct spin_map want = {0};
    struct run run;

    if (!spin_path_exists(folder)) {
        skip("birth_sound", "no fixture");
        return;
    }
    ok(run_open(NULL, path_in(folder, "scene.4dgs"), &run) == SPIN_OK &&
           spin_map_open(path_in(folder, "source_3.wav"), &want) == SPIN_OK && run.sequence.sound &&
           run.sequence.sound->size == want.size &&
           memcmp(run.sequence.sound->data, want.data, want.size) == 0 &&
           strcmp(run.sequence.sound->name, "bed") == 0 && run.sequence.sound->gain == 0.5,
       "birth_sound: the sound without a place, byte for byte");
    spin_map_close(&want);
    run_close(&run);
}

TAP_MAIN
{
    const char **names = check_cases("4dgs", "expected.npz"), *root = check_fixture("4dgs");

    spin_log_set_level(-1);
    for (size_t i = 0; root && names[i]; i++)
        /* t-golden.c compares those without values of rows. */
        if (strcmp(names[i], "birth_sound") != 0 && strcmp(names[i], "keyframe_chained") != 0)
            test_fixture(path_in(root, names[i]), names[i]);
    if (root) {
        test_sound(root);
        test_late_chunk(path_in(root, "keyframe_chained/scene.4dgs"));
    }
    if (root && names[0])
        test_refused(file_in(path_in(root, names[0]), ".4dgs"));
    else
        skip("4dgs", "there are no fixtures");
    free(names);
}
