/* The files of a sequence of PLY clouds: a folder of numbered files, a folder of per-frame folders with the
 * INRIA tree inside, one model's tree, or a single file. */
#ifndef SPIN_IMPORTERS_LIB_PLY_SEQUENCE_H
#define SPIN_IMPORTERS_LIB_PLY_SEQUENCE_H

#include "importers/lib/file_sequence.h"

/* How sure a folder's names make us that it is such a sequence, 0..100. */
int spin_ply_sequence_probe(const struct spin_peek *peek);
/* At least one frame, in any order. */
spin_status spin_ply_sequence_find(const char *path, struct spin_file_sequence *seq);

#endif
