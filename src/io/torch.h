/* PyTorch checkpoints (.pth, .pt): zip and legacy streams, as data. Nothing in them is executed. */
#pragma once

#include "io/pickle.h"

struct spin_torch {
    struct spin_pickle pickle;
    const struct spin_value *root; /* what torch.save was given */
    struct spin_torch_file *file;  /* private: map, zip, storages */
};

/* Reads the pickle; storages are looked at only when a tensor is bound. Errors name the file, and
 * say what it is when it is something else (an xz, safetensors, TorchScript, HTML). */
spin_status spin_torch_open(const char *path, struct spin_torch *out);
void spin_torch_close(struct spin_torch *torch);

/* The tensor in `v`, its storage bound: bounds, strides, sizes checked against the bytes there.
 * Stored storages are used in place. Errors name `what`. `out` dies with the checkpoint. */
spin_status spin_torch_tensor(struct spin_torch *torch, const struct spin_value *v,
                              const char *what, struct spin_array *out);
/* The same and its shape must fit; -1 matches anything. */
spin_status spin_torch_tensor_of(struct spin_torch *torch, const struct spin_value *v,
                                 const char *what, int n_dims, const int64_t *shape,
                                 struct spin_array *out);
/* The pages of its storage may go from memory: they come back when they are read. For those who
 * read a large tensor row by row. */
void spin_torch_forget(const struct spin_torch *torch, const struct spin_array *t);
/* A whole tensor as floats, allocated with malloc; NaN and infinities are SPIN_E_MALFORMED. */
spin_status spin_torch_floats(struct spin_torch *torch, const struct spin_value *v,
                              const char *what, int n_dims, const int64_t *shape,
                              struct spin_array *info, float **out);
