/* .npy arrays and .npz archives of them. */
#pragma once

#include "io/array.h"
#include "io/zip.h"

/* Parse the bytes of one .npy; `what` names it in messages. Object and string dtypes are
 * SPIN_E_UNSUPPORTED; data shorter than the header states is SPIN_E_MALFORMED. */
spin_status spin_npy_parse(const char *what, const unsigned char *bytes, size_t n_bytes,
                           struct spin_array *out);

/* An open .npz. */
struct spin_npz {
    struct spin_zip zip;
    void **owned; /* decompressed members */
    size_t n_owned;
    /* Keys with the first prefix are looked up with the second instead; or NULL. */
    const char *prefix, *prefix_there;
};
spin_status spin_npz_open(const char *path, struct spin_npz *out);
void spin_npz_close(struct spin_npz *npz);
bool spin_npz_has(const struct spin_npz *npz, const char *key);
/* Array `key`, which is member "key.npy". check_crc: see zip.h. SPIN_E_NOT_FOUND "no array
 * 'key'". */
spin_status spin_npz_array(struct spin_npz *npz, const char *key, bool check_crc,
                           struct spin_array *out);
/* The array's type and shape, read from its first bytes only; out->data is NULL. */
spin_status spin_npz_head(const struct spin_npz *npz, const char *key, struct spin_array *out);
/* Memory in bytes that the values need once read; 0 if they are used in place. */
uint64_t spin_npz_unpacked(const struct spin_npz *npz, const char *key);
/* The array's values. If they were deflated, *owned receives the block, which the caller frees
 * instead of keeping it until the archive is closed; else it is NULL, and they are used in place.
 */
spin_status spin_npz_take(const struct spin_npz *npz, const char *key, bool check_crc,
                          struct spin_array *out, void **owned);
/* Check that the array has this shape, where -1 matches any size. The error states both. */
spin_status spin_array_check_shape(const char *key, const struct spin_array *a, int n_dims,
                                   const int64_t *shape);
/* spin_npz_array() and spin_array_check_shape(). */
spin_status spin_npz_array_of(struct spin_npz *npz, const char *key, bool check_crc, int n_dims,
                              const int64_t *shape, struct spin_array *out);

/* Drop the pages of values that are not needed soon (see spin_map_forget()), for arrays that are
 * read frame by frame. Only affects contiguous arrays that are used in place. */
void spin_npz_forget(const struct spin_npz *npz, const struct spin_array *a, uint64_t first,
                     uint64_t count);

/* Write `name`.npy into an archive, all data at once: descr such as "<f4", and the shape. */
spin_status spin_npz_write(struct spin_zip_writer *w, const char *name, const char *descr,
                           int n_dims, const uint64_t *shape, const void *data);
/* The same in parts: this, spin_zip_member_write() as often as needed, spin_zip_member_end(). */
spin_status spin_npz_write_begin(struct spin_zip_writer *w, const char *name, const char *descr,
                                 int n_dims, const uint64_t *shape);
/* The same for a deflated member. */
spin_status spin_npz_write_begin_deflated(struct spin_zip_writer *w, const char *name,
                                          const char *descr, int n_dims, const uint64_t *shape);
