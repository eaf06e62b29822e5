/* The stream that torch.save wrote before 1.6: five pickles, then the storages. */
#include "io/pickle_legacy.h"

#include <string.h>

#include "base/err.h"
#include "io/pickle_run.h"
#include "io/pickle_types.h"

static const unsigned char legacy_magic[15] = {0x80, 0x02, 0x8a, 0x0a, 0x6c, 0xfc, 0x9c, 0x46,
                                               0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19, 0x2e};

bool spin_pickle_is_legacy(const unsigned char *bytes, size_t n)
{
    return n >= sizeof legacy_magic && memcmp(bytes, legacy_magic, sizeof legacy_magic) == 0;
}

/* Count and elements of one storage. */
static spin_status bind_storage(struct spin_pickle_machine *m, const struct spin_pickle *pickle,
                                const struct spin_value *key)
{
    struct spin_storage *s;
    uint64_t count = 0, bytes;
    char name[100];

    m->op = m->p;
    if (!spin_pickle_is_key(key))
        return spin_pickle_bad(m, "a storage whose key is not a number");
    s = (struct spin_storage *)(uintptr_t)spin_pickle_storage(pickle, key->text);
    if (!s)
        return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': storage '%s' is of unknown type",
                         m->what, spin_pickle_shown(key->text, key->n, name));
    if (m->end - m->p < 8)
        return spin_pickle_bad(m, "the storages are cut short");
    for (int i = 0; i < 8; i++)
        count |= (uint64_t)m->p[i] << 8 * (pickle->big_endian ? 7 - i : i);
    m->p += 8;
    if (count != s->count)
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': storage '%s' has %llu elements, expected %llu", m->what,
                         s->key, (unsigned long long)count, (unsigned long long)s->count);
    bytes = count * (uint64_t)s->item_size; /* checked at its persistent id */
    if (bytes > (uint64_t)(m->end - m->p))
        return spin_pickle_bad(m, "the storages are cut short");
    s->data = m->p;
    m->p += bytes;
    return SPIN_OK;
}

/* The pickles: magic number, version, byte order, the object, the keys in order; then the data. */
spin_status spin_pickle_run_legacy(struct spin_pickle_machine *m, struct spin_pickle *out)
{
    const struct spin_value *version, *system, *keys, *little;

    if (!spin_pickle_is_legacy(m->p, (size_t)(m->end - m->p)))
        return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': no stream of torch.save", m->what);
    m->p += sizeof legacy_magic;
    SPIN_TRY(spin_pickle_run(m, &version));
    if (version->kind != SPIN_VALUE_INT || version->integer != 1001)
        return spin_pickle_fail_at(m, SPIN_E_UNSUPPORTED,
                                   "a torch.save stream that is not of version 1001");
    SPIN_TRY(spin_pickle_run(m, &system));
    little = spin_value_get(system, "little_endian");
    if (!little || little->kind != SPIN_VALUE_BOOL)
        return spin_pickle_bad(m, "no word about the byte order");
    out->big_endian = !little->integer;
    m->n_storages = 0;
    SPIN_TRY(spin_pickle_run(m, &out->root));
    SPIN_TRY(spin_pickle_keep_storages(m, out));
    SPIN_TRY(spin_pickle_run(m, &keys));
    if (keys->kind != SPIN_VALUE_LIST)
        return spin_pickle_bad(m, "no list of storages");
    for (size_t i = 0; i < keys->n; i++)
        SPIN_TRY(bind_storage(m, out, keys->item[i]));
    for (size_t i = 0; i < out->n_storages; i++)
        if (!out->storage[i].data)
            return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': storage '%s' is missing", m->what,
                             out->storage[i].key);
    return SPIN_OK;
}

spin_status spin_pickle_load_from_bytes(struct spin_pickle_machine *m,
                                        const struct spin_value *args)
{
    struct spin_pickle_machine inner = {.what = m->what,
                                        .arena = m->arena,
                                        .level = m->level + 1,
                                        .load_from_bytes = m->load_from_bytes};
    struct spin_pickle stream = {0};
    const struct spin_storage *s;
    spin_status status;
    struct spin_pickle_node *node;

    if (args->n != 1 || args->item[0]->kind != SPIN_VALUE_BYTES)
        return spin_pickle_bad(m, "a storage that is not made of bytes");
    if (inner.level > 1)
        return spin_pickle_bad(m, "a stream inside a stream inside a pickle");
    inner.start = inner.op = inner.p = (const unsigned char *)args->item[0]->text;
    inner.end = inner.p + args->item[0]->n;
    inner.budget = m->budget;
    status = spin_pickle_run_legacy(&inner, &stream);
    m->budget = inner.budget;
    spin_pickle_release(&inner);
    SPIN_TRY(status);
    if (stream.root->kind != SPIN_VALUE_OBJECT ||
        spin_pickle_node((struct spin_value *)(uintptr_t)stream.root)->role != STORAGE)
        return spin_pickle_bad(m, "a stream that does not hold one storage");
    s = spin_pickle_storage(&stream, stream.root->tensor.storage);
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_OBJECT, STORAGE, &node));
    node->v.text = stream.root->text;
    node->v.tensor = stream.root->tensor;
    node->v.tensor.storage = NULL;
    node->v.tensor.data = s->data;
    node->v.tensor.big_endian = stream.big_endian && s->item_size > 1;
    return spin_pickle_push(m, &node->v);
}
