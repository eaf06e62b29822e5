/* .npy arrays and .npz archives of them. */
#pragma once

#include "io/array.h"
#include "io/zip.h"

/* Parse the bytes of one .npy; `what` is the name for messages. Object and string dtypes are
 * SPIN_E_UNSUPPORTED; data shorter than the header says is SPIN_E_MALFORMED. */
spin_status spin_npy_parse(const char *what, const unsigned char *bytes, size_t n_bytes,
                           struct spin_array *out);

/* One open .npz. */
struct spin_npz {
    struct spin_zip zip;
    void **owned; /* inflated members */
    size_t n_owned;
    const char *prefix,
        *prefix_there; /* keys that begin with the first lie under the second; or NULL */
};
spin_status spin_npz_open(const char *path, struct spin_npz *out);
void spin_npz_close(struct spin_npz *npz);
bool spin_npz_has(const struct spin_npz *npz, const char *key);
/* Array `key` (member "key.npy"). check_crc as in zip.h. Missing: SPIN_E_NOT_FOUND "no array
 * 'key'". */
spin_status spin_npz_array(struct spin_npz *npz, const char *key, bool check_crc,
                           struct spin_array *out);
/* What its header says, from its first bytes alone; out->data is NULL. */
spin_status spin_npz_head(const struct spin_npz *npz, const char *key, struct spin_array *out);
/* Bytes of memory that its values take once they are read: 0 when they lie in the file as they are.
 */
uint64_t spin_npz_unpacked(const struct spin_npz *npz, const char *key);
/* Its values; those that were deflated go to *owned, to be freed by the caller, instead of staying
 * until the archive is closed. NULL: they lie in the file as they are. */
spin_status spin_npz_take(const struct spin_npz *npz, const char *key, bool check_crc,
                          struct spin_array *out, void **owned);
/* The shape must be [shape..]; a -1 matches anything. Error says both. */
spin_status spin_array_check_shape(const char *key, const struct spin_array *a, int n_dims,
                                   const int64_t *shape);
/* As spin_npz_array(), and its shape must be this. */
spin_status spin_npz_array_of(struct spin_npz *npz, const char *key, bool check_crc, int n_dims,
                              const int64_t *shape, struct spin_array *out);

/* These values will not be needed soon (see spin_map_forget): for arrays read a frame at a time.
 * Only C-order arrays that lie in the file as they are have anything to forget. */
void spin_npz_forget(const struct spin_npz *npz, const struct spin_array *a, uint64_t first,
                     uint64_t count);

/* Write `name`.npy into an archive: descr such as "<f4", shape, then all the data at once. */
spin_status spin_npz_write(struct spin_zip_writer *w, const char *name, const char *descr,
                           int n_dims, const uint64_t *shape, const void *data);
/* The same in pieces: this, spin_zip_member_write() as often as needed, spin_zip_member_end(). */
spin_status spin_npz_write_begin(struct spin_zip_writer *w, const char *name, const char *descr,
                                 int n_dims, const uint64_t *shape);
/* The same for a member that is deflated. */
spin_status spin_npz_write_begin_deflated(struct spin_zip_writer *w, const char *name,
                                          const char *descr, int n_dims, const uint64_t *shape);
