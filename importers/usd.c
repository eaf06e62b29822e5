/* Reads stages of OpenUSD with splats. The input is a file (text, crate or package) with a scene or
 * a clip, or a folder that `spin-export --to usd` wrote. src/formats/usd_stage.h describes what is
 * read.
 *
 * Stages are y up or z up, whereas the axes of a training are mostly x right, y down, z forward.
 * With --axes usd, the importer undoes the half turn about x that exporters apply. */
#include "formats/usd_stage.h"

#include <string.h>

#include "importers/lib/file_sequence.h"

struct usd_model {
    struct spin_model base;
    struct spin_usd_stage stage;     /* the stage that is open */
    struct spin_file_sequence files; /* one file, or one for each frame */
    size_t at, n_frames;             /* index of the open file; number of frames in all files */
    int sh_degree;                   /* largest SH degree of all files */
    bool turned;                     /* undo the half turn about x that exporters apply */
    bool warned;                     /* a warning about dropped splats was printed */
    int *numbers;
    size_t *counts;
};

static const char *const suffixes[] = {".usda", ".usdc", ".usdz", ".usd"};
enum { N_SUFFIXES = sizeof suffixes / sizeof *suffixes };

/* Recognises layers by their first bytes, packages by their extension, and folders by names of
 * files. */
static int probe(const struct spin_peek *peek)
{
    int best = 0;

    for (int i = 0; i < N_SUFFIXES && peek->is_folder; i++) {
        int named = spin_file_named(peek, suffixes[i]);

        best = named > best ? named : best;
    }
    if (spin_peek_has(peek, "clip.usda"))
        return 90;
    if (spin_file_begins(peek, "#usda 1.0") || spin_file_begins(peek, "PXR-USDC"))
        return 90;
    if (!peek->is_folder && spin_zip_detect(peek->head, peek->n_head))
        return spin_file_has_suffix(peek->path, ".usdz") ? 90 : 0;
    return peek->is_folder ? best : 0;
}

/* Lists the files to read: `path` itself or, if `path` is a folder, the stage or the files of the
 * frames in it. */
static spin_status find_files(struct usd_model *m, const char *path)
{
    struct spin_file_sequence files = {0};
    const char *stage;

    SPIN_TRY(spin_model_find(&m->base, &stage, path, "clip.usda"));
    if (stage || !spin_path_is_folder(path))
        return spin_file_sequence_find(&m->base, stage ? stage : path, "", &m->files);
    for (int i = 0; i < N_SUFFIXES; i++) {
        SPIN_TRY(spin_file_sequence_list(&m->base, path, suffixes[i], &files));
        if (files.n_frames > 0 && m->files.n_frames > 0)
            return spin_unsupported("'%s' contains USD files with several extensions and no "
                                    "clip.usda: give one of the files",
                                    path);
        m->files = files.n_frames > 0 ? files : m->files;
    }
    if (m->files.n_frames == 0)
        return spin_not_found("'%s' contains no USD files", path);
    return spin_file_sequence_sort(&m->base, &m->files, false, m->base.sequence);
}

/* Opens the stage of a file, unless it is open. */
static spin_status open_stage(struct usd_model *m, size_t file)
{
    if (m->at == file)
        return SPIN_OK;
    spin_usd_stage_close(&m->stage);
    m->at = SIZE_MAX;
    SPIN_TRY(spin_usd_stage_open(m->files.frame[file].path, &m->stage));
    m->at = file;
    return SPIN_OK;
}

static void add_notes(const struct spin_usd_stage *s, struct spin_sequence_info *sequence)
{
    sequence->antialias = sequence->antialias || s->antialias;
    if (s->antialias)
        spin_note(sequence,
                  "trained with an antialiasing rasteriser: the splats are drawn antialiased");
    if (s->linear)
        spin_note(sequence, "colours are stored in linear light and are not converted to sRGB");
    if (s->meters > 0 && s->meters != 1)
        spin_note(sequence, "a unit is %g m: positions are not converted to metres", s->meters);
    if (s->cut)
        spin_note(sequence, "SH of degree 4 and more are cut to degree 3");
    if (s->no_orientations)
        spin_note(sequence, "splats without orientations are imported without a rotation");
    if (s->no_opacities)
        spin_note(sequence, "splats without opacities are opaque");
    if (s->no_sh)
        spin_note(sequence, "splats without SH coefficients are grey");
    if (s->variants)
        spin_note(sequence, "variants are ignored");
    if (*s->other)
        spin_note(sequence, "prims of type %s are ignored", s->other);
    if (*s->missing)
        spin_note(sequence, "a referenced file does not exist: %s", s->missing);
}

/* Sets the frame numbers to the time codes, if all of these are integers. */
static spin_status set_numbers(struct usd_model *m)
{
    const struct spin_usd_stage *s = &m->stage;

    for (size_t i = 0; i < s->n_frames; i++) {
        if (!(s->times[i] >= 0 && s->times[i] <= INT_MAX && s->times[i] == floor(s->times[i])))
            return SPIN_OK;
        m->numbers[i] = (int)s->times[i];
    }
    m->base.sequence->numbers = s->n_frames > 1 ? m->numbers : NULL;
    return SPIN_OK;
}

/* Describes the clip or the scene of a single file. */
static spin_status describe_stage(struct usd_model *m)
{
    const struct spin_usd_stage *s = &m->stage;
    struct spin_sequence_info *sequence = m->base.sequence;
    const unsigned tracked = SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH;
    double span = s->times[s->n_frames - 1] - s->times[0], *times;

    SPIN_TRY(spin_model_alloc(&m->base, s->n_frames, sizeof *times, (void **)&times));
    memcpy(times, s->times, s->n_frames * sizeof *times);
    sequence->times = times;
    sequence->time_first = times[0];
    sequence->time_last = times[s->n_frames - 1];
    sequence->static_columns = s->n_frames > 1 ? s->still : 0;
    /* If neither shape nor colour of the rows changes, row i is the same splat in all frames. */
    sequence->identity = s->n_frames > 1 && (s->still & tracked) == tracked;
    if (s->n_frames > 1)
        sequence->fps = s->codes_per_second * (double)(s->n_frames - 1) / span;
    snprintf(sequence->variant, sizeof sequence->variant, "USD, %s",
             s->n_frames > 1 ? "a clip" : "one frame");
    return set_numbers(m);
}

/* Describes a clip with one file per frame. */
static void describe_files(struct usd_model *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;

    for (size_t i = 0; i < m->n_frames; i++)
        m->numbers[i] = m->files.frame[i].number;
    sequence->numbers = m->numbers[0] >= 0 ? m->numbers : NULL;
    sequence->time_last = (double)m->n_frames - 1;
    snprintf(sequence->variant, sizeof sequence->variant, "a sequence of USD files");
}

/* Reads the counts of splats, the SH degree and the notes of a file, which is frame `file` of a
 * sequence or contains all frames. */
static spin_status look_at_file(struct usd_model *m, size_t file, size_t *n_all)
{
    size_t n_files = m->files.n_frames, n;

    SPIN_TRY(open_stage(m, file));
    n = m->stage.n_frames;
    if (n_files > 1 && n > 1)
        return spin_malformed("'%s' contains a clip of %zu frames: import this file on its own",
                              m->files.frame[file].path, n);
    if (file == 0) {
        m->n_frames = n_files > 1 ? n_files : n;
        SPIN_TRY(spin_model_alloc(&m->base, m->n_frames, sizeof *m->counts, (void **)&m->counts));
        SPIN_TRY(spin_model_alloc(&m->base, m->n_frames, sizeof *m->numbers, (void **)&m->numbers));
    }
    memcpy(m->counts + file, m->stage.counts, n * sizeof *m->counts);
    for (size_t i = 0; i < n; i++)
        *n_all += m->stage.counts[i];
    if (file > 0 && m->stage.sh_degree != m->sh_degree)
        spin_note(m->base.sequence,
                  "the SH degree differs between frames: missing SH are set to 0");
    m->sh_degree = m->stage.sh_degree > m->sh_degree ? m->stage.sh_degree : m->sh_degree;
    add_notes(&m->stage, m->base.sequence);
    return SPIN_OK;
}

static spin_status open_usd(void *self, const char *path)
{
    struct usd_model *m = self;
    struct spin_sequence_info *sequence = m->base.sequence;
    size_t n_all = 0;
    int axes;

    SPIN_TRY(spin_option_word(m->base.values, "axes", "usd|source", &axes));
    m->turned = axes == 0;
    m->at = SIZE_MAX;
    SPIN_TRY(find_files(m, path));
    m->base.path = m->files.frame[0].path;
    for (size_t i = 0; i < m->files.n_frames; i++)
        SPIN_TRY(look_at_file(m, i, &n_all));
    if (n_all == 0)
        return spin_malformed("'%s' contains 0 splats", m->base.path);
    sequence->n_frames = (int)m->n_frames;
    sequence->counts = m->counts;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = m->sh_degree;
    if (m->files.n_frames == 1)
        return describe_stage(m);
    describe_files(m);
    return SPIN_OK;
}

static void close_usd(void *self)
{
    struct usd_model *m = self;

    if (m)
        spin_usd_stage_close(&m->stage);
    spin_model_close(self);
}

static spin_status usd_frame(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out)
{
    struct usd_model *m = self;
    size_t n;
    char text[48];

    (void)time;
    if (frame < 0 || (size_t)frame >= m->n_frames)
        return spin_not_found("'%s' has no frame %d", m->base.path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(open_stage(m, m->files.n_frames > 1 ? (size_t)frame : 0));
    m->stage.sh_degree = m->sh_degree;
    SPIN_TRY(spin_usd_stage_read(&m->stage, m->files.n_frames > 1 ? 0 : (size_t)frame, m->turned,
                                 columns, out, &n));
    if (n > 0 && !m->warned)
        spin_warn("'%s': dropped %s with values that are not finite", m->files.frame[m->at].path,
                  spin_text_count((long long)n, "splat", text));
    m->warned = m->warned || n > 0;
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"axes", "usd|source",
     "axes of the file: usd (x right, y up, z back, or as the file's upAxis states), or source (as "
     "trained)",
     "usd"},
    SPIN_FILE_SEQUENCE_OPTION,
    {0},
};

SPIN_MODEL_IMPORTER(usd, struct usd_model, open_usd, close_usd,
                    .summary =
                        "USD (.usda, .usdc, .usdz) with ParticleField3DGaussianSplat: a scene, or "
                        "a clip by time samples or value clips, or a folder with one per frame",
                    .upstream = "PixarAnimationStudios/OpenUSD 26f8373", .options = options,
                    .probe = probe, .frame = usd_frame)
