/* Any bytes as one file of a run, the others as a fixture has them: open it and read frames. The
 * first byte says which of `files`. K: fuzz run */
#include "base/log.h"
#include "io/file.h"
#include "scene/probe.h"
#include "tests/fuzz/input.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_FILES = 4 };

static const struct run {
    const char *importer, *fixture; /* below fixtures/ */
    const char *file[MOST_FILES +
                     1]; /* of the run; those that the fixture has not are only there when chosen */
    const char *pairs[5];
} runs[] = {
    {"spacetimegs",
     "spacetimegs/full_techni/model",
     {"point_cloud/iteration_12000/point_cloud.ply", "point_cloud/iteration_12000/point_cloud.pt",
      "cfg_args", "cameras.json"},
     {NULL}},
    {"spacetimegs",
     "spacetimegs/full_techni/model",
     {"point_cloud/iteration_12000/point_cloud.pt", "point_cloud/iteration_12000/point_cloud.ply",
      "cfg_args"},
     {"camera", "0,0,0;1,0.5,0", NULL}},
    {"ed3dgs",
     "ed3dgs/annealed_early/model",
     {"point_cloud/iteration_5400/deformation.pth", "point_cloud/iteration_5400/point_cloud.ply",
      "cfg_args"},
     {NULL}},
    {"scgs",
     "scgs/real_mask_hyper2/model",
     {"deform/iteration_40000/deform.pth", "point_cloud/iteration_40000/point_cloud.ply",
      "cfg_args"},
     {NULL}},
    {"shapeofmotion", "shapeofmotion/fg_only_k4", {"checkpoints/last.ckpt"}, {NULL}},
    {"freetimegspp", "freetimegspp/gated_sh3", {"gaussians.pt", "config.toml"}, {NULL}},
    {"gifstream", "gifstream/entropy_knn", {"ckpts/ckpt_29999_rank0.pt", "cfg.yml"}, {NULL}},
    {"gifstream",
     "gifstream/view_app",
     {"ckpts/ckpt_6999_rank0.pt", "cfg.yml"},
     {"camera", "0,0,-6", NULL}},
    {"gaussianflow",
     "gaussianflow/dnerf_like",
     {"chkpnt30001.pth", "project_file/dnerf.yaml", "project_file/custom.yaml"},
     {NULL}},
    {"points", "none", {"f1/init_pt_cld.npz"}, {"pattern", "f%d/init_pt_cld.npz", NULL}},
    {"points", "none", {"f1/points3D.bin"}, {"pattern", "f%d/points3D.bin", NULL}},
    {"points", "none", {"f1/points3D.txt"}, {"pattern", "f%d/points3D.txt", NULL}},
    {"points", "none", {"f1/fused.ply"}, {"pattern", "f%d/fused.ply", NULL}},
};
enum { N_RUNS = sizeof runs / sizeof *runs };

static char folder[64];

static const char *in_run(const struct run *run, const char *file)
{
    static char path[256];

    snprintf(path, sizeof path, "%s/%d/%s", folder, (int)(run - runs), file);
    return path;
}

static void put_link(const struct run *run, const char *file)
{
    char *whole = NULL, source[256];

    snprintf(source, sizeof source, "fixtures/%s/%s", run->fixture, file);
    unlink(in_run(run, file));
    if (!spin_path_exists(source))
        return;
    if (spin_path_absolute(source, &whole) != SPIN_OK || symlink(whole, in_run(run, file)) != 0)
        abort();
    free(whole);
}

/* The folders that a path goes through, the deepest first. */
static void remove_with_folders(const struct run *run, const char *file)
{
    char path[256];

    snprintf(path, sizeof path, "%s", in_run(run, file));
    for (char *slash = path + strlen(path); slash && strlen(path) > strlen(folder);
         slash = strrchr(path, '/')) {
        *slash = '\0';
        remove(path);
    }
}

static void clean_up(void)
{
    for (int r = 0; r < N_RUNS; r++) {
        for (int f = 0; runs[r].file[f]; f++)
            remove(in_run(&runs[r], runs[r].file[f]));
        for (int f = 0; runs[r].file[f]; f++)
            remove_with_folders(&runs[r], runs[r].file[f]);
    }
    remove(folder);
}

static void make_runs(void)
{
    spin_log_set_level(-2);
    /* In memory where there is such a place: a disk would take most of the time. */
    snprintf(folder, sizeof folder, "%s/fuzz-run-XXXXXX",
             access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp");
    if (!mkdtemp(folder))
        abort();
    atexit(clean_up);
    for (int r = 0; r < N_RUNS; r++) {
        for (int f = 0; runs[r].file[f]; f++) {
            char *parent = NULL;

            if (spin_path_folder(in_run(&runs[r], runs[r].file[f]), &parent) != SPIN_OK ||
                spin_folder_make(parent) != SPIN_OK)
                abort();
            free(parent);
            put_link(&runs[r], runs[r].file[f]);
        }
    }
}

static void put_bytes(const char *path, const uint8_t *data, size_t n)
{
    FILE *file;

    unlink(path); /* a link into the fixtures */
    file = fopen(path, "wb");
    if (!file || fwrite(data, 1, n, file) != n)
        abort();
    fclose(file);
}

/* Whatever could be read is finite, and of as many rows as was said. */
static void check(const struct spin_splats *s, const struct spin_sequence_info *info)
{
    size_t n_sh = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    const float *const part[] = {s->means, s->quats, s->log_scales, s->logit_opacities, s->sh};
    const size_t width[] = {3, 4, 3, 1, n_sh};

    if (info->counts && s->n != info->counts[0])
        abort();
    for (int p = 0; p < 5; p++) {
        for (size_t i = 0; part[p] && i < width[p] * s->n; i++) {
            if (!isfinite(part[p][i]))
                abort();
        }
    }
}

static void read_run(const struct run *run)
{
    static const double times[] = {0, 0.31, 1, -7.5};
    const struct spin_importer *importer;
    struct spin_plugin_values values = {run->pairs};
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    void *self = NULL;

    if (spin_importer_find(in_run(run, ""), run->importer, false, &importer) != SPIN_OK)
        abort();
    if (importer->open(in_run(run, ""), &values, &self, &info) == SPIN_OK) {
        for (size_t t = 0; t < sizeof times / sizeof *times; t++) {
            if (importer->frame(self, 0, times[t], info.columns, &s) == SPIN_OK)
                check(&s, &info);
        }
    }
    if (self)
        importer->close(self);
    spin_splats_free(&s);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const struct run *run;
    const char *file;
    int count = 0;

    if (n < 1)
        return 0;
    if (!folder[0])
        make_runs();
    run = &runs[data[0] / MOST_FILES % N_RUNS];
    while (run->file[count])
        count++;
    file = run->file[data[0] % MOST_FILES % count];
    put_bytes(in_run(run, file), data + 1, n - 1);
    read_run(run);
    put_link(run, file);
    return 0;
}
