/* PyTorch checkpoints (.pth, .pt), zip and legacy streams, read as data: no code in them is
 * executed. */
#pragma once

#include "io/pickle.h"

struct spin_torch {
    struct spin_pickle pickle;
    const struct spin_value *root; /* the object passed to torch.save */
    /* Private: the mapped file or zip archive, and the positions of its storages. */
    struct spin_torch_file *file;
};

/* Read the pickle; storages are not accessed before a tensor is bound. Errors contain the file
 * name, and identify other kinds of files (xz, safetensors, TorchScript, HTML). */
spin_status spin_torch_open(const char *path, struct spin_torch *out);
void spin_torch_close(struct spin_torch *torch);

/* Bind the tensor in `v` to its storage, after checking bounds, strides and sizes against the
 * available bytes. Uncompressed storages are used in place. Errors contain `what`. `out` is valid
 * until the checkpoint is closed. */
spin_status spin_torch_tensor(struct spin_torch *torch, const struct spin_value *v,
                              const char *what, struct spin_array *out);
/* Do the same, and check that the tensor has this shape, where -1 matches any size. */
spin_status spin_torch_tensor_of(struct spin_torch *torch, const struct spin_value *v,
                                 const char *what, int n_dims, const int64_t *shape,
                                 struct spin_array *out);
/* Remove the pages of the tensor's storage from the process's memory (see spin_map_forget()), for
 * large tensors that are read row by row. */
void spin_torch_forget(const struct spin_torch *torch, const struct spin_array *t);
/* Bind a tensor, check its shape and convert all of its elements to floats, allocated with malloc.
 * SPIN_E_MALFORMED if an element is NaN or infinite. *info receives the bound tensor; may be
 * NULL. */
spin_status spin_torch_floats(struct spin_torch *torch, const struct spin_value *v,
                              const char *what, int n_dims, const int64_t *shape,
                              struct spin_array *info, float **out);
