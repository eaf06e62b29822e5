/* Inside of the pickle machine: its stack, memo and storages. pickle_types.c knows the whitelisted globals and makes
 * tensors and arrays of them, pickle.c does all else. */
#ifndef SPIN_IO_PICKLE_MACHINE_H
#define SPIN_IO_PICKLE_MACHINE_H

#include "io/pickle.h"

/* Values may take this much beyond the bytes of the input. Real checkpoints need kilobytes. */
#define BUDGET ((size_t)32 << 20)
#define SLAB ((size_t)16 << 10)
#define MAX_DEPTH 256

enum role {
    PLAIN,
    GLOBAL,   /* id says which */
    DTYPE,    /* tensor: kind, item_size, big_endian */
    STORAGE,  /* tensor: kind, item_size, storage or data, storage_count, offset (old views) */
    ORDERED,  /* a dict that was an OrderedDict */
    UNFILLED, /* a numpy array whose BUILD is to come */
    INSTANCE  /* of the class id; its BUILD may come */
};

struct spin_pickle_node {
    unsigned char role, id;
    uint16_t depth;
    struct spin_value v;
};

struct spin_pickle_machine {
    const char *what;
    const unsigned char *start, *p, *end;
    const unsigned char *op; /* where the current opcode is */
    struct spin_arena *arena;
    char *slab;
    size_t slab_left, budget;
    struct spin_value **stack, **memo;
    size_t n_stack, stack_capacity, n_memo, memo_capacity;
    size_t *mark, n_marks, mark_capacity;
    struct spin_storage *storage; /* one for each persistent id, unsorted */
    size_t n_storages, storage_capacity;
    size_t n_ops;
    int level; /* 1: inside _load_from_bytes */
    struct spin_value *none, *yes, *no, *empty_tuple, *small[256];
};

static inline struct spin_pickle_node *spin_pickle_node(struct spin_value *v)
{
    return (struct spin_pickle_node *)(void *)((char *)v - offsetof(struct spin_pickle_node, v));
}

/* Values below the last mark stay. */
static inline size_t spin_pickle_floor(const struct spin_pickle_machine *m)
{
    return m->n_marks ? m->mark[m->n_marks - 1] : 0;
}

static inline struct spin_value *spin_pickle_pop(struct spin_pickle_machine *m)
{
    return m->stack[--m->n_stack];
}

spin_status spin_pickle_fail_at(const struct spin_pickle_machine *m, spin_status code,
                                const char *why);
spin_status spin_pickle_bad(const struct spin_pickle_machine *m, const char *why);
const char *spin_pickle_shown(const char *text, size_t n, char out[100]);
spin_status spin_pickle_take(struct spin_pickle_machine *m, size_t bytes, void **out);
spin_status spin_pickle_new_node(struct spin_pickle_machine *m, enum spin_value_kind kind,
                                 enum role role, struct spin_pickle_node **out);
spin_status spin_pickle_room_for(struct spin_pickle_machine *m, void **array, size_t n,
                                 size_t *capacity, size_t size);
spin_status spin_pickle_push(struct spin_pickle_machine *m, struct spin_value *v);
spin_status spin_pickle_need(const struct spin_pickle_machine *m, size_t n);
spin_status spin_pickle_push_int(struct spin_pickle_machine *m, int64_t value);
spin_status spin_pickle_push_float(struct spin_pickle_machine *m, double value);
spin_status spin_pickle_push_constant(struct spin_pickle_machine *m, struct spin_value **kept,
                                      enum spin_value_kind kind, int value);
spin_status spin_pickle_copy_text(struct spin_pickle_machine *m, const void *text, size_t n,
                                  const char **out);
spin_status spin_pickle_deepen(struct spin_pickle_machine *m, struct spin_pickle_node *parent,
                               struct spin_value *child);
spin_status spin_pickle_append(struct spin_pickle_machine *m, struct spin_value *to, size_t have,
                               struct spin_value *const *from, size_t n);

/* pickle_types.c: what the opcodes make of globals; each takes its arguments from the stack or the input. */
spin_status spin_pickle_op_global(struct spin_pickle_machine *m);
spin_status spin_pickle_op_stack_global(struct spin_pickle_machine *m);
spin_status spin_pickle_op_persistent_id(struct spin_pickle_machine *m);
spin_status spin_pickle_op_reduce(struct spin_pickle_machine *m);
spin_status spin_pickle_op_newobj(struct spin_pickle_machine *m);
spin_status spin_pickle_op_build(struct spin_pickle_machine *m);
/* The key of a storage: up to 20 digits. */
bool spin_pickle_is_key(const struct spin_value *v);

/* pickle.c: torch.storage._load_from_bytes, a whole legacy stream in a bytes object, pushed as one storage. */
spin_status spin_pickle_load_from_bytes(struct spin_pickle_machine *m,
                                        const struct spin_value *args);

#endif
