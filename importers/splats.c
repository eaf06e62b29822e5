/* Clips of splat files: a folder with a file per frame, or a single file of one or more frames. The
 * functions here open and read a file of each format; the decoders are in src/formats.
 *
 * SPZ: most files do not record their axes. Files of splat-transform and of spin4d have the axes of
 * the training; files of Niantic's library have the axes right, up, back if its caller stated the
 * axes of the input. Option `axes` states the axes of files that do not record them.
 *
 * GLB (KHR_gaussian_splatting): the axes of glTF are x left, y up, z forward, whereas those of a
 * training are mostly x right, y down, z forward. With --axes gltf, the importer undoes the half
 * turn about z that exporters apply. */
#include "formats/glb.h"
#include "formats/ksplat.h"
#include "formats/sog.h"
#include "formats/splat.h"
#include "formats/spz.h"
#include "importers/lib/file_sequence.h"
#include "importers/lib/sog_levels.h"
#include "io/zip.h"

/* Properties of the open file. */
struct opened {
    size_t n_frames;     /* number of frames in the file; 1 unless it is a clip */
    size_t n;            /* number of splats per frame */
    int sh_degree;       /* largest SH degree that read() returns */
    bool antialias;      /* the splats were trained with antialiasing */
    bool has_axes;       /* the file records its axes */
    double axes[4];      /* if has_axes: rotation w x y z from the file's axes to the training's */
    const char *note[4]; /* notes for the user about assumptions and losses; NULL: none */
    const char *folder;  /* if the images of a SOG are separate files: their folder; else NULL */
    struct spin_gs_glb_scene scene; /* if the file is a GLB: its contents */
    struct sog_levels levels;       /* if the file is the index of a streamed SOG: its contents */
};

struct clip {
    struct spin_model base; /* base.canonical: a frame in the axes of its file */
    const struct format *format;
    const double *turn; /* rotation to the training's axes, for files that do not record their axes;
                           NULL: none */
    struct spin_file_sequence files;
    struct spin_splats still; /* splats that follow those of the file in every frame */
    double shift[3];          /* GLB: subtracted from the translations of all nodes */
    int n_frames, sh_degree;
    int *numbers;   /* [n_frames] */
    double *times;  /* [n_frames] */
    size_t *counts; /* [n_frames] */

    /* The open file. `file`: index in `files`; SIZE_MAX: no file is open. `within`: index, within
     * this file, of the frame that read() is to read. */
    size_t file, within;
    struct spin_map map;
    struct opened opened;
};

struct format {
    const char *suffix; /* extension of the files, such as ".spz" */
    const char *name;   /* name of the format for messages, such as "SPZ" */
    /* open() fills clip->opened from the bytes in clip->map; read() reads the frame clip->within.
     * Their error messages do not name the file. */
    spin_status (*open)(struct clip *clip);
    spin_status (*read)(struct clip *clip, unsigned columns, struct spin_splats *out);
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Returns the confidence according to the file names. It is low in the folder of a training, where
 * the point clouds are more likely the input. */
static int probe_names(const struct spin_peek *peek, const char *suffix)
{
    int named = spin_file_named(peek, suffix);

    for (size_t i = 0; peek->names && peek->names[i]; i++)
        if (named && (strncmp(peek->names[i], "point_cloud", 11) == 0 ||
                      strncmp(peek->names[i], "iteration_", 10) == 0))
            return 20;
    return named;
}

/* ---- Files ----------------------------------------------------------------------------------- */

static void close_file(struct clip *clip)
{
    if (clip->file == SIZE_MAX)
        return;
    spin_gs_glb_scene_close(&clip->opened.scene);
    spin_map_close(&clip->map);
    clip->file = SIZE_MAX;
}

static spin_status fail_file(const struct clip *clip, size_t file, spin_status status)
{
    return spin_fail_context(status, "cannot read '%s'", clip->files.frame[file].path);
}

/* Opens a file, unless it is already open. The last file stays open, since the frames of a file are
 * mostly read one after the other. */
static spin_status open_file(struct clip *clip, size_t file)
{
    spin_status status;

    if (clip->file == file)
        return SPIN_OK;
    close_file(clip);
    SPIN_TRY(spin_map_open(clip->files.frame[file].path, &clip->map));
    clip->file = file;
    clip->opened = (struct opened){.n_frames = 1};
    status = clip->format->open(clip);
    if (status == SPIN_OK)
        return SPIN_OK;
    close_file(clip);
    return fail_file(clip, file, status);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status reserve_frames(struct clip *clip, size_t n)
{
    if (n > INT_MAX)
        return spin_unsupported("'%s' contains 2^31 or more frames", clip->files.frame[0].path);
    clip->n_frames = (int)n;
    SPIN_TRY(spin_model_alloc(&clip->base, n, sizeof *clip->numbers, (void **)&clip->numbers));
    SPIN_TRY(spin_model_alloc(&clip->base, n, sizeof *clip->times, (void **)&clip->times));
    return spin_model_alloc(&clip->base, n, sizeof *clip->counts, (void **)&clip->counts);
}

/* Sets the numbers and times of the frames if the clip is a single file. Frame numbers in the file
 * are used only if they increase. */
static void describe_clip(const struct clip *clip, struct spin_sequence_info *sequence)
{
    bool numbered = true;

    for (int i = 0; i < clip->n_frames; i++)
        numbered = numbered && clip->numbers[i] >= 0 &&
                   (i == 0 || clip->numbers[i] > clip->numbers[i - 1]);
    sequence->numbers = numbered ? clip->numbers : NULL;
    sequence->times = clip->times;
    sequence->time_first = clip->times[0];
    sequence->time_last = clip->times[clip->n_frames - 1];
}

static void describe_files(const struct clip *clip, struct spin_sequence_info *sequence)
{
    for (int i = 0; i < clip->n_frames; i++) {
        if (clip->files.frame[i].number >= 0 || clip->n_frames > 1)
            clip->numbers[i] = clip->files.frame[i].number;
    }
    sequence->numbers = clip->numbers[0] >= 0 ? clip->numbers : NULL;
    sequence->time_last = clip->n_frames - 1;
}

/* Adds the notes of the open file to the sequence, and a note if the SH degree of the file differs
 * from the degree of the previous files. */
static void note_file(struct clip *clip, size_t file)
{
    struct spin_sequence_info *sequence = clip->base.sequence;
    const struct opened *f = &clip->opened;

    if (file > 0 && f->sh_degree != clip->sh_degree)
        spin_note(sequence, "the SH degree differs between frames: missing SH are set to 0");
    for (size_t i = 0; i < sizeof f->note / sizeof *f->note; i++)
        if (f->note[i])
            spin_note(sequence, "%s", f->note[i]);
    if (f->antialias && !sequence->antialias)
        spin_note(sequence,
                  "trained with an antialiasing rasteriser: the splats are drawn antialiased");
    sequence->antialias = sequence->antialias || f->antialias;
    clip->sh_degree = f->sh_degree > clip->sh_degree ? f->sh_degree : clip->sh_degree;
}

static spin_status look_at_files(struct clip *clip, size_t *n_all)
{
    size_t n_files = clip->files.n_frames;

    *n_all = 0;
    for (size_t i = 0; i < n_files; i++) {
        SPIN_TRY(open_file(clip, i));
        if (i == 0)
            SPIN_TRY(reserve_frames(clip, n_files > 1 ? n_files : clip->opened.n_frames));
        if (n_files > 1 && clip->opened.n_frames > 1)
            return spin_malformed("'%s' contains a clip of %zu frames: import this file on its own",
                                  clip->files.frame[i].path, clip->opened.n_frames);
        for (size_t f = 0; f < clip->opened.n_frames; f++) {
            const struct spin_gs_glb_frame *of = clip->opened.scene.frame;

            clip->numbers[i + f] = of ? of[f].number : -1;
            clip->times[i + f] = of ? of[f].time : 0;
            clip->counts[i + f] = of ? of[f].n : clip->opened.n;
            *n_all += clip->counts[i + f];
        }
        note_file(clip, i);
    }
    return SPIN_OK;
}

static spin_status open_clip(struct clip *clip, const struct format *format, const char *path)
{
    struct spin_sequence_info *sequence = clip->base.sequence;
    size_t n_all;

    clip->format = format;
    clip->file = SIZE_MAX;
    SPIN_TRY(spin_file_sequence_find(&clip->base, path, format->suffix, &clip->files));
    SPIN_TRY(spin_file_sequence_sort(&clip->base, &clip->files, false, sequence));
    SPIN_TRY(look_at_files(clip, &n_all));
    if (n_all == 0)
        return spin_malformed("'%s' contains 0 splats", clip->files.frame[0].path);
    if (clip->files.n_frames == 1 && clip->n_frames > 1)
        describe_clip(clip, sequence);
    else
        describe_files(clip, sequence);
    sequence->n_frames = clip->n_frames;
    sequence->counts = clip->counts;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = clip->sh_degree;
    snprintf(sequence->variant, sizeof sequence->variant, "%s %s%s",
             clip->files.n_frames == 1 ? "one" : "a sequence of", format->name,
             clip->files.n_frames > 1 ? " files"
             : clip->n_frames > 1     ? " file with a clip"
                                      : " file");
    return SPIN_OK;
}

static void close_clip(void *self)
{
    struct clip *clip = self;

    if (clip && clip->format)
        close_file(clip);
    if (clip)
        spin_splats_free(&clip->still);
    spin_model_close(self);
}

/* ---- One frame ------------------------------------------------------------------------------- */

static spin_status clip_frame(void *self, int frame, double time, unsigned columns,
                              struct spin_splats *out)
{
    struct clip *clip = self;
    struct spin_splats *raw = &clip->base.canonical;
    struct spin_placement placement = {.q = {1}, .scale = 1};
    size_t file = clip->files.n_frames > 1 ? (size_t)frame : 0;
    spin_status status;

    (void)time;
    if (frame < 0 || frame >= clip->n_frames)
        return spin_not_found("there is no frame %d", frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(open_file(clip, file));
    clip->within = (size_t)frame - file;
    status = clip->within < clip->opened.n_frames
                 ? clip->format->read(clip, columns, raw)
                 : spin_fail(SPIN_E_IO, "the file changed while it was being read");
    if (status != SPIN_OK)
        return fail_file(clip, file, status);
    if (raw->n != clip->counts[frame] || raw->sh_degree > clip->sh_degree)
        return spin_fail(SPIN_E_IO, "'%s' changed while it was being read",
                         clip->files.frame[file].path);
    SPIN_TRY(spin_splats_reserve(out, raw->n, columns, clip->sh_degree));
    if (clip->opened.has_axes)
        memcpy(placement.q, clip->opened.axes, sizeof placement.q);
    else if (clip->turn)
        memcpy(placement.q, clip->turn, sizeof placement.q);
    spin_splats_place(raw, columns, &placement, 0, out);
    out->antialias = clip->opened.antialias;
    return SPIN_OK;
}

/* ---- .splat ---------------------------------------------------------------------------------- */

static const struct spin_plugin_option file_options[] = {SPIN_FILE_SEQUENCE_OPTION, {0}};

/* Opens a .splat file. The format has no header, so files are recognised by name only. */
static spin_status open_splat(struct clip *clip)
{
    clip->opened.note[0] = "the format has no view-dependent colour";
    clip->opened.n = clip->map.size / SPIN_SPLAT_ROW;
    if (clip->map.size % SPIN_SPLAT_ROW != 0)
        return spin_malformed("the file has %zu bytes, expected a multiple of %d", clip->map.size,
                              SPIN_SPLAT_ROW);
    return SPIN_OK;
}

static spin_status read_splat(struct clip *clip, unsigned columns, struct spin_splats *out)
{
    return spin_splat_read(clip->map.data, clip->map.size, columns, out);
}

static int splat_probe(const struct spin_peek *peek) { return probe_names(peek, ".splat"); }

static spin_status open_splat_clip(void *self, const char *path)
{
    static const struct format format = {".splat", ".splat", open_splat, read_splat};

    return open_clip(self, &format, path);
}

SPIN_MODEL_IMPORTER(splat, struct clip, open_splat_clip, close_clip,
                    .summary = ".splat files: one, or a folder with one per frame; no SH",
                    .upstream = "antimatter15/splat", .options = file_options, .probe = splat_probe,
                    .frame = clip_frame)

/* ---- .ksplat --------------------------------------------------------------------------------- */

/* Opens a .ksplat file. The format has no magic number, so files are recognised by name only. */
static spin_status open_ksplat(struct clip *clip)
{
    struct spin_ksplat header;

    SPIN_TRY(spin_ksplat_peek(clip->map.data, clip->map.size, &header));
    clip->opened.sh_degree = header.sh_degree;
    clip->opened.n = header.n;
    return SPIN_OK;
}

static spin_status read_ksplat(struct clip *clip, unsigned columns, struct spin_splats *out)
{
    return spin_ksplat_read(clip->map.data, clip->map.size, columns, out);
}

static int ksplat_probe(const struct spin_peek *peek) { return probe_names(peek, ".ksplat"); }

static spin_status open_ksplat_clip(void *self, const char *path)
{
    static const struct format format = {".ksplat", ".ksplat", open_ksplat, read_ksplat};

    return open_clip(self, &format, path);
}

SPIN_MODEL_IMPORTER(ksplat, struct clip, open_ksplat_clip, close_clip,
                    .summary = ".ksplat files, levels 0 to 2: one, or a folder with one per frame",
                    .upstream = "mkkellogg/GaussianSplats3D", .options = file_options,
                    .probe = ksplat_probe, .frame = clip_frame)

/* ---- SPZ ------------------------------------------------------------------------------------- */

static const struct spin_plugin_option spz_options[] = {
    {"axes", "source|rub",
     "axes of files that do not record them: as trained, or rub (right, up, back)", "source"},
    SPIN_FILE_SEQUENCE_OPTION,
    {0},
};

static spin_status open_spz(struct clip *clip)
{
    struct opened *out = &clip->opened;
    struct spin_spz_header header;

    SPIN_TRY(spin_spz_peek(clip->map.data, clip->map.size, &header));
    out->n = header.n;
    out->sh_degree = header.sh_degree < 3 ? header.sh_degree : 3;
    out->antialias = header.antialias;
    out->has_axes = header.axes != 0;
    if (header.sh_degree > 3)
        out->note[0] = "SH degree 4 is cut to degree 3";
    if (!out->has_axes)
        out->note[1] = "the file does not record its axes: --axes selects them";
    return out->has_axes ? spin_spz_axes(header.axes, out->axes) : SPIN_OK;
}

static spin_status read_spz(struct clip *clip, unsigned columns, struct spin_splats *out)
{
    return spin_spz_read(clip->map.data, clip->map.size, columns, out);
}

/* Recognises folders of .spz files, files of version 4 with any name, and files of versions 2 and 3
 * whose names end with .spz. Versions 2 and 3 are gzip files, which may contain anything, so the
 * name is required. */
static int spz_probe(const struct spin_peek *peek)
{
    int named = probe_names(peek, ".spz");

    if (peek->is_folder)
        return named;
    return spin_file_begins(peek, "NGSP") || (named && spin_file_begins(peek, "\x1f\x8b")) ? 90 : 0;
}

static spin_status open_spz_clip(void *self, const char *path)
{
    static const struct format format = {".spz", "SPZ", open_spz, read_spz};
    static const double half_about_x[4] = {0, 1, 0, 0};
    struct clip *clip = self;
    int axes;

    SPIN_TRY(spin_option_word(clip->base.values, "axes", "source|rub", &axes));
    clip->turn = axes == 1 ? half_about_x : NULL;
    return open_clip(clip, &format, path);
}

SPIN_MODEL_IMPORTER(spz, struct clip, open_spz_clip, close_clip,
                    .summary = "SPZ files, versions 2 to 4: one, or a folder with one per frame",
                    .upstream = "nianticlabs/spz 21715c3", .options = spz_options,
                    .probe = spz_probe, .frame = clip_frame)

/* ---- SOG ------------------------------------------------------------------------------------- */

/* Opens a .sog file, or a meta.json whose images are separate files in the same folder. */
static spin_status open_sog(struct clip *clip)
{
    struct opened *out = &clip->opened;
    const char *path = clip->files.frame[clip->file].path;
    struct spin_sog sog;

    if (spin_file_has_suffix(path, ".json"))
        SPIN_TRY(spin_model_folder(&clip->base, &out->folder, path));
    SPIN_TRY(spin_sog_peek(clip->map.data, clip->map.size, out->folder, &sog));
    out->sh_degree = sog.sh_degree;
    out->antialias = sog.antialias;
    out->n = sog.n;
    return SPIN_OK;
}

static spin_status read_sog(struct clip *clip, unsigned columns, struct spin_splats *out)
{
    return spin_sog_read(clip->map.data, clip->map.size, clip->opened.folder, columns, out);
}

/* Opens the index of a streamed SOG. */
static spin_status open_sog_levels(struct clip *clip)
{
    struct opened *out = &clip->opened;
    struct spin_model *m = &clip->base;
    const char *folder;

    SPIN_TRY(spin_model_folder(m, &folder, clip->files.frame[clip->file].path));
    SPIN_TRY(spin_sog_levels_open(m, folder, clip->map.data, clip->map.size, &out->levels));
    SPIN_TRY(spin_sog_levels_note(m, &out->levels, &out->note[0], &out->note[1]));
    out->sh_degree = out->levels.sh_degree;
    out->antialias = out->levels.antialias;
    out->n = out->levels.n;
    return SPIN_OK;
}

static spin_status read_sog_levels(struct clip *clip, unsigned columns, struct spin_splats *out)
{
    return spin_sog_levels_read(&clip->opened.levels, columns, out);
}

/* Opens a frame of a clip whose static splats are a streamed SOG. */
static spin_status open_sog_frame(struct clip *clip)
{
    struct opened *out = &clip->opened;

    SPIN_TRY(open_sog(clip));
    out->n += clip->still.n;
    out->sh_degree =
        clip->still.sh_degree > out->sh_degree ? clip->still.sh_degree : out->sh_degree;
    out->antialias = out->antialias || clip->still.antialias;
    return SPIN_OK;
}

static spin_status read_sog_frame(struct clip *clip, unsigned columns, struct spin_splats *out)
{
    static const struct spin_placement in_place = {.q = {1}, .scale = 1};
    SPIN_LEAVES(spin_splats_free) struct spin_splats own = {0};

    SPIN_TRY(read_sog(clip, columns, &own));
    SPIN_TRY(spin_splats_reserve(out, own.n + clip->still.n, columns, clip->opened.sh_degree));
    spin_splats_place(&own, columns, &in_place, 0, out);
    spin_splats_place(&clip->still, columns, &in_place, own.n, out);
    return SPIN_OK;
}

/* Sets *joined if a folder, which spin-export wrote, contains the static splats of a clip as a
 * streamed SOG with this index, and the others as one file per frame. index: NULL if the folder has
 * no index, which then is an error if the frames need it. */
static spin_status is_joined(struct spin_model *m, const char *folder, const char *index,
                             bool *joined)
{
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
    struct spin_file_sequence files = {0};
    const char *path, *still;

    *joined = false;
    SPIN_TRY(spin_model_find(m, &path, folder, "sequence.json"));
    if (!path || spin_json_load(path, &root) != SPIN_OK)
        return SPIN_OK;
    still = spin_json_string(spin_json_get(root, "static"));
    if (!still || strcmp(still, SPIN_SOG_LEVELS_FILE) != 0)
        return SPIN_OK;
    SPIN_TRY(spin_file_sequence_list(m, folder, ".sog", &files));
    if (files.n_frames > 0 && !index)
        return spin_not_found("'%s/" SPIN_SOG_LEVELS_FILE "' does not exist, but contains the "
                              "static splats of these frames: copy it and the folders beside it, or "
                              "remove '%s' to import the other splats only",
                              folder, path);
    *joined = files.n_frames > 0;
    return SPIN_OK;
}

/* Reads the static splats of a clip from a streamed SOG. */
static spin_status read_still(struct clip *clip, const char *folder, const char *index)
{
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    struct spin_model *m = &clip->base;
    struct sog_levels levels;
    const char *note[2];
    char count[48];

    SPIN_TRY(spin_map_open(index, &map));
    SPIN_TRY_IN(spin_sog_levels_open(m, folder, map.data, map.size, &levels), "'%s'", index);
    SPIN_TRY(spin_sog_levels_read(&levels, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &clip->still));
    SPIN_TRY(spin_sog_levels_note(m, &levels, &note[0], &note[1]));
    spin_note(m->sequence, "%s", note[0]);
    spin_note(m->sequence, "every frame contains the %s of the streamed SOG",
              spin_text_count((long long)clip->still.n, "static splat", count));
    return SPIN_OK;
}

static const struct spin_plugin_option sog_options[] = {
    {"lod", "N",
     "streamed SOG: the level of detail to read, 0 is the finest (default: the finest "
     "whose files exist)",
     NULL},
    SPIN_FILE_SEQUENCE_OPTION,
    {0},
};

/* Recognises a zip with images and a meta.json, a folder with both, a meta.json with the bounds of
 * positions, or the index of a streamed SOG. */
static int sog_probe(const struct spin_peek *peek)
{
    const char *names = peek->tail_names;
    bool meta = spin_peek_has(peek, "meta.json"), picture = spin_peek_has(peek, "means_l.webp");

    if (spin_peek_has(peek, SPIN_SOG_LEVELS_FILE) ||
        strcmp(spin_path_name(peek->path), SPIN_SOG_LEVELS_FILE) == 0)
        return 90;
    if (!peek->is_folder && spin_file_has_suffix(peek->path, ".json")) {
        meta = spin_peek_contains(peek, "\"means\"");
        picture = spin_peek_contains(peek, "\"mins\"");
    } else if (spin_zip_detect(peek->head, peek->n_head)) {
        /* Only a meta.json at the root of the archive counts: a meta.json in a folder belongs to an
         * unpacked SOG, which any archive may contain. */
        meta = strncmp(names, "meta.json", 9) == 0 || strstr(names, "\nmeta.json") != NULL;
        picture = strstr(names, ".webp") != NULL;
    }
    return meta && picture ? 90 : probe_names(peek, ".sog");
}

static spin_status open_sog_clip(void *self, const char *path)
{
    static const struct format format = {".sog", "SOG", open_sog, read_sog};
    static const struct format streamed = {".json", "streamed SOG", open_sog_levels,
                                           read_sog_levels};
    static const struct format joined = {".sog", "SOG", open_sog_frame, read_sog_frame};
    struct clip *clip = self;
    const char *meta, *index;
    bool is_clip = false;

    SPIN_TRY(spin_model_find(&clip->base, &index, path, SPIN_SOG_LEVELS_FILE));
    if (spin_path_is_folder(path))
        SPIN_TRY(is_joined(&clip->base, path, index, &is_clip));
    if (is_clip) {
        SPIN_TRY(read_still(clip, path, index));
        return open_clip(clip, &joined, path);
    }
    if (index || strcmp(spin_path_name(path), SPIN_SOG_LEVELS_FILE) == 0)
        return open_clip(clip, &streamed, index ? index : path);
    if (spin_model_option(&clip->base, "lod"))
        return spin_misuse("option 'lod' is for streamed SOG (" SPIN_SOG_LEVELS_FILE ")");
    SPIN_TRY(spin_model_find(&clip->base, &meta, path, "meta.json"));
    return open_clip(clip, &format, meta ? meta : path);
}

SPIN_MODEL_IMPORTER(
    sog, struct clip, open_sog_clip, close_clip,
    .summary = "SOG, versions 1 and 2: one file or meta.json, a folder with one per frame, or "
               "streamed SOG",
    .upstream = "playcanvas/splat-transform 0f60b17", .options = sog_options, .probe = sog_probe,
    .frame = clip_frame)

/* ---- GLB ------------------------------------------------------------------------------------- */

static const struct spin_plugin_option gltf_options[] = {
    {"axes", "gltf|source",
     "axes of the file: gltf (x left, y up, z forward), or source (as trained)", "gltf"},
    SPIN_FILE_SEQUENCE_OPTION,
    {0},
};

/* Nodes with a translation of at least this are far from 0, like those of georeferenced tiles. */
#define FAR 1024.0

/* If the first node of the first file is far from 0, makes the placements of all nodes relative to
 * it, since floats could not represent the sums of translations and positions precisely. */
static void shift_nodes(struct clip *clip)
{
    struct spin_gs_glb_scene *scene = &clip->opened.scene;
    struct spin_sequence_info *sequence = clip->base.sequence;

    for (size_t c = 0; c < 3 && clip->n_frames == 0 && scene->n_pieces > 0; c++) {
        double at = scene->piece[0].placement.shift[c];

        if (fabs(at) >= FAR)
            clip->shift[c] = round(at);
        /* The half turn from the axes of glTF negates x and y. */
        sequence->shift[c] = clip->turn && c < 2 ? -clip->shift[c] : clip->shift[c];
    }
    for (size_t i = 0; i < scene->n_pieces; i++)
        for (size_t c = 0; c < 3; c++)
            scene->piece[i].placement.shift[c] -= clip->shift[c];
    if (clip->shift[0] != 0 || clip->shift[1] != 0 || clip->shift[2] != 0)
        clip->opened.note[3] =
            "positions are stored relative to the first node, which is far from 0; spin-export "
            "adds the coordinates of this node again, unless --relative is given";
}

/* Opens a scene, or a clip whose frames an animation switches on and off. */
static spin_status open_glb(struct clip *clip)
{
    struct opened *out = &clip->opened;

    SPIN_TRY(spin_gs_glb_scene_open(clip->map.data, clip->map.size, &out->scene));
    out->n_frames = out->scene.n_frames;
    out->sh_degree = out->scene.sh_degree;
    out->antialias = out->scene.antialias;
    clip->base.sequence->fps = out->scene.fps;
    if (out->scene.linear)
        out->note[0] = "colours are stored in linear light and not converted";
    if (out->scene.moves)
        out->note[1] = "animations that move or fade nodes are ignored";
    if (out->scene.others)
        out->note[2] = "meshes that are not splats are ignored";
    shift_nodes(clip);
    return SPIN_OK;
}

static spin_status read_glb(struct clip *clip, unsigned columns, struct spin_splats *out)
{
    return spin_gs_glb_scene_read(&clip->opened.scene, clip->within, columns, out);
}

static int gltf_probe(const struct spin_peek *peek)
{
    return peek->is_folder ? probe_names(peek, ".glb") : spin_file_begins(peek, "glTF") ? 90 : 0;
}

static spin_status open_glb_clip(void *self, const char *path)
{
    static const struct format format = {".glb", "GLB", open_glb, read_glb};
    static const double half_about_z[4] = {0, 0, 0, 1};
    struct clip *clip = self;
    int axes;

    SPIN_TRY(spin_option_word(clip->base.values, "axes", "gltf|source", &axes));
    clip->turn = axes == 0 ? half_about_z : NULL;
    return open_clip(clip, &format, path);
}

SPIN_MODEL_IMPORTER(
    gltf, struct clip, open_glb_clip, close_clip,
    .summary = "GLB with KHR_gaussian_splatting: a scene, a clip, or a folder with one per frame",
    .upstream = "KhronosGroup/glTF 77b44be", .options = gltf_options, .probe = gltf_probe,
    .frame = clip_frame)
