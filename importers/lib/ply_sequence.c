#include "importers/lib/ply_sequence.h"

#include <stdlib.h>
#include <string.h>

#include "io/file.h"

/* ---- Recognising ----------------------------------------------------------------------------- */

int spin_ply_sequence_probe(const struct spin_peek *peek)
{
    int n_files = spin_file_sequence_count(peek, ".ply"), n_folders = 0;
    bool tree = false, deformed = false;

    for (size_t i = 0; peek->names && peek->names[i]; i++) {
        const char *name = peek->names[i];

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

static spin_status find_folders(const char *folder, char **names, struct spin_file_sequence *seq)
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
            SPIN_TRY(spin_file_sequence_add(seq, path, spin_path_number(names[i])));
    }
    return SPIN_OK;
}

static spin_status find_in_folder(const char *folder, char **names, struct spin_file_sequence *seq)
{
    char *path = NULL;

    SPIN_TRY(spin_file_sequence_list(folder, ".ply", seq));
    if (seq->n_frames > 0)
        return SPIN_OK;
    SPIN_TRY(find_model(folder, &path));
    if (!path)
        SPIN_TRY(find_iteration(folder, &path));
    if (path)
        return spin_file_sequence_add(seq, path, -1);
    SPIN_TRY(find_folders(folder, names, seq));
    if (seq->n_frames == 0)
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s' holds neither PLY files nor folders with "
                         "point_cloud/iteration_*/point_cloud.ply",
                         folder);
    return SPIN_OK;
}

spin_status spin_ply_sequence_find(const char *path, struct spin_file_sequence *seq)
{
    char **names = NULL;
    size_t n = 0;
    spin_status status;

    if (!spin_path_is_folder(path))
        return spin_file_sequence_find(path, ".ply", seq);
    SPIN_TRY(spin_folder_list(path, &names, &n));
    status = find_in_folder(path, names, seq);
    spin_folder_list_free(names);
    return status;
}
