/* Reads the keyframes and deltas of .4dgs files, and converts the states that they define to rows,
 * each visible while its splat does not change. */
#pragma once

#include "formats/4dgs_streams.h"

enum { SPIN_4DGS_BINS = 21, SPIN_4DGS_REST = 45 };

/* A splat of a state. `bin` contains the integers of all attributes, in order; `sh` the codes of
 * the coefficients above degree 0, [coefficient][channel]. */
struct spin_4dgs_splat {
    uint32_t id;
    int32_t bin[SPIN_4DGS_BINS];
    unsigned char sh[SPIN_4DGS_REST];
};

/* Returns the integers of an attribute. */
int32_t *spin_4dgs_bin(struct spin_4dgs_splat *splat, int attribute);

/* A splat with the interval in which it does not change. */
struct spin_4dgs_row {
    struct spin_4dgs_splat splat;
    double interval[2];
};

/* The splats of a state, sorted by id, with the time of the last change of each. */
struct spin_4dgs_state {
    struct spin_4dgs_splat *splat;
    double *since;
    size_t n;
};

/* A chunk of the file, to which later chunks and the index refer. */
struct spin_4dgs_chunk {
    double begin; /* seconds */
    uint64_t offset;
    uint32_t level;
    unsigned depth, mode;
    size_t n_live;
};

struct spin_4dgs_states {
    int sh_degree;
    uint64_t most_rows;        /* limit of the rows, against decompression bombs */
    struct spin_4dgs_row *row; /* [n_rows] sorted by id and time at the end */
    size_t n_rows, capacity;
    uint64_t n_read; /* number of splats in all chunks */
    /* The current state, the last keyframe, and the state that is being read. */
    struct spin_4dgs_state shown, keyframe, next;
    double begin, end; /* interval of `next` */
    uint32_t *order;   /* [n_order] ids in the order of the streams, for SH bands */
    size_t n_order;
    unsigned bands;
    struct spin_4dgs_chunk *chunk;
    size_t n_chunks, n_indexed, chunk_capacity;
};

/* Read a record at the offset `at` of the file. */
spin_status spin_4dgs_states_keyframe(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c,
                                      size_t at);
spin_status spin_4dgs_states_delta(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c,
                                   size_t at);
spin_status spin_4dgs_states_band(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c);
/* Compares an entry of the index with the chunk that it describes. */
spin_status spin_4dgs_states_index(struct spin_4dgs_states *s, struct spin_4dgs_cursor *c);
/* Checks that the states cover the clip and have n_ids different splats, and sorts the rows. */
spin_status spin_4dgs_states_end(struct spin_4dgs_states *s, double duration, uint64_t n_ids);
/* Returns the number of states per second if they are evenly spaced and nothing moves within a
 * state, which makes them frames; else 0. */
double spin_4dgs_states_rate(const struct spin_4dgs_states *s, double duration);
void spin_4dgs_states_free(struct spin_4dgs_states *s);
