/* Any bytes as JSON: what parses must print, and the print must parse and print the same.
 * K: fuzz json */
#include "io/json.h"
#include "tests/fuzz/input.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    spin_json *first = NULL, *second = NULL;
    char *text, *again;

    if (spin_json_parse("x", (const char *)data, n, &first) != SPIN_OK)
        return 0;
    text = spin_json_text(first, n % 2);
    if (!text || spin_json_parse("y", text, strlen(text), &second) != SPIN_OK)
        abort();
    again = spin_json_text(second, n % 2);
    if (!again || strcmp(text, again) != 0)
        abort();
    free(text);
    free(again);
    spin_json_free(first);
    spin_json_free(second);
    return 0;
}
