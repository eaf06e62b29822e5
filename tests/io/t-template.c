/* Templates: formats of numbers, durations, plurals, sections, scopes, escapes. K: template */
#include "io/json.h"
#include "io/template.h"
#include "tests/tap.h"

static char *text;

static void expand(const char *template, const char *json, bool html)
{
    spin_json *document = NULL;
    size_t n;
    FILE *to;

    free(text);
    text = NULL;
    to = open_memstream(&text, &n);
    if (ok(spin_json_parse("a document", json, strlen(json), &document) == SPIN_OK, "%s", json))
        spin_template_write(to, template, document, html);
    spin_json_free(document);
    fclose(to);
}

/* json: with ' in place of ". */
static void is(const char *template, const char *json, const char *want)
{
    char copy[512];

    snprintf(copy, sizeof copy, "%s", json);
    for (char *c = copy; *c; c++)
        *c = *c == '\'' ? '"' : *c;
    expand(template, copy, false);
    is_text(text, want, template);
}

static void test_durations(void)
{
    static const struct {
        const char *seconds, *text;
    } of[] = {{"-1", "unknown"},
              {"0", "0.0 s"},
              {"99.94", "99.9 s"},
              {"100", "2 min"},
              {"5969", "99 min"},
              {"5970", "1 h 39 min"},
              {"7199.9", "1 h 59 min"},
              {"7260", "2 h 01 min"},
              {"172799", "47 h 59 min"},
              {"172800", "2.0 days"},
              {"1e20", "1000000000.0 days"}};
    char json[40];

    for (size_t i = 0; i < sizeof of / sizeof *of; i++) {
        snprintf(json, sizeof json, "{'t': %s}", of[i].seconds);
        is("{{t %T}}", json, of[i].text);
    }
}

static void test_numbers(void)
{
    is("{{a}} {{b}} {{c}}", "{'a': 3, 'b': 0.1, 'c': 3.0}", "3 0.1 3");
    is("{{a %5d}}|{{b %.1f}}|{{b %8.3f}}", "{'a': 12, 'b': 2.25}", "   12|2.2|   2.250");
    is("{{a %.1p}} {{a %.3P}} {{a %5.0p}}", "{'a': 0.12345}", "12.3 12.3    12");
    is("{{a %B}} {{b %B}}", "{'a': 1500, 'b': 12}", "1.5 kB 12 bytes");
    is("{{a %M}} {{b %M}}", "{'a': 4.0, 'b': 4.25}", "4 4.2");
    is("{{a %N frame}}, {{b %N frame}}, {{c %N frame}}", "{'a': 1, 'b': 2, 'c': 0}",
       "1 frame, 2 frames, 0 frames");
    is("{{a %N view here}} {{b %N view}}", "{'a': 1.5, 'b': 1.0}", "1.5 view heres 1 view");
    is("{{a}} {{a %N view}}", "{'a': [5, 6, 7]}", "3 3 views");
    is("{{a %d b}} {{a %.1f b}} {{a %d none}}", "{'a': 5, 'b': 2}", "3 3.0 5");
    is("[{{none}}] [{{none %6.2f}}] [{{none %-4d}}]", "{}", "[] [     -] [   -]");
}

static void test_strings(void)
{
    is("{{a}} {{a %4s}}|{{a %-4s}}|", "{'a': 'hi'}", "hi   hi|hi  |");
    is("{{a}} {{{a}}} {{{b}}}", "{'a': '<b>', 'b': 1}", "<b> <b> 1");
    expand("{{a}} {{{a}}}", "{\"a\": \"<&\"}", true);
    is_text(text, "&lt;&amp; <&", "HTML is escaped, except in triple braces");
    is("{{a.b.c}} {{a.list.1}} {{a.x.y}}", "{'a': {'b': {'c': 'deep'}, 'list': [7, 8]}}",
       "deep 8 ");
    is("{{a}}", "{'a': {'x': 1, 'y': [2, 3], 'z': 'w'}}", "x: 1, y: [2, 3], z: w");
    is("no end {{a", "{'a': 1}", "no end {{a");
}

/* Lines of settings break after the first comma beyond column 80. */
static void test_settings(void)
{
    char json[400] = "{'a': {", want[400] = "";

    for (int i = 0; i < 12; i++) {
        size_t n = strlen(json), m = strlen(want);

        snprintf(json + n, sizeof json - n, "%s'name%02d':%d", i ? "," : "", i, i % 10);
        snprintf(want + m, sizeof want - m, "%sname%02d: %d",
                 i == 0   ? ""
                 : i == 9 ? ",\n            "
                          : ", ",
                 i, i % 10);
    }
    snprintf(json + strlen(json), sizeof json - strlen(json), "}}");
    is("{{a}}", json, want);
}

static void test_sections(void)
{
    is("{{#a}}yes{{/}}{{^a}}no{{/}}", "{'a': true}", "yes");
    is("{{#a}}yes{{/}}{{^a}}no{{/}}", "{'a': false}", "no");
    is("{{#a}}yes{{/}}{{^a}}no{{/}}", "{'a': 0}", "no");
    is("{{#a}}yes{{/}}{{^a}}no{{/}}", "{'a': 2}", "yes");
    is("{{#a}}yes{{/}}{{^a}}no{{/}}", "{'a': ''}", "no");
    is("{{#a}}yes{{/}}{{^a}}no{{/}}", "{'a': []}", "no");
    is("{{#a}}yes{{/}}{{^a}}no{{/}}", "{'a': {}}", "no");
    is("{{#a}}yes{{/}}{{^a}}no{{/}}", "{'a': null}", "no");
    is("{{#a}}a measured {{a %.1f}}{{/}}", "{'a': 0.0}", "a measured 0.0");
    is("{{#a=x}}x{{/}}{{#a=y}}y{{/}}{{^a=y}}not y{{/}}", "{'a': 'x'}", "xnot y");
    is("{{#a=3}}three{{/}}{{#a=@b}}b{{/}}{{^a=@c}}not c{{/}}", "{'a': 3, 'b': 3, 'c': 4}",
       "threebnot c");
    is("{{#a}}{{@}}: {{x}} {{y}}{{#z}}z{{/}}; {{/}}",
       "{'a': [{'x': 1}, {'x': 2, 'z': true}], 'y': 9}", "1: 1 9; 2: 2 9z; ");
    is("{{#a}}{{.}} {{/}}", "{'a': [5, 6]}", "5 6 ");
    is("{{*a}}{{@}}={{.}} {{/}}", "{'a': {'p': 1, 'q': 2}}", "p=1 q=2 ");
    is("{{#a}}{{@}} {{x}}{{/}}", "{'a': {'x': 1}}", "a 1");
    is("{{^a}}{{#b}}{{c}}{{/}}hidden{{/}}end", "{'a': 1, 'b': 1, 'c': 1}", "end");
}

TAP_MAIN
{
    test_durations();
    test_numbers();
    test_strings();
    test_settings();
    test_sections();
    free(text);
}
