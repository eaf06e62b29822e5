/* Shared by the importers' tests: opening a run, comparing its frames with expected.npz, and
 * reading every truncation of a file. */
#ifndef SPIN_TESTS_IMPORTERS_RUNS_H
#define SPIN_TESTS_IMPORTERS_RUNS_H

#include <unistd.h>

#include "base/log.h"
#include "base/mem.h"
#include "scene/probe.h"
#include "tests/check.h"
#include "tests/tap.h"

/* folder/name; kept until the program ends. */
static inline const char *path_in(const char *folder, const char *name)
{
    static struct spin_arena arena;
    size_t n = strlen(folder) + strlen(name) + 2;
    void *path = NULL;

    if (spin_arena_take(&arena, n, 1, &path) != SPIN_OK)
        exit(1);
    snprintf(path, n, "%s/%s", folder, name);
    return path;
}

/* For some methods the repository contains fewer runs than the larger set. */
static inline bool has(const char *root, const char *name)
{
    return spin_path_exists(path_in(root, name));
}

/* The file in a folder whose name has this ending. */
static inline const char *file_in(const char *folder, const char *ending)
{
    const char *found = NULL;
    char **names = NULL;
    size_t n = 0;

    if (spin_folder_list(folder, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++)
        if (strlen(names[i]) > strlen(ending) &&
            !strcmp(names[i] + strlen(names[i]) - strlen(ending), ending))
            found = path_in(folder, names[i]);
    spin_folder_list_free(names);
    if (!found)
        exit(1);
    return found;
}

/* An empty folder; check_folder() only has a few. */
static inline const char *new_folder(void)
{
    static const char *parent;
    static int count;
    char name[16];
    const char *path;

    if (!parent)
        parent = check_folder();
    snprintf(name, sizeof name, "%d", count++);
    path = path_in(parent, name);
    if (spin_folder_make(path) != SPIN_OK)
        exit(1);
    return path;
}

struct run {
    const struct spin_importer *importer;
    void *self;
    struct spin_sequence_info sequence;
};

static inline void run_close(struct run *run)
{
    if (run->self)
        run->importer->close(run->self);
    run->self = NULL;
}

/* On failure everything is closed. */
static inline spin_status run_open(const char *from, const char *path, struct run *run)
{
    spin_status status;

    memset(run, 0, sizeof *run);
    status = spin_importer_find(path, from, false, &run->importer);
    if (status == SPIN_OK)
        status = run->importer->open(path, NULL, &run->self, &run->sequence);
    if (status != SPIN_OK)
        run_close(run);
    return status;
}

/* Every frame with every column; the trail stays for the caller. */
static inline spin_status read_all(const char *from, const char *path)
{
    struct spin_splats s = {0};
    struct run run;
    spin_status status = run_open(from, path, &run);

    for (int f = 0; status == SPIN_OK && f < run.sequence.n_frames; f++)
        status = run.importer->frame(run.self, f, 0, run.sequence.columns, &s);
    run_close(&run);
    spin_splats_free(&s);
    return status;
}

/* Reading fails with a message that contains this word (NULL: any). */
static inline void fails(const char *from, const char *path, const char *word, const char *what)
{
    spin_status status = read_all(from, path);
    bool good = status != SPIN_OK && (!word || strstr(spin_last_error(), word));

    ok(good, "%s", what);
    if (!good)
        printf("#   status %d, '%s'\n", status, status == SPIN_OK ? "" : spin_last_error());
}

static inline spin_json *load_manifest(const char *folder)
{
    const char *path = path_in(folder, "manifest.json");
    spin_json *manifest = NULL;

    if (!spin_path_exists(path) || spin_json_load(path, &manifest) != SPIN_OK)
        return NULL;
    return manifest;
}

static inline double manifest_tolerance(const spin_json *manifest, const char *key, double fallback)
{
    double value = fallback;

    spin_json_number(spin_json_get(spin_json_get(manifest, "tolerance"), key), &value);
    return value;
}

/* The tolerance in a fixture's manifest: both numbers of "abs 1e-4 + rel 1e-3", or of two with a
 * comma; otherwise the first. */
struct bound {
    double abs, rel;
};

static const char *bounds_of; /* the fixture's folder, for bound() */

/* `b` is used if a manifest has no tolerance. */
static inline struct bound bound_or(const char *key, struct bound b)
{
    spin_json *manifest = load_manifest(bounds_of);
    const spin_json *all = spin_json_get(manifest, "tolerance");
    const spin_json *entry = spin_json_get(all ? all : spin_json_get(manifest, "tolerances"), key);
    const char *text = spin_json_string(entry), *plus = text ? strpbrk(text, "+,") : NULL;

    if (!spin_json_number(entry, &b.abs) && text)
        sscanf(text, "abs %lf", &b.abs);
    if (plus && sscanf(plus + 1, " rel %lf", &b.rel) != 1 && *plus == '+')
        sscanf(plus + 1, " %lf", &b.rel);
    spin_json_free(manifest);
    return b;
}

static inline struct bound bound(const char *key)
{
    struct bound b = bound_or(key, (struct bound){NAN, 0});

    if (isnan(b.abs))
        ok(0, "%s: its manifest has a tolerance of %s", bounds_of, key);
    return b;
}

/* Compares activated attributes with `count` expected values that begin at `first`. */
struct expected {
    struct spin_npz *npz;
    double abs, rel;
    const char *name; /* for the test's line */
};

static inline void compare(const struct expected *e, const char *key, uint64_t first, size_t count,
                           const float *got)
{
    struct spin_array info;
    double *want = check_load(e->npz, key, &info);
    char what[300];

    if (!want)
        return;
    snprintf(what, sizeof what, "%s: %s", e->name, key);
    if (first + count > info.count)
        ok(0, "%s: %llu values expected, %zu read", what, (unsigned long long)info.count, count);
    else
        check_close(got, want + first, count, e->abs, e->rel, what);
    free(want);
}

static inline float *map_values(const float *in, size_t n, double (*fn)(double))
{
    float *out = malloc(n * sizeof *out + 1);

    for (size_t i = 0; i < n; i++)
        out[i] = (float)fn(in[i]);
    return out;
}

static inline double sigmoid(double x) { return 1 / (1 + exp(-x)); }

/* q and -q are the same rotation: choose the expected sign. */
static inline void compare_quats(const struct expected *e, const char *key, uint64_t first,
                                 size_t n, const float *quats)
{
    struct spin_array info;
    double *want = check_load(e->npz, key, &info);
    float *turned = malloc(4 * n * sizeof *turned + 1);

    for (size_t i = 0; want && first + 4 * n <= info.count && i < n; i++) {
        const double *w = want + first + 4 * i;
        const float *q = quats + 4 * i;
        double dot = q[0] * w[0] + q[1] * w[1] + q[2] * w[2] + q[3] * w[3];

        for (int c = 0; c < 4; c++)
            turned[4 * i + (size_t)c] = dot < 0 ? -q[c] : q[c];
    }
    if (want)
        compare(e, key, first, 4 * n, turned);
    free(turned);
    free(want);
}

/* Truncates the file `copy`, which the run at `path` contains, to up to 800 lengths, longest
 * first (every length if it has at most 2000 bytes); reading must fail or succeed, and not
 * crash. Returns how many could still be read. */
static inline int read_cuts(const char *from, const char *path, const char *copy)
{
    struct spin_map map;
    size_t size, step;
    int n_good = 0, n = 0;

    if (spin_map_open(copy, &map) != SPIN_OK)
        return -1;
    size = map.size;
    spin_map_close(&map);
    step = size > 2000 ? size / 400 : 1;
    while (size > 0 && n++ < (step > 1 ? 800 : 2000)) {
        /* One by one near both ends, in steps between them. */
        size -= n < 200 || size < 200 || size < step ? 1 : step;
        if (truncate(copy, (off_t)size) != 0)
            break;
        n_good += read_all(from, path) == SPIN_OK;
    }
    return n_good;
}

/* The same for a copy of a file that is the whole run. */
static inline int read_truncations(const char *from, const char *path)
{
    const char *copy = path_in(new_folder(), spin_path_name(path));
    struct spin_map map;
    FILE *file;

    if (spin_map_open(path, &map) != SPIN_OK || !(file = fopen(copy, "wb")) ||
        fwrite(map.data, 1, map.size, file) != map.size || fclose(file) != 0) {
        ok(0, "copies '%s'", path);
        return -1;
    }
    spin_map_close(&map);
    return read_cuts(from, copy, copy);
}

#endif
