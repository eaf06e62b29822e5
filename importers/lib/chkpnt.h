/* Reads the files chkpnt<N>.pth, from which 3DGS and its descendants resume a training. Each
 * contains a tuple (model, iteration). The model is itself a tuple, of tensors, numbers and the
 * state of the optimiser; the number of its items identifies the method. */
#pragma once

#include "importers/lib/model.h"

/* Returns N for the name chkpnt<N>.pth, INT64_MAX for chkpnt_best.pth and -1 for other names. */
long long spin_chkpnt_iteration(const char *name);

/* Sets *out to the name of the checkpoint to read in a folder, or to NULL if there is none.
 * `wanted` is a number or "best"; NULL selects the largest number or, if no name has a number,
 * chkpnt_best.pth. Sets *best to whether the folder contains a chkpnt_best.pth that was not chosen.
 */
spin_status spin_chkpnt_choose(struct spin_model *m, const char *folder, const char *wanted,
                               const char **out, bool *best);
/* Sets m->path to the checkpoint to read. If `path` is a file, this is `path`. If it is a folder,
 * this is the file that spin_chkpnt_choose() selects by default, or NULL if there is none; a note
 * for the user mentions a chkpnt_best.pth that was not chosen. */
spin_status spin_chkpnt_find(struct spin_model *m, const char *path);

/* Returns the type of a value as text for messages: "a tensor", "an int", ..., or "nothing" if `v`
 * is NULL. */
const char *spin_chkpnt_kind(const struct spin_value *v);

/* Returns, for messages, the name of the method whose checkpoints contain a model of n_items
 * items. */
const char *spin_chkpnt_method(size_t n_items);

/* Splits the root of a checkpoint into the model, a tuple of n_items, and the iteration. If the
 * model has another number of items, returns SPIN_E_UNSUPPORTED and sets *model to NULL; the
 * message names the caller's method, `method`, and the method whose models have that number of
 * items. */
spin_status spin_chkpnt_model(const struct spin_value *root, size_t n_items, const char *method,
                              const struct spin_value **model, double *iteration);

/* Sets *out to the tensor `v`, which must contain floating-point numbers and have the shape `shape`
 * [n_dims], where -1 matches any size; `what` names the tensor in messages. Refuses a tensor with
 * more elements than its storage has: strides of 0 would allow a small file to demand any amount of
 * memory. */
spin_status spin_chkpnt_bind(struct spin_torch *torch, const struct spin_value *v, const char *what,
                             int n_dims, const int64_t *shape, struct spin_array *out);

/* Whether a value is a tensor without elements, as saved for an attribute that does not exist yet.
 */
bool spin_chkpnt_is_empty(const struct spin_value *v);
