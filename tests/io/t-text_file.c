/* K: text json utf-8 utf-16 byte order mark crlf */
#include <unistd.h>

#include "base/base.h"
#include "io/json.h"
#include "io/text_file.h"
#include "tests/tap.h"

static char path[] = "/tmp/spin-text-XXXXXX";

static spin_status read_bytes(const char *bytes, size_t n, struct spin_text_file *out)
{
    FILE *file = fopen(path, "wb");

    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0)
        exit(1);
    return spin_text_file_open(path, out);
}

static void text_is(const char *bytes, const char *want, const char *what)
{
    struct spin_text_file got;

    ok(read_bytes(bytes, strlen(bytes), &got) == SPIN_OK && got.n == strlen(want), "%s: length",
       what);
    is_text(got.text, want, what);
    spin_text_file_close(&got);
}

static void refused(const char *bytes, size_t n, const char *says, const char *what)
{
    struct spin_text_file got;

    ok(read_bytes(bytes, n, &got) == SPIN_E_MALFORMED && strstr(spin_last_error(), says), "%s",
       what);
    spin_text_file_close(&got);
}

TAP_MAIN
{
    spin_json *root = NULL;

    close(mkstemp(path));
    text_is("a b\nc\n", "a b\nc\n", "plain text");
    text_is("\xef\xbb\xbf"
            "a\n",
            "a\n", "a byte order mark");
    text_is("a\r\n\r\nb\r\n", "a\n\nb\n", "carriage returns before line feeds");
    text_is("a\rb\r", "a\nb\n", "carriage returns alone");
    text_is("a  \t\r\nb \nc ", "a\nb\nc", "trailing blanks");
    text_is(" \n\t\n", "\n\n", "blank lines");
    text_is("", "", "an empty file");
    refused("\xff\xfe{\0}\0", 6, "UTF-16", "UTF-16 with a mark");
    refused("{\0}\0\n\0", 6, "UTF-16", "little-endian UTF-16 without a mark");
    refused("\0{\0}\0\n", 6, "UTF-16", "big-endian UTF-16 without a mark");
    refused("abcdef\0x", 8, "not text", "a byte 0");
    ok(spin_json_parse("text", "\xef\xbb\xbf{}", 5, &root) == SPIN_OK,
       "JSON in memory with a mark");
    spin_json_free(root);
    ok(spin_json_parse("text", "{\0}\0", 4, &root) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "UTF-16"),
       "JSON in memory in UTF-16");
    unlink(path);
}
