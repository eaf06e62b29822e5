/* The bytes of a file from its beginning to its end, decompressed if it is a gzip file. */
#pragma once

#include "io/file.h"

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
