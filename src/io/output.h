/* Checks and locks of outputs, for use before a long computation so that errors appear early; the
 * folders that exports fill; the names of numbered files. */
#pragma once

#include "io/file.h"
#include "io/json.h"

/* Check that a file can be written, by opening it with spin_out_open() and discarding it. */
spin_status spin_output_check_file(const char *path, bool force);
/* Check that a folder is writable; create it if it does not exist. */
spin_status spin_output_check_folder(const char *path);
/* spin_output_check_folder() that also checks, without force, that the folder is empty. */
spin_status spin_output_check_empty_folder(const char *path, bool force);
/* Check that no two of the n outputs have the same name; NULL means no output. If two outputs have
 * the same name, SPIN_E_USAGE with a message that names it. */
spin_status spin_output_check_distinct(const char *const *path, int n);

/* Disk space reserved for later output. It is allocated to an unnamed file, which the system frees
 * when the process ends, even if it is killed. */
struct spin_reserve {
    int fd; /* valid if bytes > 0 */
    uint64_t bytes;
};
/* Reserve this many bytes on the file system of `path`; 0 frees the reservation. Returns false if
 * the space is not available; the previous reservation is then kept. On file systems that cannot
 * reserve space, only compares the size with the free space. */
bool spin_reserve_set(struct spin_reserve *reserve, const char *path, uint64_t bytes);

/* Lock that allows one process at a time to write an output. It is a lock on the file OUTPUT.lock,
 * which the system releases when the process ends: a lock file left behind by a killed process is
 * not locked. */
struct spin_output_lock {
    char *path; /* NULL: not locked */
    int fd;
};
/* SPIN_E_IO if another process holds the lock. Works across hosts over NFS; a file system without
 * locks causes a warning. */
spin_status spin_output_lock_take(const char *output, struct spin_output_lock *out);
/* Release the lock and remove the lock file. */
void spin_output_lock_drop(struct spin_output_lock *lock);

#define SPIN_SEQUENCE "sequence.json"

/* A file that sequence.json of a former export lists. */
struct spin_output_former {
    char *name;
    bool written; /* overwritten by this export */
};

/* A folder that an export fills: call begin, write the files, then call end or abandon. Its
 * sequence.json lists them, so that the next export with force can remove those that it does not
 * overwrite. */
struct spin_output_folder {
    char *path;
    bool created;                      /* the folder did not exist before */
    size_t n_before;                   /* entries that existed before */
    struct spin_output_former *former; /* [n_former] sorted by name */
    size_t n_former;
    spin_json *list; /* of spin_output_folder_add(), or NULL */
};
/* Create the folder, or use an existing one, which must be empty unless force is set. Removes
 * unfinished files with this extension whose writers were killed. Warns of files that stay in the
 * folder. */
spin_status spin_output_folder_begin(const char *path, bool force, const char *ending,
                                     struct spin_output_folder *out);
/* This export writes a file of this name, which is kept. */
void spin_output_folder_mark(struct spin_output_folder *folder, const char *path);
/* The same, and lists the file with the number in its name, for spin_output_folder_list(). */
void spin_output_folder_add(struct spin_output_folder *folder, const char *name, int number);
/* Writes sequence.json of all files that were added. */
spin_status spin_output_folder_list(struct spin_output_folder *folder, const char *format,
                                    bool sync);
/* Removes the former export's files that were not marked, and logs their number. */
void spin_output_folder_remove_former(struct spin_output_folder *folder);
void spin_output_folder_end(struct spin_output_folder *folder);
/* End, and remove the folder if begin created it and it is still empty. */
void spin_output_folder_abandon(struct spin_output_folder *folder);

/* A file name with a number in it, split into its parts. */
struct spin_pattern {
    const char *text;
    int n_before; /* bytes before the number */
    bool zeros;   /* pad the number with zeros to `width` digits */
    int width;
    const char *after; /* text after the number */
};
/* Parse `text` (borrowed), a file name with exactly one %d or %0Nd, N from 1 to 9. SPIN_E_USAGE if
 * it is not; the message refers to --pattern. */
spin_status spin_pattern_parse(const char *text, struct spin_pattern *out);
/* folder/name with the number inserted, allocated. */
spin_status spin_pattern_path(const struct spin_pattern *pattern, const char *folder, int number,
                              char **out);
