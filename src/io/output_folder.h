/* A folder that an export fills: begin, write files into it, end; or abandon. And the names of the
 * numbered files in it. */
#ifndef SPIN_IO_OUTPUT_FOLDER_H
#define SPIN_IO_OUTPUT_FOLDER_H

#include "io/file.h"

struct spin_output_folder {
    char *path;
    bool created;    /* by us */
    size_t n_before; /* entries that were there */
};
/* Makes the folder, or takes one that is empty; one with entries only when force. What killed writers of files
 * with this ending have left in it is removed. */
spin_status spin_output_folder_begin(const char *path, bool force, const char *ending,
                                     struct spin_output_folder *out);
void spin_output_folder_end(struct spin_output_folder *folder);
/* Also removes it when it was made by begin and is still empty. */
void spin_output_folder_abandon(struct spin_output_folder *folder);

/* A name with a number in it, taken apart. */
struct spin_pattern {
    const char *text;
    int n_before; /* bytes before the field */
    bool zeros;
    int width;
    const char *after; /* rest after the field */
};
/* `text` (borrowed) is a file name with exactly one %d or %0Nd, N 1 to 9. SPIN_E_USAGE names
 * --pattern. */
spin_status spin_pattern_parse(const char *text, struct spin_pattern *out);
/* folder/name with the number filled in, allocated. */
spin_status spin_pattern_path(const struct spin_pattern *pattern, const char *folder, int number,
                              char **out);

#endif
