/* Writes the binary container of glTF 2.0 (section 4 of the specification): a header, the JSON
 * padded with spaces, and the binary chunk. */
#include "formats/glb.h"

#include "base/base.h"
#include "base/shim.h"

enum {
    HEADER = 12,
    CHUNK_HEADER = 8,
    TOO_FAR = -1 /* error code of spin_glb_put() for the limit of 4 GiB; no errno is negative */
};
_Static_assert(SPIN_GLB_MAX_ATTRIBUTES == SPIN_GLB_SH + SPIN_SH_MAX + 1, "all have their place");
#define MAX_BYTES                                                                                  \
    UINT32_MAX /* maximum size of a file, since the format stores lengths in 32 bits */

/* ---- Rows ------------------------------------------------------------------------------------ */

static float clamp(float x) { return spin_minf(spin_maxf(x, 0), 1); }

static uint16_t u16_of(float x) { return (uint16_t)(clamp(x) * 65535 + 0.5f); }

void spin_glb_code(const struct spin_glb_clip *clip, const struct spin_gaussian *row,
                   const float *sh, int n_sh, unsigned char *const column[], size_t at)
{
    float *rotation = (float *)(void *)column[SPIN_GLB_ROTATION] + 4 * at;
    float *scale = (float *)(void *)column[SPIN_GLB_SCALE] + 3 * at;
    uint16_t *colour = (uint16_t *)(void *)column[clip->n_attributes - 1] + 4 * at;

    memcpy(column[SPIN_GLB_POSITION] + 12 * at, row->place, sizeof row->place);
    for (int k = 0; k < 4; k++)
        rotation[k] = row->rotation[(k + 1) % 4];
    for (int c = 0; c < 3; c++)
        scale[c] = expf(row->log_scale[c]);
    memcpy(column[SPIN_GLB_OPACITY] + 4 * at, &row->opacity, sizeof row->opacity);
    for (int k = 0; k < spin_sh_count(clip->sh_degree); k++) {
        float *out = (float *)(void *)column[SPIN_GLB_SH + k] + 3 * at;

        for (int c = 0; c < 3; c++)
            out[c] = k < n_sh ? sh[3 * k + c] : 0;
    }
    for (int c = 0; c < 3; c++)
        colour[c] = u16_of(spin_light_of(clamp(row->colour[c])));
    colour[3] = u16_of(row->opacity);
}

void spin_glb_order(const struct spin_glb_clip *clip, unsigned char *const column[], size_t n)
{
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    int last = clip->n_attributes - 1;

    for (int a = 0; a < last; a++)
        spin_little_endian(column[a], n * clip->width[a] / 4);
    for (size_t i = 0; i < n * clip->width[last] / 2; i++)
        ((uint16_t *)(void *)column[last])[i] =
            __builtin_bswap16(((uint16_t *)(void *)column[last])[i]);
#else
    (void)clip;
    (void)column;
    (void)n;
#endif
}

/* ---- The file -------------------------------------------------------------------------------- */

void spin_glb_begin(struct spin_glb_clip *clip)
{
    size_t n_meshes = (size_t)clip->n_frames + (clip->animated ? 1 : 0);

    clip->n_attributes = SPIN_GLB_SH + spin_sh_count(clip->sh_degree) + 1;
    clip->row = 0;
    for (int a = 0; a < clip->n_attributes; a++) {
        bool is_colour = a == clip->n_attributes - 1;

        clip->components[a] = a == SPIN_GLB_ROTATION || is_colour ? 4
                              : a == SPIN_GLB_OPACITY             ? 1
                                                                  : 3;
        clip->width[a] = (size_t)clip->components[a] * (is_colour ? 2 : 4);
        clip->row += clip->width[a];
        if (is_colour)
            snprintf(clip->name[a], SPIN_GLB_NAME, "COLOR_0");
        else
            spin_glb_attribute_name(a, clip->name[a]);
    }
    /* An upper bound on the size of the JSON: 216 bytes for the accessor, buffer view and name of
     * an attribute, with numbers of maximum length, and 768 bytes for all other text of a frame. */
    clip->room = 1024 + n_meshes * (768 + 216 * (size_t)clip->n_attributes);
}

uint64_t spin_glb_bytes(const struct spin_glb_clip *clip, uint64_t n_rows)
{
    uint64_t n = (uint64_t)clip->n_frames, n_keys = clip->animated ? 4 * (n + 1) * (1 + 3 * n) : 0;

    return HEADER + 2 * CHUNK_HEADER + clip->room + n_rows * clip->row + n_keys;
}

int spin_glb_put(const struct spin_glb_clip *clip, uint64_t at, const void *data, size_t bytes)
{
    uint64_t first = HEADER + 2 * CHUNK_HEADER + (uint64_t)clip->room;

    if (at > MAX_BYTES || bytes > MAX_BYTES || first + at + bytes > MAX_BYTES)
        return TOO_FAR;
    return spin_out_put(clip->out, first + at, data, bytes);
}

spin_status spin_glb_failed(const struct spin_glb_clip *clip, int error)
{
    if (error != TOO_FAR)
        return spin_out_failed(clip->out, error);
    return spin_unsupported("cannot write '%s': the file would exceed 4 GiB, the limit of .glb; "
                            "export fewer frames with --range, or give a folder for one .glb per "
                            "frame",
                            clip->out->path);
}

/* Writes the key frames of the animation. Key frame i is at i / fps seconds, and frame f is visible
 * from key frame f to key frame f + 1. The last key frame, n_frames, shows the last frame again;
 * otherwise the animation would end when this frame appears, and players would skip it. */
static spin_status write_keys(struct spin_glb_clip *clip)
{
    size_t n_frames = (size_t)clip->n_frames, n = n_frames + 1;
    SPIN_FREED float *key = NULL;
    int error;

    SPIN_TRY(spin_alloc(n, 3 * sizeof *key, (void **)&key));
    for (size_t i = 0; i < n; i++)
        key[i] = (float)((double)i / clip->fps);
    spin_little_endian(key, n);
    error = spin_glb_put(clip, clip->n_bytes, key, n * sizeof *key);
    clip->n_bytes += n * sizeof *key;
    for (size_t f = 0; f < n_frames && !error; f++, clip->n_bytes += 3 * n * sizeof *key) {
        for (size_t i = 0; i < 3 * n; i++)
            key[i] = i / 3 == f || (f + 1 == n_frames && i / 3 == n_frames);
        spin_little_endian(key, 3 * n);
        error = spin_glb_put(clip, clip->n_bytes, key, 3 * n * sizeof *key);
    }
    return error ? spin_glb_failed(clip, error) : SPIN_OK;
}

static void put_u32(unsigned char *at, uint64_t value)
{
    for (int i = 0; i < 4; i++)
        at[i] = (unsigned char)(value >> (8 * i));
}

/* Writes the part of the file that precedes the binary data: its header, the JSON chunk, and the
 * header of the binary chunk. */
static spin_status write_front(const struct spin_glb_clip *clip, const char *text)
{
    const char *path = clip->out->path;
    size_t n = strlen(text), room = clip->room;
    size_t n_front = HEADER + CHUNK_HEADER + room + (clip->n_bytes > 0 ? CHUNK_HEADER : 0);
    SPIN_FREED unsigned char *front = NULL;

    if (n > room)
        return spin_unsupported("cannot write '%s': the JSON takes %zu bytes, but only %zu are "
                                "reserved",
                                path, n, room);
    SPIN_TRY(spin_alloc(n_front, 1, (void **)&front));
    memcpy(front, "glTF", 4);
    put_u32(front + 4, 2);
    put_u32(front + 8, n_front + clip->n_bytes);
    put_u32(front + 12, room);
    memcpy(front + 16, "JSON", 4);
    memcpy(front + 20, text, n);
    memset(front + 20 + n, ' ', room - n);
    if (clip->n_bytes > 0) {
        put_u32(front + 20 + room, clip->n_bytes);
        memcpy(front + 24 + room, "BIN", 4);
    }
    return spin_out_write_at(clip->out, 0, front, n_front);
}

static const struct spin_glb_shim *shim;

spin_status spin_glb_can_write(void)
{
    static struct spin_shim where = {.file = "spin-gltf.so",
                                     .override = "SPIN_GLTF_SHIM",
                                     .symbol = SPIN_GLB_SHIM_SYMBOL,
                                     .abi = SPIN_GLB_SHIM_ABI,
                                     .lacking = "glTF cannot be written: the tinygltf shim",
                                     .debian = "libtinygltf-dev"};

    return spin_shim_load(&where, (const void **)&shim);
}

spin_status spin_glb_end(struct spin_glb_clip *clip)
{
    uint64_t keys = clip->n_bytes;
    char why[256] = ""; /* empty if memory runs out */
    SPIN_FREED char *text = NULL;

    SPIN_TRY(spin_glb_can_write());
    if (clip->animated)
        SPIN_TRY(write_keys(clip));
    text = shim->text(clip, "spin4d " SPIN_VERSION, keys, why, sizeof why);
    if (!text && !*why)
        return spin_fail(SPIN_E_MEMORY, "cannot write '%s': not enough memory", clip->out->path);
    if (!text)
        return spin_unsupported("cannot write '%s': %s", clip->out->path, why);
    return write_front(clip, text);
}
