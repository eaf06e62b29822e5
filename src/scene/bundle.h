/* Reads and writes *.spin: a zip of npy arrays and meta.json. See man/spin-bundle.5.
 *
 *   meta.json
 *   source/<column>/<index, 5 digits>.npy    one frame of a column, or
 *   source/<column>.npy                      a column that is the same in every frame
 *   source/4d/<array>.npy                    4D splats, instead of columns; frames are their slices
 *   refined/<column>/<index>.npy             one frame of splats that were refined on their own
 *   trained/means/<index>.npy                positions after retraining
 *   trained/residual/<index>.npy             optional values, added to the network's outputs
 *   trained/table.npy  trained/heads.npy ... the parameters of the network (model/field)
 *
 * Columns: means [n,3], quats [n,4], log_scales [n,3], logit_opacities [n], sh [n,K,3], rgb [n,3];
 * all little-endian float32, or packed (scene/bundle_pack.h). <index> is the frame's position in
 * the list of meta.json, not its number. */
#pragma once

#include "spin.h"
#include "io/npy.h"
#include "scene/bundle_meta.h"
#include "scene/bundle_pack.h"
#include "scene/columns.h"
#include "scene/splats_4d.h"

/* Frames that were refined on their own. Their splats differ from the source's in number and order.
 * If the bundle has a network, it was trained on them. */
struct spin_bundle_refined {
    unsigned columns; /* 0: no refined frames */
    int sh_degree;    /* -1: none */
    bool antialias;   /* meant to be drawn antialiased */
    size_t *n;        /* [n_frames] */
};

/* One open array. */
struct spin_bundle_values {
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
    uint64_t count;      /* product of shape */
    const float *floats; /* the values in the map, if they can be used in place; otherwise NULL */
    /* Private. */
    const unsigned char *bytes; /* byte planes, or values */
    void *owned;
    int n_planes;   /* 0: plain values */
    bool columns;   /* planes are stored column by column */
    uint64_t width; /* values per row */
    bool whole;     /* words are integers k that stand for k / per_unit[column] */
    float per_unit[SPIN_UNITS];
    const uint32_t *key; /* the first n_key words are XORed with these */
    uint64_t n_key;
};

/* The decoded frames 0 of packed series, whose later frames are stored as differences from them. */
struct spin_bundle_keys {
    struct spin_bundle_key *key;
    size_t n, capacity;
};
void spin_bundle_keys_free(struct spin_bundle_keys *keys);

/* An open bundle. */
struct spin_bundle {
    char *path;
    struct spin_npz npz;
    spin_json *json; /* all of meta.json */
    struct spin_bundle_meta meta;
    struct spin_bundle_refined refined;
    size_t *trained_n; /* [n_frames] splats of each retrained frame if densification changed them;
                          or NULL */
    struct spin_bundle_keys keys;
    struct spin_splats_4d four_d; /* private: see spin_bundle_splats_4d() */
    bool told_not_finite;         /* the warning about splats that cannot be drawn was printed */
};

/* Bytes of a bundle by purpose: as stored in the file, or unpacked. */
struct spin_bundle_bytes {
    uint64_t file;         /* the whole file */
    uint64_t source;       /* as imported, positions and attributes */
    uint64_t refined;      /* frames refined on their own */
    uint64_t positions;    /* retrained positions and residual values of all frames */
    uint64_t tracks;       /* values that frames share, and the track of each splat */
    uint64_t table, heads; /* of the network */
};

/* True for a zip with a meta.json and members in source/. No importer's input has both. */
bool spin_bundle_looks_like(const char *path);
/* Suffix of a checkpoint's path: the clip as it was when the training was interrupted. */
#define SPIN_CLIP_OF_STATE ".spin"
/* Checks the header of every array against meta.json. Given a checkpoint, opens its clip;
 * SPIN_E_UNSUPPORTED if that was not saved. */
spin_status spin_bundle_open(const char *path, struct spin_bundle *out);
void spin_bundle_close(struct spin_bundle *bundle);
/* The size of each part, in the file and unpacked. */
void spin_bundle_weigh(const struct spin_bundle *bundle, struct spin_bundle_bytes *packed,
                       struct spin_bundle_bytes *unpacked);
spin_json *spin_bundle_bytes_json(const struct spin_bundle_bytes *bytes);
/* Checks the header of array `series`/`frame`, or of `series` itself if frame is -1. kind: 'f'
 * float32, 'u' uint32; a -1 in shape matches any size. Errors name the array. */
spin_status spin_bundle_values_check(struct spin_bundle *bundle, const char *series, int frame,
                                     char kind, int n_dims, const int64_t *shape);
/* The same, and opens the array for spin_bundle_values_get(); the caller closes it. Errors name the
 * file as well. */
spin_status spin_bundle_values_open(struct spin_bundle *bundle, const char *series, int frame,
                                    char kind, int n_dims, const int64_t *shape,
                                    struct spin_bundle_values *out);
/* Copies values [first, first + n), 4 bytes each. */
void spin_bundle_values_get(const struct spin_bundle_values *values, uint64_t first, size_t n,
                            void *out);
/* The CRC of all values, unpacked. */
uint32_t spin_bundle_values_crc(const struct spin_bundle_values *values);
void spin_bundle_values_close(struct spin_bundle_values *values);
/* Reads columns of a source frame. */
spin_status spin_bundle_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                              struct spin_splats *out);
/* The source as 4D splats, read on the first call and owned by the bundle; *out is NULL if the
 * source consists of frames. */
spin_status spin_bundle_splats_4d(struct spin_bundle *bundle, const struct spin_splats_4d **out);
/* Reads columns of a refined frame. SPIN_E_NOT_FOUND if the bundle does not have them. */
spin_status spin_bundle_refined_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                                      struct spin_splats *out);
/* Columns of a source frame, or of a refined one with SPIN_FROM_REFINED. If all of them can be used
 * in place, *out points into the map (out->mapped): it is read-only, and valid until the bundle is
 * closed. Otherwise *out is a copy. */
spin_status spin_bundle_view(struct spin_bundle *bundle, int frame, enum spin_splat_source from,
                             unsigned columns, struct spin_splats *out);
/* Releases the memory pages of a mapped view that will not be needed soon. Does nothing for a
 * copy. */
void spin_bundle_rest(const struct spin_splats *view);
/* The same for n rows from `first` and some columns; does nothing for small frames. */
void spin_bundle_rest_rows(const struct spin_splats *view, size_t first, size_t n,
                           unsigned columns);
/* The number of splats of a frame. SPIN_FROM_REFINED counts the refined splats, or the source's if
 * there are none; SPIN_FROM_TRAINED the same, unless densification changed their number. */
size_t spin_bundle_count(const struct spin_bundle *bundle, int frame, enum spin_splat_source from);
/* A checksum over the values of these columns of a source frame; equal for packed and plain
 * arrays. */
spin_status spin_bundle_checksum(struct spin_bundle *bundle, int frame, unsigned columns,
                                 uint32_t *out);

/* Writing: frames in order, then spin_bundle_writer_finish() writes meta.json and commits the
 * file. */
struct spin_bundle_writer {
    struct spin_zip_writer zip;
    bool packs; /* pack all arrays; set it before the first */
    struct spin_packer packer;
};
/* sync: fsync the file before it is renamed to its path. */
spin_status spin_bundle_writer_open(const char *path, bool force, bool sync,
                                    struct spin_bundle_writer *w);
/* Writes these columns of frame `index`; those in static_columns are written at index 0 only. */
spin_status spin_bundle_write_frame(struct spin_bundle_writer *w, int index, unsigned columns,
                                    unsigned static_columns, const struct spin_splats *splats);
/* Writes the source as 4D splats instead of frames; sets four_d, parts, columns and SH degree of
 * meta. round: the last rounding of *s by spin_splats_4d_round(), after which it must not have
 * changed. */
spin_status spin_bundle_write_4d(struct spin_bundle_writer *w, const struct spin_splats_4d *s,
                                 enum spin_round_4d round, struct spin_bundle_meta *meta);
/* Writes columns of refined frame `index`; the caller describes them in "refined" of meta.json. */
spin_status spin_bundle_write_refined(struct spin_bundle_writer *w, int index, unsigned columns,
                                      const struct spin_splats *splats);
/* Writes array `series`/`frame`, or `series` itself if frame is -1: 4-byte values, descr "<f4" or
 * "<u4". */
spin_status spin_bundle_write_array(struct spin_bundle_writer *w, const char *series, int frame,
                                    const char *descr, int n_dims, const uint64_t *shape,
                                    const void *values);
/* extra: more members for the top level of meta.json (may be NULL; this call frees it).
 * meta.frame[].n must be set. data_path is stored as given. */
spin_status spin_bundle_writer_finish(struct spin_bundle_writer *w,
                                      const struct spin_bundle_meta *meta, spin_json *extra);
void spin_bundle_writer_abandon(struct spin_bundle_writer *w);
