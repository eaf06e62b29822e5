/* The binary container of glTF 2.0 (its section 4): a header, the JSON padded with spaces, the bytes.
 * Loads the shim that holds tinygltf. */
#include "io/gltf.h"

#include <errno.h>
#include <float.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "base/shim.h"

#define HEADER 12
#define CHUNK_HEADER 8
#define MAX_BYTES UINT32_MAX /* its lengths have 32 bits */
#define TOO_FAR (-1)         /* no errno */

static const struct spin_gltf_shim *shim;

static spin_status make_json(const char *path, const struct spin_gltf_clip *clip, char **text,
                             size_t *n)
{
    static struct spin_shim where = {.file = "spin-gltf.so",
                                     .override = "SPIN_GLTF_SHIM",
                                     .symbol = SPIN_GLTF_SHIM_SYMBOL,
                                     .abi = SPIN_GLTF_SHIM_ABI,
                                     .lacking = "glTF cannot be written: the tinygltf shim",
                                     .debian = "libtinygltf-dev"};
    char why[256] = "";

    *text = NULL;
    SPIN_TRY(spin_shim_need(&where, (const void **)&shim));
    if (!shim->json(clip, text, n, why, sizeof why))
        return spin_fail(SPIN_E_UNSUPPORTED, "cannot write '%s': %s", path, why);
    return SPIN_OK;
}

/* The length of the JSON when every number in it is as long as it can be. */
static spin_status longest_json(const char *path, const struct spin_gltf_clip *worst, size_t *n)
{
    struct spin_gltf_clip clip = *worst;
    struct spin_gltf_frame *frame = NULL;
    char *text = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc((size_t)worst->n_frames + 1, sizeof *frame, (void **)&frame));
    for (int f = 0; f <= worst->n_frames; f++) {
        frame[f] = (struct spin_gltf_frame){.n = MAX_BYTES,
                                            .offset = MAX_BYTES - 1,
                                            .number = INT_MIN,
                                            .time = -DBL_MIN * (1 + 1.0 / 3)};
        for (int c = 0; c < 3; c++)
            frame[f].low[c] = frame[f].high[c] = -FLT_MIN * (1 + 1.0f / 3);
    }
    clip.frame = frame;
    clip.still = worst->still ? &frame[worst->n_frames] : NULL;
    clip.keys_offset = MAX_BYTES - 1;
    clip.n_bytes = MAX_BYTES;
    status = make_json(path, &clip, &text, n);
    /* Not every number has a longest form that is also the longest of its kind: some slack. */
    *n += 64 + 32 * (size_t)worst->n_frames;
    *n = (*n + 3) / 4 * 4;
    free(text);
    free(frame);
    return status;
}

spin_status spin_glb_begin(struct spin_out *out, const struct spin_gltf_clip *worst,
                           struct spin_glb *glb)
{
    glb->out = out;
    return longest_json(out->path, worst, &glb->room);
}

int spin_glb_put(struct spin_glb *glb, uint64_t at, const void *data, size_t bytes)
{
    uint64_t first = HEADER + 2 * CHUNK_HEADER + (uint64_t)glb->room;

    if (at > MAX_BYTES || bytes > MAX_BYTES || first + at + bytes > MAX_BYTES)
        return TOO_FAR;
    return spin_out_put(glb->out, first + at, data, bytes);
}

spin_status spin_glb_failed(const struct spin_glb *glb, int error)
{
    if (error != TOO_FAR)
        return spin_out_failed(glb->out, error);
    return spin_fail(SPIN_E_UNSUPPORTED,
                     "cannot write '%s': a .glb ends at 4 GiB; export fewer frames with "
                     "--range, or give a folder for one .glb per frame",
                     glb->out->path);
}

spin_status spin_glb_write(struct spin_glb *glb, uint64_t at, const void *data, size_t bytes)
{
    int error = spin_glb_put(glb, at, data, bytes);

    return error ? spin_glb_failed(glb, error) : SPIN_OK;
}

static void put_u32(unsigned char *at, uint64_t value)
{
    for (int i = 0; i < 4; i++)
        at[i] = (unsigned char)(value >> (8 * i));
}

/* Header, JSON, and the header of the bytes: all that stands before them. */
static spin_status write_front(struct spin_glb *glb, const struct spin_gltf_clip *clip,
                               const char *text, size_t n)
{
    size_t n_front = HEADER + CHUNK_HEADER + glb->room + (clip->n_bytes > 0 ? CHUNK_HEADER : 0);
    unsigned char *front = NULL;
    spin_status status;

    if (n > glb->room)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "cannot write '%s': its JSON takes %zu bytes, %zu were kept for it",
                         glb->out->path, n, glb->room);
    SPIN_TRY(spin_alloc(n_front, 1, (void **)&front));
    memcpy(front, "glTF", 4);
    put_u32(front + 4, 2);
    put_u32(front + 8, n_front + clip->n_bytes);
    put_u32(front + 12, glb->room);
    memcpy(front + 16, "JSON", 4);
    memcpy(front + 20, text, n);
    memset(front + 20 + n, ' ', glb->room - n);
    if (clip->n_bytes > 0) {
        put_u32(front + 20 + glb->room, clip->n_bytes);
        memcpy(front + 24 + glb->room, "BIN", 4);
    }
    status = spin_out_write_at(glb->out, 0, front, n_front);
    free(front);
    return status;
}

spin_status spin_glb_end(struct spin_glb *glb, const struct spin_gltf_clip *clip)
{
    char *text = NULL;
    size_t n = 0;
    spin_status status;

    SPIN_TRY(make_json(glb->out->path, clip, &text, &n));
    status = write_front(glb, clip, text, n);
    free(text);
    return status;
}
