#include "run/export_sound.h"

#include "base/base.h"
#include "io/sound.h"
#include "io/ranks.h"

#define USUAL_FPS 30

/* Returns whether the user wants the output without sound. */
static bool is_off(const char *sound) { return sound && strcmp(sound, "none") == 0; }

static spin_status open_file(const char *path, struct spin_export_sound *out)
{
    SPIN_TRY_IN(spin_map_open(path, &out->file), "--sound");
    return spin_fail_context(spin_sound_set(&out->sound, path, out->file.data, out->file.size),
                             "--sound '%s'", path);
}

/* Returns the difference in frame number between the first exported frame and the frame that the
 * sound is timed from: the first frame of the bundle for the file of --sound, and the first frame
 * of the whole source clip for the sound of the bundle. */
static double frames_before(const struct spin_export_options *o, const struct spin_clip *clip)
{
    const struct spin_bundle_meta *meta = &clip->bundle.meta;

    return meta->frame[clip->frame[0]].number - meta->frame[0].number +
           (o->sound ? 0 : meta->source_index[0]);
}

/* Returns the value of the exporter's option --fps; 0 if it is not given. */
static double asked_fps(const struct spin_export_options *o)
{
    const struct spin_plugin_values values = {.pairs = o->plugin_pairs};
    const char *text = spin_plugin_value(&values, "fps", NULL);

    return text ? strtod(text, NULL) : 0;
}

/* Returns whether the word is in the list, whose items are separated by spaces. */
static bool is_in(const char *list, const char *word)
{
    size_t n = strlen(word);

    for (const char *at = list; (at = strstr(at, word)); at += n)
        if ((at == list || at[-1] == ' ') && (at[n] == ' ' || at[n] == '\0'))
            return true;
    return false;
}

/* Returns whether the exporter can store the sound, and warns if it cannot. */
static bool can_store(const struct spin_exporter *e, const struct spin_sound *s)
{
    if (!e->sound)
        spin_warn("'%s' cannot store sound: the output lacks the sound '%s' (--sound none omits it "
                  "without this warning)",
                  e->name, s->name);
    else if (strcmp(e->sound, "all") != 0 && !is_in(e->sound, s->type))
        spin_warn("'%s' stores sound as %s, not as %s: the output lacks the sound '%s'; convert it "
                  "and name the file with --sound",
                  e->name, e->sound, s->type, s->name);
    else
        return true;
    return false;
}

/* Returns whether the sound can be played in sync with the exported frames, and warns if not. */
static bool can_follow(const struct spin_export_options *o, const struct spin_export_sound *x,
                       double fps, int n_frames)
{
    double asked = asked_fps(o), length = spin_sound_seconds(&x->sound);

    if (fps > 0 && asked > 0 && fabs(asked - fps) > 1e-3 * fps)
        spin_warn("--fps changes the speed of the clip from %.6g to %.6g frames per second, "
                  "but not the speed of its sound: the output lacks the sound '%s'",
                  fps, asked, x->sound.name);
    else if (x->sound.start >= n_frames / x->fps || (length > 0 && x->sound.start + length <= 0))
        spin_warn("the sound '%s' does not play during the exported frames: the output lacks it",
                  x->sound.name);
    else
        return true;
    return false;
}

static spin_status place_sound(const struct spin_export_options *o, const struct spin_clip *clip,
                               double fps, double stride, struct spin_export_sound *x)
{
    struct spin_sound whole;

    x->fps = fps > 0 ? fps : asked_fps(o);
    if (!(x->fps > 0)) {
        x->fps = USUAL_FPS / stride;
        spin_warn("the frame rate of the clip is unknown, assuming %d frames per second for its "
                  "sound: set it with --fps",
                  USUAL_FPS);
    }
    x->sound.start -= frames_before(o, clip) / (x->fps * stride);
    if (!can_follow(o, x, fps, clip->n_frames)) {
        x->sound.data = NULL;
        return SPIN_OK;
    }
    whole = x->sound;
    return x->sound.start < 0 ? spin_sound_align(&whole, &x->sound, &x->owned) : SPIN_OK;
}

spin_status spin_export_sound_check(const char *sound)
{
    struct spin_export_sound file = {.fps = 0};
    spin_status status = sound && !is_off(sound) ? open_file(sound, &file) : SPIN_OK;

    spin_export_sound_close(&file);
    return status;
}

spin_status spin_export_sound_open(const struct spin_export_options *o,
                                   const struct spin_exporter *exporter,
                                   const struct spin_clip *clip, double fps, double stride,
                                   struct spin_export_sound *out)
{
    if (is_off(o->sound) || spin_rank() > 0)
        return SPIN_OK;
    if (o->sound)
        SPIN_TRY(open_file(o->sound, out));
    else
        out->sound = clip->bundle.meta.sound;
    if (out->sound.data && !can_store(exporter, &out->sound))
        out->sound.data = NULL;
    if (out->sound.data)
        SPIN_TRY(place_sound(o, clip, fps, stride, out));
    if (!out->sound.data)
        out->fps = 0;
    return SPIN_OK;
}

void spin_export_sound_close(struct spin_export_sound *sound)
{
    spin_map_close(&sound->file);
    free(sound->owned);
}
