#include "importers/lib/ply_sequence.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "base/mem.h"
#include "io/file.h"

/* ---- Recognising ----------------------------------------------------------------------------- */

static bool ends_with(const char *text, const char *end)
{
    size_t n = strlen(text), n_end = strlen(end);

    return n >= n_end && strcasecmp(text + n - n_end, end) == 0;
}

/* "input.ply" is the point cloud that training began with. */
static bool is_frame_name(const char *name)
{
    return name[0] != '.' && ends_with(name, ".ply") && strcmp(name, "input.ply") != 0;
}

int spin_ply_sequence_probe(const struct spin_peek *peek)
{
    int n_files = 0, n_folders = 0;
    bool tree = false, deformed = false;

    for (size_t i = 0; peek->names && peek->names[i]; i++) {
        const char *name = peek->names[i];

        n_files += is_frame_name(name);
        n_folders += strncmp(name, "frame", 5) == 0 && !strchr(name, '.');
        tree = tree || strcmp(name, "point_cloud") == 0 || strncmp(name, "iteration_", 10) == 0;
        deformed = deformed || strcmp(name, "deformation.pth") == 0;
    }
    if (deformed) /* the canonical cloud of 4DGaussians, not a frame */
        return 20;
    if (n_files > 0)
        return 70;
    return n_folders > 0 ? 50 : tree ? 40 : 0;
}

/* ---- Finding the files ----------------------------------------------------------------------- */

/* Takes path. */
static spin_status add_frame(struct spin_ply_sequence *seq, char *path, long long number)
{
    spin_status status = SPIN_OK;

    if (number > INT_MAX)
        status =
            spin_fail(SPIN_E_UNSUPPORTED, "'%s': frame number %lld is too large", path, number);
    if (status == SPIN_OK && seq->n_frames == seq->capacity) {
        size_t capacity = seq->capacity ? 2 * seq->capacity : 64;
        void *block = seq->frame;

        status = spin_grow(capacity, sizeof *seq->frame, &block);
        if (status == SPIN_OK) {
            seq->frame = block;
            seq->capacity = capacity;
        }
    }
    if (status != SPIN_OK) {
        free(path);
        return status;
    }
    seq->frame[seq->n_frames++] = (struct spin_ply_frame){.path = path, .number = (int)number};
    return SPIN_OK;
}

/* <folder>/iteration_<largest>/point_cloud.ply; *out stays NULL when there is none. */
static spin_status find_iteration(const char *folder, char **out)
{
    char **names = NULL, *path = NULL;
    size_t n = 0;
    long long best = -1;
    spin_status status;

    SPIN_TRY(spin_folder_list(folder, &names, &n));
    for (size_t i = 0; i < n; i++) {
        char relative[300];
        long long iteration;

        if (strncmp(names[i], "iteration_", 10) != 0)
            continue;
        iteration = spin_path_number(names[i]);
        if (iteration <= best || strlen(names[i]) > 256)
            continue;
        snprintf(relative, sizeof relative, "%s/point_cloud.ply", names[i]);
        SPIN_TRY_OUT(spin_path_join(folder, relative, &path));
        if (spin_path_exists(path)) {
            free(*out);
            *out = path;
            path = NULL;
            best = iteration;
        }
        free(path);
        path = NULL;
    }
    status = SPIN_OK;
out:
    spin_folder_list_free(names);
    return status;
}

/* The cloud of a model folder: point_cloud/iteration_<n>/point_cloud.ply or point_cloud.ply. */
static spin_status find_model(const char *folder, char **out)
{
    char *path = NULL;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_path_join(folder, "point_cloud", &path));
    if (spin_path_is_folder(path))
        status = find_iteration(path, out);
    free(path);
    if (status != SPIN_OK || *out)
        return status;
    SPIN_TRY(spin_path_join(folder, "point_cloud.ply", &path));
    if (spin_path_exists(path))
        *out = path;
    else
        free(path);
    return SPIN_OK;
}

static spin_status find_flat(const char *folder, char **names, struct spin_ply_sequence *seq)
{
    for (size_t i = 0; names[i]; i++) {
        char *path = NULL;

        if (!is_frame_name(names[i]))
            continue;
        SPIN_TRY(spin_path_join(folder, names[i], &path));
        SPIN_TRY(add_frame(seq, path, spin_path_number(names[i])));
    }
    return SPIN_OK;
}

static spin_status find_folders(const char *folder, char **names, struct spin_ply_sequence *seq)
{
    for (size_t i = 0; names[i]; i++) {
        char *sub = NULL, *path = NULL;
        spin_status status = SPIN_OK;

        if (spin_path_number(names[i]) < 0)
            continue;
        SPIN_TRY(spin_path_join(folder, names[i], &sub));
        if (spin_path_is_folder(sub))
            status = find_model(sub, &path);
        free(sub);
        SPIN_TRY(status);
        if (path)
            SPIN_TRY(add_frame(seq, path, spin_path_number(names[i])));
    }
    return SPIN_OK;
}

static spin_status find_in_folder(const char *folder, char **names, struct spin_ply_sequence *seq)
{
    char *path = NULL;

    SPIN_TRY(find_flat(folder, names, seq));
    if (seq->n_frames > 0)
        return SPIN_OK;
    SPIN_TRY(find_model(folder, &path));
    if (!path)
        SPIN_TRY(find_iteration(folder, &path));
    if (path)
        return add_frame(seq, path, -1);
    SPIN_TRY(find_folders(folder, names, seq));
    if (seq->n_frames == 0)
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s' holds neither PLY files nor folders with "
                         "point_cloud/iteration_*/point_cloud.ply",
                         folder);
    return SPIN_OK;
}

spin_status spin_ply_sequence_find(const char *path, struct spin_ply_sequence *seq)
{
    char **names = NULL, *copy = NULL;
    size_t n = 0;
    spin_status status;

    if (spin_path_is_folder(path)) {
        SPIN_TRY(spin_folder_list(path, &names, &n));
        status = find_in_folder(path, names, seq);
        spin_folder_list_free(names);
        return status;
    }
    SPIN_TRY(spin_strdup(path, &copy));
    return add_frame(seq, copy, spin_path_number(path));
}

static int by_number(const void *a, const void *b)
{
    const struct spin_ply_frame *x = a, *y = b;

    if (x->number != y->number)
        return x->number < y->number ? -1 : 1;
    return strcmp(x->path, y->path);
}

spin_status spin_ply_sequence_sort(struct spin_ply_sequence *seq,
                                   struct spin_sequence_info *sequence)
{
    const struct spin_ply_frame *f;
    size_t n_numbered = 0;
    long long missing;

    qsort(seq->frame, seq->n_frames, sizeof *seq->frame, by_number);
    f = seq->frame;
    for (size_t i = 0; i < seq->n_frames; i++)
        n_numbered += f[i].number >= 0;
    if (n_numbered == 0) {
        if (seq->n_frames > 1)
            snprintf(sequence->notes, sizeof sequence->notes,
                     "file names have no numbers: frames are in the order of the names\n");
        return SPIN_OK;
    }
    if (n_numbered < seq->n_frames)
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s' has no frame number in its name, but '%s' has: a folder must hold "
                         "the frames of one clip only",
                         f[0].path, spin_path_name(f[seq->n_frames - 1].path));
    for (size_t i = 1; i < seq->n_frames; i++) {
        if (f[i].number == f[i - 1].number)
            return spin_fail(SPIN_E_MALFORMED, "'%s' and '%s' are both frame %d", f[i - 1].path,
                             f[i].path, f[i].number);
    }
    missing = (long long)f[seq->n_frames - 1].number - f[0].number + 1 - (long long)seq->n_frames;
    for (size_t i = 1; missing > 0 && i < seq->n_frames; i++) {
        if (f[i].number > f[i - 1].number + 1) {
            snprintf(sequence->notes, sizeof sequence->notes,
                     "frame numbers have gaps: %lld missing, the first is %d\n", missing,
                     f[i - 1].number + 1);
            break;
        }
    }
    return SPIN_OK;
}

void spin_ply_sequence_free(struct spin_ply_sequence *seq)
{
    for (size_t i = 0; i < seq->n_frames; i++)
        free(seq->frame[i].path);
    free(seq->frame);
    *seq = (struct spin_ply_sequence){0};
}
