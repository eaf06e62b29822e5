/* Reads the start times of the cameras of a rig. */
#include "importers/lib/views_rig.h"

#include "importers/lib/views_check.h"
#include "io/text_file.h"

/* Parses an offset in frames, such as "5", or in seconds, such as "0.2s". */
static spin_status parse_offset(const char *camera, const char *text, struct spin_offset *out)
{
    size_t n = strlen(text);
    char number[64];

    out->camera = camera;
    out->in_seconds = n > 0 && text[n - 1] == 's';
    snprintf(number, sizeof number, "%.*s", (int)(n - out->in_seconds), text);
    if (!*camera || n >= sizeof number || !spin_views_is_number(number, &out->value) ||
        fabs(out->value) > 1e7 || (!out->in_seconds && out->value != floor(out->value)))
        return spin_misuse("the offset '%s' of camera '%s' is neither a whole number of frames nor "
                           "seconds, such as 5 or 0.2s",
                           text, camera);
    return SPIN_OK;
}

/* Splits `text` in place into entries that end with one of the characters `ends`. In each entry,
 * one of the characters `between` separates the name of a camera from its offset. */
static spin_status parse_list(struct spin_model *m, char *text, const char *ends,
                              const char *between, struct spin_offsets *out)
{
    size_t most = 1;

    for (const char *at = text; *at; at++)
        most += strchr(ends, *at) != NULL;
    SPIN_TRY(spin_model_alloc(m, most, sizeof *out->list, (void **)&out->list));
    for (char *entry; (entry = strsep(&text, ends));) {
        char *value;

        entry += strspn(entry, " \t");
        if (*entry == '#' || *entry == '\0')
            continue;
        value = entry + strcspn(entry, between);
        if (*value)
            *value++ = '\0';
        value += strspn(value, between);
        value[strcspn(value, " \t\r#")] = '\0';
        SPIN_TRY(parse_offset(entry, value, &out->list[out->n++]));
    }
    return SPIN_OK;
}

spin_status spin_offsets_read(struct spin_model *m, struct spin_offsets *out)
{
    const char *option = spin_model_option(m, "offsets"), *path, *text;
    SPIN_LEAVES(spin_text_file_close) struct spin_text_file file = {0};

    *out = (struct spin_offsets){0};
    if (option && strchr(option, '=')) {
        SPIN_TRY(spin_model_text(m, &text, "%s", option));
        return spin_fail_context(parse_list(m, (char *)(uintptr_t)text, ";", "=", out),
                                 "option 'offsets'");
    }
    if (option && !spin_views_is_safe_name(option))
        return spin_misuse("option 'offsets' is '%s', expected a list such as 'cam01=5', or a file "
                           "in the data set",
                           option);
    SPIN_TRY(spin_model_join(m, &path, m->path, "%s", option ? option : "offsets.txt"));
    if (!option && !spin_path_exists(path))
        return SPIN_OK;
    SPIN_TRY(spin_text_file_open(path, &file));
    SPIN_TRY(spin_model_text(m, &text, "%s", file.text));
    return spin_fail_context(parse_list(m, (char *)(uintptr_t)text, "\n", " \t=:,", out), "'%s'",
                             path);
}

static bool is_same(const char *camera, const char *name)
{
    const char *base = spin_path_name(name), *dot = strrchr(base, '.');
    size_t n = dot && dot > base ? (size_t)(dot - base) : strlen(base);

    return (strlen(camera) == n && memcmp(camera, base, n) == 0) || strcmp(camera, name) == 0 ||
           (spin_views_number(camera) >= 0 && spin_views_number(camera) == spin_views_number(base));
}

const struct spin_offset *spin_offsets_of(struct spin_offsets *offsets, const char *camera)
{
    for (size_t i = 0; i < offsets->n; i++) {
        if (is_same(offsets->list[i].camera, camera)) {
            offsets->list[i].used = true;
            return &offsets->list[i];
        }
    }
    return NULL;
}

spin_status spin_offsets_check(const struct spin_offsets *offsets)
{
    for (size_t i = 0; i < offsets->n; i++) {
        if (!offsets->list[i].used)
            return spin_misuse(
                "option 'offsets' names camera '%s', but the data set has no such camera",
                offsets->list[i].camera);
    }
    return SPIN_OK;
}
