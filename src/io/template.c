/* Templates with a syntax like that of Mustache. */
#include "io/template.h"

#include "base/base.h"

/* A scope: the value of a section, in which names are looked up, and the key of this value. Names
 * that the value lacks are looked up in the enclosing scope `up`. */
struct scope {
    const json_t *value;
    const char *key;
    const struct scope *up;
};

/* Number of columns after which write_settings() starts a new line, not counting the indentation
 * and the last word of a line. */
enum { SETTINGS_WIDTH = 80 };

struct writer {
    FILE *to;
    bool html;
};

static const json_t *find_member(const json_t *value, const char *key)
{
    return json_is_array(value) ? json_array_get(value, strtoul(key, NULL, 10))
                                : json_object_get(value, key);
}

static const json_t *look_up(const struct scope *scope, const char *path)
{
    char copy[128], *rest = copy, *key;
    const json_t *value = NULL;

    if (!strcmp(path, "."))
        return scope->value;
    snprintf(copy, sizeof copy, "%s", path);
    key = strsep(&rest, ".");
    for (; scope && !value; scope = scope->up)
        value = find_member(scope->value, key);
    while ((key = strsep(&rest, ".")))
        value = find_member(value, key);
    return value;
}

static bool is_there(const json_t *j)
{
    if (json_is_string(j))
        return *json_string_value(j) != '\0';
    return json_is_true(j) || json_is_real(j) || json_integer_value(j) != 0 || json_array_size(j) ||
           json_object_size(j);
}

/* Print a text. format: a printf format for a string; NULL: "%s". */
static void write_text(const struct writer *w, const char *format, const char *text)
{
    char *copy = w->html ? NULL : strdup(text);

    if (w->html)
        spin_text_html(w->to, text);
    if (copy)
        spin_text_tidy(copy, false);
    fprintf(w->to, format ? format : "%s", copy ? copy : "");
    free(copy);
}

static void write_duration(FILE *to, double seconds)
{
    if (seconds < 0)
        fprintf(to, "unknown");
    else if (seconds < 100)
        fprintf(to, "%.1f s", seconds);
    else if (seconds < 5970)
        fprintf(to, "%.0f min", seconds / 60);
    else if (seconds < 48 * 3600)
        fprintf(to, "%.0f h %02.0f min", floor(seconds / 3600), floor(fmod(seconds, 3600) / 60));
    else
        fprintf(to, "%.1f days", fmin(seconds / 86400, 1e9));
}

/* Print a number. format: a format of template.h, whose first word ends with the conversion letter,
 * such as "%.1p". */
static void write_number(FILE *to, const char *format, double v)
{
    char plain[16], bytes[32], *kind;

    snprintf(plain, sizeof plain, "%.*s", (int)strcspn(format, " "), format);
    kind = plain + strlen(plain) - 1;
    switch (*kind) {
    case 'B':
        fputs(spin_text_bytes((uint64_t)v, bytes), to);
        break;
    case 'T':
        write_duration(to, v);
        break;
    case 'M':
        fprintf(to, v == floor(v) ? "%.0f" : "%.1f", v);
        break;
    case 'N':
        fprintf(to, v == floor(v) ? "%.0f%s%s" : "%.1f%s%s", v, format + 2, v == 1 ? "" : "s");
        break;
    case 'p':
    case 'P':
        *kind = *kind == 'p' ? 'f' : 'g';
        fprintf(to, plain, 100 * v);
        break;
    case 'd':
        memcpy(kind, ".0f", 4);
        fprintf(to, plain, v);
        break;
    default:
        fprintf(to, plain, v);
    }
}

/* Print an object without quotes and outer braces, with line breaks after commas. */
static void write_settings(FILE *to, const json_t *j)
{
    char *text = spin_json_text(j, false);
    size_t column = 0;

    for (const char *c = text ? text + 1 : ""; *c && c[1]; c++) {
        if (*c == '"')
            continue;
        fputc(*c, to);
        if (*c == ',' && ++column > SETTINGS_WIDTH) {
            fprintf(to, "\n            ");
            column = 0;
        } else if (*c == ',' || *c == ':') {
            fputc(' ', to);
        }
        column++;
    }
    free(text);
}

/* Expand a placeholder: a name, optionally followed by a blank and a format. */
static void write_placeholder(const struct writer *w, const struct scope *scope, char *tag)
{
    char *format = strchr(tag, ' ');
    const char *less = NULL;
    const json_t *j;

    if (format)
        *format++ = '\0';
    if (format && !strchr(format, 'N') && (less = strchr(format, ' ')))
        less++;
    j = look_up(scope, tag);
    if (!strcmp(tag, "@") || json_is_string(j))
        write_text(w, format, *tag == '@' ? scope->key : json_string_value(j));
    else if (json_is_object(j))
        write_settings(w->to, j);
    else if (json_is_number(j) || json_is_array(j))
        write_number(w->to,
                     format            ? format
                     : json_is_real(j) ? "%.10g"
                                       : "%d",
                     json_number_value(j) + (double)json_array_size(j) -
                         (less ? json_number_value(look_up(scope, less)) : 0));
    else if (format)
        fprintf(w->to, "%*s", abs(atoi(format + 1)), "-");
}

static const char *write_part(const struct writer *w, const char *at, const struct scope *scope,
                              bool shown);

static void short_text(const json_t *j, char text[64])
{
    if (json_is_number(j))
        snprintf(text, 64, "%.15g", json_number_value(j));
    else
        snprintf(text, 64, "%s", json_is_string(j) ? json_string_value(j) : "");
}

/* Whether a value equals `word` or, if `word` is "@NAME", the value of NAME. */
static bool is_same(const json_t *j, const char *word, const struct scope *scope)
{
    char text[64], other[64];

    short_text(j, text);
    if (*word == '@')
        short_text(look_up(scope, word + 1), other);
    return !strcmp(text, *word == '@' ? other : word);
}

/* Expand a section. `at` is the position after its opening tag; returns the position after its
 * closing tag. */
static const char *write_section(const struct writer *w, const char *at, const struct scope *scope,
                                 const char *tag, bool shown)
{
    char name[128], *word, key[32];
    const char *end = write_part(w, at, scope, false), *member_key;
    const json_t *j;
    json_t *value;
    bool there;

    snprintf(name, sizeof name, "%s", tag + 1);
    if ((word = strchr(name, '=')))
        *word++ = '\0';
    j = look_up(scope, name);
    there = word ? is_same(j, word, scope) : is_there(j);
    if (!shown || there == (*tag == '^'))
        return end;
    if (*tag == '*') {
        json_object_foreach((json_t *)(uintptr_t)j, member_key, value)
            write_part(w, at, &(struct scope){value, member_key, scope}, true);
    } else if (json_is_array(j) && *tag == '#') {
        for (size_t i = 0; i < json_array_size(j); i++) {
            snprintf(key, sizeof key, "%zu", i + 1);
            write_part(w, at, &(struct scope){json_array_get(j, i), key, scope}, true);
        }
    } else {
        write_part(w, at, json_is_object(j) ? &(struct scope){j, name, scope} : scope, true);
    }
    return end;
}

/* Expand the text from `at` to the end of the current section, or to the end of the text; returns
 * the position after that. If `shown` is false, nothing is printed. */
static const char *write_part(const struct writer *w, const char *at, const struct scope *scope,
                              bool shown)
{
    for (;;) {
        const char *open = strstr(at, "{{"), *close = open ? strstr(open, "}}") : NULL;
        bool raw = open && open[2] == '{';
        char tag[128];

        if (shown)
            fwrite(at, 1, close ? (size_t)(open - at) : strlen(at), w->to);
        if (!close)
            return at + strlen(at);
        open += raw ? 3 : 2;
        snprintf(tag, sizeof tag, "%.*s", (int)(close - open), open);
        at = close + (raw ? 3 : 2);
        if (*tag == '/')
            return at;
        if (strchr("#^*", *tag))
            at = write_section(w, at, scope, tag, shown);
        else if (raw && shown && json_is_string(look_up(scope, tag)))
            fputs(json_string_value(look_up(scope, tag)), w->to);
        else if (shown)
            write_placeholder(w, scope, tag);
    }
}

void spin_template_write(FILE *to, const char *text, const spin_json *document, bool html)
{
    write_part(&(struct writer){to, html}, text, &(struct scope){document, "", NULL}, true);
}
