/* chkpnt<N>.pth, which 3DGS and what grew out of it save to go on from: (model, iteration), where
 * the model is a tuple of tensors, numbers and the optimiser. Its length tells the methods apart.
 */
#pragma once

#include "importers/lib/model.h"

/* N of chkpnt<N>.pth, INT64_MAX of chkpnt_best.pth, else -1. */
long long spin_chkpnt_iteration(const char *name);

/* Name of the checkpoint to read in a folder: that of iteration `wanted`, a number or "best"; NULL:
 * of the largest number, or the best where none has a number. NULL when there is none. *best: there
 * is a best one that was not chosen. */
spin_status spin_chkpnt_choose(struct spin_model *m, const char *folder, const char *wanted,
                               const char **out, bool *best);
/* The checkpoint at `path` as the model's path: the file itself, or that of a folder, when a note
 * says if there is a best one besides. NULL when a folder has none. */
spin_status spin_chkpnt_find(struct spin_model *m, const char *path);

/* "a tensor", "an int", ...; "nothing" for NULL. */
const char *spin_chkpnt_kind(const struct spin_value *v);

/* Who saves a model of so many items. */
const char *spin_chkpnt_maker(size_t n_items);

/* The tuple of n_items that the root of a checkpoint holds with an int. A tuple of another length
 * is refused with the name of the method that saves such; *model is NULL then. `method` is ours. */
spin_status spin_chkpnt_model(const struct spin_value *root, size_t n_items, const char *method,
                              const struct spin_value **model, double *iteration);

/* A tensor [shape...] of floating-point numbers; -1: any size. Refuses rows that repeat one another
 * by a stride of 0, which would let a small file ask for any amount of memory. */
spin_status spin_chkpnt_bind(struct spin_torch *torch, const struct spin_value *v, const char *what,
                             int n_dims, const int64_t *shape, struct spin_array *out);

/* A tensor without elements, of any shape: what is not there yet is saved so. */
bool spin_chkpnt_is_empty(const struct spin_value *v);
