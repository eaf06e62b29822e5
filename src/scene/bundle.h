/* Reading and writing *.spin: a zip of npy arrays and meta.json. See man/spin-bundle.5.
 *
 *   meta.json
 *   source/<column>/<index, 5 digits>.npy    one frame of a column, or
 *   source/<column>.npy                      a column that is the same in every frame
 *   source/4d/<array>.npy                    instead of both: 4D splats, of which frames are slices
 *   refined/<column>/<index>.npy             one frame of splats refined on their own
 *   trained/means/<index>.npy                positions after retraining
 *   trained/residual/<index>.npy             what the network's outputs are added to, if anything
 *   trained/table.npy  trained/heads.npy ... what model/field keeps
 *
 * Columns: means [n,3], quats [n,4], log_scales [n,3], logit_opacities [n], sh [n,K,3], rgb [n,3];
 * all little-endian float32, or packed (scene/bundle_pack.h). <index> is the frame's place in
 * meta.json's list, not its number. */
#pragma once

#include "spin.h"
#include "io/npy.h"
#include "scene/bundle_meta.h"
#include "scene/bundle_pack.h"
#include "scene/columns.h"
#include "scene/splats_4d.h"

/* Frames that were refined on their own: splats in a number and an order of their own. A network in
 * the same bundle was trained on them. */
struct spin_bundle_refined {
    unsigned columns; /* 0: there are none */
    int sh_degree;    /* -1: none */
    bool antialias;   /* meant to be drawn antialiased */
    size_t *n;        /* [n_frames] */
};

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

/* An open bundle. */
struct spin_bundle {
    char *path;
    struct spin_npz npz;
    spin_json *json; /* meta.json, whole */
    struct spin_bundle_meta meta;
    struct spin_bundle_refined refined;
    size_t *trained_n; /* [frames] splats of the network's frames where these are others; or NULL */
    struct spin_bundle_keys keys; /* of packed series */
    struct spin_splats_4d four_d; /* private: see spin_bundle_splats_4d() */
    bool told_not_finite;         /* a warning said how many splats cannot be drawn */
};

/* Bytes of a bundle, by what they are for: as they lie in the file, or unpacked. */
struct spin_bundle_bytes {
    uint64_t file;         /* the whole file */
    uint64_t source;       /* as imported, positions and attributes */
    uint64_t refined;      /* frames refined on their own */
    uint64_t positions;    /* retrained positions and residual values, frame by frame */
    uint64_t tracks;       /* values that frames share, and which splat has which */
    uint64_t table, heads; /* of the network */
};

/* Whether a file is a zip with a meta.json, as bundles are and what importers read is not. */
bool spin_bundle_looks_like(const char *path);
/* Added to the name of a training's state: the clip as it was when the training was interrupted. */
#define SPIN_CLIP_OF_STATE ".spin"
/* Every member's header is checked against meta.json before this returns. A training's state stands
 * for its clip. */
spin_status spin_bundle_open(const char *path, struct spin_bundle *out);
void spin_bundle_close(struct spin_bundle *bundle);
/* What each part of it takes, in the file and unpacked. */
void spin_bundle_weigh(const struct spin_bundle *bundle, struct spin_bundle_bytes *packed,
                       struct spin_bundle_bytes *unpacked);
spin_json *spin_bundle_bytes_json(const struct spin_bundle_bytes *bytes);
/* Array `series`/`frame`, or `series` itself with a frame of -1: its header alone is looked at.
 * kind: 'f' float32, 'u' uint32; a -1 in shape matches anything. Errors name the array. */
spin_status spin_bundle_values_check(struct spin_bundle *bundle, const char *series, int frame,
                                     char kind, int n_dims, const int64_t *shape);
/* The same, open for spin_bundle_values_get(); to be closed. Errors name the file as well. */
spin_status spin_bundle_values_open(struct spin_bundle *bundle, const char *series, int frame,
                                    char kind, int n_dims, const int64_t *shape,
                                    struct spin_bundle_values *out);
/* Values [first, first + n) as their 4 bytes. */
void spin_bundle_values_get(const struct spin_bundle_values *values, uint64_t first, size_t n,
                            void *out);
/* The CRC of all values. */
uint32_t spin_bundle_values_crc(const struct spin_bundle_values *values);
void spin_bundle_values_close(struct spin_bundle_values *values);
/* The source's columns of one frame. */
spin_status spin_bundle_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                              struct spin_splats *out);
/* The source as 4D splats, read at the first call, and the bundle's; *out is NULL where it is
 * frames. */
spin_status spin_bundle_splats_4d(struct spin_bundle *bundle, const struct spin_splats_4d **out);
/* Columns of a refined frame. SPIN_E_NOT_FOUND when they are not there. */
spin_status spin_bundle_refined_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                                      struct spin_splats *out);
/* The source's columns of a frame, or with SPIN_FROM_REFINED those, without a copy where they can
 * be used as they lie in the map (out->mapped): to be read only, until the bundle is closed. */
spin_status spin_bundle_view(struct spin_bundle *bundle, int frame, enum spin_splat_source from,
                             unsigned columns, struct spin_splats *out);
/* Release the memory pages of a view that is not needed again soon. A copy (not mapped) stays as it
 * is. */
void spin_bundle_rest(const struct spin_splats *view);
/* Splats of a frame: the source's; or else the refined ones where there are some, which are also
 * the network's. */
size_t spin_bundle_count(const struct spin_bundle *bundle, int frame, enum spin_splat_source from);
/* A number that follows from the values of these columns of a source frame, packed or not. */
spin_status spin_bundle_checksum(struct spin_bundle *bundle, int frame, unsigned columns,
                                 uint32_t *out);

/* Writing. Frames in order, then spin_bundle_writer_finish() writes meta.json and commits. */
struct spin_bundle_writer {
    struct spin_zip_writer zip;
    bool packs; /* arrays are packed; to be set before the first */
    struct spin_packer packer;
};
/* sync: write the file to the disk (fsync) before it is renamed to its path. */
spin_status spin_bundle_writer_open(const char *path, bool force, bool sync,
                                    struct spin_bundle_writer *w);
/* Columns in `columns` of frame `index`; those in static_columns are written at index 0 only. */
spin_status spin_bundle_write_frame(struct spin_bundle_writer *w, int index, unsigned columns,
                                    unsigned static_columns, const struct spin_splats *splats);
/* The source as 4D splats, instead of its frames; sets four_d, parts, columns and SH degree of
 * meta. round: what was done to them by spin_splats_4d_round(), and no more since. */
spin_status spin_bundle_write_4d(struct spin_bundle_writer *w, const struct spin_splats_4d *s,
                                 enum spin_round_4d round, struct spin_bundle_meta *meta);
/* Columns of refined frame `index`; the core describes them in meta.json's "refined". */
spin_status spin_bundle_write_refined(struct spin_bundle_writer *w, int index, unsigned columns,
                                      const struct spin_splats *splats);
/* `series`/`frame` of 4-byte values, descr "<f4" or "<u4"; or `series` itself with a frame of -1.
 */
spin_status spin_bundle_write_array(struct spin_bundle_writer *w, const char *series, int frame,
                                    const char *descr, int n_dims, const uint64_t *shape,
                                    const void *values);
/* extra: members put beside ours at the top of meta.json (may be NULL; taken). meta.frame[].n must
 * be set. data_path is stored as given. */
spin_status spin_bundle_writer_finish(struct spin_bundle_writer *w,
                                      const struct spin_bundle_meta *meta, spin_json *extra);
void spin_bundle_writer_abandon(struct spin_bundle_writer *w);
