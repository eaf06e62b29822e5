/* shapeofmotion: which files are opened, which rows are dropped, and malformed files. t-golden.c
 * compares the values, t-variants.c reads altered files.
 * K: shapeofmotion import */
#include "tests/importers/edits.h"

#define FROM "shapeofmotion"

static void load(const char *path, struct pth *pth)
{
    struct spin_torch torch;

    memset(pth, 0, sizeof *pth);
    if (spin_torch_open(path, &torch) != SPIN_OK)
        exit(1);
    pth_load_dict(&torch, spin_value_get(torch.root, "model"), 0, pth);
    pth->within = "model";
    spin_torch_close(&torch);
}

static void test_rows(const char *from)
{
    const char *folder = new_folder(), *path = path_in(folder, "last.ckpt");
    struct spin_splats s = {0};
    struct pth pth;
    struct run run;

    load(from, &pth);
    pth_find(&pth, "fg.params.means")->values[0] = NAN;
    memset(pth_find(&pth, "fg.params.quats")->values + 4, 0, 4 * sizeof(float));
    pth_find(&pth, "fg.params.scales")->values[6] = 100;
    pth_find(&pth, "fg.params.opacities")->values[3] = INFINITY;
    pth_find(&pth, "fg.params.motion_coefs")->values[4 * 5] = INFINITY;
    pth_save(&pth, path);
    pth_free(&pth);
    ok(run_open(NULL, folder, &run) == SPIN_OK && strcmp(run.importer->name, FROM) == 0 &&
           strstr(run.sequence.notes, "4 of 90 Gaussians are dropped") &&
           run.sequence.counts[11] == 86 && run.sequence.identity,
       "rows that are not finite are dropped from all frames");
    ok(run.importer->frame(run.self, 3, 3, run.sequence.columns, &s) == SPIN_OK && s.n == 86 &&
           s.logit_opacities[0] == 30,
       "an infinite opacity is opaque");
    ok(run.importer->frame(run.self, 12, 12, run.sequence.columns, &s) == SPIN_E_NOT_FOUND,
       "there are as many frames as in the table");
    run_close(&run);
    spin_splats_free(&s);
}

static void test_lies(const char *from)
{
    static const struct {
        const char *drop, *put;
        int n_dims;
        uint64_t shape[3];
        const char *word, *what;
    } lies[] = {
        {"fg.params.colors", NULL, 0, {0}, "fg.params.colors", "no colours"},
        {NULL, "fg.params.colors", 2, {90, 48}, "fg.params.colors", "SH for colours"},
        {NULL, "fg.params.motion_coefs", 2, {90, 5}, "motion_coefs", "more weights than bases"},
        {NULL, "motion_bases.params.transls", 3, {4, 11, 3}, "transls", "a frame too few"},
        {NULL, "motion_bases.params.rots", 3, {0, 12, 6}, "0 bases", "no bases"},
        {NULL, "motion_bases.params.rots", 3, {4, 12, 6}, "none of the 90", "no rotations"},
        {NULL, "bg.params.means", 2, {5, 3}, "bg.params.quats", "half a background"},
    };
    const char *path = path_in(new_folder(), "last.ckpt");
    struct pth pth;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        load(from, &pth);
        if (lies[i].drop)
            pth_drop(&pth, lies[i].drop);
        if (lies[i].put)
            pth_put(&pth, lies[i].put, lies[i].n_dims, lies[i].shape);
        pth_save(&pth, path);
        model_fails(FROM, path, NULL, "last.ckpt", lies[i].word, lies[i].what);
        pth_free(&pth);
    }
    fails(FROM, new_folder(), "checkpoints/last.ckpt", "a folder without checkpoints");
    ok(read_truncations(FROM, from) == 0, "no truncation can be read");
    survive_flips(FROM, from);
}

TAP_MAIN
{
    const char *from = check_fixture("shapeofmotion/fg_only_k4/checkpoints/last.ckpt");

    spin_log_set_level(-2);
    if (!from) {
        skip("shapeofmotion fixtures", "there are none here");
        return;
    }
    test_rows(from);
    test_lies(from);
}
