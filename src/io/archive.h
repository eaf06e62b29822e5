/* Unpacks zip archives, tar archives (plain or compressed with gzip) and single files compressed
 * with gzip to a temporary folder. Archives are not trusted: names that lead out of the folder,
 * duplicate names, links, devices and archives that unpack to far more than their own size are
 * refused. */
#pragma once

#include "spin.h"

struct spin_unpacked {
    char *folder; /* the temporary folder; NULL: nothing was unpacked */
    char *root;   /* the folder in `folder` that contains the members of the archive */
    /* The first path, from `root` downwards, that is a file or a folder with several entries. */
    char *path;
};

/* Whether the file begins like an archive that spin_archive_unpack() reads. False for checkpoints
 * of PyTorch and for .npz files of NumPy, although they are zip files. */
bool spin_archive_detect(const char *path);
/* Unpacks the archive. Until spin_unpacked_remove(), messages show the path of the archive instead
 * of the path of the temporary folder. */
spin_status spin_archive_unpack(const char *path, struct spin_unpacked *out);
/* Removes the temporary folder, also after a failure of spin_archive_unpack(). */
void spin_unpacked_remove(struct spin_unpacked *u);
