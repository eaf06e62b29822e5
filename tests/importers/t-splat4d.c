/* .splat4d of splats4D compared with its viewer.
 * K: splat4d import */
#include "io/compress.h"
#include "tests/importers/models.h"

#define C0 0.28209479177387814

static double in_bytes(double x) { return rint(255 * x); }
static double colour(double dc) { return in_bytes(0.5 + C0 * dc); }
static double opacity(double logit) { return in_bytes(sigmoid(logit)); }

/* Frame f, taken from arrays of all frames. */
static void compare_frame(const struct expected *e, size_t f, const struct spin_splats *s)
{
    struct expected whole = {e->npz, 0, 0, e->name};
    float *scales = map_values(s->log_scales, 3 * s->n, exp);
    float *colours = map_values(s->sh, 3 * s->n, colour), *rgba = malloc(4 * s->n * sizeof *rgba);
    float *opacities = map_values(s->logit_opacities, s->n, opacity);

    for (size_t i = 0; i < s->n; i++) {
        memcpy(rgba + 4 * i, colours + 3 * i, 3 * sizeof *rgba);
        rgba[4 * i + 3] = opacities[i];
    }
    compare(e, "xyz", 3 * s->n * f, 3 * s->n, s->means);
    compare(e, "scale", 3 * s->n * f, 3 * s->n, scales);
    compare_quats(e, "rot", 4 * s->n * f, s->n, s->quats);
    compare(&whole, "rgba", 4 * s->n * f, 4 * s->n, rgba);
    free(scales);
    free(colours);
    free(opacities);
    free(rgba);
}

static void test_fixture(const char *folder, const char *name)
{
    const char *file = file_in(folder, ".splat4d");
    const struct spin_importer *found = NULL;
    struct expected e = {.name = name};
    struct spin_splats s = {0};
    struct spin_array info;
    struct spin_npz npz;
    struct bound allowed;
    double *times;
    struct run run;
    int n_same = 0;

    bounds_of = folder;
    allowed = bound("xyz, scale, rot");
    e.abs = allowed.abs;
    e.rel = allowed.rel;
    e.npz = &npz;
    if (!ok(run_open(NULL, folder, &run) == SPIN_OK && !strcmp(run.importer->name, "splat4d") &&
                spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK,
            "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    times = check_load(&npz, "times", &info);
    ok(times && run.sequence.n_frames == (int)info.count && run.sequence.identity &&
           !run.sequence.continuous && run.sequence.sh_degree == 0 &&
           fabs(run.sequence.fps * times[1] - 1) < 1e-9,
       "%s: %d frames, all of the same splats", name, run.sequence.n_frames);
    for (int f = run.sequence.n_frames; times && f-- > 0;) { /* backwards: in any order */
        n_same += fabs(run.sequence.times[f] - times[f]) < 1e-12;
        if (ok(run.importer->frame(run.self, f, 0, run.sequence.columns, &s) == SPIN_OK &&
                   s.n == run.sequence.counts[f],
               "%s: frame %d", name, f))
            compare_frame(&e, (size_t)f, &s);
    }
    ok(n_same == run.sequence.n_frames, "%s: times in seconds", name);
    ok(strstr(run.sequence.notes, "view-dependent colour") &&
           !strstr(run.sequence.notes, "smoothed"),
       "%s: what the format lacks", name);
    ok(spin_importer_find(file, NULL, false, &found) == SPIN_OK && found == run.importer,
       "%s: the file alone is recognised", name);
    ok(read_truncations("splat4d", file) == 0, "%s: no truncation can be read", name);
    free(times);
    run_close(&run);
    spin_npz_close(&npz);
    spin_splats_free(&s);
}

static void test_refused(const char *file)
{
    const char *folder = new_folder(), *unity = path_in(folder, "unity.splat4d");
    const char *two = new_folder(), *renamed = path_in(two, "clip.bin");
    const struct spin_importer *found = NULL;
    struct spin_map map;
    struct spin_out out;
    FILE *flags;
    struct run run;

    write_text(unity, "SPL4DV02 and what else that format has");
    model_fails(NULL, unity, NULL, "unity.splat4d", "gsplat-unity (version 2)",
                "the format of the Unity package is refused by name");
    write_text(path_in(folder, "rows.splat4d"), "rows of 64 bytes");
    model_fails(NULL, path_in(folder, "rows.splat4d"), NULL, "rows.splat4d", "gsplat-unity",
                "its version without a header may be meant");
    model_fails(NULL, folder, NULL, folder, "2 clips", "a folder with two clips");
    copy_file(file, path_in(folder, "flags.splat4d"));
    flags = fopen(path_in(folder, "flags.splat4d"), "r+b");
    ok(flags && fseek(flags, 7, SEEK_SET) == 0 && fputc(0x80, flags) == 0x80 && fclose(flags) == 0,
       "sets a flag");
    model_fails(NULL, path_in(folder, "flags.splat4d"), NULL, "flags.splat4d", "flags 80",
                "a flag that is unknown");
    copy_file(file, renamed);
    ok(spin_importer_find(renamed, NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "splat4d"),
       "a clip of another name is recognised by its first bytes");
    if (spin_map_open(file, &map) != SPIN_OK || spin_out_open(renamed, true, &out) != SPIN_OK ||
        spin_out_write(&out, map.data, 6) != SPIN_OK || spin_out_write(&out, "\1", 1) != SPIN_OK ||
        spin_out_write(&out, map.data + 7, map.size - 7) != SPIN_OK ||
        spin_out_commit(&out) != SPIN_OK)
        exit(1);
    spin_map_close(&map);
    ok(run_open(NULL, renamed, &run) == SPIN_OK && strstr(run.sequence.notes, "smoothed in time"),
       "one whose colours were smoothed says so");
    run_close(&run);
}

TAP_MAIN
{
    const char **names = check_cases("splat4d", "expected.npz"), *root = check_fixture("splat4d");

    spin_log_set_level(-1);
    if (!root || spin_zstd_need() != SPIN_OK) {
        skip("splat4d", root ? spin_last_error() : "there are no fixtures");
        free(names);
        return;
    }
    for (size_t i = 0; names[i]; i++)
        test_fixture(path_in(root, names[i]), names[i]);
    test_refused(file_in(path_in(root, names[0]), ".splat4d"));
    free(names);
}
