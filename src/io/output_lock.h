/* Outputs, looked at and locked before long work: what would fail at its end fails at its begin. */
#ifndef SPIN_IO_OUTPUT_LOCK_H
#define SPIN_IO_OUTPUT_LOCK_H

#include "io/file.h"

/* A file of this name can be written: spin_out_open() is tried, and nothing is left. */
spin_status spin_output_check_file(const char *path, bool force);
/* A folder that files can be written to; made when it is not there. */
spin_status spin_output_check_folder(const char *path);
/* The same, and unless force nothing may be in it. */
spin_status spin_output_check_empty_folder(const char *path, bool force);

/* One process at a time works on an output: a lock on output.lock, which the system gives up when the
 * process ends, however it ends. A file that a killed process left behind is no lock. */
struct spin_output_lock {
    char *path; /* NULL: none is held */
    int fd;
};
/* SPIN_E_IO when another process holds it. Over NFS it holds between machines; a file system without
 * locks gives a warning. */
spin_status spin_output_lock_take(const char *output, struct spin_output_lock *out);
/* Also removes the file. */
void spin_output_lock_drop(struct spin_output_lock *lock);

#endif
