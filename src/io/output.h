/* Checks and locks of outputs, for use before a long computation so that errors appear early; and
 * the folders that exports fill. */
#pragma once

#include "io/file.h"
#include "io/json.h"

/* Check that a file can be written, by starting to write it with spin_out_open() and then
 * abandoning the output. */
spin_status spin_output_check_file(const char *path, bool force);
/* Check that a folder is writable; create it if it does not exist. */
spin_status spin_output_check_folder(const char *path);
/* Do the same; unless force is set, also check that the folder is empty. */
spin_status spin_output_check_empty_folder(const char *path, bool force);
/* Check that n paths of outputs all differ; entries that are NULL are skipped. If two paths name
 * the same file, returns SPIN_E_USAGE, with a message that contains the path. */
spin_status spin_output_check_distinct(const char *const *path, int n);

/* Disk space reserved for later output. The space is allocated to an unnamed file, which the system
 * frees when the process ends, even if the process is killed. */
struct spin_reserve {
    int fd; /* descriptor of the unnamed file; valid if bytes > 0 */
    uint64_t bytes;
};
/* Reserve this many bytes on the file system of `path`; 0 frees the reservation. Returns false if
 * the space is not available; the previous reservation is then kept. On a file system that cannot
 * reserve space, this function only compares `bytes` with the free space. */
bool spin_reserve_set(struct spin_reserve *reserve, const char *path, uint64_t bytes);

/* A lock that allows only one process at a time to write an output. It is a lock on the file
 * OUTPUT.lock. The system releases the lock when the process ends: a lock file left behind by a
 * killed process is not locked. */
struct spin_output_lock {
    char *path; /* path of the lock file; NULL: the lock is not held */
    int fd;
};
/* Take the lock of an output; SPIN_E_IO if another process holds it. Locks also work between hosts
 * that share a file system over NFS. A file system without locks only causes a warning. */
spin_status spin_output_lock_take(const char *output, struct spin_output_lock *out);
/* Release the lock and remove the lock file. */
void spin_output_lock_drop(struct spin_output_lock *lock);

#define SPIN_SEQUENCE "sequence.json"

/* A file of a former export to the same folder, as listed in its sequence.json, or the folder of a
 * chunk, as listed in the index of a streamed SOG. */
struct spin_output_former {
    char *name;
    bool is_folder;
    bool written; /* this export has overwritten it */
};

/* A folder that an export fills: call spin_output_folder_begin(), write the files, then call
 * spin_output_folder_end() or spin_output_folder_abandon(). The file sequence.json in the folder
 * lists the files written, so that the next export to this folder, with force, can remove the
 * listed files that it does not overwrite. */
struct spin_output_folder {
    char *path;
    bool created;                      /* the folder did not exist before */
    size_t n_before;                   /* number of entries in the folder before this export */
    struct spin_output_former *former; /* [n_former] files of the former export, sorted by name */
    size_t n_former;
    spin_json *list; /* the files passed to spin_output_folder_add(); NULL if there are none */
};
/* Create the folder, or use an existing one, which must be empty unless force is set. Removes
 * unfinished files with the extension `ending` whose writers were killed. Warns if the folder
 * contains files that the former export did not write, since they stay in the folder. */
spin_status spin_output_folder_begin(const char *path, bool force, const char *ending,
                                     struct spin_output_folder *out);
/* Record that this export writes the file at `path`, so that spin_output_folder_remove_former()
 * keeps it. */
void spin_output_folder_mark(struct spin_output_folder *folder, const char *path);
/* Do the same as spin_output_folder_mark(), and add the file to the list for sequence.json. number:
 * the frame number in the file's name. */
void spin_output_folder_add(struct spin_output_folder *folder, const char *name, int number);
/* Write sequence.json, which lists all files that were passed to spin_output_folder_add(). */
spin_status spin_output_folder_list(struct spin_output_folder *folder, const char *format,
                                    bool sync);
/* Remove the files of the former export that this export did not mark, and log their number. */
void spin_output_folder_remove_former(struct spin_output_folder *folder);
void spin_output_folder_end(struct spin_output_folder *folder);
/* spin_output_folder_end() that also removes the folder if spin_output_folder_begin() created it
 * and it is still empty. */
void spin_output_folder_abandon(struct spin_output_folder *folder);
