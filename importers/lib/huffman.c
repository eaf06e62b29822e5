/* Huffman codes by their table. */
#include "importers/lib/huffman.h"

#include <stdlib.h>

#include "base/mem.h"

#define MAX_CODE_BITS 63

/* Of nodes; leaves have a label >= 0, or END. */
enum { INNER = -1, END = -2 };

static spin_status new_node(struct huffman *tree, uint32_t *out)
{
    if (tree->n > UINT32_MAX / 2)
        return spin_fail(SPIN_E_MALFORMED, "a Huffman table is too large");
    SPIN_TRY(spin_room(tree->n, &tree->capacity, sizeof *tree->node, (void **)&tree->node));
    *out = (uint32_t)tree->n;
    tree->node[tree->n++] = (struct huffman_node){{0, 0}, INNER};
    return SPIN_OK;
}

static spin_status add_code(struct huffman *tree, int bits, uint64_t code, int64_t label)
{
    uint32_t at = 0;

    for (int b = bits - 1; b >= 0; b--) {
        int side = (int)(code >> b & 1);
        uint32_t next = tree->node[at].child[side];

        if (tree->node[at].label != INNER)
            return spin_fail(SPIN_E_MALFORMED, "one Huffman code is the beginning of another");
        if (next == 0) {
            SPIN_TRY(new_node(tree, &next));
            tree->node[at].child[side] = next;
        }
        at = next;
    }
    if (tree->node[at].label != INNER || tree->node[at].child[0] || tree->node[at].child[1])
        return spin_fail(SPIN_E_MALFORMED,
                         "two Huffman codes are equal, or one is the beginning of the other");
    tree->node[at].label = label;
    return SPIN_OK;
}

spin_status spin_huffman_build(const struct spin_value *table, struct huffman *tree)
{
    uint32_t root;

    if (!table || table->kind != SPIN_VALUE_DICT || table->n == 0)
        return spin_fail(SPIN_E_MALFORMED, "a Huffman table is not a dict, or empty");
    SPIN_TRY(new_node(tree, &root));
    for (size_t i = 0; i < table->n; i++) {
        const struct spin_value *key = table->item[2 * i], *entry = table->item[2 * i + 1];
        const struct spin_value *bits = spin_value_at(entry, 0), *code = spin_value_at(entry, 1);
        double label = END;

        if (key->kind != SPIN_VALUE_OBJECT &&
            (!spin_value_number(key, &label) || !(label >= 0) || label > 1e9))
            return spin_fail(SPIN_E_MALFORMED, "a Huffman table has a label that is no number");
        if (!bits || !code || bits->kind != SPIN_VALUE_INT || code->kind != SPIN_VALUE_INT ||
            bits->integer < 1 || bits->integer > MAX_CODE_BITS || code->integer < 0 ||
            code->integer >> bits->integer != 0)
            return spin_fail(SPIN_E_MALFORMED,
                             "a Huffman table has a code that is not (bits, value) of at most %d "
                             "bits",
                             MAX_CODE_BITS);
        SPIN_TRY(add_code(tree, (int)bits->integer, (uint64_t)code->integer, (int64_t)label));
    }
    return SPIN_OK;
}

spin_status spin_huffman_read(const struct huffman *tree, const struct spin_value *bytes, size_t n,
                              uint64_t n_labels, uint32_t *out)
{
    uint32_t at = 0;
    size_t found = 0;

    for (size_t i = 0; i < 8 * bytes->n; i++) {
        int bit = (unsigned char)bytes->text[i / 8] >> (7 - i % 8) & 1;
        int64_t label;

        at = tree->node[at].child[bit];
        if (at == 0) {
            if (found == n) /* padding behind the last label */
                return SPIN_OK;
            return spin_fail(SPIN_E_MALFORMED, "the bits after label %zu are no Huffman code",
                             found);
        }
        label = tree->node[at].label;
        if (label == INNER)
            continue;
        if (label == END)
            break;
        if ((uint64_t)label >= n_labels)
            return spin_fail(SPIN_E_MALFORMED, "label %lld, but the codebook has %llu entries",
                             (long long)label, (unsigned long long)n_labels);
        if (found == n)
            return spin_fail(SPIN_E_MALFORMED, "more than %zu labels", n);
        out[found++] = (uint32_t)label;
        at = 0;
    }
    if (found != n)
        return spin_fail(SPIN_E_MALFORMED, "%zu labels, expected %zu", found, n);
    return SPIN_OK;
}

void spin_huffman_free(struct huffman *tree) { free(tree->node); }
