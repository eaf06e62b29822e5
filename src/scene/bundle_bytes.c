/* What can be said of a bundle by the names of its members. */
#include <string.h>

#include "scene/bundle.h"

#include "spin_run.h"

static bool begins(const char *text, const char *with)
{
    return strncmp(text, with, strlen(with)) == 0;
}

/* SOG is a zip with a meta.json, too. */
bool spin_bundle_looks_like(const char *path)
{
    struct spin_zip zip;
    bool meta, source = false;

    if (spin_zip_open(path, &zip) != SPIN_OK)
        return false;
    meta = spin_zip_find(&zip, "meta.json") != NULL;
    for (size_t i = 0; i < zip.n; i++)
        source = source || begins(zip.member[i].name, "source/");
    spin_zip_close(&zip);
    return meta && source;
}

/* Where a member counts; NULL: in the file alone. */
static uint64_t *part_of(struct spin_bundle_bytes *bytes, const char *name)
{
    if (begins(name, "source/"))
        return &bytes->source;
    if (begins(name, "refined/"))
        return &bytes->refined;
    if (begins(name, "network/means/") || begins(name, "network/residual/"))
        return &bytes->positions;
    if (begins(name, "network/track"))
        return &bytes->tracks;
    if (begins(name, "network/table"))
        return &bytes->table;
    return begins(name, "network/") ? &bytes->heads : NULL;
}

void spin_bundle_weigh(const struct spin_bundle *bundle, struct spin_bundle_bytes *packed,
                       struct spin_bundle_bytes *unpacked)
{
    const struct spin_zip *zip = &bundle->npz.zip;

    memset(packed, 0, sizeof *packed);
    packed->file = zip->map.size;
    *unpacked = *packed;
    for (size_t i = 0; i < zip->n; i++) {
        const struct spin_zip_member *member = &zip->member[i];

        unpacked->file += member->size - member->packed_size;
        if (part_of(packed, member->name)) {
            *part_of(packed, member->name) += member->packed_size;
            *part_of(unpacked, member->name) += member->size;
        }
    }
}
