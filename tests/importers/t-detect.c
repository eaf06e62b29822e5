/* Which importer recognises each fixture without --from and --data-from.
 * K: detect import d3dgs tc3dgs deformable3dgs motiongs ed3dgs ex4dgs grid4d hybrid4dgs dash
 * K: 4dgaussian modecgs 3dgstream realtime4dgs rotor4dgs spacetimegs omg4 ply spz splat ksplat
 * K: splat4d 4dgs sog tsog sogst gltf usd gifstream gaussianflow panoptic colmap dynerf
 * K: transforms 4danyone easyvolcap */
#include "tests/importers/runs.h"

struct known {
    const char *path, *importer; /* NULL: none */
    int confidence;              /* of the importer, in percent */
};

/* A '*' stands for every folder there. */
static const struct known runs[] = {
    {"tc3dgs/trained", "tc3dgs", 80},
    {"tc3dgs/trained/params.npz", "tc3dgs", 90},
    {"d3dgs/cloud", "d3dgs", 60},
    {"d3dgs/cloud/params.npz", "d3dgs", 90},
    {"d3dgs/trained", "d3dgs", 60},
    {"d3dgs/trained/params.npz", "d3dgs", 90},
    {"deformable3dgs/*/model", "deformable3dgs", 90},
    {"ed3dgs/*/model", "ed3dgs", 90},
    {"ed3dgs/annealed_early/model/point_cloud/*", "ed3dgs", 95},
    {"ed3dgs/annealed_early/model/point_cloud/iteration_5400/deformation.pth", "ed3dgs", 95},
    {"motiongs/*/model", "deformable3dgs", 90},
    {"ex4dgs/*/model", "ex4dgs", 95},
    {"ex4dgs/small/model/chkpnt40000.pth", "ex4dgs", 95},
    {"ex4dgs/small/model/point_cloud/iteration_40000", "ex4dgs", 95},
    {"ex4dgs/small/model/point_cloud/iteration_40000/point_cloud.ply", "ex4dgs", 100},
    {"ex4dgs/small/model/point_cloud/iteration_40000/dynamic_point_cloud.ply", "ex4dgs", 100},
    {"freetimegs/*", "freetimegs", 60},
    {"ftgs_ply/*/scene.ftgs.ply", "freetimegs", 100},
    {"gaussianflow/*", "gaussianflow", 100},
    {"gaussianflow/dnerf_like/chkpnt30001.pth", "gaussianflow", 100},
    {"gifstream/view_app", "gifstream", 95},
    {"gifstream/entropy_knn/ckpts", "gifstream", 95},
    {"gifstream/entropy_knn/ckpts/ckpt_29999_rank0.pt", "gifstream", 95},
    {"grid4d/*/model", "grid4d", 90},
    {"hybrid4dgs/*/model", "hybrid4dgs", 95},
    {"hybrid4dgs/small/model/chkpnt6000.pth", "hybrid4dgs", 95},
    {"dash/*/model", "dash", 90},
    {"4dgaussian/*/model", "4dgaussian", 90},
    {"4dgaussian/coarse_and_fine/model/point_cloud/*", "4dgaussian", 90},
    {"4dgaussian/coarse_and_fine/model/point_cloud/iteration_14000/deformation.pth", "4dgaussian",
     85},
    {"modecgs/*/model", "modecgs", 90},
    {"3dgstream", "3dgstream", 80},
    {"3dgstream/fvv", "3dgstream", 90},
    {"realtime4dgs/*", "realtime4dgs", 70},
    {"rotor4dgs/*", "rotor4dgs", 60},
    {"spacetimegs/*/model", "spacetimegs", 90},
    {"spacetimegs/full_techni/model/point_cloud/*", "spacetimegs", 100},
    {"spacetimegs/full_techni/model/point_cloud/iteration_12000/point_cloud.ply", "spacetimegs",
     100},
    {"spacetimegs/full_techni/model/point_cloud/iteration_12000/point_cloud.pt", "spacetimegs", 80},
    {"omg4/comp_xz", "omg4", 95},
    {"omg4/ftgs_xz", "omg4", 50},
    {"omg4/stale_chkpnt", "realtime4dgs", 70}, /* whose checkpoint it is */
    {"ply/inria_sh3", "ply", 50},
    {"ply/inria_sh0_varN", "ply", 70},
    {"ply/gsplat_sh2", "ply", 70},
    {"ply/brush_sh1", "ply", 70},
    {"ply/supersplat_compressed", "ply", 70},
    {"splats/spz2", "spz", 70},
    {"splats/spz2/frame_00000.spz", "spz", 90},
    {"splats/spz3", "spz", 70},
    {"splats/spz4", "spz", 70},
    {"splats/spz4/frame_00001.spz", "spz", 90},
    {"splats/splat", "splat", 70},
    {"splats/splat/frame_00001.splat", "splat", 70},
    {"splats/ksplat", "ksplat", 70},
    {"splats/ksplat/frame_00002.ksplat", "ksplat", 70},
    {"splats/sog", "sog", 70},
    {"splats/sog/frame_00000.sog", "sog", 90},
    {"splats/glb", "gltf", 70},
    {"splats/glb/frame_00001.glb", "gltf", 90},
    {"4dgs/*", "4dgs", 70},
    {"4dgs/birth_sh2/scene.4dgs", "4dgs", 90},
    {"splat4d/*", "splat4d", 70},
    {"splat4d/default_bounds/scene.splat4d", "splat4d", 90},
    {"tsog/static/scene.tsog", "tsog", 100},
    {"tsog/continuous8_legacy/scene.tsog", "tsog", 100},
    {"tsog/conformance/decode-vector.tsog", "tsog", 100},
    {"tsog/static", "tsog", 70},
    {"usd/still/scene.usda", "usd", 90},
    {"usd/clip/scene.usda", "usd", 90},
    {"usd/*/scene.usdc", "usd", 90},
    {"usd/still/scene.usdz", "usd", 90},
    {"sogst/no_segments", "sogst", 70},
    {"sogst/no_segments/scene.sogst", "sogst", 100},
    {"sogst/sh1_by_splat_transform/scene.sogst", "sogst", 100},
    {"sogst/sh1_by_splat_transform/b1.ply", "sogst", 100},
    {"freetimegspp/gated_sh3", "freetimegspp", 90},
    {"freetimegspp/field_sh1/gaussians.pt", "freetimegspp", 100},
    {"scgs/*/model", "scgs", 100},
    {"scgs/real_mask_hyper2/model/deform/iteration_40000/deform.pth", "scgs", 100},
    {"shapeofmotion/fg_bg", "shapeofmotion", 80},
    {"shapeofmotion/fg_only_k4/checkpoints/last.ckpt", "shapeofmotion", 100},
    {"stglite/supersplat4d_sh1/scene.ply", "stglite", 100},
    {"stglite/opensplat4d_sh3/scene.ply", "stglite", 100},
    {"splats", NULL, 0},
    {"datasets/panoptic_mini", NULL, 0},
    {"datasets/colmap_mini", NULL, 0},
    {"datasets/dynerf_mini", NULL, 0},
    {"datasets/dynerf_mini/n3v2blender", NULL, 0},
    {"datasets/blender_mini", NULL, 0},
    {"datasets4d/4danyone_mini/clip", NULL, 0},
    {"datasets4d/easyvolcap_mini/scene", NULL, 0},
    {"datasets4d/freetimegs_mini/scene", NULL, 0},
    {"court-mini", "d3dgs", 60}, /* a run and its data in one folder */
    {"torch_container/good", NULL, 0},
    {"core", NULL, 0},
};

static const struct known data_sets[] = {
    {"datasets/panoptic_mini", "panoptic", 70},
    {"datasets/colmap_mini", "colmap", 100},
    {"datasets/dynerf_mini", "dynerf", 80},
    {"datasets/dynerf_mini/n3v2blender", "transforms", 90},
    {"datasets/blender_mini", "transforms", 90},
    {"datasets4d/4danyone_mini/clip", "4danyone", 75},
    {"datasets4d/easyvolcap_mini/scene", "easyvolcap", 75},
    {"datasets4d/freetimegs_mini/scene", "colmap", 100},
    {"court-mini", "panoptic", 70},
    {"d3dgs/cloud", NULL, 0},
    {"4dgaussian/coarse_and_fine/model", NULL, 0},
    {"ed3dgs/annealed_early/model", NULL, 0},
    {"spacetimegs/full_techni/model", NULL, 0},
};

/* The beginning of what the importer calls the run. */
static const struct known variants[] = {
    {"tc3dgs/trained", "TC3DGS, ", 0},
    {"d3dgs/trained", "Dynamic 3D Gaussians, ", 0},
    {"ex4dgs/small/model/chkpnt40000.pth", "Ex4DGS, chkpnt40000.pth, ", 0},
    {"ex4dgs/small/model/point_cloud/iteration_40000", "Ex4DGS, two PLYs, ", 0},
    {"gifstream/entropy_knn/ckpts", "GIFStream, ", 0},
    {"hybrid4dgs/small/model/chkpnt6000.pth", "Hybrid 3D-4DGS, iteration 6000, ", 0},
    {"3dgstream", "3DGStream, moved clouds", 0},
    {"3dgstream/fvv", "3DGStream packed for its viewer, networks evaluated", 0},
    {"omg4/comp_xz", "OMG4, ", 0},
    {"omg4/ftgs_xz", "OMG4-FTGS, ", 0},
    {"ply/inria_sh3", "PLY files of Gaussians", 0},
    {"ply/supersplat_compressed", "one PLY file of SuperSplat's compressed Gaussians", 0},
    {"splats/spz2", "a sequence of SPZ files", 0},
    {"splats/spz2/frame_00000.spz", "one SPZ file", 0},
    {"splats/glb", "a sequence of GLB files", 0},
    {"4dgs/birth_sh2/scene.4dgs", "gaussian-birth, ", 0},
    {"splat4d/default_bounds/scene.splat4d", "a clip of 20 frames per second", 0},
    {"tsog/static/scene.tsog", "TSOG, static, ", 0},
    {"tsog/continuous8_legacy/scene.tsog", "TSOG, continuous, ", 0},
    {"usd/still/scene.usda", "USD, one frame", 0},
    {"usd/clip/scene.usda", "USD, a clip", 0},
    {"sogst/no_segments/scene.sogst", ".sogst, ", 0},
    {"sogst/sh1_by_splat_transform/b1.ply", "PLY for .sogst, ", 0},
    {"freetimegspp/gated_sh3", "FreeTimeGS++, ", 0},
    {"shapeofmotion/fg_bg", "Shape of Motion, ", 0},
    {"stglite/supersplat4d_sh1/scene.ply", "STG-lite PLY of SuperSplat-4D, ", 0},
    {"stglite/opensplat4d_sh3/scene.ply", "STG-lite PLY of OpenSplat4D, ", 0},
};

static void check_variant(const char *path, const char *name, const char *variant)
{
    struct run run = {0};

    ok(run_open(NULL, path, &run) == SPIN_OK &&
           strncmp(run.sequence.variant, variant, strlen(variant)) == 0,
       "%s: is called '%s'", name, run.self ? run.sequence.variant : spin_last_error());
    run_close(&run);
}

/* confidence: 0: any */
static void check(const char *path, const char *name, const char *importer, int confidence,
                  bool data)
{
    const struct spin_importer *found = NULL;
    spin_status status = spin_importer_find(path, NULL, data, &found);
    bool good = importer ? status == SPIN_OK && strcmp(found->name, importer) == 0
                         : status == SPIN_E_NOT_RECOGNISED;

    ok(good, "%s%s: %s", name, data ? ", data" : "", importer ? importer : "is none");
    if (!good)
        printf("#   %s\n", status == SPIN_OK ? found->name : spin_last_error());
    if (good && confidence > 0) {
        struct spin_peek peek;
        int got = spin_peek_open(path, &peek) == SPIN_OK ? found->probe(&peek) : -1;

        ok(got == confidence, "%s: with a confidence of %d %%", name, got);
        spin_peek_free(&peek);
    }
}

/* "a/b" and "/c" of "a/b" "*" "/c": every folder in a/b. */
static void check_all(const char *root, const char *first, const char *rest, const char *importer,
                      int confidence)
{
    char **names = NULL;
    size_t n = 0;

    if (spin_folder_list(root, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n; i++) {
        const char *path = path_in(root, names[i]);
        char name[300];

        snprintf(name, sizeof name, "%s/%s%s", first, names[i], rest);
        if (spin_path_is_folder(path) && (!rest[0] || spin_path_exists(path_in(path, rest + 1))))
            check(rest[0] ? path_in(path, rest + 1) : path, name, importer, confidence, false);
    }
    spin_folder_list_free(names);
}

/* A folder "frame_1" that contains `name`. */
static void check_frames(const char *name, const char *importer)
{
    const char *folder = new_folder(), *frame = path_in(folder, "frame_1");

    if (mkdir(frame, 0700) != 0 || mkdir(path_in(frame, name), 0700) != 0)
        exit(1);
    check(folder, name, importer, 0, false);
}

TAP_MAIN
{
    const char *json = path_in(new_folder(), "places.json"), *bare = new_folder();
    FILE *file = fopen(json, "w");

    if (!file || fputs("{\"means\": [0, 1]}", file) < 0 || fclose(file) != 0)
        exit(1);
    check(json, "a JSON of means without their range", NULL, 0, false);
    check_frames("images", NULL);
    check_frames("point_cloud", "ply");
    check_frames("0.PLY", "ply");
    if (check_fixture("freetimegspp/field_sh1/gaussians.pt") &&
        symlink(check_fixture("freetimegspp/field_sh1/gaussians.pt"),
                path_in(bare, "gaussians.pt")) == 0)
        check(bare, "FreeTimeGS++ without its settings", "freetimegspp", 60, false);
    for (size_t i = 0; i < sizeof runs / sizeof *runs; i++) {
        const char *star = strstr(runs[i].path, "/*"), *root;
        char first[100];

        snprintf(first, sizeof first, "%.*s",
                 star ? (int)(star - runs[i].path) : (int)strlen(runs[i].path), runs[i].path);
        root = check_fixture(first);
        if (!root)
            skip(runs[i].path, "it is not here");
        else if (star)
            check_all(root, first, star + 2, runs[i].importer, runs[i].confidence);
        else
            check(root, runs[i].path, runs[i].importer, runs[i].confidence, false);
    }
    for (size_t i = 0; i < sizeof variants / sizeof *variants; i++) {
        const char *root = check_fixture(variants[i].path);

        if (root)
            check_variant(root, variants[i].path, variants[i].importer);
        else
            skip(variants[i].path, "it is not here");
    }
    for (size_t i = 0; i < sizeof data_sets / sizeof *data_sets; i++) {
        const char *root = check_fixture(data_sets[i].path);

        if (root)
            check(root, data_sets[i].path, data_sets[i].importer, data_sets[i].confidence, true);
        else
            skip(data_sets[i].path, "it is not here");
    }
}
