/* What can be said of a bundle by the names of its members. */
#include <string.h>

#include "scene/bundle.h"

#include "spin.h"

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
    if (!begins(name, "trained/") && !begins(name, "network/")) /* as it was called before */
        return NULL;
    name = strchr(name, '/') + 1;
    if (begins(name, "means/") || begins(name, "residual/"))
        return &bytes->positions;
    if (begins(name, "track"))
        return &bytes->tracks;
    return begins(name, "table") ? &bytes->table : &bytes->heads;
}

/* What a member has unpacked. Planes of bytes that would be 0 are left out of the file. */
static uint64_t unpacked_size(const struct spin_bundle *bundle,
                              const struct spin_zip_member *member)
{
    char name[80];
    struct spin_array a;
    size_t length = strlen(member->name);

    if (length < 5 || length - 4 >= sizeof name || strcmp(member->name + length - 4, ".npy") != 0)
        return member->size;
    memcpy(name, member->name, length - 4);
    name[length - 4] = '\0';
    if (spin_npz_head(&bundle->npz, name, &a) != SPIN_OK || a.kind != 'i' || a.item_size != 1 ||
        a.n_dims < 2 || a.shape[0] < 1 || a.shape[0] > 4)
        return member->size;
    return member->size + a.count / a.shape[0] * (4 - a.shape[0]);
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
        uint64_t size = unpacked_size(bundle, member);

        unpacked->file += size - member->packed_size;
        if (part_of(packed, member->name)) {
            *part_of(packed, member->name) += member->packed_size;
            *part_of(unpacked, member->name) += size;
        }
    }
}

spin_json *spin_bundle_bytes_json(const struct spin_bundle_bytes *bytes)
{
    return json_pack("{s:I, s:I, s:I, s:I, s:I, s:I, s:I}", "file", (json_int_t)bytes->file,
                     "source", (json_int_t)bytes->source, "refined", (json_int_t)bytes->refined,
                     "positions", (json_int_t)bytes->positions, "tracks", (json_int_t)bytes->tracks,
                     "table", (json_int_t)bytes->table, "heads", (json_int_t)bytes->heads);
}
