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

/* File names need not be UTF-8, JSON must be: bytes above 0x7f of a text that is not UTF-8
 * become '?'. */
static json_t *string_value(const char *text)
{
    json_t *value = text ? json_string(text) : json_null();
    char *copy;

    if (value)
        return value;
    copy = strdup(text);
    if (!copy)
        return json_null();
    for (char *p = copy; *p; p++)
        if ((unsigned char)*p >= 0x80)
            *p = '?';
    value = json_string(copy);
    free(copy);
    return value;
}

static json_t *number_value(double v) { return isfinite(v) ? json_real(v) : json_null(); }

void spin_json_set_string(spin_json *object, const char *key, const char *value)
{
    spin_json_set(object, key, string_value(value));
}

void spin_json_set_number(spin_json *object, const char *key, double value)
{
    spin_json_set(object, key, number_value(value));
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

void spin_json_push_number(spin_json *array, double value)
{
    spin_json_push(array, number_value(value));
}

void spin_json_push_string(spin_json *array, const char *value)
{
    spin_json_push(array, string_value(value));
}

/* ---- Writing ------------------------------------------------------------------------------- */

static void write_newline(FILE *out, int depth)
{
    fputc('\n', out);
    for (int i = 0; i < depth; i++)
        fputs("  ", out);
}

/* The fewest digits that read back to the same double, with a mark that it is one. */
static void write_real(FILE *out, double v)
{
    char text[40];

    for (int digits = 15; digits <= 17; digits++) {
        snprintf(text, sizeof text, "%.*g", digits, v);
        if (strtod(text, NULL) == v)
            break;
    }
    for (char *p = text; *p; p++)
        if (*p == ',') /* the decimal point of some locales */
            *p = '.';
    fputs(text, out);
    if (!strpbrk(text, ".e"))
        fputs(".0", out);
}

static bool is_container(const json_t *j)
{
    return (json_is_array(j) || json_is_object(j)) && json_array_size(j) + json_object_size(j) > 0;
}

/* Arrays of plain values stay on one line, for numbers are easier to read side by side. */
static bool is_tall(const json_t *j)
{
    if (json_is_object(j))
        return json_object_size(j) > 0;
    for (size_t i = 0; i < json_array_size(j); i++)
        if (is_container(json_array_get(j, i)))
            return true;
    return false;
}

static void write_value(FILE *out, const json_t *j, int depth, bool indent);

static void write_members(FILE *out, const json_t *j, int depth, bool indent)
{
    const char *key;
    json_t *value;
    bool tall = indent && is_tall(j), first = true;
    const char *comma = indent && !tall ? ", " : ",";

    if (json_is_array(j)) {
        for (size_t i = 0; i < json_array_size(j); i++) {
            if (i > 0)
                fputs(comma, out);
            if (tall)
                write_newline(out, depth + 1);
            write_value(out, json_array_get(j, i), depth + 1, indent);
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
            fputs(indent ? ": " : ":", out);
            write_value(out, value, depth + 1, indent);
        }
    }
    if (tall)
        write_newline(out, depth);
}

static void write_value(FILE *out, const json_t *j, int depth, bool indent)
{
    switch (json_typeof(j)) {
    case JSON_OBJECT:
        fputc('{', out);
        write_members(out, j, depth, indent);
        fputc('}', out);
        break;
    case JSON_ARRAY:
        fputc('[', out);
        write_members(out, j, depth, indent);
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
    write_value(out, j, 0, indent);
    if (fclose(out) != 0) {
        free(text);
        return NULL;
    }
    return text;
}
