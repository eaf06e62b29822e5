/* Files: mapping, listing, parts of paths. Functions that write (struct spin_out, spin_folder_make)
 * are in spin.h, because plug-ins use them too. */
#pragma once

#include <sys/stat.h>

#include "spin.h"

/* A file mapped for reading. An empty file has data == "" and size 0. */
struct spin_map {
    const unsigned char *data;
    size_t size;
};
/* Error messages contain the path. Folders, fifos, missing files and Git LFS pointers are
 * errors. */
spin_status spin_map_open(const char *path, struct spin_map *out);
void spin_map_close(struct spin_map *map);
/* Check that the file has not changed since it was mapped. Call this before reading a file long
 * after it was opened, since reading a truncated part ends the process (spin_catch_cut_files()). */
spin_status spin_map_check(const struct spin_map *map);
/* Remove the pages of these bytes from the process's memory. The pages stay in the system's cache
 * and are mapped again on access, so that large files can be read in little memory. Bytes outside
 * the map are ignored. */
void spin_map_forget(const struct spin_map *map, const void *bytes, size_t n);
/* spin_map_forget() without its check: the bytes must lie in a map. */
void spin_map_rest(const void *bytes, size_t n);
/* CRC-32 of zip and gzip. crc: the result for the preceding bytes, or 0. */
uint32_t spin_crc32(uint32_t crc, const void *data, size_t n);

/* Digest that identifies a file by its contents, not by its name or time. */
struct spin_imprint {
    uint64_t size;
    uint32_t crc; /* CRC-32 of all bytes */
};
struct spin_imprint spin_map_imprint(const struct spin_map *map);

/* Read the first n bytes of a file, or all if it is shorter; *n_out receives their number. Errors
 * as in spin_map_open(). */
spin_status spin_file_head(const char *path, void *out, size_t n, size_t *n_out);

bool spin_path_exists(const char *path);
/* Whether the name exists, even as a dangling link: outputs must not replace it without --force. */
bool spin_path_is_taken(const char *path);
bool spin_path_is_folder(const char *path);
/* "dir/name", allocated. */
spin_status spin_path_join(const char *dir, const char *name, char **out);
/* The folder part of the path, or "." if it has none, allocated. */
spin_status spin_path_folder(const char *path, char **out);
/* The last component; points into path. */
const char *spin_path_name(const char *path);
/* Absolute path with links resolved, allocated. Fails if the path does not exist. */
spin_status spin_path_absolute(const char *path, char **out);
/* Path of `to` as seen from the folder `from` (both exist), allocated: relative if both have a
 * common parent other than the root, else absolute. */
spin_status spin_path_relative(const char *from, const char *to, char **out);
/* Bytes available on the file system of an existing path; UINT64_MAX if unknown. */
uint64_t spin_path_free_bytes(const char *path);

/* Entries of a folder, without . and .., sorted by bytes; names[n] is NULL. */
spin_status spin_folder_list(const char *path, char ***names, size_t *n);
void spin_folder_list_free(char **names);

/* The last group of digits in the stem of a file name, or -1 ("frame_10.ply" -> 10). */
long long spin_path_number(const char *path);

/* Suffix of the name of an unfinished file or folder: ".tmp.PID." and 16 hexadecimal digits. The
 * first 8 identify the host and container in which PID is valid; the others are a hash of process,
 * time and a counter. Names can still collide in theory: create files with O_EXCL. */
enum { SPIN_OUT_SUFFIX = 48 };
void spin_out_suffix(char suffix[SPIN_OUT_SUFFIX]);
/* Remove unfinished versions of `path` whose writers were killed. If a writer ran on another host
 * or in another container, its file is kept for an hour after the last write. */
void spin_out_sweep(const char *path);
/* Remove a file, or a folder with its contents, without following links; returns the size of the
 * removed files in bytes. */
uint64_t spin_out_remove(const char *path);
/* spin_out_sweep() for all files in a folder whose names have this extension, such as ".ply". */
void spin_out_sweep_folder(const char *folder, const char *ending);
/* Write bytes at an offset of an output file (see spin.h), bypassing the buffer of
 * spin_out_write(), which must be empty. Thread-safe, so that threads can write parts in parallel.
 * Returns 0 or an errno, which the thread that reports the error converts with
 * spin_out_failed(). */
int spin_out_put(struct spin_out *out, uint64_t at, const void *data, size_t bytes);
spin_status spin_out_failed(const struct spin_out *out, int error);
spin_status spin_out_write_at(struct spin_out *out, uint64_t at, const void *data, size_t bytes);
/* Length of the file so far, including buffered bytes. */
spin_status spin_out_length(struct spin_out *out, uint64_t *bytes);
/* Write these bytes as a whole file, replacing an existing one. sync: see struct spin_out. */
spin_status spin_out_whole(const char *path, const void *data, size_t bytes, bool sync);

/* Whether a file of this name may be written: SPIN_E_IO if the file exists and force is not set, if
 * it is not a regular file, or if it is an input of a running call (even with force). All code that
 * writes files calls this, mostly through spin_out_open(). */
spin_status spin_out_check(const char *path, bool force);

/* ---- inputs.c: the input files of running calls, which outputs must not replace ---- */

/* Record inputs from begin to end: SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin().
 * Nested calls share the set of inputs. Thread-safe. */
int spin_inputs_begin(void);
void spin_inputs_end(const int *begun);
/* Record a file as an input. spin_map_open() and the readers of images and videos do so; only call
 * this for files that will be read by other code, such as a library. A path that is NULL or not a
 * regular file is ignored. */
spin_status spin_inputs_add(const struct stat *st);
spin_status spin_inputs_add_path(const char *path);
/* Record a file as written by this call, which may then replace it even after reading it. */
void spin_inputs_own(const char *path);
bool spin_inputs_have(const struct stat *st);
/* While paused, files that this thread opens are not recorded. Use this while searching for a file:
 * the search also opens files that are not inputs, possibly an earlier output. */
void spin_inputs_pause(bool pause);

/* ---- watch.c: end the process in order if another one truncates a mapped file ---- */

/* Called by spin_map_open() and spin_map_close(). */
void spin_watch_map(const void *data, const char *path, const struct stat *st);
void spin_unwatch_map(const void *data);
/* SPIN_E_IO if the file of a watched map has changed size or time. A file that was removed or
 * replaced is still complete in the map. */
spin_status spin_watch_check(const void *data);

/* Register a temporary file, or a new folder, for removal in case a truncated file ends the
 * process. spin_unwatch_out() with the same pointer cancels this. */
void spin_watch_out(const char *path);
void spin_unwatch_out(const char *path);
