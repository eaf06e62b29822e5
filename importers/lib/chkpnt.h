/* chkpnt<N>.pth, from which 3DGS and its descendants resume a training: (model, iteration). The
 * model is a tuple of tensors, numbers and the optimiser, whose length identifies the method. */
#pragma once

#include "importers/lib/model.h"

/* N of chkpnt<N>.pth, INT64_MAX for chkpnt_best.pth, else -1. */
long long spin_chkpnt_iteration(const char *name);

/* Sets *out to the name of the checkpoint to read in a folder, or to NULL if there is none.
 * `wanted` is a number or "best"; NULL selects the largest number or, if no name has a number,
 * chkpnt_best.pth. Sets *best to whether there is a chkpnt_best.pth that was not chosen. */
spin_status spin_chkpnt_choose(struct spin_model *m, const char *folder, const char *wanted,
                               const char **out, bool *best);
/* Sets the model's path to the file `path`, or to the newest checkpoint of the folder `path`; to
 * NULL if the folder has none. Notes a chkpnt_best.pth that was not chosen. */
spin_status spin_chkpnt_find(struct spin_model *m, const char *path);

/* The kind of a value for messages: "a tensor", "an int", ...; "nothing" for NULL. */
const char *spin_chkpnt_kind(const struct spin_value *v);

/* Name, for messages, of the method whose checkpoints have n_items items in the model. */
const char *spin_chkpnt_maker(size_t n_items);

/* Splits the root of a checkpoint into the model, a tuple of n_items, and the iteration. A tuple of
 * another length is refused, with the name of the method that saves such tuples; *model is then
 * NULL. `method` is the name of the caller's method. */
spin_status spin_chkpnt_model(const struct spin_value *root, size_t n_items, const char *method,
                              const struct spin_value **model, double *iteration);

/* Binds a tensor [shape...] of floating-point numbers; -1 matches any size. Refuses rows that
 * repeat by a stride of 0, with which a small file could demand any amount of memory. */
spin_status spin_chkpnt_bind(struct spin_torch *torch, const struct spin_value *v, const char *what,
                             int n_dims, const int64_t *shape, struct spin_array *out);

/* Whether a value is a tensor without elements, as saved for an attribute that does not exist yet.
 */
bool spin_chkpnt_is_empty(const struct spin_value *v);
