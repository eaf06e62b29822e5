/* Reads the keyframes and deltas of .4dgs files, which define a sequence of states. Converts the
 * states to rows: a row is a splat with an interval of time in which it does not change. */
#pragma once

#include "formats/4dgs_streams.h"

enum { SPIN_4DGS_BINS = 21, SPIN_4DGS_REST = 45 };

/* A splat of a state. bin: the quantised integers of all attributes, in the order of
 * spin_4dgs_attributes; sh: the codes of the coefficients above degree 0, [coefficient][channel].
 */
struct spin_4dgs_splat {
    uint32_t id;
    int32_t bin[SPIN_4DGS_BINS];
    unsigned char sh[SPIN_4DGS_REST];
};

/* Returns the part of splat->bin with the integers of an attribute. */
int32_t *spin_4dgs_bin(struct spin_4dgs_splat *splat, int attribute);

/* A splat with the interval in which it does not change. */
struct spin_4dgs_row {
    struct spin_4dgs_splat splat;
    double interval[2];
};

/* The splats of a state, sorted by id. since [n]: time of the last change of each splat. */
struct spin_4dgs_state {
    struct spin_4dgs_splat *splat;
    double *since;
    size_t n;
};

/* The data that are kept of each chunk after it is read, since later chunks and the index refer to
 * it. */
struct spin_4dgs_chunk {
    double begin; /* seconds */
    uint64_t offset;
    uint32_t level;
    unsigned depth, mode;
    size_t n_live;
};

struct spin_4dgs_states {
    int sh_degree;
    uint64_t most_rows;        /* limit on n_read, against decompression bombs */
    struct spin_4dgs_row *row; /* [n_rows], sorted by id and time in spin_4dgs_states_end() */
    size_t n_rows, capacity;
    uint64_t n_read; /* number of splats and changes in all chunks */
    /* The last complete state, the last keyframe, and the state that is being read. */
    struct spin_4dgs_state shown, keyframe, next;
    double begin, end; /* interval of `next` */
    uint32_t *order;   /* [n_order] ids of new splats in stream order, which SH bands use */
    size_t n_order;
    unsigned bands;
    struct spin_4dgs_chunk *chunk;
    size_t n_chunks, n_indexed, chunk_capacity;
};

/* These functions read the content of a record: a keyframe or a delta at byte `at` of the file, or
 * an SH band of the preceding chunk. */
spin_status spin_4dgs_states_keyframe(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c,
                                      size_t at);
spin_status spin_4dgs_states_delta(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c,
                                   size_t at);
spin_status spin_4dgs_states_band(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c);
/* Reads an entry of the index, and compares it with the chunk that it describes. */
spin_status spin_4dgs_states_index(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c);
/* Checks that the states cover the whole clip and contain n_ids different ids, and sorts the rows.
 */
spin_status spin_4dgs_states_end(struct spin_4dgs_states *s, double duration, uint64_t n_ids);
/* Returns the number of states per second if the states can be taken as frames, which means that
 * they are evenly spaced and that no splat moves within a state; otherwise 0. */
double spin_4dgs_states_rate(const struct spin_4dgs_states *s, double duration);
void spin_4dgs_states_free(struct spin_4dgs_states *s);
