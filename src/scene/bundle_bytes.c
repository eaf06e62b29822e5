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

void spin_bundle_weigh(const struct spin_bundle *bundle, struct spin_bundle_bytes *out)
{
    const struct spin_zip *zip = &bundle->npz.zip;

    out->file = zip->map.size;
    for (size_t i = 0; i < zip->n; i++) {
        const struct spin_zip_member *member = &zip->member[i];

        if (begins(member->name, "source/"))
            out->source += member->packed_size;
        else if (begins(member->name, "refined/"))
            out->refined += member->packed_size;
        else if (begins(member->name, "network/means/") ||
                 begins(member->name, "network/residual/"))
            out->positions += member->packed_size;
        else if (begins(member->name, "network/track"))
            out->tracks += member->packed_size;
        else if (begins(member->name, "network/table"))
            out->table += member->packed_size;
        else if (begins(member->name, "network/"))
            out->heads += member->packed_size;
    }
}
