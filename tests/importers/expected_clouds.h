/* Clouds of one frame or more against expected.npz, which holds finished attributes: <frame>_means, ... */
#ifndef SPIN_TESTS_IMPORTERS_EXPECTED_CLOUDS_H
#define SPIN_TESTS_IMPORTERS_EXPECTED_CLOUDS_H

#include "tests/importers/runs.h"

static inline void compare_sh(const struct expected *e, const char *dc, const char *rest,
                              const struct spin_splats *s)
{
    size_t k = (size_t)((s->sh_degree + 1) * (s->sh_degree + 1)), n_rest = 0;
    struct spin_array info;
    float *first = malloc(3 * s->n * sizeof *first + 1), *others;
    double *want = check_load(e->npz, rest, &info), extra = 0;

    if (want && info.n_dims == 3)
        n_rest = info.shape[1];
    if (!want || !ok(n_rest < k, "%s: enough SH coefficients", e->name)) {
        free(first);
        free(want);
        return;
    }
    others = malloc(3 * s->n * n_rest * sizeof *others + 1);
    for (size_t i = 0; i < s->n; i++) {
        const float *sh = s->sh + 3 * k * i;

        memcpy(first + 3 * i, sh, 3 * sizeof *sh);
        memcpy(others + 3 * n_rest * i, sh + 3, 3 * n_rest * sizeof *sh);
        for (size_t c = 3 * (1 + n_rest); c < 3 * k; c++)
            extra += fabs(sh[c]);
    }
    compare(e, dc, 0, 3 * s->n, first);
    compare(e, rest, 0, 3 * s->n * n_rest, others);
    if (1 + n_rest < k)
        ok(extra == 0, "%s: coefficients beyond its degree are 0", e->name);
    free(first);
    free(others);
    free(want);
}

/* index: of expected.npz's keys. */
static inline void compare_splats(const struct expected *e, double quats_abs, int index,
                                  const struct spin_splats *s)
{
    struct expected quats = *e;
    float *scales = map_values(s->log_scales, 3 * s->n, exp);
    float *opacities = map_values(s->logit_opacities, s->n, sigmoid);
    char key[6][40];

    quats.abs = fmax(e->abs, quats_abs);
    snprintf(key[0], 40, "%04d_means", index);
    snprintf(key[1], 40, "%04d_quats_wxyz", index);
    snprintf(key[2], 40, "%04d_scales", index);
    snprintf(key[3], 40, "%04d_opacities", index);
    snprintf(key[4], 40, "%04d_sh_dc", index);
    snprintf(key[5], 40, "%04d_sh_rest", index);
    compare(e, key[0], 0, 3 * s->n, s->means);
    compare_quats(&quats, key[1], 0, s->n, s->quats);
    compare(e, key[2], 0, 3 * s->n, scales);
    compare(e, key[3], 0, s->n, opacities);
    compare_sh(e, key[4], key[5], s);
    free(scales);
    free(opacities);
}

/* expected.npz counts frames from 0, or by the files' numbers where those have gaps. */
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
        struct expected e = {&npz, fmax(manifest_tolerance(manifest, "abs", 2e-6), at_least),
                             manifest_tolerance(manifest, "rel", 2e-5), what};

        snprintf(what, sizeof what, "%s, frame %d", name, f);
        if (ok(run.importer->frame(run.self, f, 0, run.sequence.columns, &s) == SPIN_OK &&
                   s.n == run.sequence.counts[f],
               "%s: reads", what))
            compare_splats(&e, manifest_tolerance(manifest, "quats", 0),
                           expected_index(&npz, &run, f), &s);
        else
            printf("#   %s\n", spin_last_error());
    }
    spin_splats_free(&s);
    spin_npz_close(&npz);
    run_close(&run);
}

#endif
