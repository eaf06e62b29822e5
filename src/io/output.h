/* Outputs: looked at and locked before long work, as what would fail at its end should fail at its
 * begin; folders that an export fills, and the names of the numbered files in them. */
#pragma once

#include "io/file.h"

/* A file of this name can be written: spin_out_open() is tried, and nothing is left. */
spin_status spin_output_check_file(const char *path, bool force);
/* A folder that files can be written to; made when it is not there. */
spin_status spin_output_check_folder(const char *path);
/* The same, and unless force nothing may be in it. */
spin_status spin_output_check_empty_folder(const char *path, bool force);
/* No two of the n outputs have one name; NULL is none. SPIN_E_USAGE names it. */
spin_status spin_output_check_distinct(const char *const *path, int n);

/* Space on the disk that is kept for what is still to be written: a file without a name, which the
 * system frees when the process ends, however it ends. */
struct spin_reserve {
    int fd; /* where bytes > 0 */
    uint64_t bytes;
};
/* Keep this much where `path` lies; 0: free it. False: so much is not there, and what was kept
 * stays. Where file systems cannot reserve, the free space is compared instead, and nothing is
 * kept. */
bool spin_reserve_set(struct spin_reserve *reserve, const char *path, uint64_t bytes);

/* One process at a time works on an output: a lock on output.lock, which the system gives up when
 * the process ends, however it ends. A file that a killed process left behind is no lock. */
struct spin_output_lock {
    char *path; /* NULL: none is held */
    int fd;
};
/* SPIN_E_IO when another process holds it. Over NFS it holds between machines; a file system
 * without locks gives a warning. */
spin_status spin_output_lock_take(const char *output, struct spin_output_lock *out);
/* Also removes the file. */
void spin_output_lock_drop(struct spin_output_lock *lock);

/* A folder that an export fills: begin, write files into it, end; or abandon. */
struct spin_output_folder {
    char *path;
    bool created;    /* by us */
    size_t n_before; /* entries that were there */
};
/* Makes the folder, or takes one that is empty; one with entries only when force. What killed
 * writers of files with this ending have left in it is removed. */
spin_status spin_output_folder_begin(const char *path, bool force, const char *ending,
                                     struct spin_output_folder *out);
/* A warning that what is in it and not overwritten stays. */
void spin_output_folder_warn(const struct spin_output_folder *folder);
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
