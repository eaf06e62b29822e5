/* Checkpoint of an unfinished training: a file beside the output, from which --resume continues.
 * Each save replaces the file atomically. */
#pragma once

#include "io/output.h"
#include "train/simd_paths.h"
#include "train/step.h"

struct spin_checkpoint {
    /* Path of the checkpoint file. */
    const char *path;
    /* Identifies the input and the options; a resume fails if that of the file differs. */
    const char *fingerprint;
    /* The options that discard the checkpoint, for error messages: spin_options_restart(). */
    const char *restart;
    /* Times by spin_now_s(): when this run started, and when it last saved. */
    double start_s, saved_s;
    /* Seconds of work before this run, read from the checkpoint that it resumed; else 0. */
    double before_s;
    /* Seconds of refinement, included in the total of spin_checkpoint_seconds(). */
    double refine_s;
    /* Smoothed loss; 0 before the first iteration. */
    double loss;
    struct spin_simd_paths *simd_paths;
    /* True if the state can be saved: no iteration is running, and all values are finite. */
    bool sound;
    /* [frames][splats] row of each splat in the output. A checkpoint contains these rows if there
     * are tracks. */
    uint32_t **permutation;
    /* Iteration of the last checkpoint that this run saved or resumed; -1 if there is none. */
    int64_t saved;
    /* Disk space that is reserved for the next checkpoint or for the output. */
    struct spin_reserve reserve;
    /* Size of the checkpoint when space was last reserved, and how much it grew then. */
    uint64_t bytes, growth;
    bool failed; /* true if the last attempt to save failed */
    bool warned; /* true if the user has been warned that saving fails; no second warning follows */
};

/* Seconds of work so far, including those before a resume. */
double spin_checkpoint_seconds(const struct spin_checkpoint *checkpoint);
spin_status spin_checkpoint_save(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Estimates two sizes in bytes. *state: the size of a checkpoint that is saved now. *values: an
 * upper bound of the share of *state that the output will also contain, without moments and
 * statistics. */
spin_status spin_checkpoint_bytes(const struct spin_checkpoint *checkpoint,
                                  struct spin_trainer *trainer, uint64_t *state, uint64_t *values);
spin_status spin_checkpoint_load(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Reads the sizes of a trainer with tracks from a checkpoint: sets the numbers of tracks in *size,
 * and the numbers of splats of each frame in frame [size->n_frames]. */
spin_status spin_checkpoint_sizes(const struct spin_checkpoint *checkpoint,
                                  struct spin_frame_size *frame, struct spin_trainer_size *size);

/* Fails if a parameter is not finite, with an error that names the array and the iteration; fails
 * also if parameters differ between ranks. */
spin_status spin_check_parameters(struct spin_trainer *trainer);
/* Downloads the values [first, first + n) of an array from the trainer's device and stores them in
 * `to` [n]. Fails if one of the values is not finite. */
spin_status spin_read_device_values(struct spin_trainer *trainer, const char *name,
                                    const float SPIN_DEV *at, size_t first, size_t n, float *to);
/* Writes an array of n floats in device memory into an archive. Downloads it in portions, so that
 * the host needs little memory. */
spin_status spin_write_device_array(struct spin_trainer *trainer, struct spin_zip_writer *w,
                                    const char *name, int n_dims, const uint64_t *shape,
                                    const float SPIN_DEV *at, size_t n);
/* True if a recorded fingerprint is that of this run. Members for options of earlier versions are
 * ignored if these had the values that are constants now. */
bool spin_fingerprint_equal(const char *recorded, const char *own);
