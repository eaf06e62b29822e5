/* PyTorch checkpoints (.pth, .pt), zip and legacy streams, read as data: no code in them is
 * executed. */
#pragma once

#include "base/mem.h"
#include "io/array.h"

/* ---- Pickles --------------------------------------------------------------------------------- */

/* A pickle reader that builds data and never runs code.
 *
 * It supports the protocols 2 to 5. Globals are looked up by name in a list of those that represent
 * plain data (OrderedDict, torch's tensor rebuilders, numpy's array rebuilders, argparse.Namespace,
 * ...). Any other global is an error, even if it is never called. Limits on depth, memo, lengths
 * and the total size of the values bound the cost of reading a file.
 *
 * The result is a graph: a list may contain itself, and sixty nested pairs can form a tree of 2^60
 * nodes. Look up single values; never traverse the whole graph. */

enum spin_value_kind {
    SPIN_VALUE_NONE,
    SPIN_VALUE_BOOL,
    SPIN_VALUE_INT,
    SPIN_VALUE_FLOAT,
    SPIN_VALUE_TEXT, /* a str of Python */
    SPIN_VALUE_BYTES,
    SPIN_VALUE_LIST,
    SPIN_VALUE_TUPLE,
    /* A dict: `item` contains key, value, key, value, ... in the order of the file. */
    SPIN_VALUE_DICT,
    SPIN_VALUE_TENSOR, /* a torch tensor or numpy array, described by `tensor` */
    /* An instance of a class that represents plain data. text: the name of the class; item[0], if n
     * is 1: the state of the object, a dict. */
    SPIN_VALUE_OBJECT
};

struct spin_value {
    enum spin_value_kind kind;
    int64_t integer;  /* set for BOOL and INT */
    double number;    /* set for FLOAT, BOOL and INT */
    const char *text; /* set for TEXT, BYTES and OBJECT; NUL-terminated */
    /* For TEXT and BYTES, the number of bytes; for DICT, the number of pairs; for other kinds, the
     * number of items. */
    size_t n;
    /* The items of LIST, TUPLE and OBJECT, n pointers; the keys and values of DICT, 2 n
     * pointers. */
    struct spin_value **item;
    struct spin_array tensor;
};

/* A storage: an array of elements, to which tensors refer by the storage's key. */
struct spin_storage {
    const char *key;
    char kind;                 /* letter of the element type, see struct spin_array */
    int item_size;             /* bytes per element */
    uint64_t count;            /* number of elements */
    const unsigned char *data; /* the elements; set by spin_pickle_parse_legacy() only */
};

struct spin_pickle {
    const struct spin_value *root;
    struct spin_arena arena;      /* owns all values and text */
    size_t used;                  /* number of input bytes up to and including the opcode STOP */
    struct spin_storage *storage; /* [n_storages] sorted by key (strcmp), without duplicates */
    size_t n_storages;
    bool big_endian; /* the storages are big-endian; set for legacy streams only */
};

/* Parse a pickle, which messages call `what`. Tensors of torch are not bound to their storages yet
 * (see spin_torch_tensor()). The caller frees *out with spin_pickle_free(). */
spin_status spin_pickle_parse(const char *what, const unsigned char *bytes, size_t n,
                              struct spin_pickle *out);
/* Recognise and parse a legacy stream, which torch.save wrote before PyTorch 1.6: five pickles,
 * then the storages. In the result, the `data` of each storage points into `bytes`. */
bool spin_pickle_is_legacy(const unsigned char *bytes, size_t n);
spin_status spin_pickle_parse_legacy(const char *what, const unsigned char *bytes, size_t n,
                                     struct spin_pickle *out);

void spin_pickle_free(struct spin_pickle *pickle);
/* Returns the storage with this key, or NULL if there is none. */
const struct spin_storage *spin_pickle_storage(const struct spin_pickle *pickle, const char *key);

/* Look up an item by key or by index. These functions return NULL if there is no such item, or if
 * the first argument is NULL or of the wrong kind: spin_value_get() requires a dict,
 * spin_value_at() a list or a tuple. */
const struct spin_value *spin_value_get(const struct spin_value *dict, const char *key);
const struct spin_value *spin_value_at(const struct spin_value *list_or_tuple, size_t index);
/* Read a number from a value of kind BOOL, INT or FLOAT, or from a tensor of one element; returns
 * false for all other values and for NULL. */
bool spin_value_number(const struct spin_value *v, double *out);
const char *spin_value_text(const struct spin_value *v);
bool spin_value_is_sequence(const struct spin_value *v); /* true for a list or a tuple */

/* ---- Checkpoints ----------------------------------------------------------------------------- */

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
