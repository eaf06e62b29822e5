/* Planes of bytes: what is alike in neighbouring values (signs, exponents) lies together, where deflate finds it. */
#include "scene/bundle_pack.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"

enum { PORTION = 1 << 15 }; /* values at a time */

struct spin_pack_series {
    char name[64];
    uint32_t *key; /* [key_rows][width] values of frame 0 */
    uint64_t key_rows, width;
    spin_json *rows; /* a number for every frame so far */
};

/* An array whose first n_key values are taken as differences. */
struct difference {
    const uint32_t *values, *key;
    uint64_t n_key;
};

static spin_status read_difference(void *context, uint64_t first, size_t n, uint32_t *to)
{
    const struct difference *d = context;
    size_t i = 0;

    for (; i < n && first + i < d->n_key; i++)
        to[i] = d->values[first + i] ^ d->key[first + i];
    memcpy(to + i, d->values + first + i, (n - i) * sizeof *to);
    return SPIN_OK;
}

/* ---- One array ---------------------------------------------------------------------------------- */

spin_status spin_pack_write(struct spin_zip_writer *w, const char *name, int n_dims,
                            const uint64_t *shape, spin_pack_read_fn read, void *context)
{
    uint64_t planes[SPIN_NPY_MAX_DIMS] = {4}, count = 1;
    uint32_t values[PORTION];
    unsigned char bytes[PORTION];

    for (int d = 0; d < n_dims; d++) {
        planes[d + 1] = shape[d];
        count *= shape[d];
    }
    SPIN_TRY(spin_npz_write_begin_deflated(w, name, "|u1", n_dims + 1, planes));
    for (int plane = 0; plane < 4; plane++)
        for (uint64_t first = 0; first < count; first += PORTION) {
            size_t n = count - first < PORTION ? (size_t)(count - first) : PORTION;

            SPIN_TRY(read(context, first, n, values));
            for (size_t i = 0; i < n; i++)
                bytes[i] = (unsigned char)(values[i] >> 8 * plane);
            SPIN_TRY(spin_zip_member_write(w, bytes, n));
        }
    return spin_zip_member_end(w);
}

/* ---- Series ------------------------------------------------------------------------------------- */

/* About how many bits the planes become: the entropy of their bytes, each plane by itself. */
static double weigh(uint64_t count, struct difference d)
{
    uint32_t values[PORTION];
    uint64_t seen[4][256] = {{0}};
    double bits = 0;

    for (uint64_t first = 0; first < count; first += PORTION) {
        size_t n = count - first < PORTION ? (size_t)(count - first) : PORTION;

        (void)read_difference(&d, first, n, values);
        for (size_t i = 0; i < n; i++)
            for (int plane = 0; plane < 4; plane++)
                seen[plane][values[i] >> 8 * plane & 255]++;
    }
    for (int i = 0; i < 4 * 256; i++)
        if (seen[i / 256][i % 256] > 0)
            bits += (double)seen[i / 256][i % 256] *
                    log2((double)count / (double)seen[i / 256][i % 256]);
    return bits;
}

/* How many rows are worth taking as differences: none, up to the last that is the same, or all. */
static uint64_t choose_rows(const struct spin_pack_series *s, uint64_t n_rows,
                            const uint32_t *values)
{
    uint64_t width = s->width, all = n_rows < s->key_rows ? n_rows : s->key_rows, same = all;
    uint64_t tried[3], best = 0;
    double least = INFINITY;

    while (same > 0 && memcmp(values + width * (same - 1), s->key + width * (same - 1),
                              width * sizeof *values) != 0)
        same--;
    tried[0] = 0;
    tried[1] = same;
    tried[2] = all;
    for (int i = 0; i < 3; i++) {
        double bits =
            weigh(n_rows * width, (struct difference){values, s->key, tried[i] * width});

        if (bits < 0.99 * least) {
            least = bits;
            best = tried[i];
        }
    }
    return best;
}

static spin_status find_series(struct spin_packer *p, const char *name,
                               struct spin_pack_series **out)
{
    for (size_t i = 0; i < p->n; i++)
        if (strcmp(p->series[i].name, name) == 0) {
            *out = &p->series[i];
            return SPIN_OK;
        }
    SPIN_TRY(spin_room(p->n, &p->capacity, sizeof *p->series, (void **)&p->series));
    *out = &p->series[p->n++];
    memset(*out, 0, sizeof **out);
    snprintf((*out)->name, sizeof (*out)->name, "%s", name);
    (*out)->rows = spin_json_array();
    return SPIN_OK;
}

spin_status spin_packer_put(struct spin_packer *packer, struct spin_zip_writer *w,
                            const char *series, int frame, int n_dims, const uint64_t *shape,
                            const void *values)
{
    struct spin_pack_series *s;
    struct difference d = {.values = values};
    uint64_t width = 1, rows = 0;
    char name[80];

    if (frame < 0)
        return spin_pack_write(w, series, n_dims, shape, read_difference, &d);
    for (int i = 1; i < n_dims; i++)
        width *= shape[i];
    SPIN_TRY(find_series(packer, series, &s));
    if (frame == 0) {
        SPIN_TRY(spin_alloc((size_t)(width * shape[0]) + 1, sizeof *s->key, (void **)&s->key));
        memcpy(s->key, values, (size_t)(width * shape[0]) * sizeof *s->key);
        s->key_rows = shape[0];
        s->width = width;
    } else if (width == s->width) {
        rows = choose_rows(s, shape[0], values);
    }
    d.key = s->key;
    d.n_key = rows * width;
    spin_json_push_number(s->rows, (double)rows);
    snprintf(name, sizeof name, "%s/%05d", series, frame);
    return spin_pack_write(w, name, n_dims, shape, read_difference, &d);
}

spin_json *spin_packer_json(const struct spin_packer *packer)
{
    spin_json *all = spin_json_object();

    for (size_t i = 0; i < packer->n; i++) {
        spin_json_set(all, packer->series[i].name, packer->series[i].rows);
        packer->series[i].rows = NULL;
    }
    return all;
}

void spin_packer_free(struct spin_packer *packer)
{
    for (size_t i = 0; i < packer->n; i++) {
        free(packer->series[i].key);
        spin_json_free(packer->series[i].rows);
    }
    free(packer->series);
    memset(packer, 0, sizeof *packer);
}

/* ---- Rounding ----------------------------------------------------------------------------------- */

/* To the nearest, ties to even, on the bits: a carry goes into the exponent as it should. */
static float round_one(float value, int bits, float step)
{
    uint32_t u, dropped = 24 - (uint32_t)bits;
    float rounded;

    memcpy(&u, &value, sizeof u);
    u += (1u << (dropped - 1)) - 1 + (u >> dropped & 1);
    u = u >> dropped << dropped;
    memcpy(&rounded, &u, sizeof u);
    if (!isfinite(value) || !isfinite(rounded))
        return value;
    if (step > 0 && fabsf(rounded) < 0x1p22f * step)
        return rintf(rounded / step) * step;
    return rounded;
}

void spin_round_values(float *values, size_t n, int bits, float step)
{
    for (size_t i = 0; i < n; i++)
        values[i] = round_one(values[i], bits, step);
}
