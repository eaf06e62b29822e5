#include "base/option.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

const char *spin_plugin_value(const struct spin_plugin_values *v, const char *key,
                              const char *fallback)
{
    const char *found = fallback;

    if (!v || !v->pairs)
        return fallback;
    /* If an option is repeated, its last value is used, as usual on a command line. */
    for (const char *const *pair = v->pairs; pair[0]; pair += 2) {
        if (strcmp(pair[0], key) == 0)
            found = pair[1] ? pair[1] : "";
    }
    return found;
}

/* Format "a|b|c" as "a, b or c". */
static void list_words(const char *words, char *out, size_t n_out)
{
    size_t used = 0;

    out[0] = '\0';
    while (*words && used < n_out) {
        size_t n = strcspn(words, "|");
        const char *end = !words[n] ? "" : strchr(words + n + 1, '|') ? ", " : " or ";

        used += (size_t)snprintf(out + used, n_out - used, "%.*s%s", (int)n, words, end);
        words += n + (words[n] == '|');
    }
}

spin_status spin_option_word(const struct spin_plugin_values *v, const char *key, const char *words,
                             int *out)
{
    const char *text = spin_plugin_value(v, key, NULL);
    char list[128];

    *out = 0;
    if (!text)
        return SPIN_OK;
    for (const char *at = words; *at; ++*out) {
        size_t n = strcspn(at, "|");

        if (strlen(text) == n && strncmp(at, text, n) == 0)
            return SPIN_OK;
        at += n + (at[n] == '|');
    }
    list_words(words, list, sizeof list);
    return spin_misuse("option '%s' is '%s', expected %s", key, text, list);
}

static spin_status read_number(const struct spin_plugin_values *v, const char *key, bool whole,
                               double least, double most, double *out)
{
    const char *text = spin_plugin_value(v, key, NULL);
    char *end;
    double value;

    if (!text)
        return SPIN_OK;
    value = strtod(text, &end);
    if (end == text || *end || !(value >= least && value <= most) ||
        (whole && value != floor(value)))
        return spin_misuse("option '%s' is '%s', expected a %snumber from %.10g to %.10g", key,
                           text, whole ? "whole " : "", least, most);
    *out = value;
    return SPIN_OK;
}

spin_status spin_option_number(const struct spin_plugin_values *v, const char *key, double least,
                               double most, double *out)
{
    return read_number(v, key, false, least, most, out);
}

spin_status spin_option_count(const struct spin_plugin_values *v, const char *key, int least,
                              int most, int *out)
{
    double value = *out;

    SPIN_TRY(read_number(v, key, true, least, most, &value));
    *out = (int)value;
    return SPIN_OK;
}
