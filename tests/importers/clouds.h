/* Clouds made by tests: a fixture's PLY with some of its properties, rows or values changed; and
 * the settings of a run with one word replaced. */
#ifndef SPIN_TESTS_IMPORTERS_CLOUDS_H
#define SPIN_TESTS_IMPORTERS_CLOUDS_H

#include "io/ply.h"
#include "tests/importers/models.h"

enum { CLOUD_MOST = 512 };

struct cloud {
    char name[CLOUD_MOST][64];
    float *column[CLOUD_MOST]; /* [n] each */
    int n_columns;
    size_t n;
};

static inline void cloud_free(struct cloud *c)
{
    for (int i = 0; i < c->n_columns; i++)
        free(c->column[i]);
    memset(c, 0, sizeof *c);
}

static inline void cloud_load(const char *path, struct cloud *c)
{
    const struct spin_ply_element *e;
    struct spin_ply ply;

    memset(c, 0, sizeof *c);
    if (spin_ply_open(path, &ply) != SPIN_OK || !(e = spin_ply_find_element(&ply, "vertex")) ||
        e->n_properties > CLOUD_MOST) {
        printf("# no cloud at '%s'\n", path);
        exit(1);
    }
    c->n = (size_t)e->count;
    for (; c->n_columns < (int)e->n_properties; c->n_columns++) {
        float **column = &c->column[c->n_columns];

        snprintf(c->name[c->n_columns], sizeof c->name[0], "%s", e->property[c->n_columns].name);
        *column = malloc((c->n + 1) * sizeof **column);
        spin_ply_column(&ply, e, c->n_columns, *column, 1);
    }
    spin_ply_close(&ply);
}

/* The values of a property; NULL when there is none. */
static inline float *cloud_find(struct cloud *c, const char *name)
{
    for (int i = 0; i < c->n_columns; i++) {
        if (strcmp(c->name[i], name) == 0)
            return c->column[i];
    }
    return NULL;
}

static inline void cloud_drop(struct cloud *c, const char *name)
{
    for (int i = 0; i < c->n_columns; i++) {
        if (strcmp(c->name[i], name) != 0)
            continue;
        free(c->column[i]);
        c->n_columns--;
        memmove(c->name[i], c->name[i + 1], (size_t)(c->n_columns - i) * sizeof c->name[0]);
        memmove(&c->column[i], &c->column[i + 1], (size_t)(c->n_columns - i) * sizeof c->column[0]);
        return;
    }
    printf("# no property '%s'\n", name);
    exit(1);
}

/* A property of zeros. */
static inline float *cloud_add(struct cloud *c, const char *name)
{
    snprintf(c->name[c->n_columns], sizeof c->name[0], "%s", name);
    c->column[c->n_columns] = calloc(c->n + 1, sizeof(float));
    return c->column[c->n_columns++];
}

static inline void cloud_save(const struct cloud *c, const char *path)
{
    FILE *file = fopen(path, "wb");

    if (!file)
        exit(1);
    fprintf(file, "ply\nformat binary_little_endian 1.0\nelement vertex %zu\n", c->n);
    for (int i = 0; i < c->n_columns; i++)
        fprintf(file, "property float %s\n", c->name[i]);
    fprintf(file, "end_header\n");
    for (size_t row = 0; row < c->n; row++) {
        for (int i = 0; i < c->n_columns; i++)
            fwrite(&c->column[i][row], sizeof(float), 1, file);
    }
    if (fclose(file) != 0)
        exit(1);
}

/* Replaces the first occurrence of `word` in a text file by `by`. */
static inline void replace_text(const char *path, const char *word, const char *by)
{
    char text[8192], changed[8400];
    FILE *file = fopen(path, "rb");
    size_t n = file ? fread(text, 1, sizeof text - 1, file) : 0;
    char *at;

    text[n] = '\0';
    at = strstr(text, word);
    if (!file || !at) {
        printf("# '%s' has no '%s'\n", path, word);
        exit(1);
    }
    fclose(file);
    snprintf(changed, sizeof changed, "%.*s%s%s", (int)(at - text), text, by, at + strlen(word));
    write_text(path, changed);
}

/* Truncates the file to every length from one byte less than the whole: one by one near both
 * ends, and to at most 300 lengths between them. Reading the model at `path` must fail each time
 * with a message that names the file. Restores the file. */
static inline void cut_everywhere(const char *from, const char *path, const char *const *pairs,
                                  const char *folder, const char *name)
{
    const char *file = path_in(folder, name), *copy = path_in(new_folder(), name);
    struct spin_map map;
    size_t size, step, n = 0, n_read = 0, n_unnamed = 0;

    copy_file(file, copy);
    if (spin_map_open(copy, &map) != SPIN_OK)
        exit(1);
    size = map.size;
    spin_map_close(&map);
    step = size / 300 + 1;
    for (size_t to = size; to-- > 0; n++) {
        struct run run;

        if (to > 300 && to + 200 < size)
            to -= to % step;
        if (truncate(file, (off_t)to) != 0)
            exit(1);
        if (model_open(from, path, pairs, &run) == SPIN_OK)
            n_read++;
        else
            n_unnamed += !strstr(spin_last_error(), name);
        run_close(&run);
    }
    copy_file(copy, file);
    ok(n_read == 0 && n_unnamed == 0, "%s: none of %zu truncations of %s is read", from, n, name);
    if (n_read || n_unnamed)
        printf("#   %zu were read, %zu messages without the name\n", n_read, n_unnamed);
}

#endif
