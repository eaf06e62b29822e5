/* A pickle reader that builds data and never runs code.
 *
 * Protocols 2 to 5. Globals are looked up by name in a list of those that represent plain data
 * (OrderedDict, torch's tensor rebuilders, numpy's array rebuilders, argparse.Namespace, ...). Any
 * other global is an error, even if it is never called. Depth, memo, lengths and the total size of
 * the values are bounded by the size of the input.
 *
 * The result is a graph: a list may contain itself, and sixty nested pairs can form a tree of 2^60
 * nodes. Look up values; never traverse all of them. */
#pragma once

#include "base/mem.h"
#include "io/array.h"

enum spin_value_kind {
    SPIN_VALUE_NONE,
    SPIN_VALUE_BOOL,
    SPIN_VALUE_INT,
    SPIN_VALUE_FLOAT,
    SPIN_VALUE_TEXT, /* str */
    SPIN_VALUE_BYTES,
    SPIN_VALUE_LIST,
    SPIN_VALUE_TUPLE,
    SPIN_VALUE_DICT,   /* item is key, value, key, value, ... in the order of the file */
    SPIN_VALUE_TENSOR, /* torch tensor or numpy array, in `tensor` */
    SPIN_VALUE_OBJECT /* text: the name of a listed class; item[0]: the object's state, if n is 1 */
};

struct spin_value {
    enum spin_value_kind kind;
    int64_t integer;          /* BOOL, INT */
    double number;            /* FLOAT; also set for BOOL and INT */
    const char *text;         /* TEXT, BYTES, OBJECT; NUL-terminated */
    size_t n;                 /* bytes of TEXT and BYTES, pairs of DICT, else items */
    struct spin_value **item; /* LIST, TUPLE, DICT (2 n pointers for n pairs), OBJECT */
    struct spin_array tensor;
};

/* A storage, to which tensors refer by its key. */
struct spin_storage {
    const char *key;
    char kind;                 /* see struct spin_array */
    int item_size;             /* bytes */
    uint64_t count;            /* elements */
    const unsigned char *data; /* set by spin_pickle_parse_legacy() only */
};

struct spin_pickle {
    const struct spin_value *root;
    struct spin_arena arena;      /* owns all values and text */
    size_t used;                  /* bytes of the input up to and including STOP */
    struct spin_storage *storage; /* [n_storages] sorted by key (strcmp), without duplicates */
    size_t n_storages;
    bool big_endian; /* byte order of the storages (legacy streams) */
};

/* `what` names the input in messages. Tensors of torch are not bound to their storages yet. Free
 * with spin_pickle_free(). */
spin_status spin_pickle_parse(const char *what, const unsigned char *bytes, size_t n,
                              struct spin_pickle *out);
/* The stream that torch.save wrote before 1.6: five pickles, then the storages, whose data point
 * into `bytes`. */
bool spin_pickle_is_legacy(const unsigned char *bytes, size_t n);
spin_status spin_pickle_parse_legacy(const char *what, const unsigned char *bytes, size_t n,
                                     struct spin_pickle *out);

void spin_pickle_free(struct spin_pickle *pickle);
/* The storage with this key, or NULL. */
const struct spin_storage *spin_pickle_storage(const struct spin_pickle *pickle, const char *key);

/* NULL if v is NULL, is of another kind, or does not have this key or index. */
const struct spin_value *spin_value_get(const struct spin_value *dict, const char *key);
const struct spin_value *spin_value_at(const struct spin_value *list_or_tuple, size_t index);
/* Returns false unless v is BOOL, INT, FLOAT, or a tensor of one element. */
bool spin_value_number(const struct spin_value *v, double *out);
const char *spin_value_text(const struct spin_value *v);
bool spin_value_is_sequence(const struct spin_value *v); /* list or tuple */
