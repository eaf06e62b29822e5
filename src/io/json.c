/* JSON, based on Jansson. Its writer is replaced, since it prints 0.1 with seventeen digits, puts
 * each number of an array on its own line, and prints control characters that a terminal would
 * interpret. */
#include "io/json.h"

#include <setjmp.h>

#include "base/base.h"
#include "io/text_file.h"

/* ---- Memory ---------------------------------------------------------------------------------- */

/* If memory runs out, Jansson's parser drops characters: it returns wrong values, reports a syntax
 * error or aborts. Jansson's setters drop values, and our code does not check their results.
 * Therefore an allocation that fails during parsing leaves the parser with longjmp, which leaks the
 * values parsed so far; any other allocation that fails sets a flag that makes spin_json_text()
 * fail. */
static json_malloc_t allocate;
static _Thread_local jmp_buf *parser; /* not NULL while this thread parses a text */
/* An allocation of this thread has failed since the thread last formatted a text. */
static _Thread_local bool ran_out;

static void *allocate_or_record(size_t n)
{
    void *block = allocate(n);

    if (block)
        return block;
    if (parser)
        longjmp(*parser, 1);
    ran_out = true;
    return NULL;
}

__attribute__((constructor)) static void set_allocator(void)
{
    json_free_t release;

    json_get_alloc_funcs(&allocate, &release);
    json_set_alloc_funcs(allocate_or_record, release);
}

/* ---- Reading --------------------------------------------------------------------------------- */

spin_status spin_json_parse(const char *what, const char *text, size_t n, spin_json **out)
{
    json_error_t error;
    jmp_buf jump;

    *out = NULL;
    SPIN_TRY(spin_text_skip_mark(what, &text, &n));
    if (setjmp(jump) != 0) {
        parser = NULL;
        return spin_fail(SPIN_E_MEMORY, "cannot parse '%s': not enough memory", what);
    }
    parser = &jump;
    *out = json_loadb(text, n, 0, &error);
    parser = NULL;
    if (*out)
        return SPIN_OK;
    return spin_malformed("cannot parse '%s': line %d, column %d: %s", what, error.line,
                          error.column, error.text);
}

spin_status spin_json_load(const char *path, spin_json **out)
{
    SPIN_LEAVES(spin_text_file_close) struct spin_text_file file = {0};

    *out = NULL;
    SPIN_TRY(spin_text_file_open(path, &file));
    return spin_json_parse(path, file.text, file.n, out);
}

void spin_json_freed(spin_json **j) { json_decref(*j); }

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
    if (json_is_real(j)) { /* Python writes integral floats such as 3.0 */
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

/* File names need not be UTF-8, but JSON must be: invalid bytes become U+FFFD. */
spin_json *spin_json_text_value(const char *text)
{
    json_t *value = text ? json_string(text) : json_null();
    char *copy, *to;

    if (value)
        return value;
    to = copy = malloc(3 * strlen(text) + 1);
    while (copy && *text) {
        size_t n = 1, most = strnlen(text, 4);
        json_t *one = NULL;

        while (n <= most && !(one = json_stringn(text, n)))
            n++;
        json_decref(one);
        memcpy(to, one ? text : "\xef\xbf\xbd", one ? n : 3);
        to += one ? n : 3;
        text += one ? n : 1;
    }
    ran_out |= !copy;
    value = copy ? json_stringn(copy, (size_t)(to - copy)) : json_null();
    free(copy);
    return value;
}

spin_json *spin_json_number_value(double v) { return isfinite(v) ? json_real(v) : json_null(); }

spin_json *spin_json_numbers(const double *v, size_t n)
{
    json_t *array = json_array();

    for (size_t i = 0; i < n; i++)
        json_array_append_new(array, spin_json_number_value(v[i]));
    return array;
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

/* Print a number with 15 digits if reading them gives the same double, else with 17 digits. */
static void write_real(FILE *out, double v)
{
    char text[40];

    snprintf(text, sizeof text, "%.15g", v);
    if (strtod(text, NULL) != v)
        snprintf(text, sizeof text, "%.17g", v);
    for (char *p = text; *p; p++)
        if (*p == ',') /* some locales use a comma as decimal point */
            *p = '.';
    fputs(v == 0 && signbit(v) ? "-0.0" : text, out); /* a text "-0" would be read as an integer */
}

static bool is_container(const json_t *j) { return json_array_size(j) + json_object_size(j) > 0; }

/* Whether to print the value on several lines. Arrays of plain values stay on one line, where
 * numbers are easier to compare. */
static bool is_tall(const json_t *j)
{
    bool tall = json_is_object(j);

    for (size_t i = 0; i < json_array_size(j) && !tall; i++)
        tall = is_container(json_array_get(j, i));
    return tall;
}

/* Print a value. depth: level of indentation; -1: print the whole value on one line. */
static void write_value(FILE *out, const json_t *j, int depth)
{
    bool object = json_is_object(j), tall = depth >= 0 && is_tall(j);
    void *member = json_object_iter((json_t *)(uintptr_t)j);
    size_t n = json_array_size(j) + json_object_size(j);

    if (json_is_real(j))
        write_real(out, json_real_value(j));
    else if (json_is_string(j))
        spin_text_json(out, json_string_value(j));
    else if (!is_container(j))
        json_dumpf(j, out, JSON_ENCODE_ANY);
    for (size_t i = 0; i < n; i++) {
        fputs(i == 0 ? object ? "{" : "[" : depth >= 0 && !tall ? ", " : ",", out);
        if (tall)
            fprintf(out, "\n%*s", 2 * depth + 2, "");
        if (object) {
            spin_text_json(out, json_object_iter_key(member));
            fputs(depth >= 0 ? ": " : ":", out);
        }
        write_value(out, object ? json_object_iter_value(member) : json_array_get(j, i),
                    depth >= 0 ? depth + 1 : -1);
        if (object)
            member = json_object_iter_next((json_t *)(uintptr_t)j, member);
    }
    if (tall)
        fprintf(out, "\n%*s", 2 * depth, "");
    if (n > 0)
        fputc(object ? '}' : ']', out);
}

char *spin_json_text(const spin_json *j, bool indent)
{
    char *text = NULL;
    size_t n = 0;
    FILE *out = j ? spin_text_open(&text, &n) : NULL;

    if (!out) {
        ran_out = false;
        return NULL;
    }
    write_value(out, j, indent ? 0 : -1);
    if (fclose(out) != 0 || ran_out) {
        free(text);
        text = NULL;
    }
    ran_out = false;
    return text;
}

spin_status spin_json_finish(spin_json *document, char **text)
{
    *text = spin_json_text(document, true);
    spin_json_free(document);
    return *text ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "not enough memory for the report");
}
