/* One gzip stream, written in pieces, deflated by as many threads as there are. The bytes do not
 * depend on the number of threads, and carry no date. */
#ifndef SPIN_IO_GZIP_H
#define SPIN_IO_GZIP_H

#include "io/file.h"

struct spin_gzip;

/* Level 1 (fast) to 9 (small). n_threads 0: all. What is written goes to the end of out; end() leaves
 * it open. */
spin_status spin_gzip_create(int level, int n_threads, struct spin_gzip **out);
void spin_gzip_free(struct spin_gzip *gzip);

/* begin, write as often as needed, end; then the next file may begin. After a failure too. */
spin_status spin_gzip_begin(struct spin_gzip *gzip, struct spin_out *out);
spin_status spin_gzip_write(struct spin_gzip *gzip, const void *data, size_t bytes);
spin_status spin_gzip_end(struct spin_gzip *gzip);

#endif
