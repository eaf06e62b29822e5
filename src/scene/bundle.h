/* Reads and writes *.spin: a zip of npy arrays and meta.json. See man/spin-bundle.5.
 *
 *   meta.json
 *   source/<column>/<index>.npy    a column of one frame
 *   source/<column>.npy            a column that is the same in every frame
 *   source/4d/<array>.npy          an array of 4D splats; such bundles have no source/<column>
 *   refined/<column>/<index>.npy   a column of one frame after refinement
 *   trained/means/<index>.npy      positions of one frame after retraining
 *   trained/residual/<index>.npy   optional values that are added to the network's outputs
 *   trained/table.npy, heads.npy   the parameters of the network (model/field)
 *   sound                          the sound track, as an encoded file
 *
 * The columns are means [n,3], quats [n,4], log_scales [n,3], logit_opacities [n], sh [n,K,3] and
 * rgb [n,3]. All values are little-endian float32, plain or packed (scene/bundle_pack.h). <index>
 * has 5 digits and is the position of the frame in the list "frames" of meta.json, not the frame
 * number. */
#pragma once

#include "spin.h"
#include "io/npy.h"
#include "scene/bundle_meta.h"
#include "scene/bundle_pack.h"
#include "scene/columns.h"
#include "scene/splats_4d.h"

/* Frames that were refined one by one. Their splats differ from those of the source in number and
 * order. If the bundle has a network, the network was trained on the refined frames. */
struct spin_bundle_refined {
    unsigned columns; /* columns of the refined frames; 0: there are no refined frames */
    int sh_degree;    /* degree of column sh; -1: there is no such column */
    bool antialias;   /* true: splats were trained with antialiasing and must be drawn with it */
    size_t *n;        /* [n_frames] number of splats of each refined frame */
};

/* An open array. */
struct spin_bundle_values {
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
    uint64_t count; /* product of shape */
    /* The values in the memory map. NULL if they are packed or unaligned:
     * spin_bundle_values_get() then copies them. */
    const float *floats;
    /* Private. */
    const unsigned char *bytes; /* byte planes, or plain values */
    void *owned;
    int n_planes;   /* number of byte planes; 0: plain values */
    bool columns;   /* true: planes are stored column by column; false: row by row */
    uint64_t width; /* values per row */
    /* true: words are integers k, which decode to k / per_unit[column]; false: floats */
    bool whole;
    float per_unit[SPIN_UNITS];
    /* words of frame 0 of the series, with which the first n_key words of this frame are XORed */
    const uint32_t *key;
    uint64_t n_key;
};

/* Cache of the decoded frame 0 of each packed series, with which later frames of the series may be
 * XORed. */
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
    /* [n_frames] number of splats of each retrained frame; NULL: as many as in the refined frames
     * or, without refined frames, in the source */
    size_t *trained_n;
    /* private; the memory of meta.sound.data; NULL: meta.sound.data points into the memory map */
    void *sound;
    struct spin_bundle_keys keys;
    struct spin_splats_4d four_d; /* private; loaded by spin_bundle_splats_4d() */
    bool nonfinite_reported;      /* true: splats with non-finite values were reported */
};

/* Sizes of the parts of a bundle in bytes, either packed as in the file or unpacked. */
struct spin_bundle_bytes {
    uint64_t file;         /* the whole file */
    uint64_t source;       /* imported positions and attributes */
    uint64_t refined;      /* frames that were refined one by one */
    uint64_t positions;    /* retrained positions and residual values of all frames */
    uint64_t tracks;       /* shared values of tracks, and the track of each splat */
    uint64_t table, heads; /* the network: hash table, heads */
};

/* Returns whether the path is a zip with a meta.json and members in source/. No input of an
 * importer has both. */
bool spin_bundle_detect(const char *path);
/* The path of a checkpoint with this suffix appended is the path of the clip that was saved with
 * the checkpoint. */
#define SPIN_CLIP_OF_STATE ".spin"
/* Opens a bundle and checks the header of every array against meta.json. If `path` is a checkpoint,
 * opens the clip that was saved with it, or fails with SPIN_E_UNSUPPORTED if no clip was saved. */
spin_status spin_bundle_open(const char *path, struct spin_bundle *out);
void spin_bundle_close(struct spin_bundle *bundle);
/* Sums up the sizes of all zip members by part of the bundle, packed as in the file and
 * unpacked. */
void spin_bundle_sizes(const struct spin_bundle *bundle, struct spin_bundle_bytes *packed,
                       struct spin_bundle_bytes *unpacked);
spin_json *spin_bundle_bytes_json(const struct spin_bundle_bytes *bytes);
/* Checks the header of array `series`/`frame`, or of array `series` if frame is -1. `kind` is the
 * expected type of the values, 'f' for float32 or 'u' for uint32. -1 in `shape` matches any size.
 * Error messages contain the name of the array. */
spin_status spin_bundle_values_check(struct spin_bundle *bundle, const char *series, int frame,
                                     char kind, int n_dims, const int64_t *shape);
/* Checks the header like spin_bundle_values_check(), and opens the array, which the caller must
 * close. Error messages contain the path of the bundle and the name of the array. */
spin_status spin_bundle_values_open(struct spin_bundle *bundle, const char *series, int frame,
                                    char kind, int n_dims, const int64_t *shape,
                                    struct spin_bundle_values *out);
/* Copies values [first, first + n) of an array to `out`, 4 bytes each, after unpacking. */
void spin_bundle_values_get(const struct spin_bundle_values *values, uint64_t first, size_t n,
                            void *out);
/* Returns the CRC-32 of all values after unpacking. */
uint32_t spin_bundle_values_crc(const struct spin_bundle_values *values);
void spin_bundle_values_close(struct spin_bundle_values *values);
/* Reads columns of a source frame. */
spin_status spin_bundle_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                              struct spin_splats *out);
/* Sets *out to the source's 4D splats, or to NULL if the source consists of frames. The 4D splats
 * are read on the first call and owned by the bundle. */
spin_status spin_bundle_splats_4d(struct spin_bundle *bundle, const struct spin_splats_4d **out);
/* Reads columns of a refined frame. SPIN_E_NOT_FOUND if a column does not exist. */
spin_status spin_bundle_refined_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                                      struct spin_splats *out);
/* Reads columns of a source frame, or of a refined frame if `from` is SPIN_FROM_REFINED. If all
 * columns can be used in place, *out points into the memory map (out->mapped is true), is read-only
 * and stays valid until the bundle is closed. Otherwise *out is a copy. */
spin_status spin_bundle_view(struct spin_bundle *bundle, int frame, enum spin_splat_source from,
                             unsigned columns, struct spin_splats *out);
/* Releases the memory pages of a mapped view that is not needed soon. Does nothing for a copy. */
void spin_bundle_release(const struct spin_splats *view);
/* Releases the memory pages of n rows of a mapped view, from row `first` on, in these columns only.
 * Does nothing for a copy or for a frame below 64 MiB. */
void spin_bundle_release_rows(const struct spin_splats *view, size_t first, size_t n,
                              unsigned columns);
/* Returns the number of splats of a frame: for SPIN_FROM_REFINED the number of refined splats, or
 * of source splats in a bundle without refined frames; for SPIN_FROM_TRAINED the number after
 * densification if the training had any, otherwise the number for SPIN_FROM_REFINED. */
size_t spin_bundle_count(const struct spin_bundle *bundle, int frame, enum spin_splat_source from);
/* Sets *out to a checksum of the values of these columns of a source frame. It does not depend on
 * whether the arrays are packed. */
spin_status spin_bundle_checksum(struct spin_bundle *bundle, int frame, unsigned columns,
                                 uint32_t *out);

/* Writer of a bundle. The caller writes the frames in order and then calls
 * spin_bundle_writer_finish(), which writes meta.json and commits the file. */
struct spin_bundle_writer {
    struct spin_zip_writer zip;
    bool packs; /* true: all arrays are packed; to be set before the first array is written */
    struct spin_packer packer;
};
/* Begins a bundle in a temporary file, which is renamed to `path` at the end. If `sync` is true,
 * fsync() writes the file to the disk before it is renamed. */
spin_status spin_bundle_writer_open(const char *path, bool force, bool sync,
                                    struct spin_bundle_writer *w);
/* Writes columns of frame `index`. Columns in static_columns are written only if index is 0. */
spin_status spin_bundle_write_frame(struct spin_bundle_writer *w, int index, unsigned columns,
                                    unsigned static_columns, const struct spin_splats *splats);
/* Writes the source as 4D splats instead of frames, and sets the fields of *meta that describe 4D
 * splats. `round` must be the rounding that was last applied to *s by spin_splats_4d_round(), and
 * the values must not have changed since then. */
spin_status spin_bundle_write_4d(struct spin_bundle_writer *w, const struct spin_splats_4d *s,
                                 enum spin_round_4d round, struct spin_bundle_meta *meta);
/* Writes columns of refined frame `index`. The caller must pass "refined" to
 * spin_bundle_writer_finish() in `extra`. */
spin_status spin_bundle_write_refined(struct spin_bundle_writer *w, int index, unsigned columns,
                                      const struct spin_splats *splats);
/* Writes array `series`/`frame`, or array `series` if frame is -1. `descr` is the type of the
 * values, "<f4" or "<u4". */
spin_status spin_bundle_write_array(struct spin_bundle_writer *w, const char *series, int frame,
                                    const char *descr, int n_dims, const uint64_t *shape,
                                    const void *values);
/* Writes meta.json and commits the file. meta->frame[].n must be set; meta->data_path is stored
 * unchanged. `extra` is an object with further top-level keys of meta.json, or NULL; this call
 * frees it. */
spin_status spin_bundle_writer_finish(struct spin_bundle_writer *w,
                                      const struct spin_bundle_meta *meta, spin_json *extra);
void spin_bundle_writer_abandon(struct spin_bundle_writer *w);
