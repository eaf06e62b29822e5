#include "formats/spz.h"

#include "base/base.h"
#include "io/compress.h"
#include "math/portable.h"
#include "math/quat.h"
#include "math/sh.h"

#define MAGIC 0x5053474eu /* the characters "NGSP" */
#define OLDEST 2
#define IN_STREAMS 4  /* first version whose streams are compressed separately */
#define ANTIALIASED 1 /* flag in the header: the splats were trained with antialiasing */
#define EXTENDED 2    /* flag in the header: the file has extensions */
#define MAX_SH_DEGREE 4
#define AXES_RECORD 0xadbe0003u /* type of the extension record with the axes */
#define MAX_AXES 16
#define LEFT_DOWN_BACK 1
#define COLOUR_SCALE (0.15f * 255)
#define SQRT2 1.41421356237309505f
#define MAX_PLACE 8388606 /* largest absolute coordinate, in quantisation steps */
/* Typical files unpack to two or three times their size, or to ten times if SH are padded with
 * zeros. Files that would unpack to more than RATIO times their size plus RATIO_SLACK bytes are
 * refused as decompression bombs: deflate can expand one byte to 1032 bytes, zstd to far more. */
#define RATIO 32
#define RATIO_SLACK (8u << 20)
#define MAX_EXTENSIONS (1u << 20)

/* Maps the order of components in SPZ to that of spin4d: component k of x y z w is component
 * xyzw[k] of w x y z. */
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

int spin_spz_n_streams(const struct spin_spz_header *header)
{
    return header->n == 0 ? 0 : header->sh_degree == 0 ? SPIN_SPZ_SH : SPIN_SPZ_STREAMS;
}

size_t spin_spz_code_header(const struct spin_spz_header *header, unsigned char *out)
{
    bool four = header->version == IN_STREAMS;
    size_t size = four ? SPIN_SPZ_HEADER_4 : SPIN_SPZ_HEADER;
    uint32_t word[5] = {MAGIC, (uint32_t)header->version, (uint32_t)header->n, 0,
                        SPIN_SPZ_HEADER_4};

    memset(out, 0, size);
    spin_little_endian(word, 5);
    memcpy(out, word, four ? sizeof word : 3 * sizeof *word);
    out[12] = (unsigned char)header->sh_degree;
    out[13] = (unsigned char)header->fraction;
    out[14] = header->antialias ? ANTIALIASED : 0;
    out[15] = four ? (unsigned char)spin_spz_n_streams(header) : 0;
    return size;
}

void spin_spz_code_toc_entry(uint64_t packed, uint64_t bytes, unsigned char out[SPIN_SPZ_TOC_ENTRY])
{
    for (int b = 0; b < 8; b++) {
        out[b] = (unsigned char)(packed >> (8 * b));
        out[8 + b] = (unsigned char)(bytes >> (8 * b));
    }
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

/* ---- The header ------------------------------------------------------------------------------ */

static uint64_t u64_at(const unsigned char *at)
{
    return spin_u32_at(at) | (uint64_t)spin_u32_at(at + 4) << 32;
}

/* Returns the size of a stream in bytes, before compression. */
static uint64_t stream_bytes(const struct spin_spz_header *h, int stream)
{
    bool three = stream == SPIN_SPZ_ROTATION && h->version == OLDEST;

    return (uint64_t)h->n * (three ? 3 : spin_spz_width(stream, h->sh_degree));
}

static uint64_t all_bytes(const struct spin_spz_header *h)
{
    uint64_t sum = 0;

    for (int stream = 0; stream < SPIN_SPZ_STREAMS; stream++)
        sum += stream_bytes(h, stream);
    return sum;
}

/* Parses the first 16 bytes, which are the same in all versions. */
static spin_status parse_header(const unsigned char *bytes, struct spin_spz_header *out)
{
    *out = (struct spin_spz_header){.version = (int)spin_u32_at(bytes + 4),
                                    .n = spin_u32_at(bytes + 8),
                                    .sh_degree = bytes[12],
                                    .fraction = bytes[13],
                                    .antialias = bytes[14] & ANTIALIASED};
    if (out->version < OLDEST || out->version > IN_STREAMS)
        return spin_unsupported("SPZ: version %u, expected %d to %d", spin_u32_at(bytes + 4),
                                OLDEST, IN_STREAMS);
    if (bytes[14] & ~(ANTIALIASED | EXTENDED))
        return spin_unsupported(
            "SPZ: unknown flags %02x, which may change how the file must be read",
            bytes[14] & ~(ANTIALIASED | EXTENDED));
    if (out->sh_degree > MAX_SH_DEGREE)
        return spin_unsupported("SPZ: SH degree %d, expected 0 to %d", out->sh_degree,
                                MAX_SH_DEGREE);
    return SPIN_OK;
}

/* Refuses a file that declares too many splats for its size, which would be a decompression bomb.
 */
static spin_status check_count(const struct spin_spz_header *h, size_t size)
{
    if (all_bytes(h) > RATIO_SLACK + (uint64_t)RATIO * size)
        return spin_malformed("SPZ: a file of %zu bytes cannot contain %zu splats", size, h->n);
    return SPIN_OK;
}

/* Reads extension records: a type, a length, and content of this length. Skips unknown types. */
static spin_status read_extensions(const unsigned char *at, size_t n, struct spin_spz_header *out)
{
    while (n > 0) {
        uint32_t length = n >= 8 ? spin_u32_at(at + 4) : 0;

        if (n < 8 || length > n - 8)
            return spin_malformed("SPZ: truncated within an extension");
        if (spin_u32_at(at) == AXES_RECORD) {
            if (length != 4 || spin_u32_at(at + 8) > MAX_AXES)
                return spin_unsupported("SPZ: the extension for axes has an unknown value");
            out->axes = (int)spin_u32_at(at + 8);
        }
        at += 8 + length;
        n -= 8 + length;
    }
    return SPIN_OK;
}

/* Checks a file of version 4: the table of contents must list all streams that are not empty, in
 * order, and the last stream must end at the end of the file. Reads the extensions. */
static spin_status check_streams(const unsigned char *file, size_t size, struct spin_spz_header *h)
{
    uint32_t toc = spin_u32_at(file + 16);
    uint64_t at = (uint64_t)toc + (uint64_t)file[15] * SPIN_SPZ_TOC_ENTRY;
    int entry = 0;

    if (toc < SPIN_SPZ_HEADER_4 || at > size)
        return spin_malformed("SPZ: the table of contents extends beyond the file");
    for (int stream = 0; stream < SPIN_SPZ_STREAMS; stream++) {
        uint64_t bytes = stream_bytes(h, stream);
        const unsigned char *e = file + toc + SPIN_SPZ_TOC_ENTRY * entry;

        if (bytes == 0)
            continue;
        if (entry++ >= file[15] || u64_at(e + 8) != bytes)
            return spin_malformed("SPZ: the size of stream %d does not match %zu splats", stream,
                                  h->n);
        if (u64_at(e) > size - at)
            return spin_malformed("SPZ: stream %d extends beyond the file", stream);
        at += u64_at(e);
    }
    if (entry != file[15] || at != size)
        return spin_malformed("SPZ: there are extra streams or bytes after the last stream");
    SPIN_TRY(check_count(h, size));
    return file[14] & EXTENDED
               ? read_extensions(file + SPIN_SPZ_HEADER_4, toc - SPIN_SPZ_HEADER_4, h)
               : SPIN_OK;
}

/* Returns the size in bytes of the extensions of a file of version 2 or 3 that is compressed with
 * gzip: the unpacked length minus header and streams. The result is modulo 2^32, like the unpacked
 * length that the last bytes of a gzip file contain. */
static uint32_t extension_bytes(const void *file, size_t size, const struct spin_spz_header *h)
{
    return spin_gzip_length(file, size) - (uint32_t)(SPIN_SPZ_HEADER + all_bytes(h));
}

/* Allocates *out, and decompresses to it a whole file of version 2 or 3 that is compressed with
 * gzip. */
static spin_status inflate_all(const void *file, size_t size, const struct spin_spz_header *h,
                               unsigned char **out, size_t *n_out)
{
    size_t n_bytes = SPIN_SPZ_HEADER + (size_t)all_bytes(h) + extension_bytes(file, size, h);

    SPIN_TRY(spin_alloc(n_bytes + 1, 1, (void **)out));
    SPIN_TRY(spin_gzip_read(file, size, *out, n_bytes + 1, n_out));
    if (*n_out != n_bytes)
        return spin_malformed("SPZ: %zu splats take %zu bytes, but the file unpacks to %zu", h->n,
                              n_bytes, *n_out);
    return SPIN_OK;
}

static spin_status peek_gzip(const void *file, size_t size, struct spin_spz_header *out)
{
    unsigned char header[SPIN_SPZ_HEADER];
    SPIN_FREED unsigned char *all = NULL;
    size_t n = 0, n_streams;
    uint32_t n_extensions;

    SPIN_TRY(spin_gzip_read(file, size, header, sizeof header, &n));
    if (n < sizeof header || spin_u32_at(header) != MAGIC)
        return spin_malformed("SPZ: the header is missing");
    SPIN_TRY(parse_header(header, out));
    if (out->version == IN_STREAMS)
        return spin_malformed("SPZ: version %d must not be compressed by gzip", IN_STREAMS);
    SPIN_TRY(check_count(out, size));
    n_streams = (size_t)all_bytes(out);
    n_extensions = extension_bytes(file, size, out);
    if (n_extensions > (header[14] & EXTENDED ? MAX_EXTENSIONS : 0))
        return spin_malformed("SPZ: %zu splats take %zu bytes, but the file unpacks to %u", out->n,
                              SPIN_SPZ_HEADER + n_streams, spin_gzip_length(file, size));
    if (n_extensions == 0)
        return SPIN_OK;
    SPIN_TRY(inflate_all(file, size, out, &all, &n));
    return read_extensions(all + n - n_extensions, n_extensions, out);
}

/* Checks the length of a file of version 2 or 3 that is not compressed, and reads its extensions.
 */
static spin_status check_plain(const unsigned char *file, size_t size, struct spin_spz_header *h)
{
    uint64_t n = SPIN_SPZ_HEADER + all_bytes(h);

    if (n > size || (n < size && !(file[14] & EXTENDED)))
        return spin_malformed("SPZ: %zu splats take %llu bytes, but the file has %zu", h->n,
                              (unsigned long long)n, size);
    return read_extensions(file + n, size - (size_t)n, h);
}

spin_status spin_spz_peek(const void *file, size_t size, struct spin_spz_header *out)
{
    if (size < 4 || spin_u32_at(file) != MAGIC)
        return peek_gzip(file, size, out);
    if (size < SPIN_SPZ_HEADER)
        return spin_malformed("SPZ: truncated within the header");
    SPIN_TRY(parse_header(file, out));
    if (out->version != IN_STREAMS)
        return check_plain(file, size, out);
    if (size < SPIN_SPZ_HEADER_4)
        return spin_malformed("SPZ: truncated within the header");
    return check_streams(file, size, out);
}

spin_status spin_spz_axes(int axes, double q[4])
{
    static const char *const names[MAX_AXES + 1] = {
        "unspecified", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF",
        "LFD",         "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"};
    /* about: 1, 2 or 3 if these axes need half a turn about x, y or z; 0 if they need no rotation.
     * All other axes are unsupported, since they are mirrored or need a quarter turn. */
    static const struct {
        int axes, about;
    } turns[] = {{SPIN_SPZ_RIGHT_DOWN_FORWARD, 0},
                 {SPIN_SPZ_RIGHT_UP_BACK, 1},
                 {LEFT_DOWN_BACK, 2},
                 {SPIN_SPZ_LEFT_UP_FORWARD, 3}};

    for (size_t i = 0; i < sizeof turns / sizeof *turns; i++) {
        if (turns[i].axes != axes)
            continue;
        for (int k = 0; k < 4; k++)
            q[k] = k == turns[i].about;
        return SPIN_OK;
    }
    return spin_unsupported("SPZ: the axes are %s, expected RDF, RUB, LUF or LDB", names[axes]);
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Dequantises a coordinate: a signed 24-bit integer in steps of 2^-fraction. */
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

/* Dequantises a rotation of version 2: x, y and z are stored; w is omitted and not negative. */
static void rotation_of_three(const unsigned char *at, float q[4])
{
    float rest = 1;

    for (int k = 0; k < 3; k++) {
        q[1 + k] = (float)at[k] / 127.5f - 1;
        rest -= q[1 + k] * q[1 + k];
    }
    q[0] = sqrtf(spin_maxf(rest, 0));
    spin_quat_normalise(q);
}

/* Dequantises all streams with the formulas of Niantic's library. place: the unpacked streams,
 * which are contiguous; the first contains the positions. */
static void read_streams(const struct spin_spz_header *h, const unsigned char *place,
                         unsigned columns, struct spin_splats *out)
{
    size_t n = h->n, n_rest = spin_n_rest(h->sh_degree), n_kept = spin_n_rest(out->sh_degree);
    const unsigned char *alpha = place + 9 * n, *colour = alpha + n, *scale = colour + 3 * n;
    const unsigned char *rotation = scale + 3 * n;
    const unsigned char *sh = rotation + stream_bytes(h, SPIN_SPZ_ROTATION);

    for (size_t i = 0; i < 3 * n && (columns & SPIN_COL_MEANS); i++)
        out->means[i] = place_of(place + 3 * i, h->fraction);
    for (size_t i = 0; i < n && (columns & SPIN_COL_LOGIT_OPACITIES); i++)
        out->logit_opacities[i] = spin_byte_logit(alpha[i]);
    for (size_t i = 0; i < 3 * n && (columns & SPIN_COL_LOG_SCALES); i++)
        out->log_scales[i] = (float)scale[i] / 16 - 10;
    for (size_t i = 0; i < n && (columns & SPIN_COL_QUATS); i++) {
        if (h->version == OLDEST)
            rotation_of_three(rotation + 3 * i, out->quats + 4 * i);
        else
            rotation_of(rotation + 4 * i, out->quats + 4 * i);
    }
    for (size_t i = 0; i < n && (columns & SPIN_COL_SH); i++) {
        float *to = out->sh + (3 + n_kept) * i;

        for (size_t c = 0; c < 3; c++)
            to[c] = ((float)colour[3 * i + c] - 127.5f) / COLOUR_SCALE;
        for (size_t k = 0; k < n_kept; k++)
            to[3 + k] = ((float)sh[n_rest * i + k] - 128) / 128;
    }
}

/* Allocates *out, and decompresses to it all streams of a file of version 4, one after the other.
 */
static spin_status inflate_streams(const unsigned char *file, const struct spin_spz_header *h,
                                   unsigned char **out)
{
    const unsigned char *entry = file + spin_u32_at(file + 16),
                        *at = entry + file[15] * SPIN_SPZ_TOC_ENTRY;
    unsigned char *to;

    SPIN_TRY(spin_alloc((size_t)all_bytes(h) + 1, 1, (void **)out));
    to = *out;
    for (int stream = 0; stream < SPIN_SPZ_STREAMS; stream++) {
        size_t n_bytes = (size_t)stream_bytes(h, stream);

        if (n_bytes == 0)
            continue;
        SPIN_TRY_IN(spin_zstd_read(at, (size_t)u64_at(entry), to, n_bytes), "SPZ: stream %d",
                    stream);
        to += n_bytes;
        at += u64_at(entry);
        entry += SPIN_SPZ_TOC_ENTRY;
    }
    return SPIN_OK;
}

spin_status spin_spz_read(const void *file, size_t size, unsigned columns, struct spin_splats *out)
{
    struct spin_spz_header header;
    const unsigned char *streams = file;
    SPIN_FREED unsigned char *bytes = NULL;
    size_t n = 0;

    SPIN_TRY(spin_spz_peek(file, size, &header));
    if (header.version == IN_STREAMS)
        SPIN_TRY(inflate_streams(file, &header, &bytes));
    else if (spin_u32_at(streams) != MAGIC)
        SPIN_TRY(inflate_all(file, size, &header, &bytes, &n));
    if (bytes)
        streams = bytes;
    if (header.version != IN_STREAMS)
        streams += SPIN_SPZ_HEADER;
    SPIN_TRY(
        spin_splats_reserve(out, header.n, columns, header.sh_degree < 3 ? header.sh_degree : 3));
    out->antialias = header.antialias;
    read_streams(&header, streams, columns, out);
    return SPIN_OK;
}
