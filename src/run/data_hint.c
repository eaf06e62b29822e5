#include "run/data_hint.h"

#include "base/base.h"
#include "io/file.h"
#include "io/json.h"
#include "scene/probe.h"

/* At most this many entries of the parent folder are examined. */
#define MAX_BESIDE 64

struct found {
    const struct spin_importer *importer; /* importer of the first data set */
    char *path;                           /* path of the first data set */
    int n;                                /* number of data sets */
};

/* If `path` is a data set, counts it, and keeps its path if it is the first one. Takes ownership of
 * `path`. */
static void count_data_set(struct found *found, char *path)
{
    const struct spin_importer *importer =
        path && spin_path_is_folder(path) ? spin_importer_guess(path, true) : NULL;

    found->n += importer != NULL;
    if (found->n != 1 || !importer) {
        free(path);
        return;
    }
    found->importer = importer;
    found->path = path;
}

static void search_folder(struct found *found, const char *input, const char *folder)
{
    char **names = NULL, *path;
    size_t n = 0;

    if (spin_folder_list(folder, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n && i < MAX_BESIDE; i++) {
        if (strcmp(names[i], spin_path_name(input)) == 0 ||
            spin_path_join(folder, names[i], &path) != SPIN_OK)
            continue;
        /* Skip other runs: a data set inside a run belongs to that run. */
        if (spin_importer_guess(path, false))
            free(path);
        else
            count_data_set(found, path);
    }
    spin_folder_list_free(names);
}

static struct found find_data_sets(const char *input)
{
    struct found found = {0};
    SPIN_FREED char *absolute = NULL, *folder = NULL;
    char *copy = NULL;

    spin_inputs_pause(true);
    if (spin_path_absolute(input, &absolute) == SPIN_OK &&
        spin_path_folder(absolute, &folder) == SPIN_OK) {
        if (spin_strdup(absolute, &copy) == SPIN_OK)
            count_data_set(&found, copy);
        copy = NULL;
        if (found.n == 0 && spin_strdup(folder, &copy) == SPIN_OK)
            count_data_set(&found, copy);
        if (found.n == 0)
            search_folder(&found, absolute, folder);
    }
    spin_inputs_pause(false);
    return found;
}

char *spin_data_beside(const char *input)
{
    struct found found = find_data_sets(input);

    if (found.n == 1)
        return found.path;
    free(found.path);
    return NULL;
}

void spin_data_hint(const char *input, char *text, size_t n_text)
{
    struct found found = find_data_sets(input);

    text[0] = '\0';
    if (found.n == 1)
        snprintf(
            text, n_text,
            "a data set (%s) was found beside the run: use --data '%s' if the run was trained on "
            "it\n",
            found.importer->name, found.path);
    else if (found.n > 1)
        snprintf(text, n_text,
                 "%d data sets were found beside the run, one of them in '%s': use --data to name "
                 "the one that the run was trained on\n",
                 found.n, found.path);
    free(found.path);
}

bool spin_data_has_focal(const char *folder)
{
    static const char *const names[] = {"transforms_train.json", "transforms.json"};
    bool found = false;

    for (int i = 0; i < 2 && !found; i++) {
        SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
        SPIN_FREED char *path = NULL;

        if (spin_path_join(folder, names[i], &path) == SPIN_OK && spin_path_exists(path) &&
            spin_json_load(path, &root) == SPIN_OK)
            found = spin_json_get(root, "fl_x") ||
                    spin_json_get(spin_json_at(spin_json_get(root, "frames"), 0), "fl_x");
    }
    return found;
}
