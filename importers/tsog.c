/* Reads TSOG files, each of which contains a clip; src/formats/tsog.h describes the format. */
#include "formats/tsog.h"

#include <string.h>

#include "importers/lib/file_sequence.h"

/* The player does not draw splats with a lower opacity. */
#define LEAST_OPACITY (1 / 255.0)

struct tsog_model {
    struct spin_model base;
    struct spin_tsog tsog;
    size_t *counts; /* [n_frames] number of splats in each frame */
};

/* Recognises the format by the extension of the file, or by the name of the profile in meta.json.
 * The names of images do not identify the format, since they are arbitrary in older files. */
static int probe(const struct spin_peek *peek)
{
    bool zip = spin_zip_detect(peek->head, peek->n_head);

    if (peek->is_folder)
        return spin_file_named(peek, ".tsog");
    if (!zip || !strstr(peek->tail_names, "meta.json"))
        return 0;
    if (spin_file_has_suffix(peek->path, ".tsog"))
        return 100;
    return spin_peek_contains(peek, "org.opsiclear.tsog-playback") ? 100 : 0;
}

/* Fills the description of a static or discrete clip, which has a frame at each of the times 0, 1,
 * 2, ... */
static spin_status describe_frames(struct tsog_model *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    size_t n = (size_t)m->tsog.n_frames;
    double *times;

    SPIN_TRY(spin_model_alloc(&m->base, n, sizeof *m->counts, (void **)&m->counts));
    SPIN_TRY(spin_model_scratch(&m->base, n, sizeof *times, (void **)&times));
    for (size_t f = 0; f < n; f++)
        times[f] = (double)f;
    SPIN_TRY(spin_splats_4d_counts(&m->base.splats_4d, times, n, m->counts));
    sequence->n_frames = (int)n;
    sequence->counts = m->counts;
    sequence->continuous = false;
    sequence->time_last = (double)(n - 1);
    return SPIN_OK;
}

static spin_status open_file(void *self, const char *path)
{
    struct tsog_model *m = self;
    struct spin_sequence_info *sequence = m->base.sequence;
    static const char *const kinds[] = {"static", "discrete", "continuous"};
    struct spin_map map;
    spin_status status;

    SPIN_TRY(spin_file_sequence_one(&m->base, path, ".tsog", &m->base.path));
    path = m->base.path;
    SPIN_TRY(spin_map_open(path, &map));
    status = spin_tsog_read(map.data, map.size, &m->tsog, &m->base.splats_4d);
    if (status == SPIN_OK)
        status = spin_model_sound(&m->base, &m->tsog.sound.sound);
    free(m->tsog.sound.owned);
    spin_map_close(&map);
    if (status == SPIN_OK && m->tsog.time == SPIN_TSOG_CONTINUOUS)
        m->base.splats_4d.least_opacity = LEAST_OPACITY;
    if (status == SPIN_OK)
        status = spin_model_finish_4d(&m->base);
    SPIN_TRY_IN(status, "cannot read '%s'", path);
    snprintf(sequence->variant, sizeof sequence->variant, "TSOG, %s, %zu splats",
             kinds[m->tsog.time], m->base.splats_4d.n);
    sequence->fps = m->tsog.fps;
    if (*m->tsog.sound.note)
        spin_note(sequence, "%s", m->tsog.sound.note);
    if (m->tsog.time != SPIN_TSOG_CONTINUOUS)
        return describe_frames(m);
    sequence->n_clip_frames = m->tsog.n_frames;
    return SPIN_OK;
}

static spin_status frame(void *self, int frame, double time, unsigned columns,
                         struct spin_splats *out)
{
    const struct tsog_model *m = self;
    bool continuous = m->tsog.time == SPIN_TSOG_CONTINUOUS;

    if (!continuous && frame >= m->tsog.n_frames)
        return spin_not_found("'%s' has no frame %d", m->base.path, frame);
    return spin_model_slice(self, frame, continuous ? time : frame, columns, out);
}

SPIN_MODEL_IMPORTER(tsog, struct tsog_model, open_file, spin_model_close,
                    .summary = "TSOG (.tsog): 4D splats of a clip, its frames, or a static scene",
                    .upstream = "OpsiClear-4DGS/ftgs-player 64dfa9e (TSOG Playback Profile 1.0.1)",
                    .probe = probe, .frame = frame, .splats_4d = spin_model_splats_4d)
