/* JSON, read and written.  K: io json hostile */
#include <limits.h>

#include "tests/check.h"
#include "tests/tap.h"

/* In place of Jansson's: what the library allocates by, so that the memory can end. */
static int n_left = INT_MAX;

static void *starving(size_t bytes) { return n_left-- > 0 ? malloc(bytes) : NULL; }

void json_get_alloc_funcs(json_malloc_t *allocate, json_free_t *release)
{
    *allocate = starving;
    *release = free;
}

static spin_json *parse(const char *text)
{
    spin_json *j = NULL;

    if (spin_json_parse("test", text, strlen(text), &j) != SPIN_OK)
        printf("#   %s\n", spin_last_error());
    return j;
}

static void refused(const char *text, const char *what)
{
    spin_json *j = NULL;

    ok(spin_json_parse("a.json", text, strlen(text), &j) == SPIN_E_MALFORMED && !j &&
           strstr(spin_last_error(), "cannot parse 'a.json': line"),
       "refuses %s", what);
    spin_json_free(j);
}

static void reading(void)
{
    spin_json *j =
        parse(" {\"n\": 3, \"x\": -2.5e3, \"whole\": 4.0, \"t\": true, \"f\": false, \"z\": null,"
              " \"s\": \"\\u00e9\\n\", \"a\": [1, [2], \"x\"], \"o\": {\"k\": 1}}\n");
    double x = 0;
    int64_t n = 0;
    bool b = false;

    ok(spin_json_is_object(j) && !spin_json_is_array(j), "an object");
    ok(spin_json_number(spin_json_get(j, "x"), &x) && x == -2500, "a number");
    ok(spin_json_number(spin_json_get(j, "n"), &x) && x == 3, "an integer is a number");
    ok(spin_json_integer(spin_json_get(j, "n"), &n) && n == 3, "an integer");
    ok(spin_json_integer(spin_json_get(j, "whole"), &n) && n == 4, "a whole number is an integer");
    ok(!spin_json_integer(spin_json_get(j, "s"), &n) && !spin_json_integer(NULL, &n),
       "text is no integer, nor is nothing");
    ok(spin_json_bool(spin_json_get(j, "t"), &b) && b, "true");
    ok(spin_json_bool(spin_json_get(j, "f"), &b) && !b, "false");
    ok(!spin_json_bool(spin_json_get(j, "z"), &b) && !spin_json_bool(NULL, &b), "null is neither");
    is_text(spin_json_string(spin_json_get(j, "s")), "\xc3\xa9\n", "text with escapes");
    ok(!spin_json_string(spin_json_get(j, "n")) && !spin_json_string(NULL), "a number is no text");
    ok(spin_json_length(spin_json_get(j, "a")) == 3, "length of an array");
    ok(spin_json_is_array(spin_json_at(spin_json_get(j, "a"), 1)), "an array in an array");
    ok(!spin_json_at(spin_json_get(j, "a"), 3) && !spin_json_at(j, 0) && !spin_json_at(NULL, 0),
       "nothing beyond the end");
    ok(spin_json_length(j) == 0 && spin_json_length(NULL) == 0, "an object has no length");
    ok(!spin_json_get(j, "none") && !spin_json_get(NULL, "n") &&
           !spin_json_get(spin_json_get(j, "a"), "n"),
       "nothing under other keys");
    spin_json_free(j);
    spin_json_free(NULL);
}

static void bad(void)
{
    static char deep[100001];
    static const char whole[] = "{\"a\": [1, 2.5, \"x\"], \"b\": {\"c\": null}}";
    int cut = 1;

    refused("", "nothing");
    refused("{", "an open object");
    refused("[1,]", "a trailing comma");
    refused("{'a': 1}", "single quotes");
    refused("[NaN]", "NaN");
    refused("[Infinity]", "infinity");
    refused("[1e999]", "a number too large");
    refused("[99999999999999999999]", "an integer too large");
    refused("[1] 2", "two values");
    refused("[\"\xff\"]", "text that is not UTF-8");
    refused("[\"\\u0000\"]", "a zero character in text");
    refused("[\"\x01\"]", "a control character in text");
    memset(deep, '[', sizeof deep - 1);
    refused(deep, "a hundred thousand brackets");
    for (size_t n = 0; n < sizeof whole - 1; n++) {
        char *part = malloc(n ? n : 1); /* exactly sized */
        spin_json *j = NULL;

        memcpy(part, whole, n);
        cut = cut && spin_json_parse("x", part, n, &j) == SPIN_E_MALFORMED && !j;
        free(part);
    }
    ok(cut, "refuses every truncation");
}

static void writing(void)
{
    spin_json *j = spin_json_object(), *a = spin_json_array(), *o = spin_json_object();
    char *text;

    spin_json_set_string(j, "zeta", "a \"b\"\\\n\x1f\xc3\xa9");
    spin_json_set_number(j, "alpha", 0.1);
    spin_json_set_number(j, "whole", 3);
    spin_json_set_number(j, "nan", NAN);
    spin_json_set_number(j, "inf", -INFINITY);
    spin_json_set_integer(j, "i", INT64_MIN);
    spin_json_set_bool(j, "t", true);
    spin_json_set_bool(j, "f", false);
    spin_json_set_null(j, "z");
    spin_json_set_string(j, "none", NULL);
    spin_json_set_string(j, "bytes", "\xc3\xa9\xff/\xe2\x82");
    spin_json_push_number(a, 1e300);
    spin_json_push_number(a, -0.0);
    spin_json_push_string(a, "x");
    spin_json_push(a, spin_json_array());
    spin_json_set(j, "a", a);
    spin_json_set(j, "o", o);
    spin_json_set(o, "e", spin_json_object());

    text = spin_json_text(j, false);
    is_text(
        text,
        "{\"zeta\":\"a \\\"b\\\"\\\\\\n\\u001f\xc3\xa9\",\"alpha\":0.1,\"whole\":3,\"nan\":null,"
        "\"inf\":null,\"i\":-9223372036854775808,\"t\":true,\"f\":false,\"z\":null,\"none\":null,"
        "\"bytes\":\"\xc3\xa9\xef\xbf\xbd/"
        "\xef\xbf\xbd\xef\xbf\xbd\",\"a\":[1e+300,-0.0,\"x\",[]],\"o\":{\"e\":{}}}",
        "compact text, keys in the order they were set");
    free(text);
    spin_json_free(j);

    j = parse("{\"n\": [1, 2.5], \"rows\": [[1, 2], [3, 4]], \"o\": {\"k\": \"v\"}, \"e\": []}");
    text = spin_json_text(j, true);
    is_text(text,
            "{\n  \"n\": [1, 2.5],\n  \"rows\": [\n    [1, 2],\n    [3, 4]\n  ],\n  \"o\": {\n    "
            "\"k\": "
            "\"v\"\n  },\n  \"e\": []\n}",
            "indented text, plain arrays on one line");
    free(text);
    spin_json_free(j);
    ok(spin_json_text(NULL, false) == NULL, "no text of nothing");
}

/* Doubles of all sizes must read back to the same bits. */
static void round_trip(void)
{
    enum { N = 20000 };
    uint64_t state = 1;
    spin_json *a = spin_json_array(), *b;
    double *values = malloc(N * sizeof *values);
    int same = 1;
    char *text;

    for (int i = 0; i < N; i++) {
        do {
            uint64_t bits;

            state = state * 6364136223846793005u + 1442695040888963407u;
            bits = state ^ state >> 29;
            memcpy(&values[i], &bits, 8);
            if (i % 4 == 0)
                values[i] = (double)(float)(i * 0.001);
        } while (!isfinite(values[i]));
        spin_json_push_number(a, values[i]);
    }
    text = spin_json_text(a, true);
    b = parse(text);
    for (int i = 0; i < N; i++) {
        double v = 0;

        same = same && spin_json_number(spin_json_at(b, (size_t)i), &v) &&
               memcmp(&v, &values[i], 8) == 0;
    }
    ok(same, "%d doubles read back to the same bits", N);
    free(text);
    free(values);
    spin_json_free(a);
    spin_json_free(b);
}

static void files(void)
{
    char path[512];
    spin_json *j = NULL;
    FILE *file;

    snprintf(path, sizeof path, "%s/a.json", check_folder());
    ok(spin_json_load(path, &j) == SPIN_E_NOT_FOUND && !j && strstr(spin_last_error(), path),
       "a missing file is named");
    file = fopen(path, "wb");
    fputs("{\"a\": 1}", file);
    fclose(file);
    ok(spin_json_load(path, &j) == SPIN_OK && spin_json_get(j, "a"), "loads a file");
    spin_json_free(j);
    file = fopen(path, "wb");
    fputs("{\n  \"a\": }", file);
    fclose(file);
    ok(spin_json_load(path, &j) == SPIN_E_MALFORMED && strstr(spin_last_error(), path) &&
           strstr(spin_last_error(), "line 2, column 8"),
       "names the place of an error");
}

/* A document that lacks a value is not printed, whichever of its allocations failed. */
static void without_memory(void)
{
    int n_whole = 0;

    for (int n = 0; n_whole == 0 && n < 100; n++) {
        spin_json *j, *list;
        char *text;

        n_left = n;
        j = spin_json_object();
        list = spin_json_array();
        for (int i = 0; i < 20; i++)
            spin_json_push_number(list, i + 0.5);
        spin_json_set(j, "list", list);
        spin_json_set_string(j, "name", "x");
        text = spin_json_text(j, false);
        n_left = INT_MAX;
        n_whole = text ? n : 0;
        spin_json_free(j);
        free(text);
    }
    ok(n_whole > 24, "a document of %d allocations has all of them or no text", n_whole);
}

TAP_MAIN
{
    without_memory();
    reading();
    bad();
    writing();
    round_trip();
    files();
}
