#include "formats/splat4d.h"

#include "base/base.h"
#include "formats/gaussian.h"
#include "formats/planes.h"
#include "io/compress.h"
#include "io/json.h"
#include "math/quat.h"
#include "math/sh.h"

#define HEADER 12
#define STREAM_HEAD 11
#define SMOOTHED 1 /* flag in the header: colours were smoothed over time */
/* Bytes of a row before compression: 3 for pos, 4 for rot, 3 for rgb, 1 for alpha, 3 for scale. */
#define ROW_BYTES 14
#define MAX_FRAMES 1000000
/* Limits against decompression bombs. A file is refused if the uncompressed rows of all splats have
 * more than SLACK bytes plus ROW_RATIO times the size of the static section, or if a stream would
 * unpack to more than SLACK bytes plus RATIO times its compressed size. ROW_RATIO is smaller since
 * rows of the static section compress badly: no two splats share a position. Differences between
 * frames compress well if splats hardly move. */
#define ROW_RATIO 32
#define RATIO 1000
#define SLACK (1u << 20)

/* Values in stream headers: attributes, and kinds of streams. */
enum { POS, ROT, RGB, ALPHA, SCALE };
enum { KEY, CHANGE, STATIC };

static const struct {
    const char *name;
    size_t width;
    unsigned column;
    /* Keys in the JSON: the quantisation step of dynamic rows, and that of static rows. If
     * base_step is NULL, the step of static rows is 1. */
    const char *step, *base_step;
} attributes[SPIN_SPLAT4D_ATTRIBUTES] = {
    [POS] = {"pos", 3, SPIN_COL_MEANS, "pos", "base_pos"},
    [ROT] = {"rot", 4, SPIN_COL_QUATS, "rot", NULL},
    [RGB] = {"rgb", 3, SPIN_COL_SH, "rgb", NULL},
    [ALPHA] = {"alpha", 1, SPIN_COL_LOGIT_OPACITIES, "alpha", NULL},
    [SCALE] = {"scale", 3, SPIN_COL_LOG_SCALES, "scale_log", "base_scale_log"},
};

struct spin_splat4d_group {
    size_t at, bytes;
    int first, last; /* indices of the first and the last frame */
};

/* ---- The header ------------------------------------------------------------------------------ */

static spin_status check_start(const unsigned char *file, size_t size)
{
    if (size >= 8 && memcmp(file, "SPL4DV02", 8) == 0)
        return spin_unsupported(".splat4d of gsplat-unity (version 2) is another format, which is "
                                "not supported");
    if (size < HEADER || memcmp(file, "SP4D", 4) != 0)
        return spin_malformed(".splat4d: the header is missing (files of gsplat-unity, version 1, "
                              "have none and are not supported)");
    if (file[4] != 1 || file[5] != 0)
        return spin_unsupported(".splat4d: version %d, expected 1", file[4] | file[5] << 8);
    if ((file[6] & ~SMOOTHED) != 0 || file[7] != 0)
        return spin_unsupported(".splat4d: unknown flags %04x, which may change its meaning",
                                (unsigned)(file[6] | file[7] << 8));
    if (spin_u32_at(file + 8) > size - HEADER)
        return spin_malformed(".splat4d: truncated within the header");
    return SPIN_OK;
}

static spin_status read_integer(const spin_json *object, const char *key, int64_t least,
                                int64_t most, int64_t *out)
{
    if (!spin_json_integer(spin_json_get(object, key), out) || *out < least || *out > most)
        return spin_malformed("header: '%s' is not an integer from %lld to %lld", key,
                              (long long)least, (long long)most);
    return SPIN_OK;
}

static spin_status read_positive(const spin_json *object, const char *key, double *out)
{
    if (!spin_json_number(spin_json_get(object, key), out) || !isfinite(*out) || *out <= 0)
        return spin_malformed("header: '%s' is not a positive number", key);
    return SPIN_OK;
}

static spin_status read_extent(const struct spin_splat4d *clip, const spin_json *object, size_t *at,
                               size_t *bytes)
{
    int64_t offset, length;

    SPIN_TRY(read_integer(object, "offset", 0, (int64_t)clip->size, &offset));
    SPIN_TRY(read_integer(object, "len", 0, (int64_t)clip->size - offset, &length));
    *at = (size_t)offset;
    *bytes = (size_t)length;
    return SPIN_OK;
}

/* Reads the list of groups, and checks that the groups contain all frames in order and do not
 * overlap in the file. */
static spin_status read_groups(const spin_json *json, struct spin_splat4d *out)
{
    const spin_json *groups = spin_json_get(json, "gops");
    int64_t first, next = 0, last;
    size_t end = 0;

    out->n_groups = spin_json_length(groups);
    SPIN_TRY(spin_alloc(out->n_groups, sizeof *out->groups, (void **)&out->groups));
    for (size_t g = 0; g < out->n_groups; g++, next = last + 1) {
        struct spin_splat4d_group *group = &out->groups[g];
        const spin_json *object = spin_json_at(groups, g);

        SPIN_TRY(read_extent(out, object, &group->at, &group->bytes));
        if (group->at < end)
            return spin_malformed("header: group %zu overlaps with group %zu", g, g - 1);
        end = group->at + group->bytes;
        SPIN_TRY(read_integer(object, "f0", next, next, &first));
        SPIN_TRY(read_integer(object, "f1", first, out->n_frames - 1, &last));
        group->first = (int)first;
        group->last = (int)last;
    }
    if (next != out->n_frames)
        return spin_malformed(
            "header: the groups in 'gops' contain %lld frames, but 't' declares %d",
            (long long)next, out->n_frames);
    return SPIN_OK;
}

static spin_status read_header(const spin_json *json, struct spin_splat4d *out)
{
    const spin_json *steps = spin_json_get(json, "steps");
    int64_t n, n_frames;

    SPIN_TRY(read_integer(json, "n", 1, UINT32_MAX, &n));
    SPIN_TRY(read_integer(json, "t", 1, MAX_FRAMES, &n_frames));
    SPIN_TRY(read_positive(json, "fps", &out->fps));
    out->n = (size_t)n;
    out->n_frames = (int)n_frames;
    for (int a = 0; a < SPIN_SPLAT4D_ATTRIBUTES; a++) {
        struct spin_splat4d_attribute *to = &out->attribute[a];

        to->base_step = 1;
        SPIN_TRY(read_positive(steps, attributes[a].step, &to->step));
        if (attributes[a].base_step)
            SPIN_TRY(read_positive(steps, attributes[a].base_step, &to->base_step));
    }
    SPIN_TRY(read_extent(out, spin_json_get(json, "static_section"), &out->static_at,
                         &out->static_bytes));
    if ((uint64_t)out->n * ROW_BYTES > SLACK + (uint64_t)ROW_RATIO * out->static_bytes)
        return spin_malformed("header: a static section of %zu bytes cannot contain %zu splats",
                              out->static_bytes, out->n);
    return read_groups(json, out);
}

/* ---- Streams --------------------------------------------------------------------------------- */

struct stream {
    int attribute, kind, symbol;
    size_t n, bytes; /* number of symbols, compressed size in bytes */
};

static struct stream parse_stream_head(const unsigned char *head)
{
    return (struct stream){head[0], head[1], head[2], spin_u32_at(head + 3), spin_u32_at(head + 7)};
}

/* Allocates *out and decompresses the byte planes of a stream, which must have n symbols. room:
 * number of bytes from `packed` to the end of the section. */
static spin_status decompress_stream(const struct stream *s, const unsigned char *packed,
                                     size_t room, uint64_t n, unsigned char **out)
{
    const char *name = attributes[s->attribute].name;
    uint64_t bytes = (uint64_t)s->n * (unsigned)s->symbol;

    if (s->bytes > room)
        return spin_malformed("stream '%s' extends beyond its section", name);
    if (s->n != n)
        return spin_malformed("stream '%s' has %zu values, expected %llu", name, s->n,
                              (unsigned long long)n);
    if (s->symbol != 1 && s->symbol != 2 && s->symbol != 4)
        return spin_malformed("stream '%s' has symbols of %d bytes, expected 1, 2 or 4", name,
                              s->symbol);
    if (bytes > SLACK + (uint64_t)RATIO * s->bytes)
        return spin_malformed("stream '%s': %zu compressed bytes cannot unpack to %llu bytes", name,
                              s->bytes, (unsigned long long)bytes);
    SPIN_TRY(spin_alloc((size_t)bytes + 1, 1, (void **)out));
    return spin_fail_context(spin_zstd_read(packed, s->bytes, *out, (size_t)bytes), "stream '%s'",
                             name);
}

/* ---- Values ---------------------------------------------------------------------------------- */

static float byte_value(double v) { return (float)(v > 0 ? v < 255 ? v : 255 : 0) / 255; }

/* Dequantises one row of an attribute and converts it to the representation of struct
 * spin_splats. */
static void dequantise_row(int attribute, const int32_t *steps, double step, float *out)
{
    for (size_t c = 0; c < attributes[attribute].width; c++) {
        double v = steps[c] * step;

        out[c] = attribute == RGB     ? (byte_value(v) - 0.5f) / (float)SPIN_SH_C0
                 : attribute == ALPHA ? spin_opacity_logit(byte_value(v))
                                      : (float)v;
    }
    if (attribute == ROT && isfinite(spin_quat_norm(out)))
        spin_quat_normalise(out);
}

/* ---- The static section ---------------------------------------------------------------------- */

/* Reads the stream at offset *at of the static section, and advances *at to the end of the stream.
 * Fails if the stream is not of the given attribute. */
static spin_status read_static_stream(const struct spin_splat4d *clip, size_t *at, int attribute,
                                      uint64_t n, struct stream *s, unsigned char **planes)
{
    const unsigned char *section = clip->file + clip->static_at;

    if (clip->static_bytes - *at < STREAM_HEAD)
        return spin_malformed("the static section ends before stream '%s'",
                              attributes[attribute].name);
    *s = parse_stream_head(section + *at);
    *at += STREAM_HEAD;
    if (s->attribute != attribute || s->kind != STATIC)
        return spin_malformed("the static section contains another stream instead of '%s'",
                              attributes[attribute].name);
    SPIN_TRY(decompress_stream(s, section + *at, clip->static_bytes - *at, n, planes));
    *at += s->bytes;
    return SPIN_OK;
}

/* Lists the dynamic rows of an attribute: those whose bit is 0, highest bit of a byte first. */
static spin_status read_mask(struct spin_splat4d *clip, int attribute, const struct stream *s,
                             const unsigned char *bits)
{
    struct spin_splat4d_attribute *a = &clip->attribute[attribute];

    if (s->symbol != 1)
        return spin_malformed("the bit stream of '%s' has symbols of %d bytes, expected 1",
                              attributes[attribute].name, s->symbol);
    for (int store = 0; store < 2; store++) {
        a->n_moving = 0;
        for (size_t i = 0; i < clip->n; i++) {
            if (bits[i / 8] << i % 8 & 128)
                continue;
            if (store)
                a->row[a->n_moving] = (uint32_t)i;
            a->n_moving++;
        }
        if (!store)
            SPIN_TRY(spin_alloc(a->n_moving, sizeof *a->row, (void **)&a->row));
    }
    clip->moving |= a->n_moving > 0 ? attributes[attribute].column : 0;
    return spin_alloc(a->n_moving * attributes[attribute].width, sizeof *a->held,
                      (void **)&a->held);
}

/* Reads the stream with the static values of an attribute into `base`. Positions and scales are
 * stored as differences from the previous row, rotations with an offset of 128. */
static spin_status read_base(struct spin_splat4d *clip, int attribute, const struct stream *s,
                             const unsigned char *planes)
{
    struct spin_splat4d_attribute *a = &clip->attribute[attribute];
    size_t width = attributes[attribute].width;
    int32_t steps[4] = {0};

    SPIN_TRY(spin_alloc(clip->n * width, sizeof *a->base, (void **)&a->base));
    for (size_t i = 0; i < clip->n; i++) {
        for (size_t c = 0; c < width; c++) {
            uint32_t symbol = spin_plane_symbol(planes, s->symbol, s->n, width * i + c);

            if (attribute == POS || attribute == SCALE)
                steps[c] = (int32_t)((uint32_t)steps[c] + (uint32_t)spin_unzigzag(symbol));
            else
                steps[c] = (int32_t)(symbol - (attribute == ROT ? 128 : 0));
        }
        dequantise_row(attribute, steps, a->base_step, a->base + width * i);
    }
    return SPIN_OK;
}

static spin_status read_static(struct spin_splat4d *clip)
{
    static const int bases[SPIN_SPLAT4D_ATTRIBUTES] = {POS, SCALE, RGB, ALPHA, ROT};
    size_t at = 0;

    for (int k = 0; k < 2 * SPIN_SPLAT4D_ATTRIBUTES; k++) {
        bool mask = k < SPIN_SPLAT4D_ATTRIBUTES;
        int a = mask ? k : bases[k - SPIN_SPLAT4D_ATTRIBUTES];
        uint64_t n = mask ? (clip->n + 7) / 8 : (uint64_t)clip->n * attributes[a].width;
        unsigned char *planes = NULL;
        struct stream s;
        spin_status status = read_static_stream(clip, &at, a, n, &s, &planes);

        if (status == SPIN_OK)
            status = (mask ? read_mask : read_base)(clip, a, &s, planes);
        free(planes);
        SPIN_TRY(status);
    }
    if (at != clip->static_bytes)
        return spin_malformed("the static section has extra bytes after its streams");
    return SPIN_OK;
}

/* ---- Groups ---------------------------------------------------------------------------------- */

static void free_group(struct spin_splat4d *clip)
{
    for (int a = 0; a < SPIN_SPLAT4D_ATTRIBUTES; a++) {
        for (int kind = KEY; kind <= CHANGE; kind++) {
            free(clip->attribute[a].planes[kind]);
            clip->attribute[a].planes[kind] = NULL;
        }
    }
    clip->group = SIZE_MAX;
}

static uint64_t n_symbols(const struct spin_splat4d *clip, size_t group, int attribute, int kind)
{
    const struct spin_splat4d_group *g = &clip->groups[group];

    return (uint64_t)clip->attribute[attribute].n_moving * attributes[attribute].width *
           (kind == KEY ? 1 : (uint64_t)(g->last - g->first));
}

static spin_status unpack_group(struct spin_splat4d *clip, size_t group)
{
    const struct spin_splat4d_group *g = &clip->groups[group];
    const unsigned char *section = clip->file + g->at;
    size_t n = g->bytes < 2 ? 0 : section[0] | (size_t)section[1] << 8;
    size_t at = 2 + STREAM_HEAD * n;

    if (at > g->bytes)
        return spin_malformed("truncated within the headers of the streams");
    for (size_t i = 0; i < n; i++) {
        struct stream s = parse_stream_head(section + 2 + STREAM_HEAD * i);

        if (s.attribute >= SPIN_SPLAT4D_ATTRIBUTES || s.kind > CHANGE ||
            clip->attribute[s.attribute].planes[s.kind])
            return spin_malformed("stream %zu (attribute %d, kind %d) is invalid or occurs twice",
                                  i, s.attribute, s.kind);
        SPIN_TRY(decompress_stream(&s, section + at, g->bytes - at,
                                   n_symbols(clip, group, s.attribute, s.kind),
                                   &clip->attribute[s.attribute].planes[s.kind]));
        clip->attribute[s.attribute].symbol[s.kind] = s.symbol;
        at += s.bytes;
    }
    for (int a = 0; a < SPIN_SPLAT4D_ATTRIBUTES; a++)
        for (int kind = KEY; kind <= CHANGE; kind++)
            if (!clip->attribute[a].planes[kind] && n_symbols(clip, group, a, kind) > 0)
                return spin_malformed("stream '%s' of kind '%s' is missing", attributes[a].name,
                                      kind == KEY ? "key" : "change");
    if (at != g->bytes)
        return spin_malformed("extra bytes after the streams");
    return SPIN_OK;
}

/* Decodes a frame into `held`: the first frame of the unpacked group if `first` is true, otherwise
 * the frame after clip->frame. */
static void decode_frame(struct spin_splat4d *clip, bool first)
{
    const struct spin_splat4d_group *g = &clip->groups[clip->group];
    int kind = first ? KEY : CHANGE;
    size_t before = first ? 0 : (size_t)(clip->frame - g->first);

    for (int k = 0; k < SPIN_SPLAT4D_ATTRIBUTES; k++) {
        struct spin_splat4d_attribute *a = &clip->attribute[k];
        size_t n = a->n_moving * attributes[k].width, n_all;

        n_all = (size_t)n_symbols(clip, clip->group, k, kind);
        for (size_t i = 0; i < n; i++) {
            uint32_t by = (uint32_t)spin_unzigzag(
                spin_plane_symbol(a->planes[kind], a->symbol[kind], n_all, n * before + i));

            a->held[i] = (int32_t)((first ? 0 : (uint32_t)a->held[i]) + by);
        }
    }
    clip->frame = first ? g->first : clip->frame + 1;
}

static spin_status seek_frame(struct spin_splat4d *clip, int frame)
{
    size_t group = 0;

    while (clip->groups[group].last < frame)
        group++;
    if (group != clip->group) {
        spin_status status;

        free_group(clip);
        status = unpack_group(clip, group);
        if (status != SPIN_OK) {
            free_group(clip);
            return spin_fail_context(status, "group %zu", group);
        }
        clip->group = group;
        decode_frame(clip, true);
    } else if (frame < clip->frame)
        decode_frame(clip, true);
    while (clip->frame < frame)
        decode_frame(clip, false);
    return SPIN_OK;
}

/* ---- The clip -------------------------------------------------------------------------------- */

void spin_splat4d_close(struct spin_splat4d *clip)
{
    free_group(clip);
    for (int a = 0; a < SPIN_SPLAT4D_ATTRIBUTES; a++) {
        free(clip->attribute[a].base);
        free(clip->attribute[a].row);
        free(clip->attribute[a].held);
    }
    free(clip->groups);
    *clip = (struct spin_splat4d){0};
}

spin_status spin_splat4d_open(const unsigned char *file, size_t size, struct spin_splat4d *out)
{
    SPIN_LEAVES(spin_json_freed) spin_json *json = NULL;
    spin_status status;

    *out = (struct spin_splat4d){.file = file, .size = size, .group = SIZE_MAX};
    SPIN_TRY(check_start(file, size));
    out->smoothed = file[6] & SMOOTHED;
    SPIN_TRY(spin_json_parse("header", (const char *)file + HEADER, spin_u32_at(file + 8), &json));
    status = read_header(json, out);
    if (status == SPIN_OK)
        status = read_static(out);
    if (status != SPIN_OK)
        spin_splat4d_close(out);
    return status;
}

spin_status spin_splat4d_read(struct spin_splat4d *clip, int frame, unsigned columns,
                              struct spin_splats *out)
{
    static const char *const what[5] = {"pos", "rot", "scale", "alpha", "rgb"};

    if (frame < 0 || frame >= clip->n_frames)
        return spin_not_found("frame %d does not exist, expected 0 to %d", frame,
                              clip->n_frames - 1);
    SPIN_TRY(seek_frame(clip, frame));
    SPIN_TRY(spin_splats_reserve(out, clip->n, columns, 0));
    for (int k = 0; k < SPIN_SPLAT4D_ATTRIBUTES; k++) {
        float *const column[SPIN_SPLAT4D_ATTRIBUTES] = {out->means, out->quats, out->sh,
                                                        out->logit_opacities, out->log_scales};
        const struct spin_splat4d_attribute *a = &clip->attribute[k];
        size_t width = attributes[k].width;

        if (!(columns & attributes[k].column))
            continue;
        memcpy(column[k], a->base, clip->n * width * sizeof *a->base);
        for (size_t i = 0; i < a->n_moving; i++)
            dequantise_row(k, a->held + width * i, a->step, column[k] + width * a->row[i]);
    }
    return spin_check_columns(what, columns, 0, clip->n, out);
}
