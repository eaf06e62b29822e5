/* Which importer every fixture is recognised as, without --from.
 * K: detect import d3dgs tc3dgs deformable3dgs grid4d dash 4dgaussian modecgs 3dgstream realtime4dgs
 * K: rotor4dgs omg4 ply */
#include "tests/importers/runs.h"

/* A '*' stands for every folder there. */
static const struct {
    const char *path, *importer; /* NULL: none */
} known[] = {
    {"tc3dgs/trained", "tc3dgs"},
    {"tc3dgs/trained/params.npz", "tc3dgs"},
    {"d3dgs/cloud", "d3dgs"},
    {"d3dgs/cloud/params.npz", "d3dgs"},
    {"d3dgs/trained", "d3dgs"},
    {"d3dgs/trained/params.npz", "d3dgs"},
    {"deformable3dgs/*/model", "deformable3dgs"},
    {"grid4d/*/model", "grid4d"},
    {"dash/*/model", "dash"},
    {"4dgaussian/*/model", "4dgaussian"},
    {"modecgs/*/model", "modecgs"},
    {"3dgstream", "3dgstream"},
    {"3dgstream/fvv", "3dgstream"},
    {"realtime4dgs/*", "realtime4dgs"},
    {"rotor4dgs/*", "rotor4dgs"},
    {"omg4/comp_xz", "omg4"},
    {"omg4/ftgs_xz", "omg4"},
    {"omg4/stale_chkpnt", "realtime4dgs"}, /* whose checkpoint it is */
    {"ply/inria_sh3", "ply"},
    {"ply/inria_sh0_varN", "ply"},
    {"ply/gsplat_sh2", "ply"},
    {"ply/brush_sh1", "ply"},
    {"ply/supersplat_compressed", "ply"},
    {"datasets/panoptic_mini", NULL},
};

static void check(const char *path, const char *name, const char *importer)
{
    const struct spin_importer *found = NULL;
    spin_status status = spin_importer_find(path, NULL, false, &found);
    bool good = importer ? status == SPIN_OK && strcmp(found->name, importer) == 0
                         : status == SPIN_E_NOT_RECOGNISED;

    ok(good, "%s: %s", name, importer ? importer : "is no run");
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
        if (spin_path_is_folder(path))
            check(rest[0] ? path_in(path, rest + 1) : path, name, importer);
    }
    spin_folder_list_free(names);
}

TAP_MAIN
{
    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        const char *star = strstr(known[i].path, "/*"), *root;
        char first[100];

        snprintf(first, sizeof first, "%.*s",
                 star ? (int)(star - known[i].path) : (int)strlen(known[i].path), known[i].path);
        root = check_fixture(first);
        if (!root)
            skip(known[i].path, "it is not here");
        else if (star)
            check_all(root, first, star + 2, known[i].importer);
        else
            check(root, known[i].path, known[i].importer);
    }
}
