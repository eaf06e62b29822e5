#include "formats/4dgs_sound.h"

#include "io/sound.h"

/* KEYFRAME: bytes of a keyframe of a moving sound: time, position, rotation x y z w, as doubles. */
enum { KEYFRAME = 8 * 8, MOST_SOUNDS = 1000 };

struct spin_4dgs_source {
    uint32_t id;
    struct spin_4dgs_cursor name, codec;
    uint64_t size;
    double start, gain;
    bool has_place, loops;
    const unsigned char *data; /* NULL: the audio data record has not been read yet */
};

static struct spin_4dgs_source *find_source(const struct spin_4dgs_sounds *sounds, uint32_t id)
{
    for (size_t i = 0; i < sounds->n; i++)
        if (sounds->source[i].id == id)
            return &sounds->source[i];
    return NULL;
}

/* Reads a position and a rotation. Returns false if they are invalid. Returns true if the record is
 * too short, since the caller checks the length itself. */
static bool read_pose(struct spin_4dgs_cursor *c)
{
    double place = 0, length = 0;

    for (int k = 0; k < 3; k++)
        place += fabs(spin_4dgs_double(c));
    for (int k = 0; k < 4; k++) {
        double v = spin_4dgs_double(c);

        length += v * v;
    }
    return c->cut || (isfinite(place) && fabs(length - 1) < 1e-3);
}

/* Reads the keyframes of a moving sound. Their times must increase and be within the clip. */
static spin_status check_keyframes(struct spin_4dgs_cursor *c, uint32_t id, double duration)
{
    uint64_t n = spin_4dgs_number(c, 4);
    double last = -INFINITY;

    if (c->cut || n > c->left / KEYFRAME) {
        c->cut = true;
        return SPIN_OK;
    }
    for (uint64_t k = 0; k < n; k++) {
        double time = spin_4dgs_double(c);

        if (!(time > last) || time < 0 || time > duration)
            return spin_malformed(
                "sound %u: the times of its keyframes are not in ascending order within the "
                "clip",
                id);
        if (!read_pose(c))
            return spin_malformed("sound %u: a keyframe has an invalid position or rotation", id);
        last = time;
    }
    return SPIN_OK;
}

static spin_status check_source(const struct spin_4dgs_source *s, double duration, bool has_pose)
{
    if (!(duration > 0) || !isfinite(duration) || !isfinite(s->start))
        return spin_malformed("sound %u: start at %g s and duration of %g s, expected finite "
                              "values and a duration above 0",
                              s->id, s->start, duration);
    if (!(s->gain >= 0) || !isfinite(s->gain))
        return spin_malformed("sound %u: its gain is %g, expected 0 or more", s->id, s->gain);
    return has_pose ? SPIN_OK
                    : spin_malformed("sound %u has an invalid position or rotation", s->id);
}

spin_status spin_4dgs_sound_source(struct spin_4dgs_sounds *sounds, struct spin_4dgs_cursor *c,
                                   double duration)
{
    struct spin_4dgs_source s = {.id = (uint32_t)spin_4dgs_number(c, 4)};
    struct spin_4dgs_cursor how;
    double length;
    unsigned flags;
    bool has_pose;

    s.name = spin_4dgs_block(c, 4);
    s.codec = spin_4dgs_block(c, 4);
    spin_4dgs_block(c, 4); /* the layout of the channels */
    s.size = spin_4dgs_number(c, 8);
    s.start = spin_4dgs_double(c);
    length = spin_4dgs_double(c);
    s.gain = spin_4dgs_double(c);
    flags = (unsigned)spin_4dgs_number(c, 1);
    s.has_place = flags & 1;
    s.loops = flags & SPIN_4DGS_LOOPS;
    has_pose = read_pose(c);
    SPIN_TRY(check_keyframes(c, s.id, duration));
    how = spin_4dgs_block(c, 4);
    if (c->cut)
        return SPIN_OK;
    SPIN_TRY(check_source(&s, length, has_pose));
    if (!spin_4dgs_is(&how, "linear") && !spin_4dgs_is(&how, "step"))
        return spin_malformed("sound %u: its interpolation is neither linear nor step", s.id);
    if (find_source(sounds, s.id))
        return spin_malformed("two sounds have the id %u", s.id);
    if (sounds->n == MOST_SOUNDS)
        return spin_unsupported("the file has more than %d sounds", MOST_SOUNDS);
    SPIN_TRY(spin_grow(sounds->n + 1, sizeof *sounds->source, (void **)&sounds->source));
    sounds->source[sounds->n++] = s;
    return SPIN_OK;
}

spin_status spin_4dgs_sound_data(struct spin_4dgs_sounds *sounds, struct spin_4dgs_cursor *c)
{
    uint32_t id = (uint32_t)spin_4dgs_number(c, 4);
    struct spin_4dgs_cursor data = spin_4dgs_block(c, 8);
    struct spin_4dgs_source *s = find_source(sounds, id);

    if (c->cut)
        return SPIN_OK;
    if (!s || s->data)
        return spin_malformed("sound %u has data %s", id, s ? "twice" : "but no source");
    if (data.left != s->size)
        return spin_malformed("sound %u has %zu bytes, its source declares %llu", id, data.left,
                              (unsigned long long)s->size);
    s->data = data.at;
    return SPIN_OK;
}

/* The output parameters of spin_4dgs_sounds_end(). */
struct result {
    struct spin_sound *sound;
    char *notes;
    size_t n;
};

/* Adds a note for each property that the chosen sound loses. */
static void note_losses(const struct spin_4dgs_sounds *sounds, const struct spin_4dgs_source *s,
                        const struct result *to)
{
    const char *name = to->sound->name;

    if (sounds->n > 1)
        spin_text_note(to->notes, to->n, "the file has %zu sounds, of which only '%s' is imported",
                       sounds->n, name);
    if (s->has_place)
        spin_text_note(to->notes, to->n,
                       "the sound '%s' is imported without its position in the scene", name);
    if (s->loops)
        spin_text_note(to->notes, to->n,
                       "the sound '%s' repeats in the file, but is imported to play only once",
                       name);
    if (!sounds->declared)
        spin_text_note(to->notes, to->n, "the header declares no sound, but the file has some");
    if (sounds->late)
        spin_text_note(
            to->notes, to->n,
            "a record of sound follows the first chunk, which the format does not allow");
}

/* Sets *to->sound to the source *s, or to no sound if the format of its file is unknown. */
static void choose_sound(const struct spin_4dgs_sounds *sounds, const struct spin_4dgs_source *s,
                         const struct result *to)
{
    char name[64] = "";

    snprintf(name, sizeof name, "%.*s", (int)(s->name.left < 60 ? s->name.left : 60),
             (const char *)s->name.at);
    if (spin_sound_set(to->sound, name, s->data, (size_t)s->size) != SPIN_OK) {
        spin_text_note(to->notes, to->n, "the sound is not imported: %s", spin_last_error());
        *to->sound = (struct spin_sound){0};
        return;
    }
    to->sound->gain = s->gain;
    to->sound->start = sounds->start < 0 ? sounds->start : s->start;
    note_losses(sounds, s, to);
}

spin_status spin_4dgs_sounds_end(const struct spin_4dgs_sounds *sounds, struct spin_sound *sound,
                                 char *notes, size_t n_notes)
{
    const struct result to = {sound, notes, n_notes};
    const struct spin_4dgs_source *chosen = NULL;

    if (sounds->old && sounds->n > 0)
        return spin_malformed("the file contains sound in record 09 and in record 11, expected "
                              "only one of these records");
    for (size_t i = 0; i < sounds->n; i++) {
        const struct spin_4dgs_source *s = &sounds->source[i];

        if (!s->data)
            return spin_malformed("sound %u has no data", s->id);
        if (!chosen || (chosen->has_place && !s->has_place))
            chosen = s;
    }
    if (chosen)
        choose_sound(sounds, chosen, &to);
    else if (sounds->old)
        spin_text_note(
            notes, n_notes,
            "the sound is not imported: its form (record 09) is outdated and not supported");
    else if (sounds->declared)
        spin_text_note(notes, n_notes, "the header declares sound, but the file has none");
    return SPIN_OK;
}
