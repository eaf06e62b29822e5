/* Copies of a model with malformed files: tensors, properties and settings edited by a few
 * words.
 *
 *     drop NAME [A B]        deletes a tensor or a property; or those named NAME followed by A to B
 *     put NAME [D D ...]     zeros of that shape, or one for each row
 *     set NAME I VALUE       one value, or all if I is '*'; VALUE may be +X, or =J: that of index J
 *     rows N                 keeps the first N rows of a cloud
 *     pair                   a pair of dicts instead of one, or the reverse
 *     swap                   exchanges the dicts of a pair
 *     real NAME              floats instead of integers
 *     text OLD=>NEW          in a text file
 *
 * separated by ';'. */
#ifndef SPIN_TESTS_IMPORTERS_EDITS_H
#define SPIN_TESTS_IMPORTERS_EDITS_H

#include "tests/importers/clouds.h"
#include "tests/importers/golden.h"

/* Copies a folder with everything below it to a new one. */
static inline void copy_folder_to(const char *from, const char *to)
{
    char **names = NULL;
    size_t n = 0;

    if (spin_folder_make(to) != SPIN_OK || spin_folder_list(from, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        const char *path = path_in(from, names[i]), *copy = path_in(to, names[i]);

        if (spin_path_is_folder(path))
            copy_folder_to(path, copy);
        else
            copy_file(path, copy);
    }
    spin_folder_list_free(names);
}

static inline const char *copy_of(const char *folder)
{
    const char *to = path_in(new_folder(), spin_path_name(folder));

    copy_folder_to(folder, to);
    return to;
}

static inline void edit_values(float *values, size_t n, const char *rest)
{
    char *end;
    size_t at = strtoull(rest, &end, 10);
    bool all = rest[strspn(rest, " ")] == '*';
    const char *value = all ? strchr(rest, '*') + 1 : end;

    value += strspn(value, " ");
    for (size_t i = 0; i < n; i++) {
        if (all || i == at)
            values[i] = *value == '=' ? values[strtoull(value + 1, NULL, 10)]
                                      : strtof(value, NULL) + (*value == '+' ? values[i] : 0);
    }
}

static inline void edit_tensors(struct pth *pth, const char *word, const char *name,
                                const char *rest)
{
    uint64_t shape[5];
    int n_dims = 0;
    char *end;

    if (strcmp(word, "drop") == 0) {
        pth_drop(pth, name);
    } else if (strcmp(word, "put") == 0) {
        for (; n_dims < 5 && (shape[n_dims] = strtoull(rest, &end, 10), end != rest); rest = end)
            n_dims++;
        pth_put(pth, name, n_dims, shape);
    } else if (strcmp(word, "set") == 0) {
        edit_values(pth_find(pth, name)->values, pth_find(pth, name)->count, rest);
    } else if (strcmp(word, "real") == 0) {
        pth_find(pth, name)->whole = false;
    } else if (strcmp(word, "pair") == 0) {
        for (int i = 0; i < pth->n; i++)
            pth->tensor[i].dict = 0;
        pth->pair = !pth->pair;
    } else if (strcmp(word, "swap") == 0) {
        for (int i = 0; i < pth->n; i++)
            pth->tensor[i].dict = !pth->tensor[i].dict;
    } else {
        printf("# '%s' is no edit of tensors\n", word);
        exit(1);
    }
}

static inline void edit_columns(struct cloud *c, const char *word, const char *name,
                                const char *rest)
{
    if (strcmp(word, "drop") == 0) {
        cloud_drop(c, name);
    } else if (strcmp(word, "put") == 0) {
        cloud_add(c, name);
    } else if (strcmp(word, "set") == 0 && cloud_find(c, name)) {
        edit_values(cloud_find(c, name), c->n, rest);
    } else if (strcmp(word, "rows") == 0) {
        c->n = strtoull(name, NULL, 10);
    } else {
        printf("# '%s %s' is no edit of a cloud\n", word, name);
        exit(1);
    }
}

/* The file at `path` changed, written over it. */
static inline void edit_file(const char *path, const char *edits)
{
    char *text = strdup(edits), *rest = text, *one;
    const char *dot = strrchr(path, '.');
    bool is_cloud = dot && strcmp(dot, ".ply") == 0;
    struct cloud cloud = {0};
    struct pth pth = {.n = 0};

    if (strncmp(edits, "text ", 5) == 0) {
        while ((one = strsep(&rest, ";")) != NULL) {
            char *arrow = strstr(one, "=>");

            *arrow = '\0';
            replace_text(path, one + strlen("text "), arrow + 2);
        }
        free(text);
        return;
    }
    if (is_cloud)
        cloud_load(path, &cloud);
    else
        pth_load(path, &pth);
    while ((one = strsep(&rest, ";")) != NULL) {
        char word[16] = "", name[50] = "", numbered[62];
        int n = 0, first = -1, last = -1;

        if (sscanf(one, " %15s%n %49s%n", word, &n, name, &n) < 1)
            continue;
        if (strcmp(word, "drop") != 0 || sscanf(one + n, "%d %d", &first, &last) != 2)
            first = last = -1;
        for (int i = first; i <= last; i++) {
            snprintf(numbered, sizeof numbered, i < 0 ? "%s" : "%s%d", name, i);
            if (is_cloud)
                edit_columns(&cloud, word, numbered, one + n);
            else
                edit_tensors(&pth, word, numbered, one + n);
        }
    }
    if (is_cloud)
        cloud_save(&cloud, path);
    else
        pth_save(&pth, path);
    cloud_free(&cloud);
    pth_free(&pth);
    free(text);
}

/* A copy of a model with one of its files changed; `file` as golden_path() takes it. */
static inline const char *edited(const char *model, const char *file, const char *edits)
{
    const char *copy = copy_of(model);

    edit_file(golden_path(copy, file), edits);
    return copy;
}

/* A fault of a file, and a word of the message that reports it. */
struct lie {
    const char *file, *edits, *word, *what;
};

static inline void refuse_lies(const char *from, const char *model, const char *const *pairs,
                               const struct lie *lies, size_t n)
{
    for (size_t i = 0; i < n; i++)
        model_fails(from, edited(model, lies[i].file, lies[i].edits), pairs,
                    spin_path_name(lies[i].file), lies[i].word, lies[i].what);
}

/* Replaces a model's file by each bad checkpoint that the container reader is tested with. */
static inline void refuse_containers(const char *from, const char *model, const char *const *pairs,
                                     const char *file)
{
    const char *bad = check_fixture("torch_container/malformed"), *copy = copy_of(model);
    const char *path = golden_path(copy, file);
    char **names = NULL;
    size_t n = 0;

    if (!bad || spin_folder_list(bad, &names, &n) != SPIN_OK) {
        skip("malformed containers", "there are none here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        if (!strstr(names[i], ".pth"))
            continue;
        copy_file(path_in(bad, names[i]), path);
        model_fails(from, copy, pairs, spin_path_name(file), "", names[i]);
    }
    spin_folder_list_free(names);
}

/* No truncation of a model's file is accepted, and each message names the file. */
static inline void refuse_cuts(const char *from, const char *model, const char *const *pairs,
                               const char *file)
{
    const char *copy = copy_of(model), *path = golden_path(copy, file);
    char *folder = strdup(path);

    *strrchr(folder, '/') = '\0';
    cut_everywhere(from, copy, pairs, folder, spin_path_name(path));
    free(folder);
}

#endif
