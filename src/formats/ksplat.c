#include "formats/ksplat.h"

#include <string.h>

#include "io/array.h"
#include "math/quat.h"
#include "math/sh.h"

#define MAX_LEVEL 2
#define MAX_SH_DEGREE 3
#define STEPS 32767     /* default number of steps for half the width of a bucket */
#define SH_RANGE 1.5f   /* default range of SH: -1.5 to 1.5 */
#define CENTRE_BYTES 12 /* size of a bucket's centre: 3 floats */
#define LEAST_SCALE 1e-38f

struct file {
    int level;
    uint32_t n_sections; /* capacity in sections: unused sections have headers too */
    float sh_least, sh_largest;
};

struct section {
    size_t n, n_full, n_buckets, bucket; /* bucket: splats in a full bucket */
    const unsigned char *lengths, *centres, *rows;
    size_t row;     /* size of a row (one splat) in bytes */
    float step;     /* quantisation step of positions, in world units */
    uint32_t steps; /* number of quantisation steps for half the width of a bucket */
    int sh_degree;
};

static uint32_t u16_at(const unsigned char *at) { return at[0] | (uint32_t)at[1] << 8; }

static float f32_at(const unsigned char *at)
{
    uint32_t bits = spin_u32_at(at);
    float value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

/* ---- Headers --------------------------------------------------------------------------------- */

static spin_status read_header(const unsigned char *file, size_t size, struct file *out)
{
    if (size < SPIN_KSPLAT_HEADER)
        return spin_malformed(".ksplat: truncated within the header");
    if (file[0] != 0 || file[1] != 1)
        return spin_unsupported(".ksplat: version %d.%d, expected 0.1", file[0], file[1]);
    *out = (struct file){.level = (int)u16_at(file + 20),
                         .n_sections = spin_u32_at(file + 4),
                         .sh_least = f32_at(file + 36),
                         .sh_largest = f32_at(file + 40)};
    if (out->level > MAX_LEVEL)
        return spin_unsupported(".ksplat: compression level %d, expected 0 to %d", out->level,
                                MAX_LEVEL);
    if (out->n_sections > (size - SPIN_KSPLAT_HEADER) / SPIN_KSPLAT_SECTION)
        return spin_malformed(".ksplat: a file of %zu bytes cannot contain %u sections", size,
                              out->n_sections);
    out->sh_least = out->sh_least != 0 ? out->sh_least : -SH_RANGE;
    out->sh_largest = out->sh_largest != 0 ? out->sh_largest : SH_RANGE;
    return SPIN_OK;
}

static size_t row_bytes(int level, int sh_degree)
{
    return (level == 0 ? 44 : 24) + spin_n_rest(sh_degree) * (level == 0 ? 4 : level == 1 ? 2 : 1);
}

static size_t bucket_splats(const struct section *s, size_t bucket)
{
    return bucket < s->n_full ? s->bucket : spin_u32_at(s->lengths + 4 * (bucket - s->n_full));
}

/* Checks that the buckets of a section contain enough splats for the section. */
static spin_status check_buckets(const struct section *s, uint32_t index)
{
    uint64_t n = 0;

    for (size_t b = 0; b < s->n_buckets; b++)
        n += bucket_splats(s, b);
    if (n < s->n)
        return spin_malformed(".ksplat: section %u has %zu splats, but its buckets have %llu",
                              index, s->n, (unsigned long long)n);
    return SPIN_OK;
}

/* Reads the header of section `index`. *at: offset of the section's data; the function advances *at
 * to the end of these data. */
static spin_status read_section(const unsigned char *file, size_t size, const struct file *f,
                                uint32_t index, uint64_t *at, struct section *out)
{
    const unsigned char *h = file + SPIN_KSPLAT_HEADER + (size_t)SPIN_KSPLAT_SECTION * index;
    uint64_t room = spin_u32_at(h + 4), n_buckets = spin_u32_at(h + 12);
    uint64_t lengths = *at, centres = lengths + (uint64_t)4 * spin_u32_at(h + 36);
    uint64_t rows = centres + n_buckets * u16_at(h + 20);

    *out = (struct section){.n = spin_u32_at(h),
                            .bucket = spin_u32_at(h + 8),
                            .n_full = spin_u32_at(h + 32),
                            .n_buckets = (size_t)n_buckets,
                            .steps = spin_u32_at(h + 24),
                            .sh_degree = (int)u16_at(h + 40)};
    if (out->sh_degree > MAX_SH_DEGREE)
        return spin_unsupported(".ksplat: section %u has SH degree %d, expected 0 to %d", index,
                                out->sh_degree, MAX_SH_DEGREE);
    out->row = row_bytes(f->level, out->sh_degree);
    if (rows > size || room > (size - rows) / out->row || out->n > room)
        return spin_malformed(".ksplat: section %u extends beyond the file", index);
    *at = rows + room * out->row;
    out->lengths = file + lengths;
    out->centres = file + centres;
    out->rows = file + rows;
    out->steps = out->steps ? out->steps : STEPS;
    out->step = f32_at(h + 16) / 2 / (float)out->steps;
    if (f->level == 0)
        return SPIN_OK;
    if ((n_buckets > 0 && u16_at(h + 20) != CENTRE_BYTES) ||
        n_buckets != (uint64_t)out->n_full + spin_u32_at(h + 36))
        return spin_malformed(".ksplat: section %u has invalid buckets", index);
    return check_buckets(out, index);
}

spin_status spin_ksplat_peek(const unsigned char *file, size_t size, struct spin_ksplat *out)
{
    struct file f;
    uint64_t at;

    *out = (struct spin_ksplat){0};
    SPIN_TRY(read_header(file, size, &f));
    at = SPIN_KSPLAT_HEADER + (uint64_t)SPIN_KSPLAT_SECTION * f.n_sections;
    for (uint32_t i = 0; i < f.n_sections; i++) {
        struct section s;

        SPIN_TRY(read_section(file, size, &f, i, &at, &s));
        out->n += s.n;
        out->sh_degree = s.sh_degree > out->sh_degree ? s.sh_degree : out->sh_degree;
    }
    if (out->n != spin_u32_at(file + 16))
        return spin_malformed(".ksplat: the header declares %u splats, the sections contain %zu",
                              spin_u32_at(file + 16), out->n);
    return SPIN_OK;
}

/* ---- Rows ------------------------------------------------------------------------------------ */

/* Converts n consecutive numbers to floats. kind: 'f' float, 'u' unsigned; item_size: bytes per
 * number. */
static void read_numbers(const unsigned char *at, char kind, int item_size, size_t n, float *out)
{
    struct spin_array a = {.kind = kind,
                           .item_size = item_size,
                           .n_dims = 1,
                           .shape = {n},
                           .stride = {1},
                           .count = n,
                           .data = at};

    spin_array_to_f32(&a, 0, n, out);
}

static void read_sh(const unsigned char *at, const struct file *f, int sh_degree, float *out)
{
    float rest[3 * SPIN_SH_MAX];
    const float *from = rest;

    read_numbers(at, f->level == 2 ? 'u' : 'f', 4 >> f->level, spin_n_rest(sh_degree), rest);
    for (int l = 1; l <= sh_degree; from += 3 * (2 * l + 1), l++)
        for (int c = 0; c < 3; c++)
            for (int m = 0; m < 2 * l + 1; m++)
                out[3 * (l * l + m) + c] = from[(2 * l + 1) * c + m];
    for (size_t k = 3; k < 3 + spin_n_rest(sh_degree) && f->level == 2; k++)
        out[k] = f->sh_least + out[k] / 255 * (f->sh_largest - f->sh_least);
}

static void read_row(const unsigned char *at, const struct file *f, const struct section *s,
                     const unsigned char *centre, unsigned columns, size_t i,
                     struct spin_splats *out)
{
    int size = f->level == 0 ? 4 : 2;
    const unsigned char *scale = at + 3 * size, *rotation = scale + 3 * size;
    const unsigned char *colour = rotation + 4 * size;
    float v[4];

    if (columns & SPIN_COL_MEANS) {
        read_numbers(at, f->level == 0 ? 'f' : 'u', size, 3, out->means + 3 * i);
        for (size_t c = 0; c < 3 && f->level > 0; c++)
            out->means[3 * i + c] =
                (out->means[3 * i + c] - (float)s->steps) * s->step + f32_at(centre + 4 * c);
    }
    if (columns & SPIN_COL_LOG_SCALES) {
        read_numbers(scale, 'f', size, 3, v);
        for (size_t c = 0; c < 3; c++) /* NaN stays NaN; spin_ksplat_read() reports it */
            out->log_scales[3 * i + c] = logf(v[c] < LEAST_SCALE ? LEAST_SCALE : v[c]);
    }
    if (columns & SPIN_COL_QUATS) {
        read_numbers(rotation, 'f', size, 4, out->quats + 4 * i);
        if (isfinite(spin_quat_norm(out->quats + 4 * i)))
            spin_quat_normalise(out->quats + 4 * i);
    }
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        out->logit_opacities[i] = spin_byte_logit(colour[3]);
    if (columns & SPIN_COL_SH) {
        float *sh = out->sh + (3 + spin_n_rest(out->sh_degree)) * i;

        memset(sh, 0, (3 + spin_n_rest(out->sh_degree)) * sizeof *sh);
        for (int c = 0; c < 3; c++)
            sh[c] = (colour[c] / 255.0f - 0.5f) / (float)SPIN_SH_C0;
        read_sh(colour + 4, f, s->sh_degree, sh);
    }
}

static void read_rows(const struct file *f, const struct section *s, unsigned columns, size_t first,
                      struct spin_splats *out)
{
    size_t bucket = 0, within = 0;

    for (size_t i = 0; i < s->n; i++, within++) {
        for (; f->level > 0 && within == bucket_splats(s, bucket); bucket++)
            within = 0;
        read_row(s->rows + s->row * i, f, s, s->centres + CENTRE_BYTES * bucket, columns, first + i,
                 out);
    }
}

spin_status spin_ksplat_read(const unsigned char *file, size_t size, unsigned columns,
                             struct spin_splats *out)
{
    static const char *const what[5] = {"position", "rotation", "scale", "opacity", "colour"};
    struct spin_ksplat all;
    struct file f;
    struct section s;
    uint64_t at;
    size_t first = 0;

    SPIN_TRY(spin_ksplat_peek(file, size, &all));
    SPIN_TRY(read_header(file, size, &f));
    SPIN_TRY(spin_splats_reserve(out, all.n, columns, all.sh_degree));
    at = SPIN_KSPLAT_HEADER + (uint64_t)SPIN_KSPLAT_SECTION * f.n_sections;
    for (uint32_t i = 0; i < f.n_sections; i++, first += s.n) {
        SPIN_TRY(read_section(file, size, &f, i, &at, &s));
        read_rows(&f, &s, columns, first, out);
    }
    return spin_check_columns(what, columns, 0, all.n, out);
}
