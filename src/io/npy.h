/* .npy arrays and .npz archives of them. */
#ifndef SPIN_IO_NPY_H
#define SPIN_IO_NPY_H

#include "io/zip.h"

#define SPIN_NPY_MAX_DIMS 8

/* A numeric array as it lies in the file. Values are views: they die with the archive or bytes. */
struct spin_array {
    char kind;     /* 'f' 'i' 'u' 'b' */
    int item_size; /* bytes: 1 2 4 8 */
    bool big_endian;
    bool fortran; /* column-major */
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
    uint64_t count; /* product of shape */
    const unsigned char *data;
    size_t n_bytes;
};

/* Parse the bytes of one .npy; `what` is the name for messages. Object and string dtypes are
 * SPIN_E_UNSUPPORTED; data shorter than the header says is SPIN_E_MALFORMED. */
spin_status spin_npy_parse(const char *what, const unsigned char *bytes, size_t n_bytes,
                           struct spin_array *out);

/* One open .npz. */
struct spin_npz {
    struct spin_zip zip;
    void **owned; /* inflated members */
    size_t n_owned;
};
spin_status spin_npz_open(const char *path, struct spin_npz *out);
void spin_npz_close(struct spin_npz *npz);
bool spin_npz_has(const struct spin_npz *npz, const char *key);
/* Array `key` (member "key.npy"). check_crc as in zip.h. Missing: SPIN_E_NOT_FOUND "no array 'key'". */
spin_status spin_npz_array(struct spin_npz *npz, const char *key, bool check_crc,
                           struct spin_array *out);
/* The same and its shape must be [shape..]; a -1 matches anything. Error says both shapes. */
spin_status spin_npz_array_of(struct spin_npz *npz, const char *key, bool check_crc, int n_dims,
                              const int64_t *shape, struct spin_array *out);

/* Copy count values from flat C-order index first on, converted. Any kind, byte order and layout. */
void spin_array_to_f32(const struct spin_array *a, uint64_t first, uint64_t count, float *out);
void spin_array_to_f64(const struct spin_array *a, uint64_t first, uint64_t count, double *out);
void spin_array_to_i64(const struct spin_array *a, uint64_t first, uint64_t count, int64_t *out);
/* These values will not be needed soon (see spin_map_forget): for arrays read a frame at a time. Only
 * C-order arrays that lie in the file as they are have anything to forget. */
void spin_npz_forget(const struct spin_npz *npz, const struct spin_array *a, uint64_t first,
                     uint64_t count);

/* The values in place, when they are little-endian C-order float32 at a 4-byte aligned address; else
 * NULL. */
const float *spin_array_f32(const struct spin_array *a);

/* "[3, 500, 4]" into text. */
void spin_array_shape_text(int n_dims, const uint64_t *shape, char *text, size_t n_text);

/* Write `name`.npy into an archive: descr such as "<f4", shape, then all the data at once. */
spin_status spin_npz_write(struct spin_zip_writer *w, const char *name, const char *descr,
                           int n_dims, const uint64_t *shape, const void *data);
/* The same in pieces: this, spin_zip_member_write() as often as needed, spin_zip_member_end(). */
spin_status spin_npz_write_begin(struct spin_zip_writer *w, const char *name, const char *descr,
                                 int n_dims, const uint64_t *shape);

#endif
