/* Zip and zip64 archives. Ours, on zlib, because stored
 * members must be usable in place, aligned, and files are hostile until shown otherwise.
 *
 * Reading goes by the central directory. Member sizes, offsets and names are checked against the
 * file before anything is reserved; methods 0 and 8 only; never encrypted. */
#pragma once

#include "io/file.h"

struct spin_zip_member {
    const char *name;           /* NUL-terminated */
    uint64_t size, packed_size; /* bytes */
    uint64_t header_offset;
    uint32_t crc;
    int method;
};

struct spin_zip {
    struct spin_map map;
    char *path;                     /* for messages */
    struct spin_zip_member *member; /* [n], in directory order */
    size_t n;
    const struct spin_zip_member **by_name; /* private: [n] */
    char *names;                            /* private */
    bool borrowed;                          /* the map is another's */
    bool zip64;                             /* its directory was found by a zip64 record */
};

bool spin_zip_looks_like(const unsigned char *head, size_t n_head);
spin_status spin_zip_open(const char *path, struct spin_zip *out);
/* One in memory, which must stay; `what` names it in messages. */
spin_status spin_zip_parse(const char *what, const void *data, size_t size, struct spin_zip *out);
void spin_zip_close(struct spin_zip *zip);
/* NULL when there is none. With duplicates the last one counts, as in Python. */
const struct spin_zip_member *spin_zip_find(const struct spin_zip *zip, const char *name);

/* The same of a name in parts that stand in a row; NULL-terminated. */
const struct spin_zip_member *spin_zip_find_parts(const struct spin_zip *zip,
                                                  const char *const *part);

/* The bytes of a member. Stored: *data points into the map and *owned is NULL. Deflated: *owned is
 * a new block, to be freed with free(). The CRC is checked when check_crc. `limit` bounds the size
 * of an inflated member (a bomb is an error before anything is reserved). */
spin_status spin_zip_read(const struct spin_zip *zip, const struct spin_zip_member *member,
                          bool check_crc, uint64_t limit, const unsigned char **data, void **owned);

/* At most the first n bytes of a member, n_out of them, without unpacking the rest. */
spin_status spin_zip_head(const struct spin_zip *zip, const struct spin_zip_member *member,
                          void *out, size_t n, size_t *n_out);

/* ---- Writing: members stored, data 64-byte aligned, or deflated; zip64 when needed, no dates
 * (1980-01-01), so equal content gives equal bytes, by any number of threads. */

struct spin_zip_writer {
    struct spin_out out;
    struct spin_zip_written *written;
    size_t n, capacity;
    uint32_t crc;
    uint64_t member_size;
    bool in_member;
    bool plain; /* headers hold names alone, and data are not aligned; set it after begin() */
    struct spin_zip_deflate *deflate; /* of the member that is being written; NULL: stored */
    int n_threads; /* that deflate a long member; 0: all cores. Set it after open() or begin() */
    struct spin_pool *pool;
};
spin_status spin_zip_writer_open(const char *path, bool force, struct spin_zip_writer *w);
/* begin with the exact size, then write in pieces, then end. */
spin_status spin_zip_member_begin(struct spin_zip_writer *w, const char *name, uint64_t size);
/* The same for a member that is deflated on the way. */
spin_status spin_zip_member_begin_deflated(struct spin_zip_writer *w, const char *name,
                                           uint64_t size);
/* The one just begun quickly: only runs of a byte are found, and what seems random is stored.
 * Before its first bytes. */
void spin_zip_member_runs(struct spin_zip_writer *w);
spin_status spin_zip_member_write(struct spin_zip_writer *w, const void *data, size_t bytes);
spin_status spin_zip_member_end(struct spin_zip_writer *w);
/* The same at once, of two pieces that are there already: nothing is written twice. */
spin_status spin_zip_member_whole(struct spin_zip_writer *w, const char *name, const void *head,
                                  size_t n_head, const void *data, size_t n_data);
/* An archive in a file that is open and empty, which stays the caller's to commit: it is lent to
 * the writer, and end(), which must follow, gives it back. It writes the directory when all is well
 * so far. */
void spin_zip_writer_begin(const struct spin_out *out, struct spin_zip_writer *w);
spin_status spin_zip_writer_end(struct spin_zip_writer *w, spin_status so_far,
                                struct spin_out *out);
spin_status spin_zip_writer_commit(struct spin_zip_writer *w);
void spin_zip_writer_abandon(struct spin_zip_writer *w);
