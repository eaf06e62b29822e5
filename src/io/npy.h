/* .npy arrays and .npz archives of them. */
#pragma once

#include "io/array.h"
#include "io/zip.h"

/* Parse the bytes of one .npy file; `what` is its name in messages. Object and string dtypes are
 * SPIN_E_UNSUPPORTED; data shorter than the header states is SPIN_E_MALFORMED. */
spin_status spin_npy_parse(const char *what, const unsigned char *bytes, size_t n_bytes,
                           struct spin_array *out);

/* An open .npz archive. */
struct spin_npz {
    struct spin_zip zip;
    void **owned; /* [n_owned] decompressed members, freed by spin_npz_close() */
    size_t n_owned;
    /* If `prefix` is not NULL, keys that begin with `prefix` are looked up with this prefix
     * replaced by prefix_there. */
    const char *prefix, *prefix_there;
};
spin_status spin_npz_open(const char *path, struct spin_npz *out);
void spin_npz_close(struct spin_npz *npz);
bool spin_npz_has(const struct spin_npz *npz, const char *key);
/* Read array `key`, which is stored as member "key.npy". check_crc: see zip.h. SPIN_E_NOT_FOUND if
 * the archive has no such array. */
spin_status spin_npz_array(struct spin_npz *npz, const char *key, bool check_crc,
                           struct spin_array *out);
/* Read the type and shape of an array, from the first bytes of its member only; out->data is
 * NULL. */
spin_status spin_npz_head(const struct spin_npz *npz, const char *key, struct spin_array *out);
/* Returns how many bytes of memory reading the array allocates; 0 if its values are used in
 * place. */
uint64_t spin_npz_unpacked(const struct spin_npz *npz, const char *key);
/* Read an array. If it is compressed, *owned receives the block with the decompressed values, which
 * the caller frees. If it is not compressed, its values are used in place and *owned is NULL. */
spin_status spin_npz_take(const struct spin_npz *npz, const char *key, bool check_crc,
                          struct spin_array *out, void **owned);
/* Check that the array has this shape, where -1 matches any size. The error message states both
 * shapes. */
spin_status spin_array_check_shape(const char *key, const struct spin_array *a, int n_dims,
                                   const int64_t *shape);
/* Read an array and check its shape, with spin_npz_array() and spin_array_check_shape(). */
spin_status spin_npz_array_of(struct spin_npz *npz, const char *key, bool check_crc, int n_dims,
                              const int64_t *shape, struct spin_array *out);

/* Remove the pages of `count` values, from value `first` on, from the process's memory (see
 * spin_map_forget()). Arrays that are read frame by frame then need little memory. This has an
 * effect only for contiguous arrays that are used in place. */
void spin_npz_forget(const struct spin_npz *npz, const struct spin_array *a, uint64_t first,
                     uint64_t count);

/* Write an array as member "name.npy" in one call. descr: the numpy type, such as "<f4". */
spin_status spin_npz_write(struct spin_zip_writer *w, const char *name, const char *descr,
                           int n_dims, const uint64_t *shape, const void *data);
/* Write an array as member "name.npy" in parts: call this, then spin_zip_member_write() for each
 * part, then spin_zip_member_end(). */
spin_status spin_npz_write_begin(struct spin_zip_writer *w, const char *name, const char *descr,
                                 int n_dims, const uint64_t *shape);
/* spin_npz_write_begin() for a deflated member. */
spin_status spin_npz_write_begin_deflated(struct spin_zip_writer *w, const char *name,
                                          const char *descr, int n_dims, const uint64_t *shape);
