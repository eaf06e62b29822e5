/* Parts of .4dgs files that both temporal models share: the bytes of a record, and streams. */
#pragma once

#include "base/base.h"

/* Codes of the attributes, in the order of spin_4dgs_attributes. */
enum {
    SPIN_4DGS_POSITION,
    SPIN_4DGS_SCALE,
    SPIN_4DGS_LARGEST,
    SPIN_4DGS_ROTATION,
    SPIN_4DGS_COLOUR,
    SPIN_4DGS_OPACITY,
    SPIN_4DGS_MOTION,
    SPIN_4DGS_MU,
    SPIN_4DGS_SIGMA,
    SPIN_4DGS_FLAGS,
    SPIN_4DGS_WINDOW,
    SPIN_4DGS_N_ATTRIBUTES
};

extern const struct spin_4dgs_attribute {
    const char *name;
    int channels;
} spin_4dgs_attributes[SPIN_4DGS_N_ATTRIBUTES];

/* The unread bytes of a record. Reading past the end sets `cut` and returns zeros from then on. */
struct spin_4dgs_cursor {
    const unsigned char *at;
    size_t left;
    bool cut;
};

const unsigned char *spin_4dgs_bytes(struct spin_4dgs_cursor *c, uint64_t n);
uint64_t spin_4dgs_number(struct spin_4dgs_cursor *c, int bytes);
double spin_4dgs_double(struct spin_4dgs_cursor *c);
/* Reads a length of `length_bytes` bytes and returns as many bytes behind it. */
struct spin_4dgs_cursor spin_4dgs_block(struct spin_4dgs_cursor *c, int length_bytes);
bool spin_4dgs_is(const struct spin_4dgs_cursor *text, const char *word);

struct spin_4dgs_stream {
    unsigned attribute, symbol, mode, codec, channels;
    uint64_t n;
    struct spin_4dgs_cursor packed;
};

struct spin_4dgs_stream spin_4dgs_stream_head(struct spin_4dgs_cursor *c);
/* Allocates *out with the shape [n][channels], and reads the integers of n splats into it. */
spin_status spin_4dgs_stream_read(const struct spin_4dgs_stream *s, size_t n, int channels,
                                  int32_t **out);
/* Opens the streams of a chunk. If the chunk has a codec, all of its streams together were
 * compressed once more: *plain then receives their bytes, which the caller frees. */
spin_status spin_4dgs_open(struct spin_4dgs_cursor *block, const struct spin_4dgs_cursor *codec,
                           uint64_t bytes, unsigned char **plain);
/* Allowed sizes of unpacked data, see 4dgs.c. */
#define SPIN_4DGS_RATIO 32
#define SPIN_4DGS_SLACK (1u << 20)
