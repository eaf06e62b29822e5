/* gifstream: cfg.yml, the viewing direction, files of several ranks, and malformed files.
 * t-golden.c compares the values, t-variants.c reads altered files.
 * K: gifstream import */
#include "tests/importers/edits.h"

#define FROM "gifstream"
#define FILE_OF "ckpts/ckpt_6999_rank0.pt"

static const char *const camera[] = {"camera", "0,0,-6", NULL};

static bool opens(const char *path, const char *const *pairs, struct run *run)
{
    bool good = model_open(NULL, path, pairs, run) == SPIN_OK && !strcmp(run->importer->name, FROM);

    if (!good)
        printf("# %s\n", spin_last_error());
    return good;
}

static spin_status read_frame(struct run *run, int frame, struct spin_splats *out)
{
    return run->self ? run->importer->frame(run->self, frame, 0, run->sequence.columns, out)
                     : SPIN_E_IO;
}

static void test_views(const char *model)
{
    static const char *const two[] = {"camera", "0,0,-6;1,1,1", NULL};
    struct spin_splats seen = {0}, all = {0};
    struct run run;
    size_t k = 0;

    ok(opens(model, NULL, &run) && run.sequence.columns == SPIN_COL_MEANS &&
           run.sequence.identity && read_frame(&run, 3, &all) == SPIN_OK && all.n == 200 &&
           strstr(run.sequence.notes, "positions only") && run.sequence.numbers[9] == 9,
       "without --camera, there are the positions of all offsets");
    run_close(&run);
    ok(opens(model, camera, &run) && run.sequence.n_frames == 10 && !run.sequence.identity &&
           read_frame(&run, 3, &seen) == SPIN_OK && seen.n < 200 && seen.sh_degree == 0 &&
           strstr(run.sequence.notes, "first camera"),
       "with --camera, those that are seen");
    for (size_t i = 0; i < all.n && k < seen.n; i++)
        k += memcmp(all.means + 3 * i, seen.means + 3 * k, 12) == 0;
    ok(k == seen.n, "which are rows of the former, in order");
    ok(read_frame(&run, 10, &seen) == SPIN_E_NOT_FOUND, "frames end with the GOP");
    run_close(&run);
    model_fails(NULL, model, two, NULL, "one position", "two positions");
    spin_splats_free(&seen);
    spin_splats_free(&all);
}

static void test_settings(const char *model)
{
    static const struct lie lies[] = {
        {"cfg.yml", "text GOP_size: 10=>GOP_size: 11", "GOP_size is 11", "another GOP"},
        {"cfg.yml", "text GOP_size: 10=>GOP_size: ten", "GOP_size is 'ten'", "a word for a number"},
        {"cfg.yml", "text phi: 2=>phi: nan", "phi is 'nan'", "no number"},
        {"cfg.yml", "text n_knn: 6=>n_knn: 65", "n_knn is '65'", "too many neighbours"},
    };
    const char *copy = copy_of(model), *config = path_in(new_folder(), "c.yml");
    const char *const pairs[] = {"camera", "0,0,-6", "config", config, NULL};
    struct run run;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++)
        model_fails(FROM, edited(model, "cfg.yml", lies[i].edits), NULL, "cfg.yml", lies[i].word,
                    lies[i].what);
    copy_file(path_in(copy, "cfg.yml"), config);
    remove(path_in(copy, "cfg.yml"));
    model_fails(NULL, copy, NULL, copy, "--config", "no cfg.yml");
    ok(opens(copy, pairs, &run), "one that is given");
    run_close(&run);
    copy = edited(model, "cfg.yml",
                  "text start_frame: 0=>start_frame: 60;"
                  "text normalize_world_space: false=>normalize_world_space: true");
    ok(opens(path_in(copy, "ckpts"), camera, &run) && run.sequence.numbers[0] == 60 &&
           strstr(run.sequence.notes, "normalised the world"),
       "frames of a later GOP, in a world that was normalised");
    run_close(&run);
    copy = edited(model, "cfg.yml", "text knn: false=>knn: true;text n_knn: 6=>n_knn: 40");
    model_fails(FROM, copy, NULL, copy, "more than n_knn", "as many neighbours as anchors");
    copy = edited(model, "cfg.yml", "text view_adaptive: true=>view_adaptive: false");
    model_fails(FROM, copy, NULL, copy, "mlp_opacity.0.weight", "a network with more inputs");
}

static void test_ranks(const char *model, const char *other)
{
    const char *copy = copy_of(model), *second = path_in(copy, "ckpts/ckpt_6999_rank1.pt");
    struct spin_splats one = {0}, two = {0};
    struct run run;

    ok(opens(copy, camera, &run) && read_frame(&run, 2, &one) == SPIN_OK, "one rank");
    run_close(&run);
    copy_file(path_in(copy, FILE_OF), second);
    ok(opens(copy, camera, &run) && read_frame(&run, 2, &two) == SPIN_OK && two.n == 2 * one.n &&
           memcmp(two.sh + 3 * one.n, one.sh, 12 * one.n) == 0,
       "the anchors of two ranks, one after the other");
    run_close(&run);
    copy_file(path_in(copy, FILE_OF), path_in(copy, "ckpts/ckpt_5999_rank0.pt"));
    ok(opens(copy, camera, &run) && strstr(run.sequence.variant, "80 anchors"), "the last step");
    run_close(&run);
    copy_file(other, second);
    ok(opens(copy, camera, &run) && strstr(run.sequence.variant, "76 anchors"),
       "ranks may have other numbers of anchors");
    run_close(&run);
    copy_file(path_in(model, "cfg.yml"), second);
    model_fails(FROM, copy, NULL, "ckpt_6999_rank1.pt", "", "a second rank that is damaged");
    spin_splats_free(&one);
    spin_splats_free(&two);
}

static void test_files(const char *model)
{
    const char *copy = new_folder();

    if (spin_folder_make(path_in(copy, "compression/rank0")) != SPIN_OK)
        exit(1);
    model_fails(FROM, copy, NULL, copy, "compression/", "compressed streams alone");
    model_fails(FROM, new_folder(), NULL, NULL, "ckpt_<step>_rank0.pt", "an empty folder");
    refuse_containers(FROM, model, NULL, FILE_OF);
    refuse_cuts(FROM, model, NULL, FILE_OF);
    survive_flips(FROM, path_in(copy_of(model), FILE_OF));
}

TAP_MAIN
{
    const char *model = check_fixture("gifstream/view_app");
    const char *other = check_fixture("gifstream/entropy_knn/ckpts/ckpt_29999_rank0.pt");

    spin_log_set_level(-2);
    if (!model || !other) {
        skip("gifstream fixtures", "there are none here");
        return;
    }
    test_views(model);
    test_settings(model);
    test_ranks(model, other);
    test_files(model);
}
