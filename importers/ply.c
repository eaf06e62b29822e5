/* PLY: one 3DGS cloud, or a folder with one cloud per frame.
 *
 * There is no standard for sequences. Folders of numbered files and folders of per-frame folders
 * with the INRIA tree inside are read; frames go by the last number in the name. Properties are
 * looked up by name, so any writer's order will do. Besides Gaussians three other kinds are known:
 * plain points, with colours or without, which give positions only, and SuperSplat's compressed
 * layout. */
#include "spin.h"

#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "importers/lib/notes.h"
#include "io/ply.h"
#include "math/quat.h"
#include "math/sh.h"

/* Where an opacity of exactly 0 or 1 ends up: sigmoid(30) rounds to 1 in float32. */
#define LOGIT_LIMIT 30.0f
#define CHUNK 256 /* vertices per chunk of the compressed layout */

enum kind { POINTS, COLOURED, GAUSSIANS, COMPRESSED };

struct frame_file {
    char *path;
    int number; /* -1: none */
    size_t n;
};

struct clip {
    struct frame_file *frame;
    size_t n_frames, capacity;
    int *numbers;   /* [n_frames] */
    size_t *counts; /* [n_frames] */
    enum kind kind;
    int sh_degree; /* largest of all frames */
    char **names;  /* vertex properties of the first frame but f_rest_*; NULL-terminated */
    size_t n_names;
    bool warned_scale, warned_opacity, warned_extra;
};

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

static int probe_folder(const struct spin_peek *peek)
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

static int probe(const struct spin_peek *peek)
{
    if (peek->is_folder)
        return probe_folder(peek);
    return peek->n_head >= 4 && memcmp(peek->head, "ply", 3) == 0 &&
                   (peek->head[3] == '\n' || peek->head[3] == '\r')
               ? 90
               : 0;
}

/* ---- Finding the files ----------------------------------------------------------------------- */

/* Takes path. */
static spin_status add_frame(struct clip *clip, char *path, long long number)
{
    spin_status status = SPIN_OK;

    if (number > INT_MAX)
        status =
            spin_fail(SPIN_E_UNSUPPORTED, "'%s': frame number %lld is too large", path, number);
    if (status == SPIN_OK && clip->n_frames == clip->capacity) {
        size_t capacity = clip->capacity ? 2 * clip->capacity : 64;
        void *block = clip->frame;

        status = spin_grow(capacity, sizeof *clip->frame, &block);
        if (status == SPIN_OK) {
            clip->frame = block;
            clip->capacity = capacity;
        }
    }
    if (status != SPIN_OK) {
        free(path);
        return status;
    }
    clip->frame[clip->n_frames++] = (struct frame_file){.path = path, .number = (int)number};
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

static spin_status find_flat(const char *folder, char **names, struct clip *clip)
{
    for (size_t i = 0; names[i]; i++) {
        char *path = NULL;

        if (!is_frame_name(names[i]))
            continue;
        SPIN_TRY(spin_path_join(folder, names[i], &path));
        SPIN_TRY(add_frame(clip, path, spin_path_number(names[i])));
    }
    return SPIN_OK;
}

static spin_status find_folders(const char *folder, char **names, struct clip *clip)
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
            SPIN_TRY(add_frame(clip, path, spin_path_number(names[i])));
    }
    return SPIN_OK;
}

static spin_status find_in_folder(const char *folder, char **names, struct clip *clip)
{
    char *path = NULL;

    SPIN_TRY(find_flat(folder, names, clip));
    if (clip->n_frames > 0)
        return SPIN_OK;
    SPIN_TRY(find_model(folder, &path));
    if (!path)
        SPIN_TRY(find_iteration(folder, &path));
    if (path)
        return add_frame(clip, path, -1);
    SPIN_TRY(find_folders(folder, names, clip));
    if (clip->n_frames == 0)
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s' holds neither PLY files nor folders with "
                         "point_cloud/iteration_*/point_cloud.ply",
                         folder);
    return SPIN_OK;
}

static spin_status find_files(const char *path, struct clip *clip)
{
    char **names = NULL, *copy = NULL;
    size_t n = 0;
    spin_status status;

    if (spin_path_is_folder(path)) {
        SPIN_TRY(spin_folder_list(path, &names, &n));
        status = find_in_folder(path, names, clip);
        spin_folder_list_free(names);
        return status;
    }
    SPIN_TRY(spin_strdup(path, &copy));
    return add_frame(clip, copy, spin_path_number(path));
}

static int by_number(const void *a, const void *b)
{
    const struct frame_file *x = a, *y = b;

    if (x->number != y->number)
        return x->number < y->number ? -1 : 1;
    return strcmp(x->path, y->path);
}

/* Numeric order; "frame_10" comes after "frame_9". Without any numbers the order of the names. */
static spin_status sort_frames(struct clip *clip, struct spin_sequence_info *sequence)
{
    const struct frame_file *f;
    size_t n_numbered = 0;
    long long missing;

    qsort(clip->frame, clip->n_frames, sizeof *clip->frame, by_number);
    f = clip->frame;
    for (size_t i = 0; i < clip->n_frames; i++)
        n_numbered += f[i].number >= 0;
    if (n_numbered == 0) {
        if (clip->n_frames > 1)
            snprintf(sequence->notes, sizeof sequence->notes,
                     "file names have no numbers: frames are in the order of the names\n");
        return SPIN_OK;
    }
    if (n_numbered < clip->n_frames)
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s' has no frame number in its name, but '%s' has: a folder must hold "
                         "the frames of one clip only",
                         f[0].path, spin_path_name(f[clip->n_frames - 1].path));
    for (size_t i = 1; i < clip->n_frames; i++) {
        if (f[i].number == f[i - 1].number)
            return spin_fail(SPIN_E_MALFORMED, "'%s' and '%s' are both frame %d", f[i - 1].path,
                             f[i].path, f[i].number);
    }
    missing = (long long)f[clip->n_frames - 1].number - f[0].number + 1 - (long long)clip->n_frames;
    for (size_t i = 1; missing > 0 && i < clip->n_frames; i++) {
        if (f[i].number > f[i - 1].number + 1) {
            snprintf(sequence->notes, sizeof sequence->notes,
                     "frame numbers have gaps: %lld missing, the first is %d\n", missing,
                     f[i - 1].number + 1);
            break;
        }
    }
    return SPIN_OK;
}

/* ---- What a file holds ----------------------------------------------------------------------- */

static bool has(const struct spin_ply_element *e, const char *name)
{
    return spin_ply_find(e, name) >= 0;
}

static bool has_prefix(const struct spin_ply_element *e, const char *prefix)
{
    for (size_t i = 0; i < e->n_properties; i++) {
        if (strncmp(e->property[i].name, prefix, strlen(prefix)) == 0)
            return true;
    }
    return false;
}

static bool is_rest(const char *name) { return strncmp(name, "f_rest_", 7) == 0; }

static const char *const gaussian_names[] = {"opacity", "scale_0", "scale_1", "scale_2",
                                             "rot_0",   "rot_1",   "rot_2",   "rot_3"};
enum { N_GAUSSIAN_NAMES = sizeof gaussian_names / sizeof *gaussian_names };

static bool has_gaussian_names(const struct spin_ply_element *e)
{
    for (size_t i = 0; i < N_GAUSSIAN_NAMES; i++) {
        if (has(e, gaussian_names[i]))
            return true;
    }
    return has_prefix(e, "f_dc_") || has_prefix(e, "f_rest_");
}

/* A cloud whose Gaussians move by themselves is no frame. */
static spin_status check_not_4d(const struct spin_ply *ply, const struct spin_ply_element *e)
{
    const char *method = NULL, *name = "t";

    if (has_prefix(e, "trbf_") || has_prefix(e, "motion_") || has_prefix(e, "omega_")) {
        method = "SpacetimeGaussians";
        name = has_prefix(e, "trbf_")     ? "trbf_*"
               : has_prefix(e, "motion_") ? "motion_*"
                                          : "omega_*";
    } else if (has(e, "scale_t") || has_prefix(e, "rot_r_") || has_prefix(e, "scale_t_")) {
        method = "Realtime-4DGS";
        name = has_prefix(e, "rot_r_") ? "rot_r_*" : "scale_t";
    } else if (has(e, "t") && has_gaussian_names(e)) {
        method = "Realtime-4DGS or SpacetimeGaussians";
    }
    if (!method)
        return SPIN_OK;
    return spin_fail(SPIN_E_UNSUPPORTED,
                     "'%s': property '%s' says that this is a 4D model, it looks like %s, and not "
                     "the cloud of one frame",
                     ply->path, name, method);
}

static bool has_colours(const struct spin_ply_element *e)
{
    return has(e, "red") && has(e, "green") && has(e, "blue");
}

static spin_status check_gaussians(const struct spin_ply *ply, const struct spin_ply_element *e)
{
    if (has(e, "scale_0") && has(e, "scale_1") && !has(e, "scale_2"))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "'%s': no property 'scale_2': it looks like 2DGS, whose splats are flat",
                         ply->path);
    for (size_t i = 0; i < N_GAUSSIAN_NAMES; i++) {
        if (!has(e, gaussian_names[i]))
            return spin_fail(SPIN_E_MALFORMED,
                             "'%s': no property '%s', so these are not whole Gaussians", ply->path,
                             gaussian_names[i]);
    }
    for (int c = 0; c < 3 && !has_colours(e); c++) {
        char name[32];

        snprintf(name, sizeof name, "f_dc_%d", c);
        if (!has(e, name))
            return spin_fail(SPIN_E_MALFORMED,
                             "'%s': no property '%s', and no 'red', 'green', 'blue' either",
                             ply->path, name);
    }
    return SPIN_OK;
}

/* Degree from the number of f_rest_*; degree 4 (Brush) is read without its last band. */
static spin_status find_degree(const struct spin_ply *ply, const struct spin_ply_element *e,
                               int *sh_degree, int *n_rest)
{
    *n_rest = 0;
    for (size_t i = 0; e && i < e->n_properties; i++)
        *n_rest += is_rest(e->property[i].name);
    for (int i = 0; i < *n_rest; i++) {
        char name[32];

        snprintf(name, sizeof name, "f_rest_%d", i);
        if (!has(e, name))
            return spin_fail(SPIN_E_MALFORMED, "'%s': %d properties f_rest_*, but no '%s'",
                             ply->path, *n_rest, name);
    }
    for (int d = 0; d <= 4; d++) {
        if (*n_rest == 3 * ((d + 1) * (d + 1) - 1)) {
            *sh_degree = d < 3 ? d : 3;
            return SPIN_OK;
        }
    }
    return spin_fail(SPIN_E_MALFORMED,
                     "'%s': %d properties f_rest_*, expected 0, 9, 24, 45 or 72 (SH degree 0 to 4)",
                     ply->path, *n_rest);
}

static const char *const chunk_names[] = {
    "min_x",       "min_y",       "min_z",       "max_x",       "max_y",       "max_z",
    "min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z",
    "min_r",       "min_g",       "min_b",       "max_r",       "max_g",       "max_b"};
enum { N_CHUNK_NAMES = 18, N_CHUNK_NEEDED = 12 };
static const char *const packed_names[] = {"packed_position", "packed_rotation", "packed_scale",
                                           "packed_color"};

static spin_status check_compressed(const struct spin_ply *ply, const struct spin_ply_element *e)
{
    const struct spin_ply_element *chunk = spin_ply_find_element(ply, "chunk");
    const struct spin_ply_element *sh = spin_ply_find_element(ply, "sh");

    if (ply->ascii || e->has_list)
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': a compressed PLY must be binary, without lists",
                         ply->path);
    for (int i = 0; i < 4; i++) {
        int p = spin_ply_find(e, packed_names[i]);

        if (p < 0 || e->property[p].type != SPIN_PLY_U32)
            return spin_fail(SPIN_E_MALFORMED,
                             "'%s': compressed PLY without the uint property '%s'", ply->path,
                             packed_names[i]);
    }
    if (!chunk || chunk->count < e->count / CHUNK + (e->count % CHUNK != 0))
        return spin_fail(
            SPIN_E_MALFORMED,
            "'%s': compressed PLY with %llu chunks for %llu vertices, expected one for "
            "every %d",
            ply->path, (unsigned long long)(chunk ? chunk->count : 0), (unsigned long long)e->count,
            CHUNK);
    for (int i = 0; i < N_CHUNK_NEEDED; i++) {
        if (!has(chunk, chunk_names[i]))
            return spin_fail(SPIN_E_MALFORMED, "'%s': element 'chunk' has no property '%s'",
                             ply->path, chunk_names[i]);
    }
    if (sh && sh->count != e->count)
        return spin_fail(SPIN_E_MALFORMED, "'%s': element 'sh' has %llu records, 'vertex' has %llu",
                         ply->path, (unsigned long long)sh->count, (unsigned long long)e->count);
    for (size_t i = 0; sh && i < sh->n_properties; i++) {
        if (sh->property[i].type != SPIN_PLY_U8)
            return spin_fail(SPIN_E_MALFORMED, "'%s': property '%s' of element 'sh' is not uchar",
                             ply->path, sh->property[i].name);
    }
    return SPIN_OK;
}

struct content {
    const struct spin_ply_element *vertex, *rest; /* rest: the element with f_rest_* */
    enum kind kind;
    int sh_degree, n_rest;
};

static spin_status inspect(const struct spin_ply *ply, struct content *out)
{
    const struct spin_ply_element *e = spin_ply_find_element(ply, "vertex");

    memset(out, 0, sizeof *out);
    out->sh_degree = -1;
    out->vertex = out->rest = e;
    if (!e)
        return spin_fail(SPIN_E_MALFORMED, "'%s': no element 'vertex'", ply->path);
    if (e->count > UINT32_MAX)
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': more than 2^32 vertices", ply->path);
    if (has_prefix(e, "packed_")) {
        out->kind = COMPRESSED;
        out->rest = spin_ply_find_element(ply, "sh");
        SPIN_TRY(check_compressed(ply, e));
        return find_degree(ply, out->rest, &out->sh_degree, &out->n_rest);
    }
    SPIN_TRY(check_not_4d(ply, e));
    for (int i = 0; i < 3; i++) {
        const char *name = i == 0 ? "x" : i == 1 ? "y" : "z";

        if (!has(e, name))
            return spin_fail(SPIN_E_MALFORMED, "'%s': element 'vertex' has no property '%s'",
                             ply->path, name);
    }
    if (has_gaussian_names(e)) {
        out->kind = GAUSSIANS;
        SPIN_TRY(check_gaussians(ply, e));
        return find_degree(ply, e, &out->sh_degree, &out->n_rest);
    }
    out->kind = has_colours(e) ? COLOURED : POINTS;
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* What the writer said about itself, from the first frame. */
static void note_writer(const struct spin_ply *ply, const struct content *c,
                        struct spin_sequence_info *sequence)
{
    for (size_t i = 0; i < ply->n_comments; i++) {
        if (strcasecmp(ply->comment[i], "SplatRenderMode: mip") == 0 ||
            strcmp(ply->comment[i], "antialiased 1") == 0) {
            spin_note(sequence, "trained with an anti-aliasing rasteriser, and drawn so here");
            sequence->antialias = true;
        }
    }
    if (has(c->vertex, "filter_3D")) {
        spin_note(sequence,
                  "property 'filter_3D' (Mip-Splatting) is ignored: small Gaussians come out "
                  "too small");
        spin_warn("'%s': property 'filter_3D' (Mip-Splatting) is ignored", ply->path);
    }
    if (c->n_rest > 45) {
        spin_note(sequence, "SH degree 4 is cut to degree 3");
        spin_warn("'%s': SH degree 4 is cut to degree 3", ply->path);
    }
}

static spin_status keep_names(struct clip *clip, const struct spin_ply_element *e)
{
    SPIN_TRY(spin_alloc(e->n_properties + 1, sizeof *clip->names, (void **)&clip->names));
    for (size_t i = 0; i < e->n_properties; i++) {
        if (!is_rest(e->property[i].name))
            SPIN_TRY(spin_strdup(e->property[i].name, &clip->names[clip->n_names++]));
    }
    return SPIN_OK;
}

/* All frames have the same properties, in any order; only the SH degree may differ. */
static spin_status compare_names(const struct clip *clip, const struct spin_ply *ply,
                                 const struct content *c)
{
    size_t n = 0;

    for (size_t i = 0; i < c->vertex->n_properties; i++)
        n += !is_rest(c->vertex->property[i].name);
    for (size_t i = 0; i < clip->n_names; i++) {
        bool found = false;

        for (size_t k = 0; k < c->vertex->n_properties && !found; k++)
            found = strcmp(c->vertex->property[k].name, clip->names[i]) == 0;
        if (!found)
            return spin_fail(SPIN_E_MALFORMED, "'%s' has no property '%s', but '%s' has", ply->path,
                             clip->names[i], clip->frame[0].path);
    }
    if (n != clip->n_names || c->kind != clip->kind)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has other vertex properties than '%s'", ply->path,
                         clip->frame[0].path);
    return SPIN_OK;
}

static spin_status open_frame(struct clip *clip, size_t i, struct spin_sequence_info *sequence)
{
    struct spin_ply ply;
    struct content c;
    spin_status status;

    SPIN_TRY(spin_ply_open(clip->frame[i].path, &ply));
    SPIN_TRY_OUT(inspect(&ply, &c));
    clip->frame[i].n = (size_t)c.vertex->count;
    if (i == 0) {
        clip->kind = c.kind;
        SPIN_TRY_OUT(keep_names(clip, c.vertex));
        note_writer(&ply, &c, sequence);
    } else {
        SPIN_TRY_OUT(compare_names(clip, &ply, &c));
        if (c.sh_degree != clip->sh_degree && !strstr(sequence->notes, "padded"))
            spin_note(sequence, "the SH degree differs between frames: padded with zeros");
    }
    if (i == 0 || c.sh_degree > clip->sh_degree)
        clip->sh_degree = c.sh_degree;
    if (ply.extra_bytes > 0 && !clip->warned_extra) {
        clip->warned_extra = true;
        spin_warn("'%s' has %llu bytes after its last record", ply.path,
                  (unsigned long long)ply.extra_bytes);
    }
out:
    spin_ply_close(&ply);
    return status;
}

static spin_status describe(struct clip *clip, struct spin_sequence_info *sequence)
{
    static const char *const what[] = {"plain points", "coloured points", "Gaussians",
                                       "SuperSplat's compressed Gaussians"};
    size_t n_all = 0;

    SPIN_TRY(spin_alloc(clip->n_frames, sizeof *clip->numbers, (void **)&clip->numbers));
    SPIN_TRY(spin_alloc(clip->n_frames, sizeof *clip->counts, (void **)&clip->counts));
    for (size_t i = 0; i < clip->n_frames; i++) {
        clip->numbers[i] = clip->frame[i].number;
        clip->counts[i] = clip->frame[i].n;
        n_all += clip->frame[i].n;
    }
    if (n_all == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s': 0 vertices", clip->frame[0].path);
    sequence->n_frames = (int)clip->n_frames;
    sequence->numbers = clip->numbers[0] >= 0 ? clip->numbers : NULL;
    sequence->counts = clip->counts;
    sequence->columns = SPIN_COL_MEANS;
    if (clip->kind >= GAUSSIANS)
        sequence->columns |= SPIN_COL_ATTRIBUTES;
    else if (clip->kind == COLOURED)
        sequence->columns |= SPIN_COL_RGB;
    sequence->sh_degree = clip->sh_degree;
    sequence->time_last = (double)(clip->n_frames - 1);
    snprintf(sequence->variant, sizeof sequence->variant, "%s of %s",
             clip->n_frames == 1 ? "one PLY file" : "PLY files", what[clip->kind]);
    return SPIN_OK;
}

static spin_status ply_open(const char *path, const struct spin_plugin_values *values, void **self,
                            struct spin_sequence_info *sequence)
{
    struct clip *clip;

    (void)values;
    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *clip, self));
    clip = *self;
    clip->sh_degree = -1;
    SPIN_TRY(find_files(path, clip));
    if (clip->n_frames > INT_MAX)
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s' holds too many files", path);
    SPIN_TRY(sort_frames(clip, sequence));
    for (size_t i = 0; i < clip->n_frames; i++)
        SPIN_TRY(open_frame(clip, i, sequence));
    return describe(clip, sequence);
}

static void ply_close(void *self)
{
    struct clip *clip = self;

    if (!clip)
        return;
    for (size_t i = 0; i < clip->n_frames; i++)
        free(clip->frame[i].path);
    for (size_t i = 0; i < clip->n_names; i++)
        free(clip->names[i]);
    free(clip->frame);
    free(clip->names);
    free(clip->numbers);
    free(clip->counts);
    free(clip);
}

/* ---- Reading --------------------------------------------------------------------------------- */

static spin_status check_finite(const char *path, const char *what, const float *values, size_t n,
                                size_t width)
{
    size_t bad = 0, first = 0;

    for (size_t i = n * width; i-- > 0;) {
        if (!isfinite(values[i])) {
            bad++;
            first = i / width;
        }
    }
    if (bad > 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': %zu values of '%s' are not finite, the first in row %zu", path, bad,
                         what, first);
    return SPIN_OK;
}

/* +-inf is what a writer leaves that stored an opacity of exactly 1 or 0. */
static spin_status clean_logits(const char *path, float *logits, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        if (isinf(logits[i]))
            logits[i] = logits[i] > 0 ? LOGIT_LIMIT : -LOGIT_LIMIT;
    }
    return check_finite(path, "opacity", logits, n, 1);
}

static void normalise(float *quats, size_t n)
{
    for (float *q = quats; q < quats + 4 * n; q += 4)
        spin_quat_normalise(q);
}

/* Values that look as if exp or the sigmoid had been applied already: a guess, so it warns. */
static void warn_activated(struct clip *clip, const char *path, const struct spin_splats *s,
                           unsigned columns)
{
    size_t n_small = 0;
    bool positive = s->n > 0, unit = s->n > 0;

    if ((columns & SPIN_COL_LOG_SCALES) && !clip->warned_scale) {
        for (size_t i = 0; i < 3 * s->n; i++) {
            positive = positive && s->log_scales[i] > 0;
            n_small += s->log_scales[i] < 0.1f;
        }
        if (positive && 2 * n_small > 3 * s->n) {
            clip->warned_scale = true;
            spin_warn("'%s': all scales are positive and most are below 0.1; they look as if they "
                      "were not logarithms",
                      path);
        }
    }
    if ((columns & SPIN_COL_LOGIT_OPACITIES) && !clip->warned_opacity) {
        for (size_t i = 0; i < s->n; i++)
            unit = unit && s->logit_opacities[i] >= 0 && s->logit_opacities[i] <= 1;
        if (unit) {
            clip->warned_opacity = true;
            spin_warn("'%s': all opacities lie in 0..1; they look as if they were not logits",
                      path);
        }
    }
}

/* Names of properties and where their values go; spin_ply_columns() then reads all in one pass. */
struct wanted {
    struct spin_ply_target target[3 + 4 + 3 + 1 + 48];
    size_t n;
};

static void want(struct wanted *w, const struct spin_ply_element *e, const char *prefix, int n,
                 float *out, size_t step)
{
    for (int i = 0; i < n; i++) {
        char name[32];

        snprintf(name, sizeof name, "%s%d", prefix, i);
        w->target[w->n++] = (struct spin_ply_target){spin_ply_find(e, name), out + i, step};
    }
}

static void want_means(struct wanted *w, const struct spin_ply_element *e, float *means)
{
    static const char *const axis[] = {"x", "y", "z"};

    for (int i = 0; i < 3; i++)
        w->target[w->n++] = (struct spin_ply_target){spin_ply_find(e, axis[i]), means + i, 3};
}

/* f_rest_* are channel-major in the file (all of red first) and channel-last here. */
static void want_rest(struct wanted *w, const struct content *c, float *sh, size_t step)
{
    int per_channel = c->n_rest / 3;
    int kept = (c->sh_degree + 1) * (c->sh_degree + 1) - 1;

    for (int i = 0; i < 3 * kept; i++) {
        int channel = i / kept, k = i % kept;
        char name[32];

        snprintf(name, sizeof name, "f_rest_%d", channel * per_channel + k);
        w->target[w->n++] = (struct spin_ply_target){spin_ply_find(c->rest, name),
                                                     sh + 3 * (k + 1) + channel, step};
    }
}

/* red, green, blue to 0..1 at out[0..2], every `step` floats. Floats above 1 mean 0..255. */
static void read_colours(const struct spin_ply *ply, const struct spin_ply_element *e, float *out,
                         size_t step)
{
    static const char *const name[] = {"red", "green", "blue"};
    float largest = 0, whole = 1;

    for (int c = 0; c < 3; c++) {
        int p = spin_ply_find(e, name[c]);

        spin_ply_column(ply, e, p, out + c, step);
        if (e->property[p].type == SPIN_PLY_U8)
            whole = 255;
        else if (e->property[p].type == SPIN_PLY_U16)
            whole = 65535;
        for (uint64_t i = 0; i < e->count; i++)
            largest = fmaxf(largest, out[i * step + (size_t)c]);
    }
    if (whole == 1 && largest > 1)
        whole = 255;
    for (uint64_t i = 0; i < e->count; i++) {
        for (int c = 0; c < 3; c++)
            out[i * step + (size_t)c] /= whole;
    }
}

static void colours_to_sh(float *sh, size_t n, size_t step)
{
    for (size_t i = 0; i < n; i++) {
        for (int c = 0; c < 3; c++)
            sh[i * step + (size_t)c] = (float)((sh[i * step + (size_t)c] - 0.5) / SPIN_SH_C0);
    }
}

static void read_gaussians(const struct spin_ply *ply, const struct content *c, unsigned columns,
                           struct spin_splats *out)
{
    const struct spin_ply_element *e = c->vertex;
    size_t step = 3 * (size_t)((out->sh_degree + 1) * (out->sh_degree + 1));
    struct wanted w = {.n = 0};

    if (columns & SPIN_COL_MEANS)
        want_means(&w, e, out->means);
    if (columns & SPIN_COL_QUATS)
        want(&w, e, "rot_", 4, out->quats, 4);
    if (columns & SPIN_COL_LOG_SCALES)
        want(&w, e, "scale_", 3, out->log_scales, 3);
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        w.target[w.n++] =
            (struct spin_ply_target){spin_ply_find(e, "opacity"), out->logit_opacities, 1};
    if (columns & SPIN_COL_SH) {
        memset(out->sh, 0, out->n * step * sizeof *out->sh);
        want_rest(&w, c, out->sh, step);
        if (has(e, "f_dc_0") && has(e, "f_dc_1") && has(e, "f_dc_2")) {
            want(&w, e, "f_dc_", 3, out->sh, step);
        } else {
            read_colours(ply, e, out->sh, step);
            colours_to_sh(out->sh, out->n, step);
        }
    }
    spin_ply_columns(ply, e, w.target, w.n);
}

/* ---- Compressed ------------------------------------------------------------------------------ */

static uint32_t packed_at(const struct spin_ply *ply, const struct spin_ply_element *e,
                          int property, uint64_t row)
{
    const unsigned char *b =
        ply->map.data + e->data_offset + row * e->stride + e->property[property].offset;

    if (ply->big_endian)
        return (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3];
    return (uint32_t)b[3] << 24 | (uint32_t)b[2] << 16 | (uint32_t)b[1] << 8 | b[0];
}

static float lerp(float low, float high, uint32_t code, uint32_t largest)
{
    float t = (float)code / (float)largest;

    return low * (1 - t) + high * t;
}

/* 11, 10 and 11 bits between the corners of a box. */
static void unpack_box(uint32_t v, const float *low, const float *high, float out[3])
{
    out[0] = lerp(low[0], high[0], v >> 21, 2047);
    out[1] = lerp(low[1], high[1], v >> 11 & 1023, 1023);
    out[2] = lerp(low[2], high[2], v & 2047, 2047);
}

/* Two bits say which component is largest; the other three follow, in order, in 10 bits each. */
static void unpack_rotation(uint32_t v, float q[4])
{
    int largest = (int)(v >> 30), shift = 20;
    double rest = 1;

    for (int i = 0; i < 4; i++) {
        double x;

        if (i == largest)
            continue;
        x = ((v >> shift & 1023) / 1023.0 - 0.5) * sqrt(2.0);
        q[i] = (float)x;
        rest -= x * x;
        shift -= 10;
    }
    q[largest] = (float)sqrt(rest > 0 ? rest : 0);
}

static float unpack_opacity(uint32_t a)
{
    if (a == 0)
        return -LOGIT_LIMIT;
    if (a == 255)
        return LOGIT_LIMIT;
    return (float)log(a / (255.0 - a));
}

static void unpack_colour(uint32_t v, const float *low, const float *high, bool ranged, float sh[3])
{
    for (int c = 0; c < 3; c++) {
        uint32_t code = v >> (24 - 8 * c) & 255;
        float colour = ranged ? lerp(low[c], high[c], code, 255) : (float)code / 255.0f;

        sh[c] = (float)((colour - 0.5) / SPIN_SH_C0);
    }
}

/* Coefficients in -4..4 as bytes; 0 and 255 are the ends. */
static float unpack_rest(float byte)
{
    float n = byte <= 0 ? 0 : byte >= 255 ? 1 : (byte + 0.5f) / 256.0f;

    return (n - 0.5f) * 8;
}

static spin_status read_chunks(const struct spin_ply *ply, float **out, bool *ranged)
{
    const struct spin_ply_element *e = spin_ply_find_element(ply, "chunk");

    SPIN_TRY(spin_alloc((size_t)e->count, N_CHUNK_NAMES * sizeof(float), (void **)out));
    *ranged = true;
    for (int i = 0; i < N_CHUNK_NAMES; i++) {
        int p = spin_ply_find(e, chunk_names[i]);

        if (p >= 0)
            spin_ply_column(ply, e, p, *out + i, N_CHUNK_NAMES);
        else
            *ranged = false;
    }
    return SPIN_OK;
}

static spin_status read_compressed(const struct spin_ply *ply, const struct content *c,
                                   unsigned columns, struct spin_splats *out)
{
    size_t step = 3 * (size_t)((out->sh_degree + 1) * (out->sh_degree + 1));
    float *chunks = NULL;
    bool ranged = false;
    int property[4];

    SPIN_TRY(read_chunks(ply, &chunks, &ranged));
    for (int i = 0; i < 4; i++)
        property[i] = spin_ply_find(c->vertex, packed_names[i]);
    if ((columns & SPIN_COL_SH)) {
        memset(out->sh, 0, out->n * step * sizeof *out->sh);
        if (c->sh_degree > 0) {
            struct wanted w = {.n = 0};

            want_rest(&w, c, out->sh, step);
            spin_ply_columns(ply, c->rest, w.target, w.n);
        }
    }
    for (size_t i = 0; i < out->n; i++) {
        const float *box = chunks + i / CHUNK * N_CHUNK_NAMES;
        uint32_t colour = packed_at(ply, c->vertex, property[3], i);

        if (columns & SPIN_COL_MEANS)
            unpack_box(packed_at(ply, c->vertex, property[0], i), box, box + 3, out->means + 3 * i);
        if (columns & SPIN_COL_QUATS)
            unpack_rotation(packed_at(ply, c->vertex, property[1], i), out->quats + 4 * i);
        if (columns & SPIN_COL_LOG_SCALES)
            unpack_box(packed_at(ply, c->vertex, property[2], i), box + 6, box + 9,
                       out->log_scales + 3 * i);
        if (columns & SPIN_COL_LOGIT_OPACITIES)
            out->logit_opacities[i] = unpack_opacity(colour & 255);
        if (columns & SPIN_COL_SH) {
            float *sh = out->sh + i * step;
            int kept = (c->sh_degree + 1) * (c->sh_degree + 1);

            unpack_colour(colour, box + 12, box + 15, ranged, sh);
            for (int k = 3; k < 3 * kept; k++)
                sh[k] = unpack_rest(sh[k]);
        }
    }
    free(chunks);
    return SPIN_OK;
}

/* ---- One frame ------------------------------------------------------------------------------- */

static spin_status check_frame(const char *path, unsigned columns, struct spin_splats *s)
{
    size_t step = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));

    if (columns & SPIN_COL_MEANS)
        SPIN_TRY(check_finite(path, "x, y, z", s->means, s->n, 3));
    if (columns & SPIN_COL_RGB)
        SPIN_TRY(check_finite(path, "red, green, blue", s->rgb, s->n, 3));
    if (columns & SPIN_COL_LOG_SCALES)
        SPIN_TRY(check_finite(path, "scale_*", s->log_scales, s->n, 3));
    if (columns & SPIN_COL_SH)
        SPIN_TRY(check_finite(path, "f_dc_*, f_rest_*", s->sh, s->n, step));
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        SPIN_TRY(clean_logits(path, s->logit_opacities, s->n));
    if (columns & SPIN_COL_QUATS) {
        SPIN_TRY(check_finite(path, "rot_*", s->quats, s->n, 4));
        normalise(s->quats, s->n);
    }
    return SPIN_OK;
}

static spin_status read_frame(struct clip *clip, const struct spin_ply *ply, unsigned columns,
                              const struct content *c, struct spin_splats *out)
{
    SPIN_TRY(spin_splats_reserve(out, (size_t)c->vertex->count, columns,
                                 clip->sh_degree < 0 ? 0 : clip->sh_degree));
    if (c->kind == COMPRESSED) {
        SPIN_TRY(read_compressed(ply, c, columns, out));
    } else if (c->kind == GAUSSIANS) {
        read_gaussians(ply, c, columns, out);
    } else {
        struct wanted w = {.n = 0};

        if (columns & SPIN_COL_MEANS)
            want_means(&w, c->vertex, out->means);
        spin_ply_columns(ply, c->vertex, w.target, w.n);
        if (columns & SPIN_COL_RGB)
            read_colours(ply, c->vertex, out->rgb, 3);
    }
    SPIN_TRY(check_frame(ply->path, columns, out));
    if (c->kind == GAUSSIANS)
        warn_activated(clip, ply->path, out, columns);
    return SPIN_OK;
}

static spin_status ply_frame(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out)
{
    struct clip *clip = self;
    struct spin_ply ply;
    struct content c;
    spin_status status;

    (void)time;
    if (frame < 0 || (size_t)frame >= clip->n_frames)
        return spin_fail(SPIN_E_NOT_FOUND, "there is no frame %d", frame);
    SPIN_TRY(spin_ply_open(clip->frame[frame].path, &ply));
    SPIN_TRY_OUT(inspect(&ply, &c));
    if (c.kind != clip->kind || c.vertex->count != clip->frame[frame].n ||
        c.sh_degree > clip->sh_degree) {
        status = spin_fail(SPIN_E_IO, "'%s' changed while it was being read", ply.path);
        goto out;
    }
    if (clip->kind >= GAUSSIANS)
        columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    else
        columns &= SPIN_COL_MEANS | (clip->kind == COLOURED ? SPIN_COL_RGB : 0);
    SPIN_TRY_OUT(read_frame(clip, &ply, columns, &c, out));
out:
    spin_ply_close(&ply);
    return status;
}

const struct spin_importer spin_importer_ply = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "ply",
    .summary = "PLY files: one cloud, or a folder with one per frame (3DGS, or plain points)",
    .upstream = "graphdeco-inria/gaussian-splatting 1152adc",
    .probe = probe,
    .open = ply_open,
    .frame = ply_frame,
    .close = ply_close,
};
