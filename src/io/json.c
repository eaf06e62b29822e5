/* JSON on jansson. Its reader is used as it is; the writer is ours, because jansson prints 0.1 with
 * seventeen digits and puts every number of an array on a line of its own. */
#include "io/json.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "base/text.h"
#include "io/file.h"

/* ---- Reading ------------------------------------------------------------------------------- */

spin_status spin_json_parse(const char *what, const char *text, size_t n, spin_json **out)
{
    json_error_t error;

    *out = json_loadb(text, n, 0, &error);
    if (*out)
        return SPIN_OK;
    if (json_error_code(&error) == json_error_out_of_memory)
        return spin_fail(SPIN_E_MEMORY, "cannot parse '%s': not enough memory", what);
    return spin_fail(SPIN_E_MALFORMED, "cannot parse '%s': line %d, column %d: %s", what,
                     error.line, error.column, error.text);
}

spin_status spin_json_load(const char *path, spin_json **out)
{
    struct spin_map map;
    spin_status status;

    *out = NULL;
    SPIN_TRY(spin_map_open(path, &map));
    status = spin_json_parse(path, (const char *)map.data, map.size, out);
    spin_map_close(&map);
    return status;
}

void spin_json_free(spin_json *json) { json_decref(json); }

const spin_json *spin_json_get(const spin_json *object, const char *key)
{
    return object ? json_object_get(object, key) : NULL;
}

size_t spin_json_length(const spin_json *array) { return array ? json_array_size(array) : 0; }

bool spin_json_is_array(const spin_json *j) { return json_is_array(j); }

bool spin_json_is_object(const spin_json *j) { return json_is_object(j); }

bool spin_json_is_null(const spin_json *j) { return json_is_null(j); }

const spin_json *spin_json_at(const spin_json *array, size_t index)
{
    return array ? json_array_get(array, index) : NULL;
}

bool spin_json_number(const spin_json *j, double *out)
{
    if (!json_is_number(j))
        return false;
    *out = json_number_value(j);
    return true;
}

bool spin_json_integer(const spin_json *j, int64_t *out)
{
    if (json_is_integer(j)) {
        *out = json_integer_value(j);
        return true;
    }
    if (json_is_real(j)) { /* "3.0", as Python writes a float that happens to be whole */
        double v = json_real_value(j);

        if (v != floor(v) || fabs(v) > 0x1p53)
            return false;
        *out = (int64_t)v;
        return true;
    }
    return false;
}

bool spin_json_bool(const spin_json *j, bool *out)
{
    if (!json_is_boolean(j))
        return false;
    *out = json_is_true(j);
    return true;
}

const char *spin_json_string(const spin_json *j) { return j ? json_string_value(j) : NULL; }

/* ---- Building ------------------------------------------------------------------------------ */

spin_json *spin_json_object(void) { return json_object(); }

spin_json *spin_json_array(void) { return json_array(); }

void spin_json_set(spin_json *object, const char *key, spin_json *value)
{
    (void)json_object_set_new(object, key, value);
}

void spin_json_push(spin_json *array, spin_json *value)
{
    (void)json_array_append_new(array, value);
}

/* Bytes of the character at c, 0 when it is none of UTF-8. */
static size_t utf8_length(const unsigned char *c)
{
    int n = *c < 0x80 ? 1 : *c >= 0xc2 && *c < 0xe0 ? 2 : *c >= 0xe0 && *c < 0xf0 ? 3 : 4;

    if (*c >= 0x80 && (*c < 0xc2 || *c > 0xf4))
        return 0;
    for (int i = 1; i < n; i++)
        if ((c[i] & 0xc0) != 0x80)
            return 0;
    /* over-long forms, surrogates and what lies beyond the last code point */
    if ((*c == 0xe0 && c[1] < 0xa0) || (*c == 0xed && c[1] > 0x9f) || (*c == 0xf0 && c[1] < 0x90) ||
        (*c == 0xf4 && c[1] > 0x8f))
        return 0;
    return (size_t)n;
}

/* File names need not be UTF-8, JSON must be: a byte that is not becomes U+FFFD. */
spin_json *spin_json_text_value(const char *text)
{
    json_t *value = text ? json_string(text) : json_null();
    char *copy, *to;

    if (value)
        return value;
    to = copy = malloc(3 * strlen(text) + 1);
    if (!copy)
        return json_null();
    while (*text) {
        size_t n = utf8_length((const unsigned char *)text);

        memcpy(to, n ? text : "\xef\xbf\xbd", n ? n : 3);
        to += n ? n : 3;
        text += n ? n : 1;
    }
    *to = '\0';
    value = json_string(copy);
    free(copy);
    return value;
}

spin_json *spin_json_number_value(double v) { return isfinite(v) ? json_real(v) : json_null(); }

spin_json *spin_json_integer_value(int64_t v) { return json_integer(v); }

spin_json *spin_json_bool_value(bool v) { return json_boolean(v); }

void spin_json_set_string(spin_json *object, const char *key, const char *value)
{
    spin_json_set(object, key, spin_json_text_value(value));
}

void spin_json_set_number(spin_json *object, const char *key, double value)
{
    spin_json_set(object, key, spin_json_number_value(value));
}

void spin_json_set_integer(spin_json *object, const char *key, int64_t value)
{
    spin_json_set(object, key, json_integer(value));
}

void spin_json_set_bool(spin_json *object, const char *key, bool value)
{
    spin_json_set(object, key, json_boolean(value));
}

void spin_json_set_null(spin_json *object, const char *key)
{
    spin_json_set(object, key, json_null());
}

void spin_json_rename(spin_json *object, const char *from, const char *to)
{
    size_t n = strlen(from);
    json_t *value;
    const char *key;
    void *next;

    json_object_foreach_safe(object, next, key, value)
    {
        char renamed[256];

        if (strncmp(key, from, n) != 0 ||
            snprintf(renamed, sizeof renamed, "%s%s", to, key + n) >= (int)sizeof renamed)
            continue;
        json_object_set(object, renamed, value);
        json_object_del(object, key);
    }
}

void spin_json_share(spin_json *to, const spin_json *from)
{
    json_object_update(to, (json_t *)from);
}

void spin_json_push_number(spin_json *array, double value)
{
    spin_json_push(array, spin_json_number_value(value));
}

void spin_json_push_string(spin_json *array, const char *value)
{
    spin_json_push(array, spin_json_text_value(value));
}

/* ---- Writing ------------------------------------------------------------------------------- */

static void write_newline(FILE *out, int depth)
{
    fputc('\n', out);
    for (int i = 0; i < depth; i++)
        fputs("  ", out);
}

enum style { COMPACT, INDENTED, TALL };

/* The shorter of the two usual precisions that reads back to the same double. */
static void write_real(FILE *out, double v)
{
    char text[40];

    snprintf(text, sizeof text, "%.15g", v);
    if (strtod(text, NULL) != v)
        snprintf(text, sizeof text, "%.17g", v);
    for (char *p = text; *p; p++)
        if (*p == ',') /* the decimal point of some locales */
            *p = '.';
    fputs(v == 0 && signbit(v) ? "-0.0" : text, out); /* -0 would be read as an integer */
}

static bool is_container(const json_t *j)
{
    return (json_is_array(j) || json_is_object(j)) && json_array_size(j) + json_object_size(j) > 0;
}

/* Arrays of plain values stay on one line, for numbers are easier to read side by side; not when TALL. */
static bool is_tall(const json_t *j, enum style style)
{
    if (style == COMPACT)
        return false;
    if (style == TALL || json_is_object(j))
        return is_container(j);
    for (size_t i = 0; i < json_array_size(j); i++)
        if (is_container(json_array_get(j, i)))
            return true;
    return false;
}

static void write_value(FILE *out, const json_t *j, int depth, enum style style);

static void write_members(FILE *out, const json_t *j, int depth, enum style style)
{
    const char *key;
    json_t *value;
    bool tall = is_tall(j, style), first = true;
    const char *comma = style != COMPACT && !tall ? ", " : ",";

    if (json_is_array(j)) {
        for (size_t i = 0; i < json_array_size(j); i++) {
            if (i > 0)
                fputs(comma, out);
            if (tall)
                write_newline(out, depth + 1);
            write_value(out, json_array_get(j, i), depth + 1, style);
        }
    } else {
        json_object_foreach((json_t *)(uintptr_t)j, key, value)
        {
            if (!first)
                fputs(comma, out);
            first = false;
            if (tall)
                write_newline(out, depth + 1);
            spin_text_json(out, key);
            fputs(style != COMPACT ? ": " : ":", out);
            write_value(out, value, depth + 1, style);
        }
    }
    if (tall)
        write_newline(out, depth);
}

static void write_value(FILE *out, const json_t *j, int depth, enum style style)
{
    switch (json_typeof(j)) {
    case JSON_OBJECT:
        fputc('{', out);
        write_members(out, j, depth, style);
        fputc('}', out);
        break;
    case JSON_ARRAY:
        fputc('[', out);
        write_members(out, j, depth, style);
        fputc(']', out);
        break;
    case JSON_STRING:
        spin_text_json(out, json_string_value(j));
        break;
    case JSON_INTEGER:
        fprintf(out, "%lld", (long long)json_integer_value(j));
        break;
    case JSON_REAL:
        write_real(out, json_real_value(j));
        break;
    case JSON_TRUE:
        fputs("true", out);
        break;
    case JSON_FALSE:
        fputs("false", out);
        break;
    case JSON_NULL:
        fputs("null", out);
        break;
    }
}

char *spin_json_text(const spin_json *j, bool indent)
{
    char *text = NULL;
    size_t n = 0;
    FILE *out = j ? open_memstream(&text, &n) : NULL;

    if (!out)
        return NULL;
    write_value(out, j, 0, indent ? INDENTED : COMPACT);
    if (fclose(out) != 0) {
        free(text);
        return NULL;
    }
    return text;
}

void spin_json_print(FILE *to, const spin_json *j)
{
    write_value(to, j, 0, TALL);
    fputc('\n', to);
}
