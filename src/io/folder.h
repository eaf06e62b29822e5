/* A folder that an export fills: begin, write files into it, end; or abandon. */
#ifndef SPIN_IO_FOLDER_H
#define SPIN_IO_FOLDER_H

#include "io/file.h"

struct spin_out_folder {
    char *path;
    bool created;    /* by us */
    size_t n_before; /* entries that were there */
};
/* Makes the folder, or takes one that is empty; one with entries only when force. */
spin_status spin_out_folder_begin(const char *path, bool force, struct spin_out_folder *out);
void spin_out_folder_end(struct spin_out_folder *folder);
/* Also removes it when it was made by begin and is still empty. */
void spin_out_folder_abandon(struct spin_out_folder *folder);

#endif
