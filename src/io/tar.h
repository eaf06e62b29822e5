/* Tar archives (POSIX ustar and pax, and GNU's long names), read from a stream. The file is not
 * trusted: headers must have the right checksum, and links, devices and sparse files are refused.
 */
#pragma once

#include "io/stream.h"

enum { SPIN_TAR_BLOCK = 512 };

struct spin_tar {
    struct spin_stream *stream;
    char *name; /* name of the current member; owned by this struct */
    bool is_folder;
    uint64_t size;   /* bytes of the current member */
    uint64_t unread; /* bytes of the current member that were not read yet */
};

/* Whether these bytes are the first of a tar archive. */
bool spin_tar_looks_like(const unsigned char *head, size_t n);
/* Proceeds to the next member, a file or a folder, and skips the unread bytes of the current one.
 * Sets tar->name to NULL at the end of the archive. The caller sets tar->stream before the first
 * call, and calls spin_tar_close() at the end. */
spin_status spin_tar_next(struct spin_tar *tar);
/* Reads the next n bytes of the current member; n must not exceed tar->unread. */
spin_status spin_tar_read(struct spin_tar *tar, void *out, size_t n);
void spin_tar_close(struct spin_tar *tar);
