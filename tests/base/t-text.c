/* K: text */
#include "base/text.h"
#include "tests/tap.h"

static char *got;
static size_t n_got;

static FILE *begin(void)
{
    free(got);
    return open_memstream(&got, &n_got);
}

static void base64(const char *in, const char *want)
{
    FILE *f = begin();

    spin_text_base64(f, (const unsigned char *)in, strlen(in));
    fclose(f);
    is_text(got, want, in);
}

TAP_MAIN
{
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
    f = begin();
    spin_text_base64(f, block, sizeof block);
    fclose(f);
    ok(n_got == 8000 && strspn(got, "/") == 8000, "more than one piece");
    f = begin();
    spin_text_html(f, "a<b>&\"c\"\t\n");
    fclose(f);
    is_text(got, "a&lt;b&gt;&amp;&quot;c&quot;\n", "HTML");
    f = begin();
    spin_text_json(f, "a\"b\\\n\x01\x7f\xc3\xa4");
    fclose(f);
    is_text(got, "\"a\\\"b\\\\\\n\\u0001\\u007f\xc3\xa4\"", "JSON");
    f = begin();
    spin_text_json(f, "\xc2\x9b\xc2\xa0");
    fclose(f);
    is_text(got, "\"\\u009b\xc2\xa0\"", "JSON: a control character of two bytes");
    snprintf(text, sizeof text, "%s", "a\nb\x1b[31m\x7f\xc3\xa9\xc2\x9b\xc2");
    spin_text_tidy(text, true);
    is_text(text, "a\nb?[31m?\xc3\xa9?\?\xc2", "what a terminal would obey");
    spin_text_tidy(text, false);
    is_text(text, "a?b?[31m?\xc3\xa9?\?\xc2", "and line feeds");
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
    *text = '\0';
    spin_text_note(text, sizeof text, "frame %d is empty", 12);
    spin_text_note(text, sizeof text, "frame %d is empty", 1);
    spin_text_note(text, sizeof text, "frame %d", 1);
    spin_text_note(text, sizeof text, "frame %d", 1);
    is_text(text, "frame 12 is empty\nframe 1 is empty\nframe 1\n", "the same note once");
    free(got);
}
