/* Reads .4dgs files (avala-ai), each with all 4D splats of a scene. */
#include <string.h>

#include "formats/4dgs.h"
#include "importers/lib/file_sequence.h"

enum { USUAL_FPS = 30 };

static int fourdgs_probe(const struct spin_peek *peek)
{
    return spin_file_begins(peek, "\2114DGS") ? 90 : spin_file_named(peek, ".4dgs");
}

/* Returns the last time at which splats can be visible. The interval in which a splat is visible
 * excludes its end, and the latest possible end is the largest float that is at most `duration`.
 * The result is therefore the float before this one. */
static float last_visible_time(double duration)
{
    float last = (float)duration;

    return nextafterf((double)last > duration ? nextafterf(last, 0) : last, 0);
}

/* Sets the frames of the clip: frame i of n at i / fps. Returns false if there are fewer than two
 * frames, or too many. */
static bool describe_frames(struct spin_sequence_info *sequence, double duration, double fps)
{
    double n = rint(duration * fps);

    if (n < 2 || n > INT_MAX)
        return false;
    sequence->fps = fps;
    sequence->n_clip_frames = (int)n;
    sequence->time_last = (n - 1) / fps;
    return true;
}

/* Sets the times of the clip. Files of other programs may contain no frame rate; USUAL_FPS is then
 * assumed. */
static void describe_times(struct spin_sequence_info *sequence, const struct spin_4dgs *info)
{
    sequence->time_first = 0;
    if (info->fps > 0 && describe_frames(sequence, info->duration, info->fps))
        return;
    if (describe_frames(sequence, info->duration, USUAL_FPS)) {
        spin_note(sequence, "the file does not store its frame rate: assumed %d frames per second",
                  USUAL_FPS);
        return;
    }
    sequence->time_last = (double)last_visible_time(info->duration);
    sequence->half_open = true;
}

static spin_status describe(struct spin_model *m, struct spin_4dgs *info, size_t n)
{
    struct spin_sequence_info *sequence = m->sequence;

    SPIN_TRY(spin_model_finish_4d(m));
    describe_times(sequence, info);
    snprintf(sequence->variant, sizeof sequence->variant, "%s, %zu splats, SH degree %d, %g s",
             info->keyframes ? "keyframe-delta" : "gaussian-birth", n, m->splats_4d.sh_degree,
             info->duration);
    if (info->keyframes)
        spin_note(sequence, "a splat whose attributes change is imported as several 4D splats, one "
                            "for each state of the splat");
    spin_note(
        sequence,
        "a splat is visible while its Gaussian window is at least %g, the threshold in the file",
        info->cutoff);
    spin_note(sequence,
              "nothing is visible at %g s, the end of the clip, since the time windows of splats "
              "do not include their end",
              info->duration);
    spin_note(sequence, "the format clamps colours of degree 0 to the visible range, 0 to 1");
    if (info->camera)
        spin_note(sequence, "the camera path is not imported");
    for (char *text = info->sound_notes, *line; (line = strsep(&text, "\n"));)
        if (*line)
            spin_note(sequence, "%s", line);
    return spin_model_sound(m, &info->sound);
}

static spin_status open_4dgs(void *self, const char *path)
{
    struct spin_model *m = self;
    struct spin_4dgs info;
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    spin_status status;

    SPIN_TRY(spin_file_sequence_one(m, path, ".4dgs", &m->path));
    SPIN_TRY(spin_map_open(m->path, &map));
    status = spin_4dgs_read(map.data, map.size, &info, &m->splats_4d);
    if (status == SPIN_OK)
        status = describe(m, &info, m->splats_4d.n);
    return spin_fail_reading(status, m->path);
}

SPIN_MODEL_IMPORTER(4dgs, struct spin_model, open_4dgs, spin_model_close,
                    .summary = ".4dgs files, version 1: 4D splats (gaussian-birth, keyframe-delta)",
                    .upstream = "avala-ai/4dgs 30f5d0f", .probe = fourdgs_probe,
                    .frame = spin_model_slice, .splats_4d = spin_model_splats_4d)
