#include "formats/compressed_ply.h"

#include "base/base.h"
#include "math/portable.h"
#include "math/quat.h"
#include "math/sh.h"

#define SCALE_LIMIT 20.0f /* limit of |log scale|, as in splat-transform */
#define SQRT2 1.41421356237309505f

/* Files must have at least the first twelve values of range_names; old files lack the colour
 * ranges. */
enum { N_RANGES_NEEDED = 12 };

static const char *const range_names[SPIN_COMPRESSED_RANGES] = {
    "min_x",       "min_y",       "min_z",       "max_x",       "max_y",       "max_z",
    "min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z",
    "min_r",       "min_g",       "min_b",       "max_r",       "max_g",       "max_b"};
enum { POSITION, ROTATION, SCALE, COLOUR };
static const char *const packed_names[4] = {"packed_position", "packed_rotation", "packed_scale",
                                            "packed_color"};

/* ---- Packing --------------------------------------------------------------------------------- */

/* Quantises x in [low, high] to 0..n. */
static uint32_t quantise(float x, float low, float high, uint32_t n)
{
    float u = high - low > 0 ? (x - low) / (high - low) : 0;

    return (uint32_t)(spin_minf(spin_maxf(u, 0), 1) * (float)n + 0.5f);
}

static uint32_t pack_3(const float *x, const float *low, const float *high)
{
    return quantise(x[0], low[0], high[0], 2047) << 21 |
           quantise(x[1], low[1], high[1], 1023) << 11 | quantise(x[2], low[2], high[2], 2047);
}

static uint32_t pack_rotation(const float q[4])
{
    int largest = spin_largest_of_4(q);
    uint32_t word = (uint32_t)largest;
    float sign = q[largest] < 0 ? -1 : 1;

    for (int k = 0; k < 4; k++)
        if (k != largest)
            word = word << 10 | quantise(sign * q[k], -0.5f * SQRT2, 0.5f * SQRT2, 1023);
    return word;
}

static uint32_t pack_colour(const struct spin_gaussian *row, const float *low, const float *high)
{
    uint32_t word = 0;

    for (int c = 0; c < 3; c++)
        word = word << 8 | quantise(row->colour[c], low[c], high[c], 255);
    return word << 8 | quantise(row->opacity, 0, 1, 255);
}

static void widen_range(float *range, const float *x)
{
    for (int c = 0; c < 3; c++) {
        range[c] = spin_minf(range[c], x[c]);
        range[3 + c] = spin_maxf(range[3 + c], x[c]);
    }
}

void spin_compressed_pack(struct spin_gaussian *row, size_t n, float range[SPIN_COMPRESSED_RANGES],
                          uint32_t (*word)[4])
{
    for (int i = 0; i < SPIN_COMPRESSED_RANGES; i++)
        range[i] = i / 3 % 2 ? -INFINITY : INFINITY;
    for (size_t i = 0; i < n; i++) {
        for (int c = 0; c < 3; c++)
            row[i].log_scale[c] =
                spin_minf(spin_maxf(row[i].log_scale[c], -SCALE_LIMIT), SCALE_LIMIT);
        widen_range(range, row[i].place);
        widen_range(range + 6, row[i].log_scale);
        widen_range(range + 12, row[i].colour);
    }
    for (size_t i = 0; i < n; i++) {
        word[i][POSITION] = pack_3(row[i].place, range, range + 3);
        word[i][ROTATION] = pack_rotation(row[i].rotation);
        word[i][SCALE] = pack_3(row[i].log_scale, range + 6, range + 9);
        word[i][COLOUR] = pack_colour(&row[i], range + 12, range + 15);
    }
}

/* Byte u decodes to (u + 0.5) / 32 - 4, except for 0 and 255, which decode to exactly -4 and 4. */
static float unpack_rest(unsigned char u)
{
    return u == 0 ? -4 : u == 255 ? 4 : ((float)u + 0.5f) / 32 - 4;
}

void spin_compressed_pack_sh(const float *restrict sh, int n_sh, int sh_degree,
                             unsigned char *restrict out, float *restrict lost)
{
    int n = spin_sh_count(sh_degree), at = 0;

    for (int c = 0; c < 3; c++) {
        for (int k = 1; k < n; k++, at++) {
            float v = k < n_sh ? sh[3 * k + c] : 0;

            out[at] = (unsigned char)spin_minf(spin_maxf((v / 8 + 0.5f) * 256, 0), 255);
            lost[at] = v - unpack_rest(out[at]);
        }
    }
}

uint64_t spin_compressed_body(int sh_degree, size_t n)
{
    return spin_compressed_chunks(n) * SPIN_COMPRESSED_RANGES * sizeof(float) +
           (uint64_t)n * (SPIN_COMPRESSED_VERTEX + spin_n_rest(sh_degree));
}

size_t spin_compressed_header(int sh_degree, size_t n, const char *comments,
                              char text[SPIN_GS_PLY_MAX_HEADER])
{
    const size_t room = SPIN_GS_PLY_MAX_HEADER;
    size_t n_rest = spin_n_rest(sh_degree);
    size_t at =
        (size_t)snprintf(text, room, "ply\nformat binary_little_endian 1.0\n%selement chunk %zu\n",
                         comments, spin_compressed_chunks(n));

    for (int i = 0; i < SPIN_COMPRESSED_RANGES; i++)
        at += (size_t)snprintf(text + at, room - at, "property float %s\n", range_names[i]);
    at += (size_t)snprintf(text + at, room - at, "element vertex %zu\n", n);
    for (int i = 0; i < 4; i++)
        at += (size_t)snprintf(text + at, room - at, "property uint %s\n", packed_names[i]);
    if (n_rest > 0)
        at += (size_t)snprintf(text + at, room - at, "element sh %zu\n", n);
    for (size_t i = 0; i < n_rest; i++)
        at += (size_t)snprintf(text + at, room - at, "property uchar f_rest_%zu\n", i);
    return at + (size_t)snprintf(text + at, room - at, "end_header\n");
}

/* ---- Unpacking ------------------------------------------------------------------------------- */

static float lerp(float low, float high, uint32_t code, uint32_t largest)
{
    float t = (float)code / (float)largest;

    return low * (1 - t) + high * t;
}

/* Dequantises three numbers of 11, 10 and 11 bits. */
static void unpack_3(uint32_t v, const float *low, const float *high, float out[3])
{
    out[0] = lerp(low[0], high[0], v >> 21, 2047);
    out[1] = lerp(low[1], high[1], v >> 11 & 1023, 1023);
    out[2] = lerp(low[2], high[2], v & 2047, 2047);
}

static void unpack_rotation(uint32_t v, float q[4])
{
    int largest = (int)(v >> 30), shift = 20;
    double rest = 1;

    for (int i = 0; i < 4; i++) {
        double x;

        if (i == largest)
            continue;
        x = ((v >> shift & 1023) / 1023.0 - 0.5) * sqrt(2.0);
        q[i] = (float)x;
        rest -= x * x;
        shift -= 10;
    }
    q[largest] = (float)sqrt(rest > 0 ? rest : 0);
}

static void unpack_colour(uint32_t v, const float *low, const float *high, float out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] = lerp(low[c], high[c], v >> (24 - 8 * c) & 255, 255);
}

void spin_compressed_unpack(const uint32_t word[4], const float range[SPIN_COMPRESSED_RANGES],
                            struct spin_gaussian *out)
{
    unpack_3(word[POSITION], range, range + 3, out->place);
    unpack_rotation(word[ROTATION], out->rotation);
    unpack_3(word[SCALE], range + 6, range + 9, out->log_scale);
    unpack_colour(word[COLOUR], range + 12, range + 15, out->colour);
    out->opacity = (float)(word[COLOUR] & 255) / 255;
}

/* ---- Parsing the header ---------------------------------------------------------------------- */

bool spin_compressed_any(const struct spin_ply_element *vertex)
{
    return spin_ply_has_prefix(vertex, "packed_");
}

static spin_status check_chunks(const struct spin_compressed_ply *f)
{
    uint64_t n = f->vertex->count;

    if (!f->chunk || f->chunk->count < spin_compressed_chunks(n))
        return spin_malformed(
            "'%s': compressed PLY: %llu chunks for %llu vertices, expected one per %d vertices",
            f->ply->path, (unsigned long long)(f->chunk ? f->chunk->count : 0),
            (unsigned long long)n, SPIN_COMPRESSED_CHUNK);
    for (int i = 0; i < N_RANGES_NEEDED; i++) {
        if (!spin_ply_has(f->chunk, range_names[i]))
            return spin_malformed("'%s': element 'chunk' has no property '%s'", f->ply->path,
                                  range_names[i]);
    }
    return SPIN_OK;
}

static spin_status check_sh(const struct spin_compressed_ply *f)
{
    if (f->sh && f->sh->count != f->vertex->count)
        return spin_malformed("'%s': element 'sh' has %llu rows, element 'vertex' has %llu",
                              f->ply->path, (unsigned long long)f->sh->count,
                              (unsigned long long)f->vertex->count);
    for (size_t i = 0; f->sh && i < f->sh->n_properties; i++) {
        if (f->sh->property[i].type != SPIN_PLY_U8)
            return spin_malformed("'%s': element 'sh': property '%s' is not of type uchar",
                                  f->ply->path, f->sh->property[i].name);
    }
    return SPIN_OK;
}

spin_status spin_compressed_find(const struct spin_ply *ply, struct spin_compressed_ply *out)
{
    const struct spin_ply_element *e;

    SPIN_TRY(spin_ply_vertices(ply, &e));
    *out = (struct spin_compressed_ply){.ply = ply,
                                        .vertex = e,
                                        .chunk = spin_ply_find_element(ply, "chunk"),
                                        .sh = spin_ply_find_element(ply, "sh")};
    if (ply->ascii || e->has_list)
        return spin_unsupported(
            "'%s': a compressed PLY must be binary, without lists in element 'vertex'", ply->path);
    for (int i = 0; i < 4; i++) {
        int p = out->packed[i] = spin_ply_find(e, packed_names[i]);

        if (p < 0 || e->property[p].type != SPIN_PLY_U32)
            return spin_malformed("'%s': compressed PLY: element 'vertex' has no property '%s' of "
                                  "type uint",
                                  ply->path, packed_names[i]);
    }
    SPIN_TRY(check_chunks(out));
    SPIN_TRY(check_sh(out));
    return spin_gs_ply_degree(ply, out->sh, &out->sh_degree, &out->n_rest);
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Allocates *out with the shape [chunks][SPIN_COMPRESSED_RANGES], and reads the ranges. If the file
 * has no colour ranges, they are set to 0..1. */
static spin_status read_ranges(const struct spin_compressed_ply *f, float **out)
{
    size_t n = (size_t)f->chunk->count;
    bool ranged = true;

    SPIN_TRY(spin_alloc(n, SPIN_COMPRESSED_RANGES * sizeof(float), (void **)out));
    for (int i = 0; i < SPIN_COMPRESSED_RANGES; i++) {
        int p = spin_ply_find(f->chunk, range_names[i]);

        if (p >= 0)
            spin_ply_column(f->ply, f->chunk, p, *out + i, SPIN_COMPRESSED_RANGES);
        ranged = ranged && p >= 0;
    }
    for (size_t i = 0; i < n && !ranged; i++)
        for (int c = 0; c < 3; c++) {
            (*out)[i * SPIN_COMPRESSED_RANGES + 12 + (size_t)c] = 0;
            (*out)[i * SPIN_COMPRESSED_RANGES + 15 + (size_t)c] = 1;
        }
    return SPIN_OK;
}

static uint32_t packed_at(const struct spin_compressed_ply *f, int which, size_t row)
{
    const unsigned char *b = f->ply->map.data + f->vertex->data_offset + row * f->vertex->stride +
                             f->vertex->property[f->packed[which]].offset;

    return f->ply->big_endian ? __builtin_bswap32(spin_u32_at(b)) : spin_u32_at(b);
}

static void read_row(const struct spin_compressed_ply *f, const float *range, unsigned columns,
                     size_t i, struct spin_splats *out)
{
    size_t step = 3 * (size_t)spin_sh_count(out->sh_degree);
    uint32_t colour = packed_at(f, COLOUR, i);
    float shown[3];

    if (columns & SPIN_COL_MEANS)
        unpack_3(packed_at(f, POSITION, i), range, range + 3, out->means + 3 * i);
    if (columns & SPIN_COL_QUATS) {
        unpack_rotation(packed_at(f, ROTATION, i), out->quats + 4 * i);
        spin_quat_normalise(out->quats + 4 * i);
    }
    if (columns & SPIN_COL_LOG_SCALES)
        unpack_3(packed_at(f, SCALE, i), range + 6, range + 9, out->log_scales + 3 * i);
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        out->logit_opacities[i] = spin_byte_logit((unsigned char)colour);
    if (columns & SPIN_COL_SH) {
        float *sh = out->sh + i * step;
        int kept = 3 * spin_sh_count(f->sh_degree);

        unpack_colour(colour, range + 12, range + 15, shown);
        for (int c = 0; c < 3; c++)
            sh[c] = (float)((shown[c] - 0.5) / SPIN_SH_C0);
        for (int k = 3; k < kept; k++)
            sh[k] = unpack_rest((unsigned char)sh[k]);
    }
}

spin_status spin_compressed_read(const struct spin_compressed_ply *file, unsigned columns,
                                 struct spin_splats *out)
{
    size_t step = 3 * (size_t)spin_sh_count(out->sh_degree), n = (size_t)file->vertex->count;
    SPIN_FREED float *range = NULL;
    spin_status status = read_ranges(file, &range);

    if (status == SPIN_OK && n > 0 && (columns & SPIN_COL_SH)) {
        memset(out->sh, 0, n * step * sizeof *out->sh);
        if (file->sh_degree > 0)
            spin_gs_ply_rest(file->ply, file->sh, file->n_rest, file->sh_degree, out->sh, step);
    }
    for (size_t i = 0; i < n && status == SPIN_OK; i++)
        read_row(file, range + i / SPIN_COMPRESSED_CHUNK * SPIN_COMPRESSED_RANGES, columns, i, out);
    return status == SPIN_OK ? spin_ply_check(file->ply, columns, 0, n, out) : status;
}
