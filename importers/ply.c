/* PLY: one 3DGS cloud, or a folder with one cloud per frame.
 *
 * Properties are looked up by name, so their order does not matter. Besides Gaussians, three other
 * kinds of files are supported: points without colours, which yield positions only; points with
 * colours, which yield positions and RGB; and Gaussians in SuperSplat's compressed layout. */
#include <ctype.h>
#include <strings.h>

#include "formats/compressed_ply.h"
#include "importers/lib/file_sequence.h"
#include "math/quat.h"

enum kind { POINTS, COLOURED, GAUSSIANS, COMPRESSED };

struct clip {
    struct spin_model base;
    struct spin_file_sequence files;
    int *numbers;   /* [n_frames] */
    size_t *counts; /* [n_frames] */
    enum kind kind;
    int sh_degree;      /* largest SH degree of all frames; -1: points */
    const char **names; /* vertex properties of the first frame except f_rest_*; NULL-terminated */
    size_t n_names;
    /* warnings that were already printed */
    bool warned_scale, warned_opacity, warned_extra, warned_dropped;
    bool strict;     /* refuse values that are not finite */
    double shift[3]; /* subtracted from the positions of all frames */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Whether the number in a folder's name can be a frame number. Names such as run1 instead number
 * trainings, scenes or checkpoints. */
static bool is_frame_folder(const char *name)
{
    static const char *const others[] = {"run",     "exp",   "scene", "seed",       "trial", "test",
                                         "train",   "model", "save",  "iteration",  "ckpt",  "job",
                                         "version", "out",   "v",     "checkpoint", "chkpnt"};
    size_t n = strcspn(name, "0123456789");

    if (!name[n] || name[0] == '.')
        return false;
    while (n > 0 && strchr("_- .", name[n - 1]))
        n--;
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (n >= strlen(others[i]) &&
            strncasecmp(name + n - strlen(others[i]), others[i], strlen(others[i])) == 0 &&
            (n == strlen(others[i]) || !isalpha((unsigned char)name[n - strlen(others[i]) - 1])))
            return false;
    return true;
}

/* Whether the first of the folders that may be frames contains a model. */
static bool has_frame_models(const struct spin_peek *peek)
{
    static const char *const models[] = {"point_cloud", "point_cloud.ply", "splat.ply"};
    bool found = false;

    for (size_t i = 0; peek->names && peek->names[i]; i++) {
        if (!is_frame_folder(peek->names[i]))
            continue;
        for (size_t k = 0; k < 3 && !found; k++) {
            char name[600];

            snprintf(name, sizeof name, "%s/%s", peek->names[i], models[k]);
            found = spin_model_holds(peek->path, name);
        }
        return found;
    }
    return false;
}

/* Whether a folder contains a model or a PLY file. The folders of a data set's frames, which may
 * have the same names as folders of clouds, contain neither. */
static bool contains_cloud(const char *path, const char *name)
{
    SPIN_FREED char *folder = NULL;
    char **names = NULL;
    size_t n = 0;
    bool found = false;

    if (spin_path_join(path, name, &folder) == SPIN_OK)
        (void)spin_folder_list(folder, &names, &n);
    for (size_t i = 0; i < n && !found; i++)
        found = strcmp(names[i], "point_cloud") == 0 || spin_text_ends_any_case(names[i], ".ply");
    spin_folder_list_free(names);
    return found;
}

/* Returns the confidence that a folder contains a sequence of clouds: numbered files, one folder
 * per frame with the layout of INRIA's 3DGS, or a single model in this layout. */
static int probe_folder(const struct spin_peek *peek)
{
    bool tree = spin_peek_has(peek, "point_cloud"), frames = false;

    for (size_t i = 0; peek->names && peek->names[i]; i++) {
        const char *name = peek->names[i];

        frames = frames || (strncmp(name, "frame", 5) == 0 && !strchr(name, '.') &&
                            contains_cloud(peek->path, name));
        tree = tree || strncmp(name, "iteration_", 10) == 0;
    }
    if (spin_peek_has(
            peek,
            "deformation.pth")) /* the PLY is the canonical cloud of 4DGaussians, not a frame */
        return 20;
    if (spin_file_sequence_count(peek, ".ply") > 0)
        return 70;
    return frames || (!tree && has_frame_models(peek)) ? 50 : tree ? 40 : 0;
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

/* Sets *out to the first of these files in a model's folder that exists, or to NULL if there is
 * none: point_cloud/iteration_<n>/point_cloud.ply with the largest n; point_cloud.ply; and
 * splat.ply, which nerfstudio writes. */
static spin_status find_model(struct spin_model *m, const char *folder, const char **out)
{
    const char *clouds, *name = NULL;

    SPIN_TRY(spin_model_join(m, &clouds, folder, "point_cloud"));
    if (spin_path_is_folder(clouds))
        SPIN_TRY(spin_model_choose(m, NULL, clouds, "point_cloud.ply", NULL, NULL, &name));
    if (name)
        return spin_model_join(m, out, clouds, "%s/point_cloud.ply", name);
    SPIN_TRY(spin_model_find(m, out, folder, "point_cloud.ply"));
    return *out ? SPIN_OK : spin_model_find(m, out, folder, "splat.ply");
}

/* Sets *out to the cloud in the folder of a frame, or to NULL if there is none. If option `pattern`
 * has a slash, the text after the slash names the file. Otherwise the cloud is that of a model or,
 * without a model, the only PLY file. */
static spin_status find_frame(struct spin_model *m, const char *folder, const char **out)
{
    const char *pattern = spin_model_option(m, "pattern");
    struct spin_file_sequence files;

    if (pattern && strchr(pattern, '/'))
        return spin_model_find(m, out, folder, "%s", strchr(pattern, '/') + 1);
    SPIN_TRY(find_model(m, folder, out));
    if (*out)
        return SPIN_OK;
    SPIN_TRY(spin_file_sequence_list(m, folder, ".ply", &files));
    *out = files.n_frames == 1 ? files.frame[0].path : NULL;
    return SPIN_OK;
}

static spin_status list_frame_folders(struct spin_model *m, const char *path,
                                      struct spin_file_sequence *seq)
{
    const char *cloud, *folder;
    char **names;
    size_t n;

    SPIN_TRY(spin_model_names(m, path, &names, &n));
    SPIN_TRY(spin_file_sequence_reserve(m, seq, n));
    for (size_t i = 0; i < n; i++) {
        SPIN_TRY(spin_model_join(m, &folder, path, "%s", names[i]));
        if (names[i][0] == '.' || !strpbrk(names[i], "0123456789") || !spin_path_is_folder(folder))
            continue;
        SPIN_TRY(find_frame(m, folder, &cloud));
        if (cloud)
            spin_file_sequence_add(seq, cloud, names[i]);
    }
    return seq->n_frames > 0
               ? SPIN_OK
               : spin_not_found("'%s' contains neither PLY files nor folders with "
                                "point_cloud/iteration_*/point_cloud.ply or splat.ply",
                                path);
}

/* Lists the files of all frames and sorts them; it is an error if there are none. If `path` is a
 * folder, the first of these that exists is used: (1) the PLY files in the folder; (2) a single
 * frame, the cloud of the model or of the newest checkpoint in the folder; (3) the clouds of the
 * models in numbered subfolders. Option `pattern` excludes (2) and, if it has a slash, also (1). */
static spin_status find_files(struct clip *clip, const char *path)
{
    struct spin_model *m = &clip->base;
    struct spin_file_sequence *seq = &clip->files;
    const char *cloud = NULL, *save, *pattern = spin_model_option(m, "pattern");
    bool in_folders = pattern && strchr(pattern, '/');

    if (!spin_path_is_folder(path)) {
        SPIN_TRY(spin_file_sequence_find(m, path, ".ply", seq));
        return spin_file_sequence_sort(m, seq, false, m->sequence);
    }
    if (!in_folders)
        SPIN_TRY(spin_file_sequence_list(m, path, ".ply", seq));
    if (seq->n_frames > 0)
        return spin_file_sequence_sort(m, seq, false, m->sequence);
    SPIN_TRY(spin_model_choose(m, NULL, path, "point_cloud.ply", NULL, NULL, &save));
    if (!pattern)
        SPIN_TRY(find_model(m, path, &cloud));
    if (!pattern && !cloud && save)
        SPIN_TRY(spin_model_join(m, &cloud, path, "%s/point_cloud.ply", save));
    if (cloud) {
        SPIN_TRY(spin_file_sequence_reserve(m, seq, 1));
        spin_file_sequence_add(seq, cloud, "");
        return SPIN_OK;
    }
    SPIN_TRY(list_frame_folders(m, path, seq));
    return spin_file_sequence_sort(m, seq, true, m->sequence);
}

/* ---- Contents of a file ---------------------------------------------------------------------- */

/* Refuses a PLY file that contains a 4D model instead of the cloud of one frame. */
static spin_status check_not_4d(const struct spin_ply *ply, const struct spin_ply_element *e)
{
    /* Names of properties, or prefixes that end with *; the first match names the method. */
    static const struct {
        const char *name, *method, *use;
    } signs[] = {
        {"xyz_disp_*", "Ex4DGS", ""},
        {"motion_xyz_*", "Ex4DGS", ""},
        {"trbf_*", "SpacetimeGaussians", "; use --from spacetimegs"},
        {"motion_*", "SpacetimeGaussians", "; use --from spacetimegs"},
        {"omega_*", "SpacetimeGaussians", "; use --from spacetimegs"},
        {"rot_r_*", "Realtime-4DGS", ""},
        {"scale_t", "Realtime-4DGS", ""},
        {"scale_t_*", "Realtime-4DGS", ""},
        {"log_duration", "FreeTimeGS (.ftgs.ply)", "; use --from freetimegs"},
        {"t_center", "the PLY for .sogst", "; use --from sogst"},
        {"t", "Realtime-4DGS or SpacetimeGaussians", ""},
    };
    size_t i = 0, n = sizeof signs / sizeof *signs;

    for (; i < n; i++) {
        size_t stem = strcspn(signs[i].name, "*");
        char prefix[32];

        snprintf(prefix, sizeof prefix, "%.*s", (int)stem, signs[i].name);
        if (signs[i].name[stem] ? spin_ply_has_prefix(e, prefix) : spin_ply_has(e, prefix))
            break;
    }
    if (i == n || (i == n - 1 && !spin_gs_ply_any(e))) /* plain points may have a property t */
        return SPIN_OK;
    return spin_unsupported("'%s': property '%s' belongs to a 4D model, probably of %s, not to the "
                            "cloud of one frame%s",
                            ply->path, signs[i].name, signs[i].method, signs[i].use);
}

struct content {
    const struct spin_ply_element *vertex;
    enum kind kind;
    int sh_degree, n_rest;             /* sh_degree is -1 for points */
    struct spin_gs_ply gaussians;      /* set if `kind` is GAUSSIANS */
    struct spin_compressed_ply packed; /* set if `kind` is COMPRESSED */
};

static spin_status inspect(const struct spin_ply *ply, struct content *out)
{
    const struct spin_ply_element *e;

    SPIN_TRY(spin_ply_vertices(ply, &e));
    *out = (struct content){.vertex = e, .sh_degree = -1};
    if (spin_compressed_any(e)) {
        out->kind = COMPRESSED;
        SPIN_TRY(spin_compressed_find(ply, &out->packed));
        out->sh_degree = out->packed.sh_degree;
        out->n_rest = out->packed.n_rest;
        return SPIN_OK;
    }
    SPIN_TRY(check_not_4d(ply, e));
    if (spin_gs_ply_any(e)) {
        out->kind = GAUSSIANS;
        SPIN_TRY(spin_gs_ply_find(ply, &out->gaussians));
        out->sh_degree = out->gaussians.sh_degree;
        out->n_rest = out->gaussians.n_rest;
        return SPIN_OK;
    }
    for (int i = 0; i < 3; i++) {
        const char *name = i == 0 ? "x" : i == 1 ? "y" : "z";

        if (!spin_ply_has(e, name))
            return spin_malformed("'%s': element 'vertex' has no property '%s'", ply->path, name);
    }
    out->kind = spin_ply_has_colours(e) ? COLOURED : POINTS;
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Adds notes and warnings for the user about peculiarities of the program or the training that
 * wrote the first frame. */
static void note_writer(const struct spin_ply *ply, const struct content *c,
                        struct spin_sequence_info *sequence)
{
    if (spin_ply_is_antialiased(ply)) {
        spin_note(sequence,
                  "trained with an antialiasing rasteriser: the splats are drawn antialiased");
        sequence->antialias = true;
    }
    for (size_t i = 0; i < ply->n_comments; i++)
        if (strcasecmp(ply->comment[i], "SplatRenderMode: 2dgs") == 0)
            spin_warn("'%s': trained as 2D splats (SplatRenderMode: 2dgs), drawn as flat 3D splats",
                      ply->path);
    if (c->kind == GAUSSIANS && c->gaussians.flat)
        spin_note(sequence, "flat splats (2DGS) are drawn as thin 3D splats");
    if (spin_ply_has(c->vertex, "filter_3D")) {
        spin_note(
            sequence,
            "property 'filter_3D' (Mip-Splatting) is ignored: small Gaussians are drawn too small");
        spin_warn("'%s': property 'filter_3D' (Mip-Splatting) is ignored", ply->path);
    }
    if (spin_ply_has(c->vertex, "embedding_0")) {
        spin_note(sequence,
                  "the properties embedding_* belong to the canonical cloud of E-D3DGS, which is "
                  "not a frame of the video; --from ed3dgs reads it with its network");
        spin_warn("'%s': the canonical cloud of E-D3DGS is not a frame of the video", ply->path);
    }
    if (c->n_rest > 45) {
        spin_note(sequence, "SH degree 4 is cut to degree 3");
        spin_warn("'%s': SH degree 4 is cut to degree 3", ply->path);
    }
}

static bool is_rest(const char *name) { return strncmp(name, "f_rest_", 7) == 0; }

static spin_status keep_names(struct clip *clip, const struct spin_ply_element *e)
{
    SPIN_TRY(spin_model_alloc(&clip->base, e->n_properties + 1, sizeof *clip->names,
                              (void **)&clip->names));
    for (size_t i = 0; i < e->n_properties; i++) {
        if (!is_rest(e->property[i].name))
            SPIN_TRY(spin_model_text(&clip->base, &clip->names[clip->n_names++], "%s",
                                     e->property[i].name));
    }
    return SPIN_OK;
}

/* Checks that a frame has the same properties as the first one, in any order; only the SH degree
 * may differ. */
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
            return spin_malformed("'%s' has no property '%s', but '%s' has", ply->path,
                                  clip->names[i], clip->files.frame[0].path);
    }
    if (n != clip->n_names || c->kind != clip->kind)
        return spin_malformed("'%s' has other vertex properties than '%s'", ply->path,
                              clip->files.frame[0].path);
    return SPIN_OK;
}

static spin_status choose_shift(struct clip *clip, const struct spin_ply *ply,
                                const struct spin_ply_element *e)
{
    bool wide = ply->ascii || e->property[spin_ply_find(e, "x")].type == SPIN_PLY_F64;
    SPIN_FREED float *means = NULL;

    SPIN_TRY(spin_alloc(3 * (size_t)e->count, sizeof *means, (void **)&means));
    for (int c = 0; c < 3; c++)
        spin_ply_column(ply, e, spin_ply_find(e, (const char[2]){(char)('x' + c), '\0'}), means + c,
                        3);
    return spin_model_choose_shift(&clip->base, ply->path, means, (size_t)e->count, wide,
                                   clip->shift);
}

static spin_status open_frame(struct clip *clip, size_t i)
{
    struct spin_sequence_info *sequence = clip->base.sequence;
    const struct spin_ply *ply = &clip->base.ply;
    struct content c;

    SPIN_TRY(spin_model_ply(&clip->base, clip->files.frame[i].path));
    SPIN_TRY(inspect(ply, &c));
    clip->files.frame[i].n = (size_t)c.vertex->count;
    if (i == 0) {
        clip->kind = c.kind;
        SPIN_TRY(keep_names(clip, c.vertex));
        note_writer(ply, &c, sequence);
        if (c.kind != COMPRESSED)
            SPIN_TRY(choose_shift(clip, ply, c.vertex));
    } else {
        SPIN_TRY(compare_names(clip, ply, &c));
        if (c.sh_degree != clip->sh_degree)
            spin_note(sequence, "the SH degree differs between frames: missing SH are set to 0");
    }
    if (i == 0 || c.sh_degree > clip->sh_degree)
        clip->sh_degree = c.sh_degree;
    if (ply->extra_bytes > 0 && !clip->warned_extra) {
        clip->warned_extra = true;
        spin_warn("'%s' has %llu bytes after its last record", ply->path,
                  (unsigned long long)ply->extra_bytes);
    }
    return SPIN_OK;
}

static spin_status describe(struct clip *clip)
{
    struct spin_sequence_info *sequence = clip->base.sequence;
    size_t n_frames = clip->files.n_frames;
    static const char *const what[] = {"plain points", "coloured points", "Gaussians",
                                       "SuperSplat's compressed Gaussians"};
    size_t n_all = 0;

    SPIN_TRY(
        spin_model_alloc(&clip->base, n_frames, sizeof *clip->numbers, (void **)&clip->numbers));
    SPIN_TRY(spin_model_alloc(&clip->base, n_frames, sizeof *clip->counts, (void **)&clip->counts));
    for (size_t i = 0; i < clip->files.n_frames; i++) {
        clip->numbers[i] = clip->files.frame[i].number;
        clip->counts[i] = clip->files.frame[i].n;
        n_all += clip->files.frame[i].n;
    }
    if (n_all == 0)
        return spin_malformed("'%s' contains 0 vertices", clip->files.frame[0].path);
    sequence->n_frames = (int)clip->files.n_frames;
    sequence->numbers = clip->numbers[0] >= 0 ? clip->numbers : NULL;
    sequence->counts = clip->counts;
    sequence->columns = SPIN_COL_MEANS;
    if (clip->kind >= GAUSSIANS)
        sequence->columns |= SPIN_COL_ATTRIBUTES;
    else if (clip->kind == COLOURED)
        sequence->columns |= SPIN_COL_RGB;
    sequence->sh_degree = clip->sh_degree;
    sequence->time_last = (double)(clip->files.n_frames - 1);
    snprintf(sequence->variant, sizeof sequence->variant, "%s of %s",
             clip->files.n_frames == 1 ? "one PLY file" : "PLY files", what[clip->kind]);
    return SPIN_OK;
}

static spin_status open_clip(void *self, const char *path)
{
    struct clip *clip = self;

    clip->sh_degree = -1;
    clip->strict = spin_model_option(&clip->base, "strict") != NULL;
    SPIN_TRY(find_files(clip, path));
    if (clip->files.n_frames > INT_MAX)
        return spin_unsupported("'%s' contains 2^31 or more files", path);
    for (size_t i = 0; i < clip->files.n_frames; i++)
        SPIN_TRY(open_frame(clip, i));
    return describe(clip);
}

/* ---- One frame ------------------------------------------------------------------------------- */

/* Warns about values that look as if exp or the sigmoid had been applied already. Since this is a
 * guess, it is not an error. */
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
            spin_warn("'%s': all scales are positive and most are below 0.1; they are probably not "
                      "logarithms",
                      path);
        }
    }
    if ((columns & SPIN_COL_LOGIT_OPACITIES) && !clip->warned_opacity) {
        for (size_t i = 0; i < s->n; i++)
            unit = unit && s->logit_opacities[i] >= 0 && s->logit_opacities[i] <= 1;
        if (unit) {
            clip->warned_opacity = true;
            spin_warn("'%s': all opacities are in 0..1; they are probably not logits", path);
        }
    }
}

/* Drops single splats whose values are not finite, with a warning for the first frame that has
 * any. */
static void drop_rows(struct clip *clip, const char *path, unsigned columns,
                      struct spin_splats *out)
{
    size_t n;
    char text[48];

    spin_drop_nonfinite(columns, out, &n);
    if (n > 0 && !clip->warned_dropped)
        spin_warn("'%s': dropped %s with values that are not finite (--strict refuses such files)",
                  path, spin_text_count((long long)n, "splat", text));
    clip->warned_dropped = clip->warned_dropped || n > 0;
}

static spin_status read_points(const struct content *c, const struct spin_ply *ply,
                               unsigned columns, struct spin_splats *out)
{
    spin_status status = SPIN_OK;

    if (columns & SPIN_COL_MEANS)
        SPIN_TRY(spin_ply_places(ply, c->vertex, out->means));
    if (columns & SPIN_COL_RGB) {
        spin_ply_colours(ply, c->vertex, out->rgb, 3);
        status = spin_check_finite("red, green, blue", out->rgb, out->n, 3);
    }
    return spin_fail_context(status, "'%s'", ply->path);
}

static spin_status ply_frame(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out)
{
    struct clip *clip = self;
    const struct spin_ply *ply = &clip->base.ply;
    struct content c;

    (void)time;
    if (frame < 0 || (size_t)frame >= clip->files.n_frames)
        return spin_not_found("there is no frame %d", frame);
    SPIN_TRY(spin_model_ply(&clip->base, clip->files.frame[frame].path));
    memcpy(clip->base.ply.shift, clip->shift, sizeof clip->shift);
    SPIN_TRY(inspect(ply, &c));
    if (c.kind != clip->kind || c.vertex->count != clip->files.frame[frame].n ||
        c.sh_degree > clip->sh_degree)
        return spin_fail(SPIN_E_IO, "'%s' changed while it was being read", ply->path);
    columns &= SPIN_COL_MEANS | (clip->kind >= GAUSSIANS  ? SPIN_COL_ATTRIBUTES
                                 : clip->kind == COLOURED ? SPIN_COL_RGB
                                                          : 0);
    SPIN_TRY(spin_splats_reserve(out, (size_t)c.vertex->count, columns,
                                 clip->sh_degree < 0 ? 0 : clip->sh_degree));
    if (c.kind == COMPRESSED)
        return spin_compressed_read(&c.packed, columns, out);
    if (c.kind != GAUSSIANS)
        return read_points(&c, ply, columns, out);
    spin_gs_ply_load(&c.gaussians, columns, 0, out);
    if (!clip->strict)
        drop_rows(clip, ply->path, columns, out);
    SPIN_TRY(spin_ply_check(ply, columns, 0, out->n, out));
    for (size_t i = 0; i < out->n && (columns & SPIN_COL_QUATS); i++)
        spin_quat_normalise(out->quats + 4 * i);
    warn_activated(clip, ply->path, out, columns);
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    SPIN_FILE_SEQUENCE_OPTION,
    {"strict", NULL,
     "refuse files with splats whose values are not finite (default: up to 1 in "
     "1,000 are dropped)",
     NULL},
    {0},
};

SPIN_MODEL_IMPORTER(
    ply, struct clip, open_clip, spin_model_close,
    .summary = "PLY files: one cloud, or a folder with one per frame (3DGS, or plain points)",
    .upstream = "graphdeco-inria/gaussian-splatting 1152adc", .options = options, .probe = probe,
    .frame = ply_frame)
