/* Unpacks zip and tar archives, also those that gzip has packed, and single files that gzip has
 * packed, to a temporary folder. Archives are not trusted: names that leave the folder, duplicate
 * names, links, devices and archives that unpack to far more than their own size are refused. */
#pragma once

#include "spin.h"

struct spin_unpacked {
    char *folder; /* the temporary folder; NULL: nothing was unpacked */
    char *root;   /* the folder in it that has the contents of the archive */
    char *path;   /* the contents: `root` or, while a folder has a single entry, that entry */
};

/* Whether the file begins like an archive that spin_archive_unpack() reads. False for checkpoints
 * of PyTorch, which are zip files. */
bool spin_archive_detect(const char *path);
/* Unpacks the archive. Until spin_unpacked_remove(), messages show the path of the archive in place
 * of that of the temporary folder. */
spin_status spin_archive_unpack(const char *path, struct spin_unpacked *out);
/* Removes the temporary folder, also after a failure of spin_archive_unpack(). */
void spin_unpacked_remove(struct spin_unpacked *u);
