/* The files of a sequence of point clouds. There is no standard for these. A folder of numbered files, a
 * folder of per-frame folders with the INRIA tree inside, one model's tree and a single file are found;
 * frames go by the last number in the name. */
#ifndef SPIN_IMPORTERS_LIB_PLY_SEQUENCE_H
#define SPIN_IMPORTERS_LIB_PLY_SEQUENCE_H

#include "spin.h"

struct spin_ply_frame {
    char *path;
    int number; /* -1: none */
    size_t n;   /* splats; the caller's */
};

/* Zero it to begin. */
struct spin_ply_sequence {
    struct spin_ply_frame *frame;
    size_t n_frames, capacity;
};

/* How sure a folder's names make us that it is such a sequence, 0..100. */
int spin_ply_sequence_probe(const struct spin_peek *peek);
/* At least one frame, in any order. */
spin_status spin_ply_sequence_find(const char *path, struct spin_ply_sequence *seq);
/* Numeric order; "frame_10" comes after "frame_9". Without any numbers the order of the names. Notes
 * missing numbers. */
spin_status spin_ply_sequence_sort(struct spin_ply_sequence *seq,
                                   struct spin_sequence_info *sequence);
void spin_ply_sequence_free(struct spin_ply_sequence *seq);

#endif
