/* K: text */
#include "base/text.h"
#include "tests/tap.h"

/* In place of the C library's: memory that ends. */
#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
void *__libc_realloc(void *block, size_t bytes);
static size_t most = SIZE_MAX;

void *realloc(void *block, size_t bytes)
{
    return bytes > most ? NULL : __libc_realloc(block, bytes);
}
#endif

static char *got;
static size_t n_got;

static FILE *open_text(void)
{
    free(got);
    return spin_text_open(&got, &n_got);
}

static void base64(const char *in, const char *want)
{
    FILE *f = open_text();

    spin_text_base64(f, (const unsigned char *)in, strlen(in));
    fclose(f);
    is_text(got, want, in);
}

TAP_MAIN
{
    /* Right to left, its kin, zero width, a tag; C1 as a byte and as UTF-8; bytes that are no
     * UTF-8: alone, too long, surrogates, beyond the last character. */
    static const char *const hidden[] = {
        "\xe2\x80\xae",     "\xe2\x80\xaa", "\xe2\x81\xa6", "\xd8\x9c",         "\xe2\x80\x8b",
        "\xe2\x80\x8f",     "\xe2\x81\xa0", "\xef\xbb\xbf", "\xf3\xa0\x80\xa1", "\x9b",
        "\xc2\x9b",         "\x80",         "\xc0\x9b",     "\xe0\x82\x9b",     "\xed\xa0\x80",
        "\xf4\x90\x80\x80", "\xff",         "\xe2\x80"};
    static const char shown[] = "\xc3\xa9\xd7\x90\xe2\x82\xac\xe4\xb8\xad\xf0\x9f\x98\x80\xc2\xa0";
    unsigned char block[6000];
    char text[48];
    FILE *f;

    /* RFC 4648, section 10. */
    base64("", "");
    base64("f", "Zg==");
    base64("fo", "Zm8=");
    base64("foo", "Zm9v");
    base64("foobar", "Zm9vYmFy");
    memset(block, 0xff, sizeof block);
    f = open_text();
    spin_text_base64(f, block, sizeof block);
    fclose(f);
    ok(n_got == 8000 && strspn(got, "/") == 8000, "more than one piece");
    f = open_text();
    spin_text_html(f, "a<b>&\"c\"\t\n");
    fclose(f);
    is_text(got, "a&lt;b&gt;&amp;&quot;c&quot;\n", "HTML");
    f = open_text();
    spin_text_json(f, "a\"b\\\n\x01\x7f\xc3\xa4");
    fclose(f);
    is_text(got, "\"a\\\"b\\\\\\n\\u0001\\u007f\xc3\xa4\"", "JSON");
    f = open_text();
    spin_text_json(f, "\xc2\x9b\xc2\xa0");
    fclose(f);
    is_text(got, "\"\\u009b\xc2\xa0\"", "JSON: a control character of two bytes");
    f = open_text();
    spin_text_json(f, "\xe2\x80\xae\xf3\xa0\x80\xa1\x9b\xf0\x9f\x98\x80");
    fclose(f);
    is_text(got, "\"\\u202e\\udb40\\udc21\\ufffd\xf0\x9f\x98\x80\"",
            "JSON: invisible characters, and no UTF-8");
    snprintf(text, sizeof text, "%s", "a\nb\x1b[31m\x7f\xc3\xa9\xc2\x9b\xc2");
    spin_text_tidy(text, true);
    is_text(text, "a\nb?[31m?\xc3\xa9?\?\?", "what a terminal would obey");
    spin_text_tidy(text, false);
    is_text(text, "a?b?[31m?\xc3\xa9?\?\?", "and line feeds");
    for (size_t i = 0; i < sizeof hidden / sizeof *hidden; i++) {
        snprintf(text, sizeof text, "a%sb", hidden[i]);
        spin_text_tidy(text, false);
        ok(strlen(text) == strlen(hidden[i]) + 2 && text[0] == 'a' &&
               strspn(text + 1, "?") == strlen(hidden[i]),
           "not for a terminal: %s", text);
    }
    snprintf(text, sizeof text, "%s", shown);
    spin_text_tidy(text, false);
    is_text(text, shown, "other characters stay");
    is_text(spin_text_bytes(999, text), "999 bytes", "bytes");
    is_text(spin_text_bytes(1234567, text), "1.23 MB", "megabytes");
    is_text(spin_text_duration(245, text), "4:05", "minutes");
    is_text(spin_text_duration(9372.4, text), "2:36:12", "hours");
    is_text(spin_text_duration(-1, text), "0:00", "no time");
    is_text(spin_text_about(1.4, text), "a second", "about: a second");
    is_text(spin_text_about(99.4, text), "99 seconds", "seconds");
    is_text(spin_text_about(99.5, text), "2 minutes", "minutes from a hundred seconds on");
    is_text(spin_text_about(5969, text), "99 minutes", "up to a hundred of them");
    is_text(spin_text_about(5970, text), "1.7 hours", "hours");
    is_text(spin_text_about(48 * 3600, text), "2.0 days", "days");
    is_text(spin_text_count(0, "frame", text), "0 frames", "no frames");
    is_text(spin_text_count(1, "frame", text), "1 frame", "one frame");
    is_text(spin_text_count(2, "frame", text), "2 frames", "two frames");
    is_text(spin_text_share(1, 1, "frame", "has", "have", (char[96]){0}), "1 of 1 frame has",
            "one of one");
    is_text(spin_text_share(1, 6, "frame", "has", "have", (char[96]){0}), "1 of 6 frames has",
            "one of several");
    is_text(spin_text_share(2, 6, "frame", "has", "have", (char[96]){0}), "2 of 6 frames have",
            "several of several");

    f = open_text();
    ok(fclose(f) == 0 && got && !*got && n_got == 0, "no text is empty");
#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
    f = open_text();
    most = 100000;
    for (int i = 0; i < 100; i++)
        fwrite(block, 1, sizeof block, f);
    fputs("the end", f);
    ok(fclose(f) != 0, "a text that memory was too small for is not whole");
    most = SIZE_MAX;
#endif
    *text = '\0';
    spin_text_note(text, sizeof text, "frame %d is empty", 12);
    spin_text_note(text, sizeof text, "frame %d is empty", 1);
    spin_text_note(text, sizeof text, "frame %d", 1);
    spin_text_note(text, sizeof text, "frame %d", 1);
    is_text(text, "frame 12 is empty\nframe 1 is empty\nframe 1\n", "the same note once");
    free(got);
}
