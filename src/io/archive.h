/* Unpacks zip archives, tar archives (plain or compressed with gzip) and single files compressed
 * with gzip to a temporary folder. Archives are not trusted: names that lead out of the folder,
 * duplicate names, links, devices and archives that unpack to far more than their own size are
 * refused. */
#pragma once

#include "spin.h"
#include "io/file.h"

struct spin_unpacked {
    char *folder; /* the temporary folder; NULL: nothing was unpacked */
    char *root;   /* the folder in `folder` that contains the members of the archive */
    /* The first path, from `root` downwards, that is a file or a folder with several entries. */
    char *path;
};

/* Whether the file begins like an archive that spin_archive_unpack() reads. False for checkpoints
 * of PyTorch and for .npz files of NumPy, although they are zip files. */
bool spin_archive_detect(const char *path);
/* Unpacks the archive. Until spin_unpacked_remove(), messages show the path of the archive instead
 * of the path of the temporary folder. */
spin_status spin_archive_unpack(const char *path, struct spin_unpacked *out);
/* Removes the temporary folder, also after a failure of spin_archive_unpack(). */
void spin_unpacked_remove(struct spin_unpacked *u);

/* ---- Streams --------------------------------------------------------------------------------- */

/* The bytes of a file from its beginning to its end, decompressed if it is a gzip file. */

struct spin_stream {
    struct spin_map map;
    const char *path; /* name of the file in messages; owned by the caller */
    size_t at;        /* position in the file: number of bytes read so far */
    uint64_t n_out;   /* number of bytes that spin_stream_read() has returned */
    uint64_t limit;   /* reading more than this many bytes is an error */
    void *inflater;   /* state of zlib; NULL outside a gzip member */
    bool is_gzip;
};

/* Opens a file. Reading fails once more than `limit` bytes were decompressed, which stops
 * decompression bombs. `path` must stay valid until spin_stream_close(). */
spin_status spin_stream_open(const char *path, uint64_t limit, struct spin_stream *out);
void spin_stream_close(struct spin_stream *s);
/* Reads n bytes, or fewer at the end of the stream; *got receives their number. The checksums of a
 * gzip file are verified. */
spin_status spin_stream_read(struct spin_stream *s, void *out, size_t n, size_t *got);

/* ---- Tar archives ---------------------------------------------------------------------------- */

/* Tar archives (POSIX ustar and pax, and GNU's long names), read from a stream. The file is not
 * trusted: headers must have the right checksum, and links, devices and sparse files are refused.
 */

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
