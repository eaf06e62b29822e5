/* Sizes, durations and JSON on stdout. */
#include "cmd/print.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "base/text.h"
#include "io/json.h"

const char *spin_print_bytes(double bytes, char text[32])
{
    static const char *const unit[] = {"B", "kB", "MB", "GB", "TB", "PB"};
    int u = 0;

    for (; bytes >= 1000 && u < 5; u++)
        bytes /= 1000;
    snprintf(text, 32, u ? "%.1f %s" : "%.0f %s", bytes, unit[u]);
    return text;
}

const char *spin_print_path(const char *path, char text[4096])
{
    snprintf(text, 4096, "%s", path);
    spin_text_tidy(text, false);
    return text;
}

const char *spin_print_mean(double mean, char text[32])
{
    snprintf(text, 32, mean == floor(mean) ? "%.0f" : "%.1f", mean);
    return text;
}

const char *spin_print_count(long long n, const char *noun, char text[48])
{
    snprintf(text, 48, "%lld %s%s", n, noun, n == 1 ? "" : "s");
    return text;
}

const char *spin_print_seconds(double seconds, char text[32])
{
    if (!isfinite(seconds) || seconds < 0)
        snprintf(text, 32, "unknown");
    else if (seconds < 100)
        snprintf(text, 32, "%.1f s", seconds);
    else if (seconds < 5970)
        snprintf(text, 32, "%.0f min", seconds / 60);
    else if (seconds < 48 * 3600)
        snprintf(text, 32, "%.0f h %02.0f min", floor(seconds / 3600),
                 floor(fmod(seconds, 3600) / 60));
    else
        snprintf(text, 32, "%.1f days", fmin(seconds / 86400, 1e9));
    return text;
}

/* The document in the making: what is open, outermost first. */
static spin_json *opened[8];
static int depth;

static void put(const char *key, spin_json *value)
{
    if (key)
        spin_json_set(opened[depth - 1], key, value);
    else
        spin_json_push(opened[depth - 1], value);
}

void spin_print_open(const char *key, char bracket)
{
    spin_json *container = bracket == '{' ? spin_json_object() : spin_json_array();

    if (depth > 0)
        put(key, container);
    opened[depth++] = container;
}

void spin_print_close(char bracket)
{
    (void)bracket;
    if (--depth > 0)
        return;
    char *text = spin_json_text(opened[0], true);

    puts(text ? text : "null");
    free(text);
    spin_json_free(opened[0]);
}

void spin_print_string(const char *key, const char *value)
{
    put(key, spin_json_text_value(value));
}

void spin_print_number(const char *key, double value) { put(key, spin_json_number_value(value)); }

void spin_print_integer(const char *key, long long value)
{
    put(key, spin_json_integer_value(value));
}

void spin_print_bool(const char *key, bool value) { put(key, json_boolean(value)); }

void spin_print_null(const char *key) { put(key, spin_json_text_value(NULL)); }
