/* Files: map, list, path words. Writing (struct spin_out, spin_folder_make) is in spin.h, as
 * plug-ins write files too. */
#pragma once

#include <sys/stat.h>

#include "spin.h"

/* A file mapped for reading. Empty files give data == "" and size 0. */
struct spin_map {
    const unsigned char *data;
    size_t size;
};
/* Errors name the path. A folder, a fifo, a missing file or a Git LFS pointer is an error. */
spin_status spin_map_open(const char *path, struct spin_map *out);
void spin_map_close(struct spin_map *map);
/* Is the file still as it was? For what is read long after it was opened: reading what was cut off
 * ends the process (spin_catch_cut_files). */
spin_status spin_map_check(const struct spin_map *map);
/* These bytes will not be needed soon: their pages leave the process (they stay in the system's
 * cache, and come back by themselves). So memory stays bounded by what is in use, not by the file.
 * What does not lie in the map is left alone. */
void spin_map_forget(const struct spin_map *map, const void *bytes, size_t n);
/* The same of bytes that are known to lie in a map. */
void spin_map_rest(const void *bytes, size_t n);
/* The checksum of zip and gzip: of all the bytes so far, from that of those before (0: none). */
uint32_t spin_crc32(uint32_t crc, const void *data, size_t n);

/* What a file is told by: its bytes, not its name or time. */
struct spin_imprint {
    uint64_t size;
    uint32_t crc; /* of all bytes */
};
struct spin_imprint spin_map_imprint(const struct spin_map *map);

/* At most the first n bytes of a file, n_out of them. Errors as of spin_map_open(). */
spin_status spin_file_head(const char *path, void *out, size_t n, size_t *n_out);

bool spin_path_exists(const char *path);
/* Something has this name, be it a link to nothing: what an output must not replace unasked. */
bool spin_path_is_taken(const char *path);
bool spin_path_is_folder(const char *path);
/* dir/name, allocated. */
spin_status spin_path_join(const char *dir, const char *name, char **out);
/* The folder a path lies in ("." when it has none), allocated. */
spin_status spin_path_folder(const char *path, char **out);
/* Last component; points into path. */
const char *spin_path_name(const char *path);
/* Absolute, links resolved; fails when it does not exist. Allocated. */
spin_status spin_path_absolute(const char *path, char **out);
/* Path of `to` as seen from the folder `from` (both exist): relative where they share a parent
 * other than the root, else absolute. Allocated. */
spin_status spin_path_relative(const char *from, const char *to, char **out);
/* Bytes that could still be written below a path that exists; UINT64_MAX when that is not known. */
uint64_t spin_path_free_bytes(const char *path);

/* Entries of a folder without . and .., sorted by name (bytes); names[n] == NULL. */
spin_status spin_folder_list(const char *path, char ***names, size_t *n);
void spin_folder_list_free(char **names);

/* The last run of digits in a file's stem as a number, or -1 ("frame_10.ply" -> 10). */
long long spin_path_number(const char *path);

/* What the name of a half-written file or folder ends with: ".tmp.", the process, then 16 digits
 * that tell the place where that number counts and are else random. No two are equal. */
enum { SPIN_OUT_SUFFIX = 48 };
void spin_out_suffix(char suffix[SPIN_OUT_SUFFIX]);
/* Remove what writers of `path` that were killed have left beside it. What a process elsewhere
 * writes, on another host or in another container, is left for an hour after its last write. */
void spin_out_sweep(const char *path);
/* Remove a file, or a folder with all in it: the bytes of its files. Links are not followed. */
uint64_t spin_out_remove(const char *path);
/* spin_out_sweep() of all files in a folder whose names have this ending, such as ".ply". */
void spin_out_sweep_folder(const char *folder, const char *ending);
/* Of an output file (spin.h): bytes to a place in it, past the buffer of spin_out_write(), by any
 * thread, where pieces are made side by side. 0, or the errno, of which spin_out_failed() makes the
 * status in the thread that asks. Nothing of spin_out_write() may still lie in its buffer. */
int spin_out_put(struct spin_out *out, uint64_t at, const void *data, size_t bytes);
spin_status spin_out_failed(const struct spin_out *out, int error);
spin_status spin_out_write_at(struct spin_out *out, uint64_t at, const void *data, size_t bytes);
/* The file's length so far, buffer included. */
spin_status spin_out_length(struct spin_out *out, uint64_t *bytes);
/* These bytes as a whole file, in place of the one that may be there. sync: as in struct spin_out.
 */
spin_status spin_out_whole(const char *path, const void *data, size_t bytes, bool sync);

/* May a file of this name be written? SPIN_E_IO when it is there and not ordinary, was read by this
 * call (force or not), or is there at all without force. Everything that writes comes through here,
 * most of it by spin_out_open(). */
spin_status spin_out_check(const char *path, bool force);

/* ---- inputs.c: what the calls of src/run have read, which they must not replace ---- */

/* Around a call: SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin(). Calls within calls
 * share what was read. Thread-safe. */
int spin_inputs_begin(void);
void spin_inputs_end(const int *begun);
/* spin_map_open() and the readers of images and videos do this; other code for a file that is read
 * later. NULL and what is no file are left out. */
spin_status spin_inputs_add(const struct stat *st);
spin_status spin_inputs_add_path(const char *path);
/* This file is the call's own, to be replaced though it was read. */
void spin_inputs_own(const char *path);
bool spin_inputs_have(const struct stat *st);

/* ---- watch.c: files that others cut short while they are mapped, and what must not be left behind
 * then ---- */

/* What spin_map_open() and spin_map_close() tell. */
void spin_watch_map(const void *data, const char *path, const struct stat *st);
void spin_unwatch_map(const void *data);
/* SPIN_E_IO when the file behind a map that is watched has another size or time by now. One that
 * was removed or replaced is still whole in the map. */
spin_status spin_watch_check(const void *data);

/* A temporary file, or a new folder, to be removed when the process ends because of a cut file,
 * until the same pointer is given to spin_unwatch_out(). */
void spin_watch_out(const char *path);
void spin_unwatch_out(const char *path);
