/* Checkpoint of an unfinished training: a file beside the output, from which --resume continues.
 * Each save replaces the file atomically. */
#pragma once

#include "io/output.h"
#include "train/step.h"
#include "train/trainer.h"

/* ---- Arrays of a checkpoint ------------------------------------------------------------------ */

/* List of all arrays that a training keeps between iterations, for saving, loading, checking and
 * averaging them. */

/* An array that a training keeps. The values are floats or, for the kind SPIN_STATE_SEEN and later
 * kinds, 32-bit unsigned integers. */
struct spin_state_array {
    char name[48];
    enum {
        SPIN_STATE_VALUES, /* parameters, moments, turns, and the Polyak average */
        SPIN_STATE_STEPS,  /* the last Adam step of each line of the table, for lazy Adam */
        SPIN_STATE_GRADIENT,
        /* GRADIENT and SEEN are the statistics of a frame's splats. Each rank has a part of them;
         * the sum of these parts is the whole. A checkpoint contains the whole sum; a resume gives
         * it to rank 0, and zeros to the other ranks. */
        SPIN_STATE_SEEN,
        SPIN_STATE_TRACK, /* the track of each splat of a frame */
        SPIN_STATE_PLACE  /* the row in the output of each splat of a frame */
    } kind;
    float SPIN_DEV *at;
    /* If not NULL, the array is here, in host memory; otherwise it is at `at`, in device memory. */
    uint32_t *host;
    size_t n;
    int frame;
};

/* Sets *out [*n] to the list of all arrays, which the caller frees. permutation [frames][splats] is
 * the memory of the arrays of kind SPIN_STATE_PLACE; NULL if the caller does not need them. */
spin_status spin_state_arrays(struct spin_trainer *t, uint32_t **permutation,
                              struct spin_state_array **out, size_t *n);
/* True if the array contains parameters, which the training optimises; false if it contains
 * moments, statistics or anything else. */
bool spin_state_is_parameter(const struct spin_state_array *array);

/* ---- Checkpoints ----------------------------------------------------------------------------- */

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

/* ---- Polyak average -------------------------------------------------------------------------- */

/* Polyak average: the mean of the parameters over the last iterations. Every iteration draws other
 * images, so at the end of a training the parameters fluctuate in proportion to the learning rates.
 * The mean of the parameters fluctuates far less, so the learning rates need not decay to zero. The
 * methods "tracks" and "4d" use the average. */

/* Plans an average over the last `share` (0..1) of all `iterations`. Iterations up to `until` are
 * never averaged, even if `share` includes them. */
struct spin_average spin_average_of(double share, int64_t until, int64_t iterations);
/* Must be called by all ranks after each iteration. Every few iterations it adds the parameters to
 * the mean; after the last iteration it replaces the parameters by their mean. */
spin_status spin_average_step(struct spin_trainer *t);
/* After a resume, derives the number of averaged iterations from the trainer's iteration and
 * allocates the mean, which the caller then loads from the checkpoint. */
spin_status spin_average_resume(struct spin_trainer *t);
/* Sets *n to the number of values that the average covers: all trained parameters. */
spin_status spin_average_values(struct spin_trainer *t, size_t *n);
