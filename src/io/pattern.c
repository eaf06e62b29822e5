/* File names with a frame number. */
#include "io/numbered.h"

#include <ctype.h>

#include "base/base.h"
#include "io/file.h"

static spin_status fail_pattern(const char *text)
{
    return spin_misuse("--pattern '%s': expected a file name with exactly one %%d, %%0Nd or ####, "
                       "where N is 1 to 9",
                       text);
}

/* Parses the field %d, %0Nd or #### at `at`. Returns the text after the field, or NULL if there is
 * no valid field. */
static const char *parse_field(const char *at, struct spin_pattern *out)
{
    size_t n = strspn(at, "#");

    out->zeros = n > 0;
    out->width = (int)n;
    if (n > 0)
        return n <= 9 ? at + n : NULL;
    if (*at++ != '%')
        return NULL;
    if (*at == '0') {
        out->zeros = true;
        out->width = at[1] - '0';
        if (out->width < 1 || out->width > 9)
            return NULL;
        at += 2;
    }
    return *at == 'd' ? at + 1 : NULL;
}

spin_status spin_pattern_parse(const char *text, struct spin_pattern *out)
{
    *out = (struct spin_pattern){.text = text, .n_before = (int)strcspn(text, "%#")};
    if (strchr(text, '/'))
        return fail_pattern(text);
    out->after = parse_field(text + out->n_before, out);
    if (!out->after || strpbrk(out->after, "%#"))
        return fail_pattern(text);
    return SPIN_OK;
}

spin_status spin_pattern_path(const struct spin_pattern *p, const char *folder, int number,
                              char **out)
{
    char name[512];

    if (snprintf(name, sizeof name, p->zeros ? "%.*s%0*d%s" : "%.*s%*d%s", p->n_before, p->text,
                 p->width, number, p->after) >= (int)sizeof name)
        return spin_misuse("--pattern: the resulting file name is too long: '%.40s...'", name);
    return spin_path_join(folder, name, out);
}

/* Whether the n bytes at `text` match a glob of n_glob bytes, in which only '*' is special. */
static bool match_glob(const char *glob, size_t n_glob, const char *text, size_t n)
{
    if (n_glob == 0)
        return n == 0;
    if (*glob == '*')
        return match_glob(glob + 1, n_glob - 1, text, n) ||
               (n > 0 && match_glob(glob, n_glob, text + 1, n - 1));
    return n > 0 && tolower((unsigned char)*glob) == tolower((unsigned char)*text) &&
           match_glob(glob + 1, n_glob - 1, text + 1, n - 1);
}

bool spin_pattern_match(const struct spin_pattern *p, const char *name, const char **digits)
{
    for (const char *at = name; *at; at++) {
        const char *first = at + (*at == '-');
        size_t n = strspn(first, "0123456789"), n_before = (size_t)(at - name);

        /* Match only whole numbers, from their first digit on. */
        if (n == 0 || (at > name && isdigit((unsigned char)at[-1])))
            continue;
        if (p->zeros && (n < (size_t)p->width || (n > (size_t)p->width && *first == '0')))
            continue;
        if (match_glob(p->text, (size_t)p->n_before, name, n_before) &&
            match_glob(p->after, strlen(p->after), first + n, strlen(first + n))) {
            *digits = at;
            return true;
        }
    }
    return false;
}

static bool has_field(const char *component)
{
    struct spin_pattern unused;
    size_t n = strcspn(component, "%#/");

    return component[n] != '/' && parse_field(component + n, &unused);
}

spin_status spin_pattern_split(const char *path, char **folder, const char **rest)
{
    const char *at = path;

    *folder = NULL;
    *rest = NULL;
    while (at && !has_field(at)) {
        at = strchr(at, '/');
        at += at != NULL;
    }
    if (!at || spin_path_exists(path))
        return SPIN_OK;
    SPIN_TRY(spin_strdup(at > path ? path : ".", folder));
    if (at > path + 1)
        (*folder)[at - path - 1] = '\0';
    else if (at > path)
        (*folder)[1] = '\0';
    *rest = at;
    return SPIN_OK;
}
