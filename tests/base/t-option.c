/* Words and numbers that plug-ins are given.  K: base option */
#include "base/option.h"
#include "tests/tap.h"

static void refused(spin_status status, const char *want, const char *what)
{
    ok(status == SPIN_E_USAGE, "%s is refused", what);
    is_text(spin_last_error(), want, what);
}

TAP_MAIN
{
    static const char *const pairs[] = {"order", "size", "odd",  "sizes", "n",    "7",
                                        "half",  "0.5",  "text", "7x",    "huge", "1e10",
                                        "empty", NULL,   "n",    "8",     NULL};
    const struct spin_plugin_values v = {pairs}, none = {NULL};
    int word = 9, n = 3;
    double x = 2;

    ok(spin_option_word(&v, "order", "source|size", &word) == SPIN_OK && word == 1, "a word");
    ok(spin_option_word(&v, "lacking", "source|size", &word) == SPIN_OK && word == 0,
       "the first word, when nothing is given");
    ok(spin_option_word(&none, "order", "source|size", &word) == SPIN_OK && word == 0,
       "nor any option");
    refused(spin_option_word(&v, "odd", "source|size", &word),
            "option 'odd' is 'sizes', expected source or size", "a longer word");
    refused(spin_option_word(&v, "odd", "a|b|c", &word),
            "option 'odd' is 'sizes', expected a, b or c", "a word of three");
    refused(spin_option_word(&v, "empty", "a|b", &word), "option 'empty' is '', expected a or b",
            "no text");

    ok(spin_option_count(&v, "n", 1, 9, &n) == SPIN_OK && n == 8, "a count, the last one given");
    ok(spin_option_count(&v, "lacking", 1, 9, &n) == SPIN_OK && n == 8, "stays without an option");
    refused(spin_option_count(&v, "n", 1, 7, &n),
            "option 'n' is '8', expected a whole number from 1 to 7", "a count too large");
    refused(spin_option_count(&v, "half", 0, 7, &n),
            "option 'half' is '0.5', expected a whole number from 0 to 7", "half a count");
    refused(spin_option_count(&v, "huge", 0, 2147483647, &n),
            "option 'huge' is '1e10', expected a whole number from 0 to 2147483647", "too many");
    ok(n == 8, "what is refused changes nothing");
    ok(spin_option_number(&v, "half", 0, 1, &x) == SPIN_OK && x == 0.5, "a number");
    refused(spin_option_number(&v, "text", 0, 9, &x),
            "option 'text' is '7x', expected a number from 0 to 9", "letters");
    refused(spin_option_number(&v, "empty", 0, 9, &x),
            "option 'empty' is '', expected a number from 0 to 9", "nothing");
}
