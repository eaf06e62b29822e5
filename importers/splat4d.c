/* Reads .splat4d files of adamraudonis/splats4D: a clip in one file, with the same splats in every
 * frame. Only one group of frames is unpacked in memory at a time. */
#include <string.h>

#include "formats/splat4d.h"
#include "importers/lib/file_sequence.h"

struct splat4d {
    struct spin_model base;
    struct spin_map map;
    struct spin_splat4d clip;
};

static int splat4d_probe(const struct spin_peek *peek)
{
    return spin_file_begins(peek, "SP4D") ? 90 : spin_file_named(peek, ".splat4d");
}

static spin_status describe(struct splat4d *s)
{
    struct spin_sequence_info *sequence = s->base.sequence;
    double *times;
    size_t *counts;

    SPIN_TRY(spin_model_alloc(&s->base, (size_t)s->clip.n_frames, sizeof *times, (void **)&times));
    SPIN_TRY(
        spin_model_alloc(&s->base, (size_t)s->clip.n_frames, sizeof *counts, (void **)&counts));
    for (int i = 0; i < s->clip.n_frames; i++) {
        times[i] = i / s->clip.fps;
        counts[i] = s->clip.n;
    }
    sequence->n_frames = s->clip.n_frames;
    sequence->times = times;
    sequence->time_last = times[s->clip.n_frames - 1];
    sequence->counts = counts;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->static_columns = sequence->columns & ~s->clip.moving;
    sequence->identity = true;
    sequence->fps = s->clip.fps;
    sequence->sh_degree = 0;
    snprintf(sequence->variant, sizeof sequence->variant, "a clip of %g frames per second",
             s->clip.fps);
    spin_note(sequence, "the format has no view-dependent colour");
    if (s->clip.smoothed)
        spin_note(sequence, "colours were smoothed in time before they were packed");
    return SPIN_OK;
}

static spin_status open_splat4d(void *self, const char *path)
{
    struct splat4d *s = self;
    spin_status status;

    SPIN_TRY(spin_file_sequence_one(&s->base, path, ".splat4d", &s->base.path));
    SPIN_TRY(spin_map_open(s->base.path, &s->map));
    status = spin_splat4d_open(s->map.data, s->map.size, &s->clip);
    return status == SPIN_OK ? describe(s) : spin_fail_reading(status, s->base.path);
}

static spin_status splat4d_frame(void *self, int frame, double time, unsigned columns,
                                 struct spin_splats *out)
{
    struct splat4d *s = self;
    spin_status status =
        spin_splat4d_read(&s->clip, frame, columns & (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES), out);

    (void)time;
    return spin_fail_reading(status, s->base.path);
}

static void splat4d_close(void *self)
{
    struct splat4d *s = self;

    spin_splat4d_close(&s->clip);
    spin_map_close(&s->map);
    spin_model_close(s);
}

SPIN_MODEL_IMPORTER(splat4d, struct splat4d, open_splat4d, splat4d_close,
                    .summary = ".splat4d files, version 1: a clip of the same splats; no SH",
                    .upstream = "adamraudonis/splats4D bf7c41a", .probe = splat4d_probe,
                    .frame = splat4d_frame)
