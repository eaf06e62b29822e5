#include "formats/spz.h"

#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "io/gzip.h"
#include "math/portable.h"
#include "math/quat.h"
#include "math/sh.h"

#define MAGIC 0x5053474eu /* "NGSP" */
#define VERSION 3
#define ANTIALIASED 1 /* of the header's flags */
#define COLOUR_SCALE (0.15f * 255)
#define SQRT2 1.41421356237309505f
#define MAX_PLACE 8388606 /* steps */
/* Deflate makes at most 1032 bytes of one. */
#define MAX_RATIO 1032

/* x y z w in our w x y z */
static const int xyzw[4] = {1, 2, 3, 0};

/* ---- Writing --------------------------------------------------------------------------------- */

size_t spin_spz_width(int stream, int sh_degree)
{
    static const size_t width[SPIN_SPZ_SH] = {9, 1, 3, 3, 4};

    return stream == SPIN_SPZ_SH ? spin_n_rest(sh_degree) : width[stream];
}

uint64_t spin_spz_bytes(size_t n, int sh_degree)
{
    return SPIN_SPZ_HEADER + (uint64_t)n * (20 + spin_n_rest(sh_degree));
}

void spin_spz_code_header(const struct spin_spz_header *header, unsigned char out[SPIN_SPZ_HEADER])
{
    uint32_t word[3] = {MAGIC, VERSION, (uint32_t)header->n};

    spin_little_endian(word, 3);
    memcpy(out, word, sizeof word);
    out[12] = (unsigned char)header->sh_degree;
    out[13] = (unsigned char)header->fraction;
    out[14] = header->antialias ? ANTIALIASED : 0;
    out[15] = 0;
}

int spin_spz_fraction(float largest, int at_most)
{
    while (at_most >= 0 && ldexp((double)largest, at_most) > MAX_PLACE)
        at_most--;
    return at_most;
}

void spin_spz_code_place(const float place[3], int fraction, unsigned char out[9], float shown[3])
{
    for (int c = 0; c < 3; c++) {
        int32_t fixed = (int32_t)lrint((double)place[c] * (1 << fraction));

        for (int b = 0; b < 3; b++)
            out[3 * c + b] = (unsigned char)((uint32_t)fixed >> (8 * b));
        shown[c] = (float)((double)fixed / (1 << fraction));
    }
}

unsigned char spin_spz_code_alpha(float opacity, float *shown)
{
    unsigned char out = spin_byte_of(opacity * 255);

    *shown = (float)out / 255;
    return out;
}

void spin_spz_code_colour(const float colour[3], unsigned char out[3], float shown[3])
{
    for (int c = 0; c < 3; c++) {
        out[c] = spin_byte_of((colour[c] - 0.5f) / (float)SPIN_SH_C0 * 0.15f * 255 + 127.5f);
        shown[c] = 0.5f + (float)SPIN_SH_C0 * ((float)out[c] - 127.5f) / COLOUR_SCALE;
    }
}

void spin_spz_code_scale(const float log_scale[3], unsigned char out[3], float shown[3])
{
    for (int c = 0; c < 3; c++) {
        out[c] = spin_byte_of((log_scale[c] + 10) * 16);
        shown[c] = (float)out[c] / 16 - 10;
    }
}

void spin_spz_code_rotation(const float q[4], unsigned char out[4], float shown[4])
{
    const float p[4] = {q[1], q[2], q[3], q[0]};
    int largest = spin_largest_of_4(p);
    uint32_t word = (uint32_t)largest;
    float rest = 1, sign = p[largest] < 0 ? -1 : 1;

    for (int k = 0; k < 4; k++) {
        float v = p[k] * sign, *seen = &shown[xyzw[k]];
        uint32_t size;

        if (k == largest)
            continue;
        size = (uint32_t)spin_minf(511 * SQRT2 * fabsf(v) + 0.5f, 511);
        word = word << 10 | (uint32_t)(v < 0) << 9 | size;
        *seen = (v < 0 ? -1 : 1) * (float)size / (511 * SQRT2);
        rest -= *seen * *seen;
    }
    shown[xyzw[largest]] = sqrtf(spin_maxf(rest, 0));
    for (int b = 0; b < 4; b++)
        out[b] = (unsigned char)(word >> (8 * b));
}

void spin_spz_code_sh(const float *restrict sh, int n_sh, int sh_degree,
                      unsigned char *restrict out, float *restrict lost)
{
    int n = 3 * spin_sh_count(sh_degree);

    for (int k = 3; k < n; k++) {
        float bucket = k < 12 ? 8 : 16, v = k < 3 * n_sh ? sh[k] : 0;
        float steps = (float)spin_byte_of((v * 128 + 128) / bucket);

        out[k - 3] = spin_byte_of(steps * bucket);
        lost[k - 3] = v - ((float)out[k - 3] - 128) / 128;
    }
}

/* ---- Reading --------------------------------------------------------------------------------- */

spin_status spin_spz_parse_header(const unsigned char *bytes, size_t n_bytes,
                                  struct spin_spz_header *out)
{
    uint32_t version;

    if (n_bytes < SPIN_SPZ_HEADER || spin_u32_at(bytes) != MAGIC)
        return spin_fail(SPIN_E_MALFORMED, "no header of SPZ");
    version = spin_u32_at(bytes + 4);
    if (version != VERSION)
        return spin_fail(SPIN_E_UNSUPPORTED, "SPZ of version %u, expected version %d", version,
                         VERSION);
    if (bytes[12] > 3)
        return spin_fail(SPIN_E_UNSUPPORTED, "SPZ with SH degree %d, expected 0 to 3", bytes[12]);
    *out = (struct spin_spz_header){.n = spin_u32_at(bytes + 8),
                                    .sh_degree = bytes[12],
                                    .fraction = bytes[13],
                                    .antialias = bytes[14] & ANTIALIASED};
    return SPIN_OK;
}

spin_status spin_spz_peek(const void *file, size_t size, struct spin_spz_header *out)
{
    unsigned char header[SPIN_SPZ_HEADER];
    size_t n = 0;

    SPIN_TRY(spin_gzip_read(file, size, header, sizeof header, &n));
    SPIN_TRY(spin_spz_parse_header(header, n, out));
    if (spin_gzip_length(file, size) != (uint32_t)spin_spz_bytes(out->n, out->sh_degree))
        return spin_fail(SPIN_E_MALFORMED, "SPZ with %zu splats of %zu bytes each, but %u bytes",
                         out->n, 20 + spin_n_rest(out->sh_degree), spin_gzip_length(file, size));
    return SPIN_OK;
}

/* 24 bits, signed, in steps of 2^-fraction. */
static float place_of(const unsigned char *at, int fraction)
{
    uint32_t bits = (uint32_t)at[0] << 8 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 24;

    return (float)ldexp((int32_t)bits / 256, -fraction);
}

static void rotation_of(const unsigned char *at, float q[4])
{
    uint32_t word = spin_u32_at(at);
    int largest = (int)(word >> 30);
    float rest = 1;

    for (int k = 3; k >= 0; k--) {
        float *v = &q[xyzw[k]];

        if (k == largest)
            continue;
        *v = (word & 512 ? -1 : 1) * (float)(word & 511) / (511 * SQRT2);
        rest -= *v * *v;
        word >>= 10;
    }
    q[xyzw[largest]] = sqrtf(spin_maxf(rest, 0));
    spin_quat_normalise(q);
}

/* The streams of header->n rows, as Niantic's library reads them. */
static void read_streams(const struct spin_spz_header *header, const unsigned char *at,
                         unsigned columns, struct spin_splats *out)
{
    size_t n = header->n, n_rest = spin_n_rest(header->sh_degree);
    const unsigned char *alpha = at + 9 * n, *colour = alpha + n, *scale = colour + 3 * n;
    const unsigned char *rotation = scale + 3 * n, *sh = rotation + 4 * n;

    for (size_t i = 0; i < 3 * n && (columns & SPIN_COL_MEANS); i++)
        out->means[i] = place_of(at + 3 * i, header->fraction);
    for (size_t i = 0; i < n && (columns & SPIN_COL_LOGIT_OPACITIES); i++)
        out->logit_opacities[i] = spin_byte_logit(alpha[i]);
    for (size_t i = 0; i < 3 * n && (columns & SPIN_COL_LOG_SCALES); i++)
        out->log_scales[i] = (float)scale[i] / 16 - 10;
    for (size_t i = 0; i < n && (columns & SPIN_COL_QUATS); i++)
        rotation_of(rotation + 4 * i, out->quats + 4 * i);
    for (size_t i = 0; i < n && (columns & SPIN_COL_SH); i++) {
        float *to = out->sh + (3 + n_rest) * i;

        for (size_t c = 0; c < 3; c++)
            to[c] = ((float)colour[3 * i + c] - 127.5f) / COLOUR_SCALE;
        for (size_t k = 0; k < n_rest; k++)
            to[3 + k] = ((float)sh[n_rest * i + k] - 128) / 128;
    }
}

spin_status spin_spz_read(const void *file, size_t size, unsigned columns, struct spin_splats *out)
{
    struct spin_spz_header header;
    unsigned char *bytes = NULL;
    size_t n = 0, n_bytes;
    spin_status status;

    SPIN_TRY(spin_spz_peek(file, size, &header));
    n_bytes = (size_t)spin_spz_bytes(header.n, header.sh_degree);
    if (n_bytes / MAX_RATIO > size)
        return spin_fail(SPIN_E_MALFORMED, "SPZ with %zu splats in %zu bytes", header.n, size);
    SPIN_TRY(spin_alloc(n_bytes + 1, 1, (void **)&bytes));
    SPIN_TRY_OUT(spin_gzip_read(file, size, bytes, n_bytes + 1, &n));
    if (n != n_bytes)
        SPIN_TRY_OUT(spin_fail(SPIN_E_MALFORMED,
                               "SPZ with %zu splats of %zu bytes each, but %zu bytes", header.n,
                               20 + spin_n_rest(header.sh_degree), n));
    SPIN_TRY_OUT(spin_splats_reserve(out, header.n, columns, header.sh_degree));
    out->antialias = header.antialias;
    read_streams(&header, bytes + SPIN_SPZ_HEADER, columns, out);
out:
    free(bytes);
    return status;
}
