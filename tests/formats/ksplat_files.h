/* Files of .ksplat, written by the words of the format, apart from its reader. */
#ifndef SPIN_TESTS_FORMATS_KSPLAT_FILES_H
#define SPIN_TESTS_FORMATS_KSPLAT_FILES_H

#include "formats/ksplat.h"
#include "tests/formats/splats.h"

/* One section of a file: buckets of `bucket` rows, of which the last may hold fewer; centres[b] is
 * that of bucket b. */
struct ksplat_section {
    size_t n, bucket;
    int sh_degree;
    const struct spin_gaussian *row;
};

__attribute__((unused)) static void put_bytes(unsigned char *at, uint64_t value, int n)
{
    for (int b = 0; b < n; b++)
        at[b] = (unsigned char)(value >> (8 * b));
}

__attribute__((unused)) static void put_f32(unsigned char *at, float value)
{
    uint32_t bits;

    memcpy(&bits, &value, sizeof bits);
    put_bytes(at, bits, 4);
}

/* A float, or its nearest half; those here are normal numbers. */
__attribute__((unused)) static unsigned char *put_real(unsigned char *at, int level, float value)
{
    int exponent;
    double fraction = frexp(fabs((double)value), &exponent);

    if (level == 0) {
        put_f32(at, value);
        return at + 4;
    }
    if (fabsf(value) < 6.2e-5f)
        put_bytes(at, (uint64_t)lrint(ldexp(fabs((double)value), 24)), 2);
    else
        put_bytes(
            at, (uint64_t)lrint((fraction * 2 - 1) * 1024) + ((uint64_t)(exponent + 14) << 10), 2);
    at[1] |= value < 0 ? 0x80 : 0;
    return at + 2;
}

/* Coefficient k of channel c, the same for all rows. */
__attribute__((unused)) static float ksplat_sh(int k, int c)
{
    return (float)(k - 8 + 16 * (c - 1)) / 32;
}

__attribute__((unused)) static unsigned char *
put_ksplat_row(unsigned char *at, int level, const struct ksplat_section *s,
               const struct spin_gaussian *row, const float centre[3], float width, int steps)
{
    for (int c = 0; c < 3; c++) {
        if (level == 0) {
            put_f32(at, row->place[c]);
            at += 4;
        } else {
            put_bytes(at,
                      (uint64_t)lrint((row->place[c] - centre[c]) / width * 2 * steps) +
                          (uint64_t)steps,
                      2);
            at += 2;
        }
    }
    for (int c = 0; c < 3; c++)
        at = put_real(at, level, expf(row->log_scale[c]));
    for (int k = 0; k < 4; k++)
        at = put_real(at, level, row->rotation[k]);
    for (int c = 0; c < 3; c++)
        *at++ = spin_byte_of(row->colour[c] * 255);
    *at++ = spin_byte_of(row->opacity * 255);
    for (int l = 1; l <= s->sh_degree; l++)
        for (int c = 0; c < 3; c++)
            for (int k = l * l; k < (l + 1) * (l + 1); k++) {
                if (level < 2)
                    at = put_real(at, level, ksplat_sh(k, c));
                else /* least -1, largest 1 */
                    *at++ = spin_byte_of((ksplat_sh(k, c) + 1) / 2 * 255);
            }
    return at;
}

/* Allocated with malloc. steps 0: the section does not say how many. */
__attribute__((unused)) static unsigned char *make_ksplat(int level, const struct ksplat_section *s,
                                                          size_t n_sections, uint32_t steps,
                                                          size_t *n_bytes)
{
    const float width = 9;
    unsigned char *file = calloc(1, 1 << 20),
                  *at = file + SPIN_KSPLAT_HEADER + SPIN_KSPLAT_SECTION * n_sections;
    size_t n = 0;

    file[1] = 1;
    put_bytes(file + 4, n_sections, 4);
    put_bytes(file + 8, n_sections, 4);
    put_bytes(file + 20, (uint64_t)level, 2);
    put_f32(file + 36, -1);
    put_f32(file + 40, 1);
    for (size_t i = 0; i < n_sections; i++, s++) {
        unsigned char *h = file + SPIN_KSPLAT_HEADER + SPIN_KSPLAT_SECTION * i;
        size_t n_full = level ? s->n / s->bucket : 0, part = level ? s->n % s->bucket : 0;
        float centre[3] = {0};

        put_bytes(h, s->n, 4);
        put_bytes(h + 4, s->n, 4);
        put_bytes(h + 40, (uint64_t)s->sh_degree, 2);
        if (level > 0) {
            put_bytes(h + 8, s->bucket, 4);
            put_bytes(h + 12, n_full + (part > 0), 4);
            put_f32(h + 16, width);
            put_bytes(h + 20, 12, 2);
            put_bytes(h + 24, steps, 4);
            put_bytes(h + 32, n_full, 4);
            put_bytes(h + 36, part > 0, 4);
            if (part > 0) {
                put_bytes(at, part, 4);
                at += 4;
            }
            for (size_t b = 0; b < n_full + (part > 0); b++, at += 12)
                for (int c = 0; c < 3; c++)
                    put_f32(at + 4 * c, 0.25f * (float)b - 0.125f * (float)c);
        }
        for (size_t k = 0; k < s->n; k++) {
            for (int c = 0; c < 3 && level > 0; c++)
                centre[c] = 0.25f * (float)(k / s->bucket) - 0.125f * (float)c;
            at =
                put_ksplat_row(at, level, s, &s->row[k], centre, width, steps ? (int)steps : 32767);
        }
        n += s->n;
    }
    put_bytes(file + 12, n, 4);
    put_bytes(file + 16, n, 4);
    *n_bytes = (size_t)(at - file);
    return file;
}

#endif
