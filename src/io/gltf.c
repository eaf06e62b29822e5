/* The binary container of glTF 2.0 (its section 4): a header, the JSON padded with spaces, the bytes.
 * Loads the shim that holds tinygltf. */
#include "io/gltf.h"

#include <errno.h>
#include <float.h>
#include <limits.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/shim.h"

#define HEADER 12
#define CHUNK_HEADER 8
#define MAX_BYTES UINT32_MAX /* its lengths have 32 bits */

static pthread_once_t once = PTHREAD_ONCE_INIT;
static const struct spin_gltf_shim *shim; /* NULL after a failed start */
static char failure[512];

static void start(void)
{
    static const struct spin_shim where = {.file = "spin-gltf.so",
                                           .override = "SPIN_GLTF_SHIM",
                                           .symbol = SPIN_GLTF_SHIM_SYMBOL,
                                           .abi = SPIN_GLTF_SHIM_ABI};

    shim = spin_shim_load(&where, failure, sizeof failure);
}

static spin_status make_json(const char *path, const struct spin_gltf_clip *clip, char **text,
                             size_t *n)
{
    char why[256] = "";

    *text = NULL;
    pthread_once(&once, start);
    if (!shim)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "glTF cannot be written: the tinygltf shim 'spin-gltf.so' is missing or "
                         "does not load%s%s (Debian: install libtinygltf-dev, then make)",
                         *failure ? ": " : "", failure);
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
    for (int f = 0; f < worst->n_frames; f++) {
        frame[f] = (struct spin_gltf_frame){.n = MAX_BYTES,
                                            .offset = MAX_BYTES - 1,
                                            .number = INT_MIN,
                                            .time = -DBL_MIN * (1 + 1.0 / 3)};
        for (int c = 0; c < 3; c++)
            frame[f].low[c] = frame[f].high[c] = -FLT_MIN * (1 + 1.0f / 3);
    }
    clip.frame = frame;
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

spin_status spin_glb_open(const char *path, bool force, const struct spin_gltf_clip *worst,
                          struct spin_glb *out)
{
    memset(out, 0, sizeof *out);
    SPIN_TRY(longest_json(path, worst, &out->room));
    return spin_out_open(path, force, &out->out);
}

static spin_status write_at(struct spin_glb *glb, uint64_t at, const void *data, size_t bytes)
{
    if (fseeko(glb->out.file, (off_t)at, SEEK_SET) != 0)
        return spin_fail(SPIN_E_IO, "cannot write '%s': %s", glb->out.path, strerror(errno));
    return spin_out_write(&glb->out, data, bytes);
}

spin_status spin_glb_write(struct spin_glb *glb, uint64_t at, const void *data, size_t bytes)
{
    uint64_t first = HEADER + 2 * CHUNK_HEADER + (uint64_t)glb->room;

    if (at > MAX_BYTES || bytes > MAX_BYTES || first + at + bytes > MAX_BYTES)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "cannot write '%s': a .glb ends at 4 GiB; export fewer frames with "
                         "--range, or give a folder for one .glb per frame",
                         glb->out.path);
    return write_at(glb, first + at, data, bytes);
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
                         glb->out.path, n, glb->room);
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
    status = write_at(glb, 0, front, n_front);
    free(front);
    return status;
}

spin_status spin_glb_commit(struct spin_glb *glb, const struct spin_gltf_clip *clip)
{
    char *text = NULL;
    size_t n = 0;
    spin_status status;

    SPIN_TRY_OUT(make_json(glb->out.path, clip, &text, &n));
    SPIN_TRY_OUT(write_front(glb, clip, text, n));
    free(text);
    return spin_out_commit(&glb->out);
out:
    free(text);
    spin_glb_abandon(glb);
    return status;
}

void spin_glb_abandon(struct spin_glb *glb) { spin_out_abandon(&glb->out); }
