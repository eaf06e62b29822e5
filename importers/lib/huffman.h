/* Huffman codes as the Python package dahuffman pickles them: the table is the code, as it need not be
 * canonical. */
#ifndef SPIN_IMPORTERS_LIB_HUFFMAN_H
#define SPIN_IMPORTERS_LIB_HUFFMAN_H

#include "io/pickle.h"

struct huffman_node {
    uint32_t child[2]; /* 0: none */
    int64_t label;
};

struct huffman {
    struct huffman_node *node;
    size_t n, capacity;
};

/* From the table {label: (bits, code), ..., end mark: (bits, code)}; *tree is zero before. */
spin_status spin_huffman_build(const struct spin_value *table, struct huffman *tree);
/* n labels below n_labels. The end mark may be missing or cut off: what counts is how many came. */
spin_status spin_huffman_read(const struct huffman *tree, const struct spin_value *bytes, size_t n,
                              uint64_t n_labels, uint32_t *out);
void spin_huffman_free(struct huffman *tree);

#endif
