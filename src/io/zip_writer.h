/* Writing zip archives: members stored, data 64-byte aligned, or deflated; zip64 when needed, no dates
 * (1980-01-01), so equal content gives equal bytes. */
#ifndef SPIN_IO_ZIP_WRITER_H
#define SPIN_IO_ZIP_WRITER_H

#include "io/file.h"

struct spin_zip_writer {
    struct spin_out out;
    struct spin_zip_written *written;
    size_t n, capacity;
    uint32_t crc;
    uint64_t member_size;
    bool in_member;
    struct spin_zip_deflate *deflate; /* of the member that is being written; NULL: stored */
};
spin_status spin_zip_writer_open(const char *path, bool force, struct spin_zip_writer *w);
/* begin with the exact size, then write in pieces, then end. */
spin_status spin_zip_member_begin(struct spin_zip_writer *w, const char *name, uint64_t size);
/* The same for a member that is deflated on the way. */
spin_status spin_zip_member_begin_deflated(struct spin_zip_writer *w, const char *name,
                                           uint64_t size);
spin_status spin_zip_member_write(struct spin_zip_writer *w, const void *data, size_t bytes);
spin_status spin_zip_member_end(struct spin_zip_writer *w);
/* The same at once, of two pieces that are there already: nothing is written twice. */
spin_status spin_zip_member_whole(struct spin_zip_writer *w, const char *name, const void *head,
                                  size_t n_head, const void *data, size_t n_data);
/* An archive in a file that is open and empty, which stays the caller's to commit: it is lent to the writer, and
 * end(), which must follow, gives it back. It writes the directory when all is well so far. */
void spin_zip_writer_begin(const struct spin_out *out, struct spin_zip_writer *w);
spin_status spin_zip_writer_end(struct spin_zip_writer *w, spin_status so_far,
                                struct spin_out *out);
spin_status spin_zip_writer_commit(struct spin_zip_writer *w);
void spin_zip_writer_abandon(struct spin_zip_writer *w);

#endif
