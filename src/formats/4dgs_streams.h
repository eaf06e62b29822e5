/* The parts of .4dgs files that the two temporal models, gaussian-birth and keyframe-delta, share:
 * records as bytes, streams, and quantisation. */
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
    SPIN_4DGS_N_ATTRIBUTES,
    SPIN_4DGS_ID = 13 /* ids of splats, only in files with keyframes; not in spin_4dgs_attributes */
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
/* Reads a block: its length, a number of `length_bytes` bytes, and then this number of bytes.
 * Returns a cursor over the bytes of the block. */
struct spin_4dgs_cursor spin_4dgs_block(struct spin_4dgs_cursor *c, int length_bytes);
bool spin_4dgs_is(const struct spin_4dgs_cursor *text, const char *word);

struct spin_4dgs_stream {
    unsigned attribute, symbol, mode, codec, channels;
    uint64_t n;
    struct spin_4dgs_cursor packed;
};

struct spin_4dgs_stream spin_4dgs_stream_head(struct spin_4dgs_cursor *c);
/* Allocates *out with the shape [n][channels], and sets it to the integers of n splats. */
spin_status spin_4dgs_stream_read(const struct spin_4dgs_stream *s, size_t n, int channels,
                                  int32_t **out);
/* Opens the block that contains the streams of a chunk. If the chunk has a codec, the whole block
 * is compressed in addition to the streams. It is then decompressed to *plain, which the caller
 * frees, and *block points to the result. bytes: size of the decompressed block. */
spin_status spin_4dgs_open(struct spin_4dgs_cursor *block, const struct spin_4dgs_cursor *codec,
                           uint64_t bytes, unsigned char **plain);
/* Limits against decompression bombs: n packed bytes may unpack to at most RATIO n + SLACK bytes,
 * see 4dgs.c. */
#define SPIN_4DGS_RATIO 32
#define SPIN_4DGS_SLACK (1u << 20)

#define SPIN_4DGS_MAGIC                                                                            \
    "\x89"                                                                                         \
    "4DGS1\r\n"
#define SPIN_4DGS_MAGIC_BYTES 8
#define SPIN_4DGS_MODEL "gaussian-birth"
#define SPIN_4DGS_STATES "keyframe-delta"
#define SPIN_4DGS_SCHEME "uniform-v1"
#define SPIN_4DGS_CHAINED                                                                          \
    1 /* mode of a delta that is applied to the previous state, not to the last keyframe */
#define SPIN_4DGS_NEVER_FADES 1 /* flag of a splat that has no Gaussian window */

/* Name of the metadata record that spin4d writes, and its keys: whether the splats must be rendered
 * with antialiasing, and the number of frames per second. */
#define SPIN_4DGS_METADATA "spin4d"
#define SPIN_4DGS_ANTIALIAS "antialias"
#define SPIN_4DGS_FPS "fps"
/* Key for the time in seconds at which the sound begins, only written if it is below 0. The audio
 * source record then contains a start of 0. */
#define SPIN_4DGS_SOUND_START "sound_start"
#define SPIN_4DGS_LOOPS                                                                            \
    2 /* flag of a sound that is repeated; flag 1: it has a position in the scene */

/* Opcodes of records. */
enum {
    SPIN_4DGS_REC_HEADER = 1,
    SPIN_4DGS_REC_FOOTER,
    SPIN_4DGS_REC_QUANTIZATION,
    SPIN_4DGS_REC_WINDOWS,
    SPIN_4DGS_REC_CHUNK,
    SPIN_4DGS_REC_SH_BAND = 7,
    SPIN_4DGS_REC_INDEX,
    SPIN_4DGS_REC_SOUND,
    SPIN_4DGS_REC_CAMERA,
    SPIN_4DGS_REC_METADATA,
    SPIN_4DGS_REC_DELTA_CHUNK = 16,
    SPIN_4DGS_REC_SOUND_SOURCE,
    SPIN_4DGS_REC_SOUND_DATA,
    SPIN_4DGS_REC_FRAME = 32,
    SPIN_4DGS_REC_OBJECT_TRACK = 37,
};

/* Quantisation steps, in the order of the file. */
enum {
    SPIN_4DGS_STEP_POSITION,
    SPIN_4DGS_STEP_SCALE,
    SPIN_4DGS_STEP_ROTATION,
    SPIN_4DGS_STEP_COLOUR,
    SPIN_4DGS_STEP_OPACITY,
    SPIN_4DGS_STEP_MOTION,
    SPIN_4DGS_STEP_TIME,
    SPIN_4DGS_STEP_SIGMA,
    SPIN_4DGS_N_STEPS
};

double spin_4dgs_clamp(double x, double least, double most);
/* Returns the quantisation step of a splat's velocity. The step is finer for splats that are
 * visible for longer. life: seconds from the splat's centre in time until the splat fades below the
 * cutoff or, for a splat that never fades, the length of its window. */
double spin_4dgs_motion_step(const double step[SPIN_4DGS_N_STEPS], double life);
/* Returns the quantisation step of a splat's centre in time: the file's step, halved up to ten
 * times until it is at most a twentieth of the splat's sigma. */
double spin_4dgs_time_step(const double step[SPIN_4DGS_N_STEPS], double sigma);
/* Decodes a quaternion from its three smaller components, `steps`, in units of `step`. largest:
 * index of the largest component in the order x y z w, which the file omits and which is positive.
 * The result is in the order w x y z. */
void spin_4dgs_rotation(const int32_t *steps, int largest, double step, float wxyz[4]);
