#include "io/text_file.h"

#include "base/base.h"
#include "io/file.h"

spin_status spin_text_skip_mark(const char *what, const char **text, size_t *n)
{
    const unsigned char *t = (const unsigned char *)*text;
    bool marked = *n >= 2 && ((t[0] == 0xff && t[1] == 0xfe) || (t[0] == 0xfe && t[1] == 0xff));
    /* ASCII characters in UTF-16, in either byte order */
    bool wide = *n >= 4 && ((t[0] && !t[1] && t[2] && !t[3]) || (!t[0] && t[1] && !t[2] && t[3]));

    if (marked || wide)
        return spin_malformed("'%s' is text in UTF-16: save the file as UTF-8", what);
    if (*n >= 3 && memcmp(*text, "\xef\xbb\xbf", 3) == 0) {
        *text += 3;
        *n -= 3;
    }
    return SPIN_OK;
}

/* Copies a text, converts every line end (CR LF or CR) to LF, and removes blanks at the end of
 * lines; returns the length of the copy. */
static size_t copy_lines(const char *from, size_t n, char *to)
{
    size_t used = 0;

    for (size_t i = 0; i < n; i++) {
        char c = from[i];

        if (c == '\r' && i + 1 < n && from[i + 1] == '\n')
            continue;
        c = c == '\r' ? '\n' : c;
        while (c == '\n' && used > 0 && (to[used - 1] == ' ' || to[used - 1] == '\t'))
            used--;
        to[used++] = c;
    }
    while (used > 0 && (to[used - 1] == ' ' || to[used - 1] == '\t'))
        used--;
    return used;
}

spin_status spin_text_file_open(const char *path, struct spin_text_file *out)
{
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    const char *text;
    size_t n;

    *out = (struct spin_text_file){0};
    SPIN_TRY(spin_map_open(path, &map));
    text = (const char *)map.data;
    n = map.size;
    SPIN_TRY(spin_text_skip_mark(path, &text, &n));
    if (memchr(text, '\0', n))
        return spin_malformed("'%s' is not text: it contains a byte 0", path);
    SPIN_TRY(spin_alloc(n + 1, 1, (void **)&out->text));
    out->n = copy_lines(text, n, out->text);
    out->text[out->n] = '\0';
    return SPIN_OK;
}

void spin_text_file_close(struct spin_text_file *file)
{
    free(file->text);
    *file = (struct spin_text_file){0};
}
