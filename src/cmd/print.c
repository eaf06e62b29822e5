/* Sizes, durations and JSON on stdout. */
#include "cmd/print.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *spin_print_bytes(double bytes, char text[32])
{
    static const char *const unit[] = {"B", "KiB", "MiB", "GiB", "TiB", "PiB"};
    int u = 0;

    for (; bytes >= 1024 && u < 5; u++)
        bytes /= 1024;
    snprintf(text, 32, u ? "%.1f %s" : "%.0f %s", bytes, unit[u]);
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

static struct {
    int depth;
    bool first; /* nothing stands yet at this depth */
} json = {0, true};

static int utf8_length(const unsigned char *c)
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
    return n;
}

static void put_quoted(const char *text)
{
    const unsigned char *c = (const unsigned char *)text;

    putchar('"');
    while (*c) {
        int n = utf8_length(c);

        if (n == 0) {
            fputs("\\ufffd", stdout);
            c++;
        } else if (*c < 0x20 || *c == 0x7f) {
            printf("\\u%04x", (unsigned)*c++);
        } else {
            if (*c == '"' || *c == '\\')
                putchar('\\');
            fwrite(c, 1, (size_t)n, stdout);
            c += n;
        }
    }
    putchar('"');
}

static void put_key(const char *key)
{
    if (!json.first)
        putchar(',');
    if (json.depth)
        printf("\n%*s", 2 * json.depth, "");
    json.first = false;
    if (key) {
        put_quoted(key);
        fputs(": ", stdout);
    }
}

void spin_print_open(const char *key, char bracket)
{
    put_key(key);
    putchar(bracket);
    json.depth++;
    json.first = true;
}

void spin_print_close(char bracket)
{
    json.depth--;
    if (!json.first)
        printf("\n%*s", 2 * json.depth, "");
    putchar(bracket);
    json.first = false;
    if (json.depth == 0)
        putchar('\n');
}

void spin_print_string(const char *key, const char *value)
{
    if (!value) {
        spin_print_null(key);
        return;
    }
    put_key(key);
    put_quoted(value);
}

/* The shortest of the two usual precisions that reads back as the same number. */
void spin_print_number(const char *key, double value)
{
    char text[40];

    if (!isfinite(value)) {
        spin_print_null(key);
        return;
    }
    snprintf(text, sizeof text, "%.15g", value);
    if (strtod(text, NULL) != value)
        snprintf(text, sizeof text, "%.17g", value);
    put_key(key);
    fputs(text, stdout);
}

void spin_print_integer(const char *key, long long value)
{
    put_key(key);
    printf("%lld", value);
}

void spin_print_bool(const char *key, bool value)
{
    put_key(key);
    fputs(value ? "true" : "false", stdout);
}

void spin_print_null(const char *key)
{
    put_key(key);
    fputs("null", stdout);
}
