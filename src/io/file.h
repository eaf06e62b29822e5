/* Files: mapping, listing folders, parts of paths, and the output functions that plug-ins do not
 * use. Those for plug-ins (struct spin_out, spin_folder_make()) are in spin.h. */
#pragma once

#include <sys/stat.h>

#include "spin.h"

/* A file mapped for reading. An empty file has data == "" and size 0. */
struct spin_map {
    const unsigned char *data;
    size_t size;
};
/* Map a file. Folders, fifos, missing files and Git LFS pointers are errors. Error messages contain
 * the path. */
spin_status spin_map_open(const char *path, struct spin_map *out);
void spin_map_close(struct spin_map *map);
/* Check that the file has not changed since it was mapped. Call this before reading a file long
 * after it was opened, since reading a truncated part ends the process (spin_catch_cut_files()). */
spin_status spin_map_check(const struct spin_map *map);
/* Remove the pages of these bytes from the process's memory. The pages stay in the system's cache
 * and are mapped again on access, so that large files can be read in little memory. Bytes outside
 * the map are ignored. */
void spin_map_forget(const struct spin_map *map, const void *bytes, size_t n);
/* Do the same without a check: the caller must ensure that the bytes belong to a map. */
void spin_map_release(const void *bytes, size_t n);
/* Returns the CRC-32 of n bytes, as zip and gzip define it. crc: the CRC-32 of all bytes before
 * these n bytes; 0 if these are the first. */
uint32_t spin_crc32(uint32_t crc, const void *data, size_t n);

/* Digest that identifies a file by its contents, not by its name or time. */
struct spin_digest {
    uint64_t size;
    uint32_t crc; /* CRC-32 of all bytes of the file */
};
struct spin_digest spin_map_digest(const struct spin_map *map);

/* Read the first n bytes of a file, or the whole file if it is shorter; *n_out receives the number
 * of bytes read. Fails for the same files as spin_map_open(). */
spin_status spin_file_head(const char *path, void *out, size_t n, size_t *n_out);

bool spin_path_exists(const char *path);
/* Whether the path exists, even as a dangling link. Without --force, an output must not replace an
 * existing path. */
bool spin_path_is_taken(const char *path);
bool spin_path_is_folder(const char *path);
/* *out receives "dir/name", allocated. */
spin_status spin_path_join(const char *dir, const char *name, char **out);
/* *out receives the folder part of the path, or "." if the path has no folder part; allocated. */
spin_status spin_path_folder(const char *path, char **out);
/* Returns the last component of the path, as a pointer into `path`. */
const char *spin_path_name(const char *path);
/* *out receives the absolute path with links resolved, allocated. Fails if the path does not
 * exist. */
spin_status spin_path_absolute(const char *path, char **out);
/* *out receives the path that leads from the folder `from` to `to`, allocated. It is relative if
 * `to` and `from`, which must exist, have a common parent folder other than the root; otherwise it
 * is absolute. */
spin_status spin_path_relative(const char *from, const char *to, char **out);
/* Returns the number of bytes available on the file system of an existing path; UINT64_MAX if
 * unknown. */
uint64_t spin_path_free_bytes(const char *path);
/* True if the files of this folder are in memory (tmpfs); false if unknown. */
bool spin_path_is_in_memory(const char *path);
/* True if two existing paths are on the same file system. */
bool spin_path_same_disk(const char *a, const char *b);

/* List the names in a folder, without "." and "..", in byte order. (*names)[*n] is NULL. */
spin_status spin_folder_list(const char *path, char ***names, size_t *n);
void spin_folder_list_free(char **names);

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
 * Returns 0 or an error number (errno), which spin_out_failed() converts to an error of the calling
 * thread. spin_out_write_at() does both. */
int spin_out_put(struct spin_out *out, uint64_t at, const void *data, size_t bytes);
spin_status spin_out_failed(const struct spin_out *out, int error);
spin_status spin_out_write_at(struct spin_out *out, uint64_t at, const void *data, size_t bytes);
/* *bytes receives the length of the file so far, including buffered bytes. */
spin_status spin_out_length(struct spin_out *out, uint64_t *bytes);
/* Write these bytes as a whole file, replacing an existing one. sync: see struct spin_out. */
spin_status spin_out_whole(const char *path, const void *data, size_t bytes, bool sync);

/* Check that a file of this name may be written: returns SPIN_E_IO if the file exists and force is
 * not set; if it is not a regular file; or, even with force, if it is an input of a running call.
 * All code that writes files calls this, mostly through spin_out_open(). */
spin_status spin_out_check(const char *path, bool force);

/* ---- inputs.c: the input files of running calls, which outputs must not replace ---- */

/* Record the files that are read between spin_inputs_begin() and spin_inputs_end(). Usage, at the
 * start of a call: SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin(). Nested calls
 * share the set of inputs. Thread-safe. */
int spin_inputs_begin(void);
void spin_inputs_end(const int *begun);
/* Record a file as an input. spin_map_open() and the readers of images and videos already do so;
 * call this only for files that other code will read, such as a library. A path that is NULL or not
 * a regular file is ignored. */
spin_status spin_inputs_add(const struct stat *st);
spin_status spin_inputs_add_path(const char *path);
/* Record that the running call wrote this file. The call may then replace the file, even after
 * reading it. */
void spin_inputs_own(const char *path);
bool spin_inputs_have(const struct stat *st);
/* Returns the sum of the sizes of all inputs so far. */
uint64_t spin_inputs_bytes(void);
/* While paused, files that this thread opens are not recorded. Use this while searching for a file:
 * the search also opens files that are not inputs, possibly an earlier output. */
void spin_inputs_pause(bool pause);

/* ---- watch.c: clean up and end the process if another process truncates a mapped file ---- */

/* Start and stop watching a mapped file. Only spin_map_open() and spin_map_close() call these. */
void spin_watch_map(const void *data, const char *path, const struct stat *st);
void spin_unwatch_map(const void *data);
/* Returns SPIN_E_IO if the size or modification time of a watched file has changed. It is no error
 * if the path was deleted or now names another file, since the mapped file still exists. */
spin_status spin_watch_check(const void *data);

/* Register a temporary file, or a new folder, so that it is removed if the process ends because an
 * input file was truncated while it was mapped (SIGBUS). spin_unwatch_out() with the same pointer
 * cancels the registration. */
void spin_watch_out(const char *path);
void spin_unwatch_out(const char *path);
