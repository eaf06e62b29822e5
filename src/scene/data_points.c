#include "scene/data_points.h"

#include <ctype.h>
#include <sys/stat.h>

#include "base/base.h"
#include "io/file.h"

/* Smallest file with points: an empty points3D.bin has 8 bytes. */
enum { EMPTY = 8 };

static const char *const models[] = {"sparse/0", "sparse", "sparse_", "colmap/sparse/0", "."};
static const char *const files[] = {"points3D.bin", "points3D.txt"};
static const char *const clouds[] = {"init_pt_cld.npz",
                                     "points3D_multipleview.ply",
                                     "points3D_downsample2.ply",
                                     "points3D_downsample.ply",
                                     "points3D.ply",
                                     "points3d.ply",
                                     "fused.ply",
                                     "sparse_pc.ply"};
enum {
    N_MODELS = sizeof models / sizeof *models,
    N_FILES = sizeof files / sizeof *files,
    N_CLOUDS = sizeof clouds / sizeof *clouds
};

static bool is_filled(const char *path)
{
    struct stat st;

    return stat(path, &st) == 0 && S_ISREG(st.st_mode) && st.st_size > EMPTY;
}

/* Sets *out to the first file of points of a COLMAP model in this folder, or to NULL. */
static spin_status find_model_points(const char *folder, char **out)
{
    *out = NULL;
    for (size_t i = 0; i < N_MODELS * N_FILES; i++) {
        char name[64];

        snprintf(name, sizeof name, "%s/%s", models[i / N_FILES], files[i % N_FILES]);
        SPIN_TRY(spin_path_join(folder, strncmp(name, "./", 2) == 0 ? name + 2 : name, out));
        if (is_filled(*out))
            return SPIN_OK;
        free(*out);
        *out = NULL;
    }
    return SPIN_OK;
}

/* Returns the length of the word in the name of a frame's folder, such as "frame000001", "frame_1"
 * and "colmap_1"; 0 for other names. */
static size_t frame_word(const char *name)
{
    static const char *const words[] = {"frame_", "frame", "colmap_"};

    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        size_t n = strlen(words[i]);

        if (strncmp(name, words[i], n) == 0 && isdigit((unsigned char)name[n]) &&
            strspn(name + n, "0123456789") == strlen(name + n))
            return n;
    }
    return 0;
}

/* The first frame folder that has points, and the number of frame folders whose points have the
 * same path below the folder. */
struct frames {
    char *first;
    const char *name, *rest; /* the folder's name; the path below it */
    int n;
};

static spin_status count_frame(const char *folder, const char *name, struct frames *f)
{
    SPIN_FREED char *frame = NULL, *path = NULL;

    SPIN_TRY(spin_path_join(folder, name, &frame));
    if (f->n > 0) {
        SPIN_TRY(spin_path_join(frame, f->rest, &path));
        f->n += is_filled(path);
        return SPIN_OK;
    }
    SPIN_TRY(find_model_points(frame, &f->first));
    if (f->first) {
        f->name = name;
        f->rest = f->first + strlen(frame) + 1;
        f->n = 1;
    }
    return SPIN_OK;
}

/* Sets *path to a pattern for the points of all frames. */
static spin_status make_pattern(const char *folder, const struct frames *f, char **path)
{
    size_t n = strlen(f->name) + strlen(f->rest) + 8;
    SPIN_FREED char *name = NULL;

    SPIN_TRY(spin_alloc(n, 1, (void **)&name));
    snprintf(name, n, "%.*s%%d/%s", (int)frame_word(f->name), f->name, f->rest);
    return spin_path_join(folder, name, path);
}

static spin_status find_frame_points(const char *folder, char **path, bool *per_frame)
{
    struct frames f = {0};
    char **names = NULL;
    size_t n = 0;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_folder_list(folder, &names, &n));
    for (size_t i = 0; i < n && status == SPIN_OK; i++)
        if (frame_word(names[i]) > 0)
            status = count_frame(folder, names[i], &f);
    *path = f.first;
    *per_frame = f.n > 1;
    if (status == SPIN_OK && *per_frame) {
        char *first = f.first; /* f.rest points into it */

        *path = NULL;
        status = make_pattern(folder, &f, path);
        free(first);
    }
    spin_folder_list_free(names);
    return status;
}

spin_status spin_data_points(const char *folder, char **path, bool *per_frame)
{
    *per_frame = false;
    SPIN_TRY(find_model_points(folder, path));
    if (!*path)
        SPIN_TRY(find_frame_points(folder, path, per_frame));
    for (size_t i = 0; i < N_CLOUDS && !*path; i++) {
        SPIN_TRY(spin_path_join(folder, clouds[i], path));
        if (is_filled(*path))
            break;
        free(*path);
        *path = NULL;
    }
    return SPIN_OK;
}

static bool is_cloud(const char *name)
{
    bool found = false;

    for (size_t i = 0; i < N_CLOUDS; i++)
        found = found || strcmp(name, clouds[i]) == 0;
    return found;
}

bool spin_holds_only_points(const char *folder)
{
    char **names = NULL;
    size_t n = 0, n_clouds = 0, n_others = 0;

    if (spin_folder_list(folder, &names, &n) != SPIN_OK)
        return false;
    for (size_t i = 0; i < n; i++) {
        n_clouds += is_cloud(names[i]);
        n_others += !is_cloud(names[i]) && spin_text_ends_any_case(names[i], ".ply");
    }
    spin_folder_list_free(names);
    return n_clouds > 0 && n_others == 0;
}
