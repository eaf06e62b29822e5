/* Reads stages of OpenUSD with splats: one file, text, crate or package, with a scene or a clip, or
 * the folder that `spin-export --to usd` writes. src/formats/usd_stage.h describes what is read.
 *
 * Stages are y up or z up, whereas the axes of a training are mostly x right, y down, z forward.
 * With --axes usd, the importer undoes the half turn about x that exporters apply. */
#include "formats/usd_stage.h"

#include <string.h>

#include "importers/lib/file_sequence.h"

struct usd_model {
    struct spin_model base;
    struct spin_usd_stage stage;
    bool turned;
    bool warned; /* note about splats that were dropped */
    int *numbers;
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
    if (!peek->is_folder && spin_zip_looks_like(peek->head, peek->n_head))
        return spin_file_has_suffix(peek->path, ".usdz") ? 90 : 0;
    return peek->is_folder ? best : 0;
}

/* Sets *out to the file to read: `path` itself or, if `path` is a folder, the stage in it. */
static spin_status find_stage(struct spin_model *m, const char *path, const char **out)
{
    struct spin_file_sequence files = {0};

    SPIN_TRY(spin_model_find(m, out, path, "clip.usda"));
    if (*out || !spin_path_is_folder(path)) {
        *out = *out ? *out : path;
        return SPIN_OK;
    }
    for (int i = 0; i < N_SUFFIXES; i++) {
        SPIN_TRY(spin_file_sequence_list(m, path, suffixes[i], &files));
        if (files.n_frames > 1 || (files.n_frames == 1 && *out))
            return spin_unsupported("'%s' contains several files of USD and no clip.usda: give one "
                                    "of the files",
                                    path);
        *out = files.n_frames == 1 ? files.frame[0].path : *out;
    }
    return *out ? SPIN_OK : spin_not_found("'%s' contains no files of USD", path);
}

static void add_notes(const struct spin_usd_stage *s, struct spin_sequence_info *sequence)
{
    if (s->antialias)
        spin_note(sequence,
                  "trained with an antialiasing rasteriser: the splats are drawn antialiased");
    if (s->linear)
        spin_note(sequence, "colours are stored in linear light and not converted");
    if (s->meters > 0 && s->meters != 1)
        spin_note(sequence, "a unit is %g m: positions are not converted to metres", s->meters);
    if (s->cut)
        spin_note(sequence, "SH of degree 4 and more are cut to degree 3");
    if (s->no_orientations)
        spin_note(sequence, "splats without orientations are not rotated");
    if (s->no_opacities)
        spin_note(sequence, "splats without opacities are opaque");
    if (s->no_sh)
        spin_note(sequence, "splats without SH coefficients are grey");
    if (s->variants)
        spin_note(sequence, "variants are ignored");
    if (*s->other)
        spin_note(sequence, "prims of type %s are ignored", s->other);
    if (*s->missing)
        spin_note(sequence, "a file that is referenced does not exist: %s", s->missing);
}

/* Sets frame numbers to the time codes, if those are integers. */
static spin_status set_numbers(struct usd_model *m)
{
    const struct spin_usd_stage *s = &m->stage;

    SPIN_TRY(spin_model_alloc(&m->base, s->n_frames, sizeof *m->numbers, (void **)&m->numbers));
    for (size_t i = 0; i < s->n_frames; i++) {
        if (!(s->times[i] >= 0 && s->times[i] <= INT_MAX && s->times[i] == floor(s->times[i])))
            return SPIN_OK;
        m->numbers[i] = (int)s->times[i];
    }
    m->base.sequence->numbers = s->n_frames > 1 ? m->numbers : NULL;
    return SPIN_OK;
}

static spin_status describe(struct usd_model *m)
{
    const struct spin_usd_stage *s = &m->stage;
    struct spin_sequence_info *sequence = m->base.sequence;
    const unsigned tracked = SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH;
    double span = s->times[s->n_frames - 1] - s->times[0];

    sequence->n_frames = (int)s->n_frames;
    sequence->times = s->times;
    sequence->time_first = s->times[0];
    sequence->time_last = s->times[s->n_frames - 1];
    sequence->counts = s->counts;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->static_columns = s->n_frames > 1 ? s->still : 0;
    /* If neither shape nor colour of the rows changes, row i is the same splat in all frames. */
    sequence->identity = s->n_frames > 1 && (s->still & tracked) == tracked;
    sequence->sh_degree = s->sh_degree;
    sequence->antialias = s->antialias;
    if (s->n_frames > 1)
        sequence->fps = s->codes_per_second * (double)(s->n_frames - 1) / span;
    snprintf(sequence->variant, sizeof sequence->variant, "USD, %s",
             s->n_frames > 1 ? "a clip" : "one frame");
    add_notes(s, sequence);
    return set_numbers(m);
}

static spin_status open_usd(void *self, const char *path)
{
    struct usd_model *m = self;
    size_t n_all = 0;
    int axes;

    SPIN_TRY(spin_option_word(m->base.values, "axes", "usd|source", &axes));
    m->turned = axes == 0;
    SPIN_TRY(find_stage(&m->base, path, &path));
    SPIN_TRY(spin_model_text(&m->base, &m->base.path, "%s", path));
    SPIN_TRY(spin_usd_stage_open(path, &m->stage));
    for (size_t i = 0; i < m->stage.n_frames; i++)
        n_all += m->stage.counts[i];
    if (n_all == 0)
        return spin_malformed("'%s': 0 splats", path);
    return describe(m);
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
    if (frame < 0 || (size_t)frame >= m->stage.n_frames)
        return spin_not_found("'%s' has no frame %d", m->base.path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_usd_stage_read(&m->stage, (size_t)frame, m->turned, columns, out, &n));
    if (n > 0 && !m->warned)
        spin_warn("'%s': %s with values that are not finite dropped", m->base.path,
                  spin_text_count((long long)n, "splat", text));
    m->warned = m->warned || n > 0;
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"axes", "usd|source",
     "axes of the file: usd (x right, y up, z back, or as its upAxis says), or source (as trained)",
     "usd"},
    {0},
};

SPIN_MODEL_IMPORTER(usd, struct usd_model, open_usd, close_usd,
                    .summary =
                        "USD (.usda, .usdc, .usdz) with ParticleField3DGaussianSplat: a scene, or "
                        "a clip by time samples or value clips",
                    .upstream = "PixarAnimationStudios/OpenUSD 26f8373", .options = options,
                    .probe = probe, .frame = usd_frame)
