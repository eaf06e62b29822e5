/* A pickle machine that builds data and never runs code.
 *
 * Protocols 2 to 5. Globals are names, not things: the few that stand for plain data (OrderedDict,
 * torch's tensor rebuilders, numpy's array rebuilders, argparse.Namespace, ...) are known by a
 * whitelist and become values; any other is an error that names it, even when it is never called.
 * Depth, memo, lengths and the sum of all values are bounded by the size of the input.
 *
 * What comes out is a graph of values, for a list may hold itself, and sixty pairs of pairs are a
 * tree of 2^60. Look things up; never walk it all. */
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
    SPIN_VALUE_DICT,   /* item holds key, value, key, value, ... in the order of the file */
    SPIN_VALUE_TENSOR, /* torch tensor or numpy array: see tensor */
    SPIN_VALUE_OBJECT  /* a whitelisted class: name in text; its state, if any, in item[0] */
};

struct spin_value {
    enum spin_value_kind kind;
    int64_t integer;          /* BOOL, INT */
    double number;            /* FLOAT; also set for BOOL and INT */
    const char *text;         /* TEXT, BYTES, OBJECT: NUL-terminated after n bytes */
    size_t n;                 /* bytes of text, or items */
    struct spin_value **item; /* LIST, TUPLE, DICT (2 n pointers for n pairs), OBJECT */
    struct spin_array tensor;
};

/* A storage that tensors refer to by its key. */
struct spin_storage {
    const char *key;
    char kind;                 /* as in struct spin_array */
    int item_size;             /* bytes */
    uint64_t count;            /* elements */
    const unsigned char *data; /* of spin_pickle_parse_legacy() only */
};

struct spin_pickle {
    const struct spin_value *root;
    struct spin_arena arena;      /* owns all values and text */
    size_t used;                  /* bytes of the input up to and with STOP */
    struct spin_storage *storage; /* [n_storages] sorted by key (strcmp), each once */
    size_t n_storages;
    bool big_endian; /* the storages are (legacy streams) */
};

/* `what` names it in messages. Storages stay unbound. To be freed with spin_pickle_free(). */
spin_status spin_pickle_parse(const char *what, const unsigned char *bytes, size_t n,
                              struct spin_pickle *out);
/* The raw stream that torch.save wrote before 1.6: five pickles, then the storages, whose data
 * point into `bytes`. */
bool spin_pickle_is_legacy(const unsigned char *bytes, size_t n);
spin_status spin_pickle_parse_legacy(const char *what, const unsigned char *bytes, size_t n,
                                     struct spin_pickle *out);

void spin_pickle_free(struct spin_pickle *pickle);
/* NULL when there is none. */
const struct spin_storage *spin_pickle_storage(const struct spin_pickle *pickle, const char *key);

/* NULL when v is NULL, of another kind, or has no such key or index. */
const struct spin_value *spin_value_get(const struct spin_value *dict, const char *key);
const struct spin_value *spin_value_at(const struct spin_value *list_or_tuple, size_t index);
/* BOOL, INT, FLOAT, and tensors of one element. */
bool spin_value_number(const struct spin_value *v, double *out);
const char *spin_value_text(const struct spin_value *v);
bool spin_value_is_sequence(const struct spin_value *v); /* list or tuple */
