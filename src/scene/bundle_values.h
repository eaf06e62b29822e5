/* The values of an array of a bundle, packed or as they are. See scene/bundle_pack.h. */
#ifndef SPIN_SCENE_BUNDLE_VALUES_H
#define SPIN_SCENE_BUNDLE_VALUES_H

#include "io/json.h"
#include "io/npy.h"

struct spin_bundle;

/* One array, open until closed. */
struct spin_bundle_values {
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
    uint64_t count;      /* product of shape */
    const float *floats; /* the values in the map, where they can be used as they lie; or NULL */
    /* Private. */
    const unsigned char *bytes; /* planes, or values */
    void *owned;
    bool planes;
    const uint32_t *key; /* the first n_key values are differences from these */
    uint64_t n_key;
};

/* A frame 0 that others are differences from, decoded once. */
struct spin_bundle_key {
    char series[64];
    uint32_t *values;
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
};

/* Array `series`/`frame`, or `series` itself with a frame of -1: its header alone is looked at. kind: 'f'
 * float32, 'u' uint32; a -1 in shape matches anything. Errors name the array. */
spin_status spin_bundle_values_check(const struct spin_bundle *bundle, const char *series,
                                     int frame, char kind, int n_dims, const int64_t *shape);
/* The same, open. */
spin_status spin_bundle_values_open(struct spin_bundle *bundle, const char *series, int frame,
                                    char kind, int n_dims, const int64_t *shape,
                                    struct spin_bundle_values *out);
/* Values [first, first + n) as their 4 bytes. */
void spin_bundle_values_get(const struct spin_bundle_values *values, uint64_t first, size_t n,
                            void *out);
/* The CRC of all values. */
uint32_t spin_bundle_values_crc(const struct spin_bundle_values *values);
void spin_bundle_values_close(struct spin_bundle_values *values);
/* "xor_rows" of meta.json is sound: to be called once, before any of the above. */
spin_status spin_bundle_values_check_meta(const struct spin_bundle *bundle);

#endif
