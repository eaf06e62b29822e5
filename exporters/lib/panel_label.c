#include "exporters/lib/panel_label.h"

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

/* The letters of the words of the panels, 5 x 7: a byte a row, the leftmost pixel is its highest of 5 bits. */
static const struct {
    char letter;
    unsigned char row[7];
} glyphs[] = {
    {'a', {0, 0, 14, 1, 15, 17, 15}},    {'b', {16, 16, 22, 25, 17, 17, 30}},
    {'e', {0, 0, 14, 17, 31, 16, 14}},   {'f', {6, 9, 8, 28, 8, 8, 8}},
    {'h', {16, 16, 22, 25, 17, 17, 17}}, {'o', {0, 0, 14, 17, 17, 17, 14}},
    {'r', {0, 0, 22, 25, 16, 16, 16}},   {'t', {8, 8, 28, 8, 8, 9, 6}},
    {'u', {0, 0, 17, 17, 17, 19, 13}},
};

static bool is_ink(const char *word, int x, int y)
{
    for (size_t g = 0; x >= 0 && y >= 0 && y < 7 && g < sizeof glyphs / sizeof *glyphs; g++) {
        if (glyphs[g].letter == word[x / 6])
            return x % 6 < 5 && glyphs[g].row[y] >> (4 - x % 6) & 1;
    }
    return false;
}

void spin_panel_label(const char *word, int width, int height, float *image)
{
    int dot = height / 180 > 1 ? height / 180 : 1, n = (int)strlen(word);
    int wide = (6 * n + 3) * dot, high = 11 * dot;

    if (height < 4 * high || width < wide)
        return;
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < high; y++)
            for (int x = 0; x < wide; x++)
                image[((size_t)c * (size_t)height + (size_t)y) * (size_t)width + (size_t)x] =
                    x / dot < 6 * n + 2 && is_ink(word, x / dot - 2, y / dot - 2);
}
