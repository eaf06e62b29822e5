/* The bytes of a file from its beginning to its end, decompressed if it is a gzip file. */
#pragma once

#include "io/file.h"

struct spin_stream {
    struct spin_map map;
    const char *path; /* of the file, for messages; the caller owns it */
    size_t at;        /* bytes of the file that were read */
    uint64_t n_out;   /* bytes that spin_stream_read() returned */
    uint64_t limit;   /* an error if more bytes would be returned */
    void *inflater;   /* NULL: the file is not compressed, or its end was reached */
    bool is_gzip;
};

/* Opens a file. At most `limit` bytes are decompressed, so that a bomb fails early. */
spin_status spin_stream_open(const char *path, uint64_t limit, struct spin_stream *out);
void spin_stream_close(struct spin_stream *s);
/* Reads n bytes, or fewer at the end of the stream; *got receives their number. The checksums of
 * gzip are verified. */
spin_status spin_stream_read(struct spin_stream *s, void *out, size_t n, size_t *got);
