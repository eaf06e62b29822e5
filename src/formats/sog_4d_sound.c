#include "formats/sog_4d_sound.h"

#include <strings.h>

#include "base/base.h"

static spin_status fail_audio(const struct spin_sog_4d *r, const char *key, const char *expected)
{
    return spin_malformed("%s: 'audio%s' is invalid, expected %s", r->what, key, expected);
}

/* Returns whether the name has the extension of a sound format that browsers can play. */
static bool is_sound_name(const char *name)
{
    static const char *const endings[] = {".mp3",  ".m4a", ".aac",  ".ogg", ".oga",
                                          ".opus", ".wav", ".flac", ".webm"};
    const char *dot = strrchr(name, '.');

    for (size_t i = 0; dot && i < sizeof endings / sizeof *endings; i++)
        if (strcasecmp(dot, endings[i]) == 0)
            return true;
    return false;
}

static bool is_sound_type(const char *type)
{
    static const char token[] =
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.+-_";

    return strncasecmp(type, "audio/", 6) == 0 && type[6] && type[6 + strspn(type + 6, token)] == 0;
}

/* Checks the description of the sound, and sets *volume. */
static spin_status check_audio(const struct spin_sog_4d *r, const spin_json *audio, double *volume)
{
    const char *file = spin_json_string(spin_json_get(audio, "file"));
    const spin_json *type = spin_json_get(audio, "mimeType");
    const spin_json *loud = spin_json_get(audio, "volume");

    if (!file || !spin_sog_4d_name_is_plain(file) || strcmp(file, "meta.json") == 0)
        return fail_audio(r, ".file", "the name of a member");
    for (int p = 0; p < SPIN_4D_PICTURES; p++)
        if (r->name[p] && strcmp(r->name[p], file) == 0)
            return fail_audio(r, ".file", "a name that differs from those of the images");
    if (type ? !spin_json_string(type) || !is_sound_type(spin_json_string(type))
             : !is_sound_name(file))
        return fail_audio(r, "", "a known 'mimeType' or file extension");
    *volume = 1;
    if (loud && (!spin_json_number(loud, volume) || !(*volume >= 0 && *volume <= 1)))
        return fail_audio(r, ".volume", "a number from 0 to 1");
    return SPIN_OK;
}

/* Reads the name and the start of the sound, which are only in files that spin4d has written. */
static spin_status read_start(const struct spin_sog_4d *r, const spin_json *audio,
                              struct spin_sound *out)
{
    const spin_json *own = spin_json_get(audio, SPIN_SOG_4D_OWN);
    const spin_json *start = spin_json_get(own, "start");
    const char *name = spin_json_string(spin_json_get(own, "name"));

    if (start && (!spin_json_number(start, &out->start) || !isfinite(out->start)))
        return fail_audio(r, "." SPIN_SOG_4D_OWN ".start", "a number");
    if (name)
        snprintf(out->name, sizeof out->name, "%s", name);
    spin_text_tidy(out->name, false);
    return SPIN_OK;
}

spin_status spin_sog_4d_sound(const struct spin_sog_4d *r, const spin_json *audio,
                              struct spin_sog_4d_sound *out)
{
    const char *file = spin_json_string(spin_json_get(audio, "file"));
    const struct spin_zip_member *member;
    const unsigned char *data;
    double volume;

    if (!audio)
        return SPIN_OK;
    SPIN_TRY(check_audio(r, audio, &volume));
    member = spin_zip_find(&r->zip, file);
    if (!member || member->size > SPIN_SOUND_LIMIT)
        return spin_malformed("%s: sound '%.60s' is missing or above 128 MiB", r->what, file);
    SPIN_TRY(spin_zip_read(&r->zip, member, true, SPIN_SOUND_LIMIT, &data, &out->owned));
    if (spin_sound_set(&out->sound, file, data, (size_t)member->size) != SPIN_OK) {
        snprintf(out->note, sizeof out->note, "the sound is not imported: %s", spin_last_error());
        out->sound = (struct spin_sound){0};
        return SPIN_OK;
    }
    out->sound.gain = volume;
    return read_start(r, audio, &out->sound);
}
