/* Compares clouds of one or more frames with expected.npz, which contains activated attributes:
 * <frame>_means, ... */
#ifndef SPIN_TESTS_IMPORTERS_EXPECTED_CLOUDS_H
#define SPIN_TESTS_IMPORTERS_EXPECTED_CLOUDS_H

#include "tests/importers/golden.h"

/* Compares rows [first, first + n) with the arrays of this prefix; rest: the tolerance of arrays
 * without one of their own. */
static inline void compare_cloud(struct spin_npz *npz, const char *prefix,
                                 const struct spin_splats *s, size_t first, size_t n, double abs,
                                 double rel, double quats_abs, bool still, const char *name)
{
    static const struct golden_array arrays[] = {
        {.key = "means", .kind = MEANS},   {.key = "quats_wxyz", .kind = QUATS},
        {.key = "sh_dc", .kind = SH},      {.key = "sh_rest", .kind = SH_REST},
        {.key = "scales", .kind = SCALES}, {.key = "opacities", .kind = OPACITIES},
    };
    size_t *row = malloc((s->n + 1) * sizeof *row);
    struct golden_now now = {
        .npz = npz, .prefix = prefix, .n_all = n, .row = row, .s = s, .name = name};

    for (size_t i = 0; i < s->n; i++)
        row[i] = i >= first && i < first + n ? i - first : NOWHERE;
    for (size_t k = 0; k < (still ? 6 : 4); k++) {
        struct golden_array a = arrays[k];

        a.bound = "";
        a.abs = a.kind == QUATS ? fmax(abs, quats_abs) : abs;
        a.rel = rel;
        golden_compare(&now, &a);
    }
    free(row);
}

/* expected.npz counts frames from 0, or uses the numbers of the files if these have gaps. */
static inline int expected_index(const struct spin_npz *npz, const struct run *run, int frame)
{
    bool by_number = run->sequence.numbers != NULL;
    char key[40];

    for (int f = 0; by_number && f < run->sequence.n_frames; f++) {
        snprintf(key, sizeof key, "%04d_means", run->sequence.numbers[f]);
        by_number = spin_npz_has(npz, key);
    }
    return by_number ? run->sequence.numbers[frame] : frame;
}

static inline void compare_run(const char *from, const char *path, const char *expected,
                               const spin_json *manifest, double at_least, const char *name)
{
    struct spin_splats s = {0};
    struct spin_npz npz;
    struct run run;
    char what[200];

    if (!ok(run_open(from, path, &run) == SPIN_OK, "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    if (!ok(spin_npz_open(expected, &npz) == SPIN_OK, "%s: has expected.npz", name)) {
        run_close(&run);
        return;
    }
    for (int f = 0; f < run.sequence.n_frames; f++) {
        char prefix[16];

        snprintf(prefix, sizeof prefix, "%04d_", expected_index(&npz, &run, f));
        snprintf(what, sizeof what, "%s, frame %d", name, f);
        if (ok(run.importer->frame(run.self, f, 0, run.sequence.columns, &s) == SPIN_OK &&
                   s.n == run.sequence.counts[f],
               "%s: reads", what))
            compare_cloud(&npz, prefix, &s, 0, s.n,
                          fmax(manifest_tolerance(manifest, "abs", 2e-6), at_least),
                          manifest_tolerance(manifest, "rel", 2e-5),
                          manifest_tolerance(manifest, "quats", 0), true, what);
        else
            printf("#   %s\n", spin_last_error());
    }
    spin_splats_free(&s);
    spin_npz_close(&npz);
    run_close(&run);
}

#endif
