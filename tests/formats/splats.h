/* What the formats' tests share: plausible rows, and a file cut short and spoiled in every way. */
#ifndef SPIN_TESTS_FORMATS_SPLATS_H
#define SPIN_TESTS_FORMATS_SPLATS_H

#include "formats/gaussian.h"
#include "tests/tap.h"

#define ALL (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)

/* In [low, high], the same on every machine. */
__attribute__((unused)) static float draw(uint32_t *seed, float low, float high)
{
    *seed = *seed * 1664525u + 1013904223u;
    return low + (high - low) * (float)(*seed >> 8) / 16777216.0f;
}

__attribute__((unused)) static struct spin_gaussian make_row(uint32_t *seed)
{
    struct spin_gaussian row;
    float q[4];

    for (int c = 0; c < 3; c++) {
        row.place[c] = draw(seed, -4, 4);
        row.log_scale[c] = draw(seed, -7, 0);
        row.colour[c] = draw(seed, 0, 1);
    }
    for (int k = 0; k < 4; k++)
        q[k] = draw(seed, -1, 1);
    spin_unit_rotation(q, row.rotation);
    row.opacity = draw(seed, 0.01f, 0.99f);
    return row;
}

/* Whether row i of splats that were read is this one, within the format's steps. */
__attribute__((unused)) static int is_row(const struct spin_splats *s, size_t i,
                                          const struct spin_gaussian *row, double place,
                                          double scale, double other)
{
    const float *q = s->quats + 4 * i, *sh = s->sh + (3 + spin_n_rest(s->sh_degree)) * i;
    double dot = 0, opacity = 1 / (1 + exp(-(double)s->logit_opacities[i]));
    int good = fabs(opacity - row->opacity) <= other;

    for (int k = 0; k < 4; k++)
        dot += (double)q[k] * row->rotation[k];
    good &= 1 - fabs(dot) <= other;
    for (size_t c = 0; c < 3; c++) {
        good &= fabs(s->means[3 * i + c] - row->place[c]) <= place;
        good &= fabs(s->log_scales[3 * i + c] - row->log_scale[c]) <= scale;
        good &= fabs(0.5 + 0.28209479177387814 * sh[c] - row->colour[c]) <= other;
    }
    return good;
}

__attribute__((unused)) static int all_finite(const struct spin_splats *s)
{
    static const char *const what[5] = {"", "", "", "", ""};

    return spin_check_columns(what, ALL, 0, s->n, s) == SPIN_OK;
}

typedef spin_status (*read_fn)(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out);

/* Bytes in a block of their own length, so that a sanitizer sees who reads beyond. */
static spin_status read_copy(read_fn read, const unsigned char *bytes, size_t n,
                             struct spin_splats *out)
{
    unsigned char *copy = malloc(n ? n : 1);
    spin_status status;

    memcpy(copy, bytes, n);
    status = read(copy, n, out);
    free(copy);
    return status;
}

/* Every length below the file's is refused but those that `may` names (a multiple of it; 0: none),
 * and whatever bytes are changed, what is read is finite. */
__attribute__((unused)) static void check_hostile(read_fn read, const unsigned char *bytes,
                                                  size_t n, size_t may)
{
    struct spin_splats s = {0};
    unsigned char *spoiled = malloc(n);
    uint32_t seed = 7;
    int refused = 1, finite = 1, taken = 0;

    for (size_t i = 0; i < n; i++)
        if (!may || i % may != 0)
            refused &= read_copy(read, bytes, i, &s) != SPIN_OK;
    ok(refused, "a file cut short is refused");
    for (int round = 0; round < 3000; round++) {
        memcpy(spoiled, bytes, n);
        for (int k = 0; k <= round % 4; k++) {
            size_t at = (size_t)draw(&seed, 0, (float)n - 1);

            if (round % 3 == 0)
                at = at % 64 % n; /* counts stand at the beginning */
            spoiled[at] = (unsigned char)draw(&seed, 0, 255.99f);
        }
        if (read_copy(read, spoiled, n, &s) != SPIN_OK)
            continue;
        taken++;
        finite &= all_finite(&s);
    }
    ok(finite, "of 3000 spoiled files %d are read, and all they give is finite", taken);
    free(spoiled);
    spin_splats_free(&s);
}

#endif
