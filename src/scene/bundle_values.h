/* The values of an array of a bundle, packed or as they are. See scene/bundle_pack.h. */
#ifndef SPIN_SCENE_BUNDLE_VALUES_H
#define SPIN_SCENE_BUNDLE_VALUES_H

#include "io/json.h"
#include "io/npy.h"
#include "scene/bundle_pack.h"

/* One array, open until closed. */
struct spin_bundle_values {
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
    uint64_t count;      /* product of shape */
    const float *floats; /* the values in the map, where they can be used as they lie; or NULL */
    /* Private. */
    const unsigned char *bytes; /* planes, or values */
    void *owned;
    int n_planes;   /* 0: values */
    bool columns;   /* of the planes: column after column */
    uint64_t width; /* values of a row */
    bool whole;     /* words are whole numbers, of units of 1 / per_unit[column] */
    float per_unit[SPIN_UNITS];
    const uint32_t *key; /* the first n_key words are differences from these */
    uint64_t n_key;
};

/* Frames 0 that others are differences from, each decoded once. */
struct spin_bundle_keys {
    struct spin_bundle_key *key;
    size_t n, capacity;
};
void spin_bundle_keys_free(struct spin_bundle_keys *keys);

/* Where arrays lie: what bundle.c lends for a call. */
struct spin_bundle_place {
    const char *path;
    const struct spin_npz *npz;
    const spin_json *meta; /* meta.json */
    struct spin_bundle_keys *keys;
};
/* As spin_bundle_values_check() and _open() of scene/bundle.h. */
spin_status spin_bundle_place_check(const struct spin_bundle_place *place, const char *series,
                                    int frame, char kind, int n_dims, const int64_t *shape);
spin_status spin_bundle_place_open(const struct spin_bundle_place *place, const char *series,
                                   int frame, char kind, int n_dims, const int64_t *shape,
                                   struct spin_bundle_values *out);
/* Values [first, first + n) as their 4 bytes. */
void spin_bundle_values_get(const struct spin_bundle_values *values, uint64_t first, size_t n,
                            void *out);
/* The CRC of all values. */
uint32_t spin_bundle_values_crc(const struct spin_bundle_values *values);
void spin_bundle_values_close(struct spin_bundle_values *values);

#endif
