/* Zip and zip64 archives. This implementation, which uses zlib, aligns stored members so that they
 * can be used in place, and does not trust the files that it reads.
 *
 * The reader uses the central directory. It checks sizes, offsets and names of members against the
 * file before it allocates memory. Only the methods 0 (stored) and 8 (deflate) are supported,
 * without encryption. */
#pragma once

#include "io/file.h"

struct spin_zip_member {
    const char *name;           /* name of the member, NUL-terminated */
    uint64_t size, packed_size; /* decompressed and compressed size in bytes */
    uint64_t header_offset;
    uint32_t crc;
    int method;
};

struct spin_zip {
    struct spin_map map;
    char *path;                     /* path of the archive, for messages */
    struct spin_zip_member *member; /* [n], in the order of the central directory */
    size_t n;
    const struct spin_zip_member **by_name; /* private: [n] the members, sorted by name */
    char *names;                            /* private: the memory of all names of members */
    bool borrowed;                          /* the caller owns `map` */
    bool zip64;                             /* the directory was found through a zip64 record */
};

bool spin_zip_detect(const unsigned char *head, size_t n_head);
spin_status spin_zip_open(const char *path, struct spin_zip *out);
/* Open an archive in memory. The memory must stay valid until spin_zip_close(). what: name of the
 * archive in messages. */
spin_status spin_zip_parse(const char *what, const void *data, size_t size, struct spin_zip *out);
void spin_zip_close(struct spin_zip *zip);
/* Returns the member of this name, or NULL if there is none. If there are several, returns the last
 * one, as Python does. */
const struct spin_zip_member *spin_zip_find(const struct spin_zip *zip, const char *name);

/* Find a member by a name in several parts: the name is the concatenation of `part`, a list of
 * strings that ends with NULL. */
const struct spin_zip_member *spin_zip_find_parts(const struct spin_zip *zip,
                                                  const char *const *part);

/* Read the bytes of a member. If the member is stored, *data points into the map and *owned is
 * NULL. If it is deflated, *data and *owned point to a new block, which the caller frees with
 * free(). check_crc: verify the CRC. `limit` bounds the decompressed size, so that a zip bomb fails
 * before anything is allocated. */
spin_status spin_zip_read(const struct spin_zip *zip, const struct spin_zip_member *member,
                          bool check_crc, uint64_t limit, const unsigned char **data, void **owned);

/* Read the first n bytes of a member, or all of them if it is shorter, without decompressing the
 * rest; *n_out receives the number of bytes read. */
spin_status spin_zip_head(const struct spin_zip *zip, const struct spin_zip_member *member,
                          void *out, size_t n, size_t *n_out);

/* ---- Writing ---- */

/* Members are stored, with their data aligned to 64 bytes, or deflated. Zip64 is used if needed.
 * Equal contents give equal files: the date is always 1980-01-01, and the number of threads has no
 * effect. */

struct spin_zip_writer {
    struct spin_out out;
    struct spin_zip_written *written;
    size_t n, capacity;
    uint32_t crc;
    uint64_t member_size;
    bool in_member;
    /* Write headers without extra fields, so that data are not aligned. Set this after
     * spin_zip_writer_begin(). */
    bool plain;
    /* State of the deflated member being written; NULL: there is none. */
    struct spin_zip_deflate *deflate;
    /* Number of threads that deflate a long member; 0: one per core. Set this after
     * spin_zip_writer_open() or spin_zip_writer_begin(). */
    int n_threads;
    struct spin_pool *pool;
};
spin_status spin_zip_writer_open(const char *path, bool force, struct spin_zip_writer *w);
/* Write a stored member: begin with its exact size, write it in parts, then end. */
spin_status spin_zip_member_begin(struct spin_zip_writer *w, const char *name, uint64_t size);
/* The same for a member that is deflated while it is written. */
spin_status spin_zip_member_begin_deflated(struct spin_zip_writer *w, const char *name,
                                           uint64_t size);
/* Compress the current member quickly: search only for runs of one byte, and store data that seem
 * random. Call this after spin_zip_member_begin_deflated(), before the first bytes are written. */
void spin_zip_member_runs(struct spin_zip_writer *w);
spin_status spin_zip_member_write(struct spin_zip_writer *w, const void *data, size_t bytes);
spin_status spin_zip_member_end(struct spin_zip_writer *w);
/* Write a stored member in one call, from two blocks in memory, which are not copied. */
spin_status spin_zip_member_whole(struct spin_zip_writer *w, const char *name, const void *head,
                                  size_t n_head, const void *data, size_t n_data);
/* Write an archive into an open, empty file that the caller will commit. spin_zip_writer_begin()
 * takes over the file until spin_zip_writer_end(), which must follow, returns it in *out. If so_far
 * is SPIN_OK, spin_zip_writer_end() also writes the directory. */
void spin_zip_writer_begin(const struct spin_out *out, struct spin_zip_writer *w);
spin_status spin_zip_writer_end(struct spin_zip_writer *w, spin_status so_far,
                                struct spin_out *out);
spin_status spin_zip_writer_commit(struct spin_zip_writer *w);
void spin_zip_writer_abandon(struct spin_zip_writer *w);
