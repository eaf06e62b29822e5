/* What the tests of Grid4D and DASH share: a model against its fixture, copies with another
 * network. */
#ifndef SPIN_TESTS_IMPORTERS_HASHFIELDS_H
#define SPIN_TESTS_IMPORTERS_HASHFIELDS_H

#include "math/covariance.h"
#include "tests/importers/models.h"

static inline float *covariances(const struct spin_splats *s)
{
    float *out = malloc(6 * s->n * sizeof *out + 1);

    for (size_t i = 0; i < s->n; i++) {
        double scale[3], quat[4], cov6[6];

        for (int c = 0; c < 3; c++)
            scale[c] = exp(s->log_scales[3 * i + (size_t)c]);
        for (int c = 0; c < 4; c++)
            quat[c] = s->quats[4 * i + (size_t)c];
        spin_covariance_of(scale, quat, cov6);
        for (int c = 0; c < 6; c++)
            out[6 * i + (size_t)c] = (float)cov6[c];
    }
    return out;
}

static inline void compare_hash_time(struct spin_npz *npz, int index, const char *name,
                                     const struct spin_splats *s)
{
    struct spin_array info;
    double *want = check_load(npz, "xyz", &info), extent = 1, longest = 0;
    uint64_t first = (uint64_t)index * s->n;
    float *opacity = map_values(s->logit_opacities, s->n, sigmoid), *cov6 = covariances(s);
    struct expected cov = {npz, bound("cov6").abs, bound("cov6").rel, name},
                    same = {npz, 1e-6, 0, name};

    if (want)
        extent = fmax(1, largest(want, info.count));
    struct expected xyz = {npz, bound("xyz").abs * extent, 0, name};

    compare(&xyz, "xyz", 3 * first, 3 * s->n, s->means);
    compare(&cov, "cov6", 6 * first, 6 * s->n, cov6);
    compare(&same, "opacity", 0, s->n, opacity);
    compare(&same, "sh", 0, 48 * s->n, s->sh);
    for (size_t i = 0; i < s->n; i++) {
        const float *q = s->quats + 4 * i;

        longest =
            fmax(longest, fabs(1 - sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])));
    }
    near(longest, 0, 1e-6, "quaternions are of unit length");
    free(want);
    free(opacity);
    free(cov6);
}

static inline void compare_hash_model(const char *from, const char *path, const char *const *pairs,
                                      const char *folder, const char *name)
{
    struct spin_splats s = {0}, again = {0};
    struct spin_array info;
    struct spin_npz npz;
    struct run run;
    double *times;

    bounds_of = folder;
    if (!ok(model_open(from, path, pairs, &run) == SPIN_OK, "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    ok(run.sequence.continuous && run.sequence.time_last == 1 &&
           run.sequence.static_columns == (SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH),
       "%s: any time may be asked for; opacity and colour are still", name);
    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK)
        exit(1);
    times = check_load(&npz, "times", &info);
    for (size_t t = 0; times && t < info.count; t++) {
        char what[200];

        snprintf(what, sizeof what, "%s, time %g", name, times[t]);
        if (ok(run.importer->frame(run.self, (int)t, times[t], run.sequence.columns, &s) == SPIN_OK,
               "%s: reads", what))
            compare_hash_time(&npz, (int)t, what, &s);
        else
            printf("#   %s\n", spin_last_error());
    }
    run.importer->frame(run.self, 0, times ? times[info.count - 1] : 0, SPIN_COL_MEANS, &again);
    check_same_bits(again.means, s.means, 3 * s.n * sizeof *s.means,
                    "positions alone are the same");
    run.importer->frame(run.self, 0, times ? times[info.count - 1] : 0, SPIN_COL_LOG_SCALES,
                        &again);
    check_same_bits(again.log_scales, s.log_scales, 3 * s.n * sizeof *s.log_scales,
                    "so are scales alone");
    free(times);
    spin_splats_free(&s);
    spin_splats_free(&again);
    spin_npz_close(&npz);
    run_close(&run);
}

/* iteration_<N> of a fixture. */
static inline const char *hash_save_of(const char *folder)
{
    const char *clouds = path_in(folder, "model/deform"), *save = NULL;
    char **names = NULL;
    size_t n = 0;

    if (spin_folder_list(clouds, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        if (strcmp(names[i], "iteration_best") != 0)
            save = path_in("", names[i]) + 1;
    }
    spin_folder_list_free(names);
    return save;
}

static inline const char *hash_network_of(const char *folder)
{
    return path_in(path_in(path_in(folder, "model/deform"), hash_save_of(folder)), "deform.pth");
}

/* A copy of a fixture's model with another network and cfg_args; NULL: the same, "": none. */
static inline const char *make_hash_model(const char *folder, const struct pth *pth,
                                          const char *cfg)
{
    const char *model = new_folder(), *save = hash_save_of(folder);
    const char *clouds = path_in(model, "point_cloud/iteration_7");
    const char *deforms = path_in(model, "deform/iteration_7");
    const char *from = path_in(path_in(folder, "model/point_cloud"), save);

    if (spin_folder_make(clouds) != SPIN_OK || spin_folder_make(deforms) != SPIN_OK)
        exit(1);
    copy_file(path_in(from, "point_cloud.ply"), path_in(clouds, "point_cloud.ply"));
    if (pth)
        pth_save(pth, path_in(deforms, "deform.pth"));
    else
        copy_file(hash_network_of(folder), path_in(deforms, "deform.pth"));
    if (!cfg)
        copy_file(path_in(folder, "model/cfg_args"), path_in(model, "cfg_args"));
    else if (*cfg)
        write_text(path_in(model, "cfg_args"), cfg);
    return model;
}

/* What is wrong with a checkpoint, and a word of the message. */
struct hash_lie {
    void (*change)(struct pth *);
    const char *word, *what;
};

static inline void test_hash_lies(const char *from, const char *folder, const struct hash_lie *lies,
                                  size_t n)
{
    for (size_t i = 0; i < n; i++) {
        struct pth pth;

        pth_load(hash_network_of(folder), &pth);
        lies[i].change(&pth);
        model_fails(from, make_hash_model(folder, &pth, NULL), NULL, "deform.pth", lies[i].word,
                    lies[i].what);
        pth_free(&pth);
    }
}

/* Settings that are missing or wrong, and folders that are not whole. */
static inline void test_hash_settings(const char *from, const char *folder)
{
    static const struct {
        const char *cfg, *word, *what;
    } bad[] = {
        {"", "--bound", "no cfg_args"},
        {"Namespace(sh_degree=3)", "--bound", "cfg_args without grid_args"},
        {"Namespace(grid_args={'bound': 0})", "above 0", "a bound of 0"},
        {"Namespace(grid_args={'bound': -1.5})", "above 0", "a negative bound"},
        {"Namespace(grid_args={'bound': 'x'})", "not a number", "a bound in words"},
        {"Namespace(grid_args={'bound': 1.6}, scale_xyz=[1, 2])", "scale_xyz", "two scales"},
        {"Namespace(grid_args={'bound': 1.6)", "cut short", "brackets that do not match"},
    };
    const char *zero[] = {"bound", "0", NULL}, *word[] = {"bound", "wide", NULL};
    const char *scales[] = {"bound", "1", "scale-xyz", "1,2", NULL};
    const char *missing[] = {"iteration", "12345", NULL};
    const char *model = make_hash_model(folder, NULL, NULL);
    struct run run;

    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        model_fails(from, make_hash_model(folder, NULL, bad[i].cfg), NULL,
                    *bad[i].cfg ? "cfg_args" : NULL, bad[i].word, bad[i].what);
    model_fails(from, model, zero, "--bound", "above 0", "--bound 0");
    model_fails(from, model, word, "--bound", "expected a number", "--bound of a word");
    model_fails(from, model, scales, "--scale-xyz", "expected", "--scale-xyz of two numbers");
    model_fails(from, model, missing, model, "iteration_12345", "a save that is not there");
    if (ok(run_open(from, make_hash_model(folder, NULL, "Namespace(grid_args={'a': 1})"), &run) ==
               SPIN_OK,
           "the method's bound when grid_args has none"))
        ok(strstr(run.sequence.notes, "1.6") != NULL, "which is noted");
    run_close(&run);
    cut_file(from, model, path_in(model, "deform/iteration_7"), "deform.pth",
             "no truncation of the network is read");
    cut_file(from, model, path_in(model, "point_cloud/iteration_7"), "point_cloud.ply",
             "no truncation of the cloud is read");
    unlink(path_in(model, "point_cloud/iteration_7/point_cloud.ply"));
    model_fails(from, model, NULL, model, "both", "a network without its cloud");
    model_fails(from, new_folder(), NULL, NULL, "no folder 'point_cloud'", "an empty folder");
    model_fails(from, path_in(folder, "manifest.json"), NULL, "manifest.json", "model's folder",
                "a file of another kind");
}

#endif
