/* What the tests of data set readers share: small sets made here, comparing with expected.npz. */
#ifndef SPIN_TESTS_IMPORTERS_SETS_H
#define SPIN_TESTS_IMPORTERS_SETS_H

#include "io/image.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"
#include "tests/importers/runs.h"

static inline void make_folder(const char *folder, const char *name)
{
    if (spin_folder_make(path_in(folder, name)) != SPIN_OK)
        exit(1);
}

/* A grey image; its folder exists. */
static inline void make_image(const char *folder, const char *name, int width, int height)
{
    uint8_t *rgb = calloc((size_t)width * (size_t)height, 3);

    if (!rgb || spin_image_write(path_in(folder, name), width, height, rgb, false) != SPIN_OK) {
        printf("# %s\n", spin_last_error());
        exit(1);
    }
    free(rgb);
}

static inline void make_file(const char *folder, const char *name, const void *bytes, size_t n)
{
    FILE *file = fopen(path_in(folder, name), "wb");

    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0)
        exit(1);
}

static inline void make_text(const char *folder, const char *name, const char *text)
{
    make_file(folder, name, text, strlen(text));
}

/* folder/name is another name of the file `target`. */
static inline void make_link(const char *target, const char *folder, const char *name)
{
    char *absolute = NULL;

    if (spin_path_absolute(target, &absolute) != SPIN_OK ||
        symlink(absolute, path_in(folder, name)) != 0)
        exit(1);
    free(absolute);
}

static inline void set_refused(const char *folder, const char *from, const char *word,
                               const char *what)
{
    struct spin_views views;
    spin_status status = spin_views_open(folder, from, &views, NULL, 0);
    bool good = status != SPIN_OK && (!word || strstr(spin_last_error(), word)) &&
                strchr(spin_last_error(), '\n') == NULL;

    ok(good, "%s", what);
    if (!good)
        printf("#   %s\n", status == SPIN_OK ? "it was read" : spin_last_error());
    if (status == SPIN_OK)
        spin_views_free(&views);
}

/* Reads, or says why not. */
static inline bool set_opens(const char *folder, const char *from, struct spin_views *views,
                             const char *what)
{
    bool good = spin_views_open(folder, from, views, NULL, 0) == SPIN_OK;

    ok(good, "%s", what);
    if (!good)
        printf("#   %s\n", spin_last_error());
    return good;
}

/* The view whose image path ends in `ending`, or NULL. */
static inline const struct spin_view *view_of(const struct spin_views *views, const char *ending)
{
    for (size_t i = 0; i < views->n; i++) {
        size_t n = strlen(views->view[i].path), n_ending = strlen(ending);

        if (n >= n_ending && strcmp(views->view[i].path + n - n_ending, ending) == 0)
            return &views->view[i];
    }
    return NULL;
}

/* w2c as [4][4] floats. */
static inline void pose_of(const struct spin_view *view, float out[16])
{
    for (int j = 0; j < 16; j++)
        out[j] = j < 12 ? (float)view->camera.w2c[j] : j == 15;
}

/* Every truncation of a file is refused, or read without harm. Returns how many were read. */
static inline int set_truncations(const char *folder, const char *name, const char *from)
{
    const char *path = path_in(folder, name);
    struct spin_map map = {0};
    size_t size;
    int n_good = 0;

    if (spin_map_open(path, &map) != SPIN_OK)
        exit(1);
    size = map.size;
    spin_map_close(&map);
    while (size-- > 0) {
        struct spin_views views;

        if (truncate(path, (off_t)size) == 0 &&
            spin_views_open(folder, from, &views, NULL, 0) == SPIN_OK) {
            n_good++;
            spin_views_free(&views);
        }
    }
    return n_good;
}

/* Folders among a fixture's altered files: "cases" of its manifest. */
static inline void set_cases(const char *folder, const char *from, const spin_json *manifest)
{
    const spin_json *cases = spin_json_get(manifest, "cases");

    for (size_t i = 0; i < spin_json_length(cases); i++) {
        const spin_json *c = spin_json_at(cases, i);
        const char *file = spin_json_string(spin_json_get(c, "file"));
        const char *expect = spin_json_string(spin_json_get(c, "expect"));
        const char *path = file ? path_in(folder, file) : folder;
        struct spin_views views;
        spin_status status;

        if (!file || !expect || !spin_path_is_folder(path))
            continue;
        status = spin_views_open(path, from, &views, NULL, 0);
        if (status == SPIN_OK)
            spin_views_free(&views);
        if (strcmp(expect, "error") == 0)
            ok(status != SPIN_OK, "%s is refused", file);
        else
            ok(1, "%s is survived (expect '%s')", file, expect);
    }
}

/* Calls `test` for each fixture folder whose name begins with `kind`. */
static inline void each_set(const char *kind, void (*test)(const char *folder, const char *name,
                                                           const spin_json *manifest))
{
    const char *root = check_fixture("datasets");
    char **names = NULL;
    size_t n = 0;

    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip(kind, "there are no fixtures of data sets here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        const char *folder = path_in(root, names[i]);
        spin_json *manifest =
            strncmp(names[i], kind, strlen(kind)) == 0 ? load_manifest(folder) : NULL;

        if (manifest)
            test(folder, names[i], manifest);
        spin_json_free(manifest);
    }
    spin_folder_list_free(names);
}

#endif
