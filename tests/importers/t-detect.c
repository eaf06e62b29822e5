/* Which importer recognises each fixture without --from and --data-from.
 * K: detect import d3dgs tc3dgs deformable3dgs motiongs ed3dgs ex4dgs grid4d hybrid4dgs dash
 * K: 4dgaussian modecgs 3dgstream realtime4dgs rotor4dgs spacetimegs omg4 ply spz splat ksplat
 * K: splat4d 4dgs sog tsog sogst gltf usd gifstream gaussianflow panoptic colmap dynerf
 * K: transforms 4danyone easyvolcap */
#include "tests/importers/runs.h"

struct known {
    const char *path, *importer; /* NULL: none */
};

/* A '*' stands for every folder there. */
static const struct known runs[] = {
    {"tc3dgs/trained", "tc3dgs"},
    {"tc3dgs/trained/params.npz", "tc3dgs"},
    {"d3dgs/cloud", "d3dgs"},
    {"d3dgs/cloud/params.npz", "d3dgs"},
    {"d3dgs/trained", "d3dgs"},
    {"d3dgs/trained/params.npz", "d3dgs"},
    {"deformable3dgs/*/model", "deformable3dgs"},
    {"ed3dgs/*/model", "ed3dgs"},
    {"ed3dgs/annealed_early/model/point_cloud/*", "ed3dgs"},
    {"ed3dgs/annealed_early/model/point_cloud/iteration_5400/deformation.pth", "ed3dgs"},
    {"motiongs/*/model", "deformable3dgs"},
    {"ex4dgs/*/model", "ex4dgs"},
    {"ex4dgs/small/model/chkpnt40000.pth", "ex4dgs"},
    {"ex4dgs/small/model/point_cloud/iteration_40000", "ex4dgs"},
    {"ex4dgs/small/model/point_cloud/iteration_40000/point_cloud.ply", "ex4dgs"},
    {"ex4dgs/small/model/point_cloud/iteration_40000/dynamic_point_cloud.ply", "ex4dgs"},
    {"freetimegs/*", "freetimegs"},
    {"ftgs_ply/*/scene.ftgs.ply", "freetimegs"},
    {"gaussianflow/*", "gaussianflow"},
    {"gaussianflow/dnerf_like/chkpnt30001.pth", "gaussianflow"},
    {"gifstream/view_app", "gifstream"},
    {"gifstream/entropy_knn/ckpts", "gifstream"},
    {"gifstream/entropy_knn/ckpts/ckpt_29999_rank0.pt", "gifstream"},
    {"grid4d/*/model", "grid4d"},
    {"hybrid4dgs/*/model", "hybrid4dgs"},
    {"hybrid4dgs/small/model/chkpnt6000.pth", "hybrid4dgs"},
    {"dash/*/model", "dash"},
    {"4dgaussian/*/model", "4dgaussian"},
    {"4dgaussian/coarse_and_fine/model/point_cloud/*", "4dgaussian"},
    {"4dgaussian/coarse_and_fine/model/point_cloud/iteration_14000/deformation.pth", "4dgaussian"},
    {"modecgs/*/model", "modecgs"},
    {"3dgstream", "3dgstream"},
    {"3dgstream/fvv", "3dgstream"},
    {"realtime4dgs/*", "realtime4dgs"},
    {"rotor4dgs/*", "rotor4dgs"},
    {"spacetimegs/*/model", "spacetimegs"},
    {"spacetimegs/full_techni/model/point_cloud/*", "spacetimegs"},
    {"spacetimegs/full_techni/model/point_cloud/iteration_12000/point_cloud.ply", "spacetimegs"},
    {"spacetimegs/full_techni/model/point_cloud/iteration_12000/point_cloud.pt", "spacetimegs"},
    {"omg4/comp_xz", "omg4"},
    {"omg4/ftgs_xz", "omg4"},
    {"omg4/stale_chkpnt", "realtime4dgs"}, /* whose checkpoint it is */
    {"ply/inria_sh3", "ply"},
    {"ply/inria_sh0_varN", "ply"},
    {"ply/gsplat_sh2", "ply"},
    {"ply/brush_sh1", "ply"},
    {"ply/supersplat_compressed", "ply"},
    {"splats/spz2", "spz"},
    {"splats/spz2/frame_00000.spz", "spz"},
    {"splats/spz3", "spz"},
    {"splats/spz4", "spz"},
    {"splats/spz4/frame_00001.spz", "spz"},
    {"splats/splat", "splat"},
    {"splats/splat/frame_00001.splat", "splat"},
    {"splats/ksplat", "ksplat"},
    {"splats/ksplat/frame_00002.ksplat", "ksplat"},
    {"splats/sog", "sog"},
    {"splats/sog/frame_00000.sog", "sog"},
    {"splats/glb", "gltf"},
    {"splats/glb/frame_00001.glb", "gltf"},
    {"4dgs/*", "4dgs"},
    {"4dgs/birth_sh2/scene.4dgs", "4dgs"},
    {"splat4d/*", "splat4d"},
    {"splat4d/default_bounds/scene.splat4d", "splat4d"},
    {"tsog/static/scene.tsog", "tsog"},
    {"tsog/continuous8_legacy/scene.tsog", "tsog"},
    {"tsog/conformance/decode-vector.tsog", "tsog"},
    {"tsog/static", "tsog"},
    {"usd/still/scene.usda", "usd"},
    {"usd/clip/scene.usda", "usd"},
    {"usd/*/scene.usdc", "usd"},
    {"usd/still/scene.usdz", "usd"},
    {"sogst/no_segments", "sogst"},
    {"sogst/no_segments/scene.sogst", "sogst"},
    {"sogst/sh1_by_splat_transform/scene.sogst", "sogst"},
    {"sogst/sh1_by_splat_transform/b1.ply", "sogst"},
    {"freetimegspp/gated_sh3", "freetimegspp"},
    {"freetimegspp/field_sh1/gaussians.pt", "freetimegspp"},
    {"scgs/*/model", "scgs"},
    {"scgs/real_mask_hyper2/model/deform/iteration_40000/deform.pth", "scgs"},
    {"shapeofmotion/fg_bg", "shapeofmotion"},
    {"shapeofmotion/fg_only_k4/checkpoints/last.ckpt", "shapeofmotion"},
    {"stglite/supersplat4d_sh1/scene.ply", "stglite"},
    {"stglite/opensplat4d_sh3/scene.ply", "stglite"},
    {"splats", NULL},
    {"datasets/panoptic_mini", NULL},
    {"datasets/colmap_mini", NULL},
    {"datasets/dynerf_mini", NULL},
    {"datasets/dynerf_mini/n3v2blender", NULL},
    {"datasets/blender_mini", NULL},
    {"datasets4d/4danyone_mini/clip", NULL},
    {"datasets4d/easyvolcap_mini/scene", NULL},
    {"datasets4d/freetimegs_mini/scene", NULL},
    {"court-mini", "d3dgs"}, /* a run and its data in one folder */
    {"torch_container/good", NULL},
    {"core", NULL},
};

static const struct known data_sets[] = {
    {"datasets/panoptic_mini", "panoptic"},
    {"datasets/colmap_mini", "colmap"},
    {"datasets/dynerf_mini", "dynerf"},
    {"datasets/dynerf_mini/n3v2blender", "transforms"},
    {"datasets/blender_mini", "transforms"},
    {"datasets4d/4danyone_mini/clip", "4danyone"},
    {"datasets4d/easyvolcap_mini/scene", "easyvolcap"},
    {"datasets4d/freetimegs_mini/scene", "colmap"},
    {"court-mini", "panoptic"},
    {"d3dgs/cloud", NULL},
    {"4dgaussian/coarse_and_fine/model", NULL},
    {"ed3dgs/annealed_early/model", NULL},
    {"spacetimegs/full_techni/model", NULL},
};

/* The beginning of what the importer calls the run. */
static const struct known variants[] = {
    {"tc3dgs/trained", "TC3DGS, "},
    {"d3dgs/trained", "Dynamic 3D Gaussians, "},
    {"ex4dgs/small/model/chkpnt40000.pth", "Ex4DGS, chkpnt40000.pth, "},
    {"ex4dgs/small/model/point_cloud/iteration_40000", "Ex4DGS, two PLYs, "},
    {"gifstream/entropy_knn/ckpts", "GIFStream, "},
    {"hybrid4dgs/small/model/chkpnt6000.pth", "Hybrid 3D-4DGS, iteration 6000, "},
    {"3dgstream", "3DGStream, moved clouds"},
    {"3dgstream/fvv", "3DGStream packed for its viewer, networks evaluated"},
    {"omg4/comp_xz", "OMG4, "},
    {"omg4/ftgs_xz", "OMG4-FTGS, "},
    {"ply/inria_sh3", "PLY files of Gaussians"},
    {"ply/supersplat_compressed", "one PLY file of SuperSplat's compressed Gaussians"},
    {"splats/spz2", "a sequence of SPZ files"},
    {"splats/spz2/frame_00000.spz", "one SPZ file"},
    {"splats/glb", "a sequence of GLB files"},
    {"4dgs/birth_sh2/scene.4dgs", "gaussian-birth, "},
    {"splat4d/default_bounds/scene.splat4d", "a clip of 20 frames per second"},
    {"tsog/static/scene.tsog", "TSOG, static, "},
    {"tsog/continuous8_legacy/scene.tsog", "TSOG, continuous, "},
    {"usd/still/scene.usda", "USD, one frame"},
    {"usd/clip/scene.usda", "USD, a clip"},
    {"sogst/no_segments/scene.sogst", ".sogst, "},
    {"sogst/sh1_by_splat_transform/b1.ply", "PLY for .sogst, "},
    {"freetimegspp/gated_sh3", "FreeTimeGS++, "},
    {"shapeofmotion/fg_bg", "Shape of Motion, "},
    {"stglite/supersplat4d_sh1/scene.ply", "STG-lite PLY of SuperSplat-4D, "},
    {"stglite/opensplat4d_sh3/scene.ply", "STG-lite PLY of OpenSplat4D, "},
};

static void check_variant(const char *path, const char *name, const char *variant)
{
    struct run run = {0};

    ok(run_open(NULL, path, &run) == SPIN_OK &&
           strncmp(run.sequence.variant, variant, strlen(variant)) == 0,
       "%s: is called '%s'", name, run.self ? run.sequence.variant : spin_last_error());
    run_close(&run);
}

static void check(const char *path, const char *name, const char *importer, bool data)
{
    const struct spin_importer *found = NULL;
    spin_status status = spin_importer_find(path, NULL, data, &found);
    bool good = importer ? status == SPIN_OK && strcmp(found->name, importer) == 0
                         : status == SPIN_E_NOT_RECOGNISED;

    ok(good, "%s%s: %s", name, data ? ", data" : "", importer ? importer : "is none");
    if (!good)
        printf("#   %s\n", status == SPIN_OK ? found->name : spin_last_error());
}

/* "a/b" and "/c" of "a/b" "*" "/c": every folder in a/b. */
static void check_all(const char *root, const char *first, const char *rest, const char *importer)
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
            check(rest[0] ? path_in(path, rest + 1) : path, name, importer, false);
    }
    spin_folder_list_free(names);
}

/* A folder "frame_1" that contains `name`. */
static void check_frames(const char *name, const char *importer)
{
    const char *folder = new_folder(), *frame = path_in(folder, "frame_1");

    if (mkdir(frame, 0700) != 0 || mkdir(path_in(frame, name), 0700) != 0)
        exit(1);
    check(folder, name, importer, false);
}

TAP_MAIN
{
    const char *json = path_in(new_folder(), "places.json");
    FILE *file = fopen(json, "w");

    if (!file || fputs("{\"means\": [0, 1]}", file) < 0 || fclose(file) != 0)
        exit(1);
    check(json, "a JSON of means without their range", NULL, false);
    check_frames("images", NULL);
    check_frames("point_cloud", "ply");
    check_frames("0.PLY", "ply");
    for (size_t i = 0; i < sizeof runs / sizeof *runs; i++) {
        const char *star = strstr(runs[i].path, "/*"), *root;
        char first[100];

        snprintf(first, sizeof first, "%.*s",
                 star ? (int)(star - runs[i].path) : (int)strlen(runs[i].path), runs[i].path);
        root = check_fixture(first);
        if (!root)
            skip(runs[i].path, "it is not here");
        else if (star)
            check_all(root, first, star + 2, runs[i].importer);
        else
            check(root, runs[i].path, runs[i].importer, false);
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
            check(root, data_sets[i].path, data_sets[i].importer, true);
        else
            skip(data_sets[i].path, "it is not here");
    }
}
