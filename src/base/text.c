#include "base/text.h"

#include <stdarg.h>
#include <string.h>
#include <strings.h>

void spin_text_base64(FILE *to, const unsigned char *bytes, size_t n)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    char text[4 * 1024];
    size_t used = 0;

    for (size_t i = 0; i < n; i += 3) {
        uint32_t word = (uint32_t)bytes[i] << 16 | (i + 1 < n ? (uint32_t)bytes[i + 1] << 8 : 0) |
                        (i + 2 < n ? bytes[i + 2] : 0);

        text[used++] = digit[word >> 18];
        text[used++] = digit[(word >> 12) & 63];
        text[used++] = i + 1 < n ? digit[(word >> 6) & 63] : '=';
        text[used++] = i + 2 < n ? digit[word & 63] : '=';
        if (used == sizeof text || i + 3 >= n) {
            fwrite(text, 1, used, to);
            used = 0;
        }
    }
}

void spin_text_html(FILE *to, const char *text)
{
    for (const char *c = text; *c; c++) {
        switch (*c) {
        case '<':
            fputs("&lt;", to);
            break;
        case '>':
            fputs("&gt;", to);
            break;
        case '&':
            fputs("&amp;", to);
            break;
        case '"':
            fputs("&quot;", to);
            break;
        default:
            if ((unsigned char)*c >= 0x20 || *c == '\n')
                fputc(*c, to);
        }
    }
}

/* C1, which UTF-8 has in two bytes: terminals obey U+009B as they do ESC [. */
static bool is_c1(const char *text)
{
    const unsigned char *c = (const unsigned char *)text;

    return c[0] == 0xc2 && c[1] >= 0x80 && c[1] < 0xa0;
}

void spin_text_tidy(char *text, bool lines)
{
    for (; *text; text++) {
        unsigned char c = (unsigned char)*text;

        if (is_c1(text))
            text[0] = text[1] = '?';
        else if ((c < 0x20 || c == 0x7f) && !(lines && c == '\n'))
            *text = '?';
    }
}

void spin_text_json(FILE *to, const char *text)
{
    fputc('"', to);
    for (; *text; text++) {
        unsigned char c = (unsigned char)*text;

        if (c == '"' || c == '\\')
            fprintf(to, "\\%c", c);
        else if (c == '\n')
            fputs("\\n", to);
        else if (c < 0x20 || c == 0x7f)
            fprintf(to, "\\u%04x", c);
        else if (is_c1(text))
            fprintf(to, "\\u%04x", (unsigned char)*++text);
        else
            fputc(c, to);
    }
    fputc('"', to);
}

bool spin_text_ends(const char *text, const char *with)
{
    size_t n = strlen(text), n_with = strlen(with);

    return n >= n_with && strcmp(text + n - n_with, with) == 0;
}

bool spin_text_ends_any_case(const char *text, const char *with)
{
    size_t n = strlen(text), n_with = strlen(with);

    return n >= n_with && strcasecmp(text + n - n_with, with) == 0;
}

const char *spin_text_bytes(uint64_t bytes, char text[32])
{
    static const char *const unit[] = {"bytes", "kB", "MB", "GB", "TB"};
    double value = (double)bytes;
    int u = 0;

    for (; value >= 999.5 && u < 4; u++)
        value /= 1000;
    snprintf(text, 32, "%.3g %s", value, unit[u]);
    return text;
}

const char *spin_text_duration(double seconds, char text[32])
{
    long long s = seconds < 0 ? 0 : seconds > 3.6e8 ? 360000000 : (long long)(seconds + 0.5);

    if (s >= 3600)
        snprintf(text, 32, "%lld:%02lld:%02lld", s / 3600, s / 60 % 60, s % 60);
    else
        snprintf(text, 32, "%lld:%02lld", s / 60, s % 60);
    return text;
}

const char *spin_text_about(double seconds, char text[32])
{
    if (seconds < 1.5)
        snprintf(text, 32, "a second");
    else if (seconds < 99.5)
        snprintf(text, 32, "%.0f seconds", seconds);
    else if (seconds < 99.5 * 60)
        snprintf(text, 32, "%.0f minutes", seconds / 60);
    else if (seconds < 48 * 3600)
        snprintf(text, 32, "%.1f hours", seconds / 3600);
    else
        snprintf(text, 32, "%.1f days", seconds / 86400);
    return text;
}

const char *spin_text_count(long long n, const char *noun, char text[48])
{
    snprintf(text, 48, "%lld %s%s", n, noun, n == 1 ? "" : "s");
    return text;
}

/* Whether the notes up to n have this line. */
static bool has_line(const char *notes, size_t n, const char *line)
{
    for (size_t length, at = 0; at < n; at += length + 1) {
        length = strcspn(notes + at, "\n");
        if (length == strlen(line) && memcmp(notes + at, line, length) == 0)
            return true;
    }
    return false;
}

void spin_text_note(char *notes, size_t size, const char *fmt, ...)
{
    size_t used = strlen(notes), room = size - used;
    va_list args;
    int n;

    va_start(args, fmt);
    n = vsnprintf(notes + used, room, fmt, args);
    va_end(args);
    if (n < 0 || (size_t)n + 1 >= room || has_line(notes, used, notes + used))
        notes[used] = '\0';
    else
        memcpy(notes + used + n, "\n", 2);
}

int spin_text_distance(const char *a, size_t n_a, const char *b)
{
    size_t n_b = strlen(b);
    int row[32];

    if (n_a > 31 || n_b > 31)
        return 99;
    for (size_t j = 0; j <= n_b; j++)
        row[j] = (int)j;
    for (size_t i = 1; i <= n_a; i++) {
        int diagonal = row[0];

        row[0] = (int)i;
        for (size_t j = 1; j <= n_b; j++) {
            int change = diagonal + (a[i - 1] != b[j - 1]);
            int best = row[j] < row[j - 1] ? row[j] + 1 : row[j - 1] + 1;

            diagonal = row[j];
            row[j] = best < change ? best : change;
        }
    }
    return row[n_b];
}
