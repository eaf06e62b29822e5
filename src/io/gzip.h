/* One gzip stream, written in pieces, deflated by as many threads as there are. The bytes do not
 * depend on the number of threads, and carry no date. */
#ifndef SPIN_IO_GZIP_H
#define SPIN_IO_GZIP_H

#include "io/file.h"

struct spin_gzip;

/* Level 1 (fast: codes by frequency and runs of one byte, no search for repeats) to 9 (small). n_threads 0: all. What is written goes to the end of out; end() leaves
 * it open. */
spin_status spin_gzip_create(int level, int n_threads, struct spin_gzip **out);
void spin_gzip_free(struct spin_gzip *gzip);

/* begin, write as often as needed, end; then the next file may begin. After a failure too. */
spin_status spin_gzip_begin(struct spin_gzip *gzip, struct spin_out *out);
spin_status spin_gzip_write(struct spin_gzip *gzip, const void *data, size_t bytes);
spin_status spin_gzip_end(struct spin_gzip *gzip);

/* At most n_out bytes from the beginning of a gzip in memory; *n how many there were. A stream that is
 * damaged before them is SPIN_E_MALFORMED, checksum and length included when its end is reached. */
spin_status spin_gzip_read(const void *data, size_t size, void *out, size_t n_out, size_t *n);
/* What its last bytes say of its length, modulo 2^32; 0 when there are none. */
uint32_t spin_gzip_length(const void *data, size_t size);

#endif
