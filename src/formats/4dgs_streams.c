/* Reads records and streams of .4dgs files, and dequantises values. */
#include "formats/4dgs_streams.h"

#include <math.h>

#include "formats/planes.h"
#include "io/compress.h"

enum { RAW, DIFFERENCE, CONSTANT, N_MODES };

const struct spin_4dgs_attribute spin_4dgs_attributes[SPIN_4DGS_N_ATTRIBUTES] = {
    {"position", 3}, {"scale", 3},   {"rotation_index", 1}, {"rotation", 3},
    {"color", 3},    {"opacity", 1}, {"motion", 3},         {"mu_t", 1},
    {"sigma_t", 1},  {"flags", 1},   {"window_index", 1},
};

const unsigned char *spin_4dgs_bytes(struct spin_4dgs_cursor *c, uint64_t n)
{
    const unsigned char *at = c->at;

    if (n > c->left) {
        c->cut = true;
        c->left = 0;
        return NULL;
    }
    c->at += n;
    c->left -= (size_t)n;
    return at;
}

uint64_t spin_4dgs_number(struct spin_4dgs_cursor *c, int bytes)
{
    const unsigned char *at = spin_4dgs_bytes(c, (uint64_t)bytes);
    uint64_t value = 0;

    for (int b = 0; at && b < bytes; b++)
        value |= (uint64_t)at[b] << (8 * b);
    return value;
}

double spin_4dgs_double(struct spin_4dgs_cursor *c)
{
    uint64_t bits = spin_4dgs_number(c, 8);
    double value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

struct spin_4dgs_cursor spin_4dgs_block(struct spin_4dgs_cursor *c, int length_bytes)
{
    uint64_t n = spin_4dgs_number(c, length_bytes);
    const unsigned char *at = spin_4dgs_bytes(c, n);

    return (struct spin_4dgs_cursor){at ? at : (const unsigned char *)"", at ? (size_t)n : 0,
                                     false};
}

bool spin_4dgs_is(const struct spin_4dgs_cursor *text, const char *word)
{
    return text->left == strlen(word) && memcmp(text->at, word, text->left) == 0;
}

/* Allocates *out and decompresses exactly n_out bytes into it. */
static spin_status decompress(unsigned codec, const struct spin_4dgs_cursor *packed, uint64_t n_out,
                              unsigned char **out)
{
    size_t n = 0;

    SPIN_TRY(spin_alloc((size_t)n_out + 1, 1, (void **)out));
    if (codec == 1)
        return spin_zstd_read(packed->at, packed->left, *out, (size_t)n_out);
    SPIN_TRY(spin_zlib_read(packed->at, packed->left, *out, (size_t)n_out + 1, &n));
    return n == n_out ? SPIN_OK
                      : spin_malformed("the zlib data do not decompress to the declared %llu bytes",
                                       (unsigned long long)n_out);
}

struct spin_4dgs_stream spin_4dgs_stream_head(struct spin_4dgs_cursor *c)
{
    struct spin_4dgs_stream s;

    s.attribute = (unsigned)spin_4dgs_number(c, 1);
    s.symbol = (unsigned)spin_4dgs_number(c, 1);
    s.mode = (unsigned)spin_4dgs_number(c, 1);
    s.codec = (unsigned)spin_4dgs_number(c, 1);
    s.channels = (unsigned)spin_4dgs_number(c, 1);
    s.n = spin_4dgs_number(c, 4);
    s.packed = spin_4dgs_block(c, 8);
    return s;
}

/* Decodes the symbols of a stream to integers. `out` has the shape [n][channels]. */
static spin_status decode_symbols(const struct spin_4dgs_stream *s, const unsigned char *planes,
                                  size_t n_symbols, int32_t *out)
{
    size_t width = s->channels;

    for (size_t i = 0; i < s->n * width; i++) {
        int64_t v = spin_unzigzag(spin_plane_symbol(planes, (int)s->symbol, n_symbols,
                                                    s->mode == CONSTANT ? i % width : i));

        v += s->mode == DIFFERENCE && i >= width ? out[i - width] : 0;
        if (v < INT32_MIN || v > INT32_MAX)
            return spin_malformed("a value in row %zu does not fit in 32 bits", i / width);
        out[i] = (int32_t)v;
    }
    return SPIN_OK;
}

spin_status spin_4dgs_stream_read(const struct spin_4dgs_stream *s, size_t n, int channels,
                                  int32_t **out)
{
    size_t n_symbols = (s->mode == CONSTANT ? 1 : n) * (size_t)channels;
    SPIN_FREED unsigned char *planes = NULL;

    if (s->codec > 1)
        return spin_unsupported("codec %u is not supported, expected 0 (deflate) or 1 (zstd)",
                                s->codec);
    if (s->n != n || s->channels != (unsigned)channels)
        return spin_malformed("%llu splats with %u values each, expected %zu with %d each",
                              (unsigned long long)s->n, s->channels, n, channels);
    if (s->mode >= N_MODES || (s->symbol != 1 && s->symbol != 2 && s->symbol != 4))
        return spin_malformed("symbols of %u bytes and mode %u, expected 1, 2 or 4 "
                              "bytes and mode 0, 1 or 2",
                              s->symbol, s->mode);
    SPIN_TRY(spin_alloc(n * (size_t)channels, sizeof **out, (void **)out));
    SPIN_TRY(decompress(s->codec, &s->packed, (uint64_t)n_symbols * s->symbol, &planes));
    return decode_symbols(s, planes, n_symbols, *out);
}

spin_status spin_4dgs_open(struct spin_4dgs_cursor *block, const struct spin_4dgs_cursor *codec,
                           uint64_t bytes, unsigned char **plain)
{
    if (codec->left == 0 && bytes == block->left)
        return SPIN_OK;
    if (codec->left == 0 || bytes > SPIN_4DGS_SLACK + (uint64_t)SPIN_4DGS_RATIO * block->left)
        return spin_malformed("%zu compressed bytes cannot unpack to %llu bytes", block->left,
                              (unsigned long long)bytes);
    if (!spin_4dgs_is(codec, "deflate") && !spin_4dgs_is(codec, "zstd"))
        return spin_unsupported("codec '%.*s' is not supported, expected 'deflate' or 'zstd'",
                                codec->left < 80 ? (int)codec->left : 80, (const char *)codec->at);
    SPIN_TRY(decompress(spin_4dgs_is(codec, "zstd"), block, bytes, plain));
    *block = (struct spin_4dgs_cursor){*plain, (size_t)bytes, false};
    return SPIN_OK;
}

/* ---- Values ---------------------------------------------------------------------------------- */

double spin_4dgs_clamp(double x, double least, double most)
{
    return x > least ? x < most ? x : most : least;
}

double spin_4dgs_motion_step(const double step[SPIN_4DGS_N_STEPS], double life)
{
    double level = spin_4dgs_clamp(ceil(log2(spin_4dgs_clamp(life, 0.02, 2) / 0.5)), -4, 2);

    return ldexp(step[SPIN_4DGS_STEP_MOTION], -(int)level);
}

double spin_4dgs_time_step(const double step[SPIN_4DGS_N_STEPS], double sigma)
{
    double whole = step[SPIN_4DGS_STEP_TIME];

    return whole > 0 && 0.05 * sigma < whole
               ? ldexp(whole, (int)spin_4dgs_clamp(floor(log2(0.05 * sigma / whole)), -10, 0))
               : whole;
}

void spin_4dgs_rotation(const int32_t *steps, int largest, double step, float wxyz[4])
{
    static const int place[4] = {1, 2, 3, 0};
    double rest = 1;

    for (int k = 0, from = 0; k < 4; k++) {
        double v;

        if (k == largest)
            continue;
        v = spin_4dgs_clamp(steps[from++] * step, -1, 1);
        rest -= v * v;
        wxyz[place[k]] = (float)v;
    }
    wxyz[place[largest]] = (float)sqrt(rest > 0 ? rest : 0);
}
