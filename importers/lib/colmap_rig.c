/* Finds the frames of a camera rig whose cameras are in a sparse model of COLMAP. */
#include "importers/lib/colmap.h"

#include <ctype.h>
#include <strings.h>

#include "io/video.h"

/* ---- Names ----------------------------------------------------------------------------------- */

bool spin_colmap_is_other(const char *name)
{
    static const char *const others[] = {"images", "sparse", "mask",   "depth",
                                         "seg",    "normal", "colmap", "stereo"};

    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (strncasecmp(name, others[i], strlen(others[i])) == 0)
            return true;
    return name[0] == '.';
}

/* Returns the length of a path without the extension of its last component. */
static size_t stem_length(const char *path)
{
    const char *name = spin_path_name(path), *dot = strrchr(name, '.');

    return dot && dot > name ? (size_t)(dot - path) : strlen(path);
}

spin_status spin_colmap_picture(struct spin_model *m, const char *folder, const char *name,
                                const char **out)
{
    static const char *const endings[] = {".png", ".jpg", ".jpeg", ".JPG", ".PNG", ".webp"};
    const char *other;

    SPIN_TRY(spin_model_name(m, folder, name, &name));
    SPIN_TRY(spin_model_join(m, out, folder, "%s", name));
    if (spin_path_exists(*out))
        return SPIN_OK;
    for (size_t i = 0; i < 2 * sizeof endings / sizeof *endings; i++) {
        size_t n = i % 2 ? strlen(name) : stem_length(name);

        SPIN_TRY(spin_model_find(m, &other, folder, "%.*s%s", (int)n, name, endings[i / 2]));
        if (other) {
            *out = other;
            return SPIN_OK;
        }
    }
    return SPIN_OK;
}

/* Returns the length of the part of an image's name that is the name of its camera: the folder or,
 * if there is none, the name without its extension. */
static size_t camera_part(const char *name)
{
    const char *end = strrchr(name, '/');

    return end ? (size_t)(end - name) : stem_length(name);
}

static bool has_camera_word(const char *name)
{
    for (const char *at = name; *at; at++)
        if (strncasecmp(at, "cam", 3) == 0 && (at == name || !isalpha((unsigned char)at[-1])))
            return true;
    return false;
}

/* Splits the name of an image into the name of its camera, the first *n_camera bytes of *camera,
 * and a frame number, as in cam00_0012.png, cam00/0012.png and 0012/cam00.png. Returns false if
 * there is no frame number. */
static bool split_name(const char *name, const char **camera, size_t *n_camera, int *frame)
{
    size_t end = stem_length(name), base = (size_t)(spin_path_name(name) - name), from;

    while (end > base && !isdigit((unsigned char)name[end - 1]))
        end--;
    for (from = end; from > base && isdigit((unsigned char)name[from - 1]);)
        from--;
    *camera = name;
    *n_camera = from;
    while (*n_camera > 0 && strchr("_-./ ", name[*n_camera - 1]))
        (*n_camera)--;
    if (from == end)
        return false;
    if (strcspn(name + base, "0123456789") < from - base || !has_camera_word(name + base)) {
        *frame = (int)strtol(name + from, NULL, 10);
        return *n_camera > 0 && end - from < 10;
    }
    if (base == 0) /* the only number is that of the camera */
        return false;
    *camera = name + base;
    *n_camera = stem_length(name) - base;
    for (end = base - 1; end > 0 && !isdigit((unsigned char)name[end - 1]);)
        end--;
    for (from = end; from > 0 && isdigit((unsigned char)name[from - 1]) && end - from < 9;)
        from--;
    *frame = (int)strtol(name + from, NULL, 10);
    return from < end;
}

/* ---- All frames in the model, or in one folder ----------------------------------------------- */

/* An image file: the camera and the frame number in its name, and the image of the model, or NULL
 * if the model does not contain it. */
struct picture {
    const char *camera;
    size_t n_camera;
    int frame;
    const char *path;
    const struct spin_colmap_image *image;
};

static int by_camera_and_frame(const void *a, const void *b)
{
    const struct picture *x = a, *y = b;
    size_t n = x->n_camera < y->n_camera ? x->n_camera : y->n_camera;
    int order = memcmp(x->camera, y->camera, n);

    if (order == 0 && x->n_camera != y->n_camera)
        order = x->n_camera < y->n_camera ? -1 : 1;
    return order ? order : (x->frame > y->frame) - (x->frame < y->frame);
}

static bool is_same_camera(const struct picture *a, const struct picture *b)
{
    return a->n_camera == b->n_camera && memcmp(a->camera, b->camera, a->n_camera) == 0;
}

static int by_int_frame(const void *a, const void *b)
{
    const struct picture *x = a, *y = b;

    return (x->frame > y->frame) - (x->frame < y->frame);
}

/* Sets *out to whether the images p [n], sorted by camera and frame, form a rig: at least two
 * cameras and two frames, no duplicates, and at least half of the images that a complete rig would
 * have. Sets *n_cameras to the number of cameras. */
static spin_status is_grid(struct spin_model *m, const struct picture *p, size_t n,
                           size_t *n_cameras, bool *out)
{
    struct picture *sorted;
    size_t n_frames = n > 0;
    bool unique = true;

    *n_cameras = n > 0;
    SPIN_TRY(spin_model_alloc(m, n, sizeof *sorted, (void **)&sorted));
    for (size_t i = 1; i < n; i++) {
        *n_cameras += !is_same_camera(&p[i], &p[i - 1]);
        unique = unique && (!is_same_camera(&p[i], &p[i - 1]) || p[i].frame != p[i - 1].frame);
    }
    if (n > 0)
        memcpy(sorted, p, n * sizeof *p);
    qsort(sorted, n, sizeof *sorted, by_int_frame);
    for (size_t i = 1; i < n; i++)
        n_frames += sorted[i].frame != sorted[i - 1].frame;
    *out = unique && *n_cameras > 1 && n_frames > 1 && 2 * n >= *n_cameras * n_frames;
    return SPIN_OK;
}

/* Fills the frames of one camera from its n images. */
static spin_status fill_camera(struct spin_model *m, const struct picture *p, size_t n,
                               struct spin_rig_camera *c)
{
    SPIN_TRY(spin_model_text(m, &c->name, "%.*s", (int)p->n_camera, p->camera));
    c->where = c->name;
    SPIN_TRY(spin_file_sequence_reserve(m, &c->frames, n));
    if (p->image)
        SPIN_TRY(spin_model_alloc(m, n, sizeof *c->moving, (void **)&c->moving));
    for (size_t i = 0; i < n; i++) {
        spin_file_sequence_add(&c->frames, p[i].path, p[i].path);
        c->frames.frame[i].number = p[i].frame;
        if (p->image)
            c->moving[i] = p[i].image->camera;
    }
    return SPIN_OK;
}

static spin_status fill_rig(struct spin_model *m, struct picture *p, size_t n, size_t n_cameras,
                            struct spin_colmap_rig *out)
{
    SPIN_TRY(spin_model_alloc(m, n_cameras, sizeof *out->camera, (void **)&out->camera));
    for (size_t i = 0, k; i < n; i = k) {
        for (k = i + 1; k < n && is_same_camera(&p[i], &p[k]);)
            k++;
        SPIN_TRY(fill_camera(m, p + i, k - i, &out->camera[out->n++]));
    }
    return SPIN_OK;
}

/* Builds a rig from the images of the model if all their names consist of a camera name and a frame
 * number. */
static spin_status find_grid(const struct spin_colmap *m, const char *images,
                             struct spin_colmap_rig *out)
{
    struct picture *p;
    size_t n_cameras;
    bool grid;

    SPIN_TRY(spin_model_alloc(m->base, m->n_images, sizeof *p, (void **)&p));
    for (size_t i = 0; i < m->n_images; i++) {
        p[i].image = &m->image[i];
        if (!split_name(m->image[i].name, &p[i].camera, &p[i].n_camera, &p[i].frame))
            return SPIN_OK;
        SPIN_TRY(spin_colmap_picture(m->base, images, m->image[i].name, &p[i].path));
    }
    qsort(p, m->n_images, sizeof *p, by_camera_and_frame);
    SPIN_TRY(is_grid(m->base, p, m->n_images, &n_cameras, &grid));
    return grid ? fill_rig(m->base, p, m->n_images, n_cameras, out) : SPIN_OK;
}

/* Lists the images of the folder that belong to a camera of the model. */
static spin_status list_flat(const struct spin_colmap *m, const char *images, struct picture **out,
                             size_t *n)
{
    char **names;
    size_t n_names;

    SPIN_TRY(spin_model_names(m->base, images, &names, &n_names));
    SPIN_TRY(spin_model_alloc(m->base, n_names, sizeof **out, (void **)out));
    for (size_t i = 0; i < n_names; i++) {
        struct picture p = {0}, of;

        if (names[i][0] == '.' || !split_name(names[i], &p.camera, &p.n_camera, &p.frame))
            continue;
        for (size_t k = 0; k < m->n_images && !p.path; k++) {
            if (split_name(m->image[k].name, &of.camera, &of.n_camera, &of.frame) &&
                is_same_camera(&p, &of))
                SPIN_TRY(spin_model_join(m->base, &p.path, images, "%s", names[i]));
        }
        if (p.path)
            (*out)[(*n)++] = p;
    }
    return SPIN_OK;
}

/* Builds a rig from the images of the folder if it contains further frames of the cameras of the
 * model, such as cam00_0001.png for the image cam00_0000.png. */
static spin_status find_flat(const struct spin_colmap *m, const char *images,
                             struct spin_colmap_rig *out)
{
    struct picture *p, of;
    size_t n = 0, n_cameras;
    bool grid;

    if (!spin_path_is_folder(images))
        return SPIN_OK;
    SPIN_TRY(list_flat(m, images, &p, &n));
    qsort(p, n, sizeof *p, by_camera_and_frame);
    SPIN_TRY(is_grid(m->base, p, n, &n_cameras, &grid));
    if (!grid || n_cameras != m->n_images)
        return SPIN_OK;
    SPIN_TRY(fill_rig(m->base, p, n, n_cameras, out));
    for (size_t k = 0; k < m->n_images; k++) {
        split_name(m->image[k].name, &of.camera, &of.n_camera, &of.frame);
        for (size_t i = 0; i < out->n; i++)
            if (strlen(out->camera[i].name) == of.n_camera &&
                memcmp(out->camera[i].name, of.camera, of.n_camera) == 0)
                out->camera[i].camera = m->image[k].camera;
    }
    return SPIN_OK;
}

/* ---- A folder or a video for each camera ----------------------------------------------------- */

/* A folder of frames or a video. */
struct source {
    const char *name; /* name of the folder, or of the video without its extension */
    const char *where;
    bool film, used;
};

static spin_status has_frames(const char *folder, bool *out)
{
    char **names = NULL;
    size_t n_names = 0, n_frames = 0;

    *out = false;
    if (!spin_path_is_folder(folder))
        return SPIN_OK;
    SPIN_TRY(spin_folder_list(folder, &names, &n_names));
    for (size_t k = 0; k < n_names; k++)
        n_frames += names[k][0] != '.' && spin_views_number(names[k]) >= 0;
    spin_folder_list_free(names);
    *out = n_frames > 1;
    return SPIN_OK;
}

/* Lists the videos in `parent`, and the folders there that contain frames, directly or in their
 * subfolder images. */
static spin_status list_sources(struct spin_model *m, const char *parent, struct source **out,
                                size_t *n)
{
    char **names;
    size_t n_names;

    *n = 0;
    if (!spin_path_is_folder(parent))
        return SPIN_OK;
    SPIN_TRY(spin_model_names(m, parent, &names, &n_names));
    SPIN_TRY(spin_model_alloc(m, n_names, sizeof **out, (void **)out));
    for (size_t i = 0; i < n_names; i++) {
        struct source s = {.film = spin_video_is_name(names[i])};
        bool found = s.film;

        SPIN_TRY(spin_model_join(m, &s.where, parent, "%s/images", names[i]));
        if (s.film || !spin_path_is_folder(s.where))
            SPIN_TRY(spin_model_join(m, &s.where, parent, "%s", names[i]));
        if (!s.film)
            SPIN_TRY(has_frames(s.where, &found));
        SPIN_TRY(spin_model_text(m, &s.name, "%.*s",
                                 (int)(s.film ? stem_length(names[i]) : strlen(names[i])),
                                 names[i]));
        if (found)
            (*out)[(*n)++] = s;
    }
    return SPIN_OK;
}

/* Assigns to each camera a folder or, if there is none, a video whose name `fits` accepts. No
 * folder or video is assigned twice. Returns false if a camera gets none, or if some cameras get
 * folders and others videos. */
static bool assign(struct spin_rig_camera *c, size_t n, struct source *s, size_t n_sources,
                   bool (*fits)(const char *camera, const char *source), bool *film)
{
    for (size_t k = 0; k < n_sources; k++)
        s[k].used = false;
    for (size_t i = 0; i < n; i++) {
        struct source *found = NULL;

        for (size_t k = 0; k < n_sources; k++)
            if (!s[k].used && fits(c[i].name, s[k].name) && (!found || found->film))
                found = &s[k];
        if (!found || (i > 0 && found->film != *film))
            return false;
        found->used = true;
        *film = found->film;
        c[i].where = found->where;
    }
    return true;
}

static bool has_same_name(const char *camera, const char *source)
{
    return strcmp(camera, source) == 0 || strcmp(spin_path_name(camera), source) == 0;
}

/* In the layout MultipleView of 4DGaussians, the model's image image1.jpg belongs to the folder
 * cam01. */
static bool has_same_number(const char *camera, const char *source)
{
    return !spin_colmap_is_other(source) && spin_views_number(camera) >= 0 &&
           spin_views_number(camera) == spin_views_number(source);
}

/* If there are as many folders of frames as cameras, assigns them in the order of names. */
static bool assign_in_order(struct spin_rig_camera *c, size_t n, const struct source *s,
                            size_t n_sources, const char *images)
{
    if (n_sources != n)
        return false;
    for (size_t i = 0; i < n; i++)
        c[i].where = s[i].where;
    spin_warn("'%s': the folders of frames are not named like the cameras of the model: '%s' "
              "is used for '%s', and so on in the order of their names",
              images, s[0].name, c[0].name);
    return true;
}

static size_t count_folders(struct source *s, size_t n)
{
    size_t kept = 0;

    for (size_t k = 0; k < n; k++)
        if (!s[k].film)
            s[kept++] = s[k];
    return kept;
}

/* Sets c[i].where to the folder in `images` that has the name of camera i, as in FreeTimeGS, and
 * *found to whether all these folders contain frames. */
static spin_status find_folders(const struct spin_colmap *m, const char *images,
                                struct spin_rig_camera *c, bool *found)
{
    *found = true;
    for (size_t i = 0; i < m->n_images && *found; i++) {
        SPIN_TRY(spin_model_join(m->base, &c[i].where, images, "%s", c[i].name));
        SPIN_TRY(has_frames(c[i].where, found));
    }
    return SPIN_OK;
}

/* Finds the folder or the video of each camera in `images` or in one of some usual folders of the
 * data set. Sets *found to whether every camera has one. */
static spin_status find_sources(const struct spin_colmap *m, const char *path, const char *images,
                                struct spin_rig_camera *c, bool *found, bool *film)
{
    static const char *const places[] = {"images", ".", "videos", "frames"};
    const char *parent = images;
    struct source *s;
    size_t n;

    SPIN_TRY(find_folders(m, images, c, found));
    for (size_t i = 0; i <= sizeof places / sizeof *places && !*found; i++) {
        if (i > 0)
            SPIN_TRY(spin_model_join(m->base, &parent, path, "%s", places[i - 1]));
        SPIN_TRY(list_sources(m->base, parent, &s, &n));
        *found = assign(c, m->n_images, s, n, has_same_name, film) ||
                 assign(c, m->n_images, s, n, has_same_number, film);
    }
    if (*found || spin_model_holds(images, m->image[0].name))
        return SPIN_OK;
    SPIN_TRY(list_sources(m->base, images, &s, &n));
    *film = false;
    *found = n > 0 && assign_in_order(c, m->n_images, s, count_folders(s, n), images);
    return SPIN_OK;
}

static spin_status find_rig(const struct spin_colmap *m, const char *path, const char *images,
                            struct spin_colmap_rig *out)
{
    struct spin_rig_camera *c;
    bool found, film = false;

    SPIN_TRY(spin_model_alloc(m->base, m->n_images, sizeof *c, (void **)&c));
    for (size_t i = 0; i < m->n_images; i++) {
        const char *name = m->image[i].name;

        c[i].camera = m->image[i].camera;
        SPIN_TRY(spin_model_text(m->base, &c[i].name, "%.*s", (int)camera_part(name), name));
    }
    if (spin_rig_sort(m->sparse, c, m->n_images) != SPIN_OK)
        return SPIN_OK; /* a camera has several images in the model, which therefore is not a rig */
    SPIN_TRY(find_sources(m, path, images, c, &found, &film));
    if (!found)
        return SPIN_OK;
    for (size_t i = 0; i < m->n_images; i++) {
        c[i].film = film;
        if (!film)
            SPIN_TRY(spin_rig_pictures(m->base, &c[i], c[i].where));
    }
    out->camera = c;
    out->n = m->n_images;
    return SPIN_OK;
}

spin_status spin_colmap_find_rig(const struct spin_colmap *m, const char *path, const char *images,
                                 struct spin_colmap_rig *out)
{
    *out = (struct spin_colmap_rig){0};
    SPIN_TRY(find_rig(m, path, images, out));
    if (out->n == 0)
        SPIN_TRY(find_grid(m, images, out));
    return out->n == 0 ? find_flat(m, images, out) : SPIN_OK;
}
