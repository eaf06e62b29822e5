#include "base/text.h"

#include <pthread.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#ifdef _WIN32
FILE *spin_text_open(char **text, size_t *n) { return open_memstream(text, n); }
#else
struct memory {
    char **text, *bytes;
    size_t *n, used, capacity;
    bool failed;
};

static ssize_t add_bytes(void *cookie, const char *bytes, size_t n)
{
    struct memory *m = cookie;

    if (m->capacity - m->used <= n) { /* keep one more byte for the NUL */
        size_t larger = 2 * m->capacity + n + 1;
        char *grown = m->failed ? NULL : realloc(m->bytes, larger);

        m->failed = !grown;
        if (m->failed)
            return 0;
        m->bytes = grown;
        m->capacity = larger;
    }
    memcpy(m->bytes + m->used, bytes, n);
    m->used += n;
    return (ssize_t)n;
}

/* Pass the text to the caller, even if memory ran out and the text is incomplete. */
static int close_memory(void *cookie)
{
    struct memory *m = cookie;
    bool failed = m->failed || !m->bytes;

    if (m->bytes)
        m->bytes[m->used] = '\0';
    *m->text = m->bytes;
    *m->n = m->used;
    free(m);
    return failed ? EOF : 0;
}

FILE *spin_text_open(char **text, size_t *n)
{
    struct memory *m = calloc(1, sizeof *m);
    FILE *file;

    *text = NULL;
    *n = 0;
    if (!m)
        return NULL;
    m->text = text;
    m->n = n;
    m->bytes = calloc(1, 1); /* so that an empty text is "", not NULL */
    m->capacity = m->bytes ? 1 : 0;
    file = fopencookie(m, "w", (cookie_io_functions_t){.write = add_bytes, .close = close_memory});
    if (!file) {
        free(m->bytes);
        free(m);
    }
    return file;
}
#endif

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

/* Decode the UTF-8 character at `text`: returns the character's length in bytes, or 0 if the bytes
 * are not valid UTF-8. Never reads past the terminating NUL. */
static int read_utf8(const char *text, uint32_t *code)
{
    static const uint32_t least[] = {0, 0, 0x80, 0x800, 0x10000};
    const unsigned char *c = (const unsigned char *)text;
    int n = c[0] < 0x80 ? 1 : c[0] >> 5 == 6 ? 2 : c[0] >> 4 == 14 ? 3 : c[0] >> 3 == 30 ? 4 : 0;

    *code = n > 1 ? c[0] & (0x7fu >> n) : c[0];
    for (int i = 1; i < n; i++) {
        if (c[i] >> 6 != 2)
            return 0;
        *code = *code << 6 | (c[i] & 0x3f);
    }
    return *code >= least[n] && *code < 0x110000 && *code >> 11 != 0xd800 >> 11 ? n : 0;
}

/* Whether the character controls a terminal (C0, DEL, C1), or can disguise a text (bidirectional
 * controls, zero-width characters and tags). */
static bool is_control(uint32_t code)
{
    static const struct {
        uint32_t first, last;
    } range[] = {{0, 0x1f},        {0x7f, 0x9f},     {0xad, 0xad},      {0x61c, 0x61c},
                 {0x180e, 0x180e}, {0x200b, 0x200f}, {0x2028, 0x202e},  {0x2060, 0x206f},
                 {0xfeff, 0xfeff}, {0xfff9, 0xfffb}, {0xe0000, 0xe0fff}};

    for (size_t i = 0; i < sizeof range / sizeof *range; i++)
        if (code >= range[i].first && code <= range[i].last)
            return true;
    return false;
}

void spin_text_tidy(char *text, bool lines)
{
    uint32_t code;

    for (int n; *text; text += n) {
        n = read_utf8(text, &code);
        if (n == 0 || (is_control(code) && !(lines && code == '\n')))
            memset(text, '?', (size_t)(n = n ? n : 1));
    }
}

void spin_text_json(FILE *to, const char *text)
{
    uint32_t code;

    fputc('"', to);
    for (int n; *text; text += n) {
        n = read_utf8(text, &code);
        if (n == 0)
            fputs("\\ufffd", to), n = 1;
        else if (code == '"' || code == '\\')
            fprintf(to, "\\%c", (int)code);
        else if (code == '\n')
            fputs("\\n", to);
        else if (!is_control(code))
            fwrite(text, 1, (size_t)n, to);
        else if (code < 0x10000)
            fprintf(to, "\\u%04x", code);
        else
            fprintf(to, "\\u%04x\\u%04x", 0xd7c0 + (code >> 10), 0xdc00 + (code & 0x3ff));
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

const char *spin_text_share(size_t n, size_t of, const char *noun, const char *verb_1,
                            const char *verb, char text[96])
{
    snprintf(text, 96, "%zu of %zu %s%s %s", n, of, noun, of == 1 ? "" : "s",
             n == 1 ? verb_1 : verb);
    return text;
}

/* ---- Paths to show --------------------------------------------------------------------------- */

enum { MAX_ALIASES = 8 };

static pthread_mutex_t alias_mutex = PTHREAD_MUTEX_INITIALIZER;
static struct alias {
    char *path, *shown; /* NULL: unused */
} aliases[MAX_ALIASES];

/* If all aliases are in use, or memory ran out, messages show the path itself. */
void spin_text_alias(const char *path, const char *shown)
{
    struct alias new = {strdup(path), strdup(shown)};

    pthread_mutex_lock(&alias_mutex);
    for (int i = 0; i < MAX_ALIASES && new.path &&new.shown; i++) {
        struct alias old = aliases[i];

        if (old.path)
            continue;
        aliases[i] = new;
        new = old;
    }
    pthread_mutex_unlock(&alias_mutex);
    free(new.path);
    free(new.shown);
}

void spin_text_unalias(const char *path)
{
    pthread_mutex_lock(&alias_mutex);
    for (int i = 0; i < MAX_ALIASES; i++) {
        if (!aliases[i].path || strcmp(aliases[i].path, path) != 0)
            continue;
        free(aliases[i].path);
        free(aliases[i].shown);
        aliases[i] = (struct alias){NULL, NULL};
    }
    pthread_mutex_unlock(&alias_mutex);
}

/* Replaces n bytes at `at` by a word. A text that would exceed `size` bytes is cut off. */
static void replace_at(char *text, size_t size, char *at, size_t n, const char *word)
{
    size_t before = (size_t)(at - text), n_word = strlen(word), rest = strlen(at + n);

    if (before + n_word >= size)
        return;
    if (before + n_word + rest >= size)
        rest = size - 1 - before - n_word;
    memmove(at + n_word, at + n, rest);
    at[n_word + rest] = '\0';
    memcpy(at, word, n_word);
}

void spin_text_show_paths(char *text, size_t size)
{
    pthread_mutex_lock(&alias_mutex);
    for (int i = 0; i < MAX_ALIASES; i++) {
        const struct alias *a = &aliases[i];

        for (char *at = text; a->path && a->shown && (at = strstr(at, a->path));) {
            replace_at(text, size, at, strlen(a->path), a->shown);
            at += strlen(a->shown) < strlen(at) ? strlen(a->shown) : strlen(at);
        }
    }
    pthread_mutex_unlock(&alias_mutex);
}

/* ---- Notes ----------------------------------------------------------------------------------- */

/* Whether the first n bytes of the notes contain this line. */
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
    if (n >= 0 && (size_t)n < room) {
        spin_text_show_paths(notes + used, room);
        n = (int)strlen(notes + used);
    }
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
