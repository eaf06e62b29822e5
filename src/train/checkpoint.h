/* The checkpoint of an unfinished training: a file beside the output, from which --resume
 * continues. Each save replaces the file atomically. */
#pragma once

#include "io/output.h"
#include "train/step.h"
#include "train/trainer.h"

/* ---- Arrays of a checkpoint ------------------------------------------------------------------ */

/* The list of all arrays that a training keeps between iterations. Saving, loading, checking and
 * averaging iterate over this list. */

/* An array of the list. Its n values are floats or, for the kind SPIN_STATE_SEEN and later kinds,
 * 32-bit unsigned integers. */
struct spin_state_array {
    char name[48];
    enum {
        SPIN_STATE_VALUES, /* parameters, Adam moments, turns, Polyak average */
        SPIN_STATE_STEPS,  /* last Adam step that updated each line of the hash table (lazy Adam) */
        SPIN_STATE_GRADIENT,
        /* GRADIENT and SEEN are the densification statistics of a frame's splats, which each rank
           accumulates over its own views. A checkpoint contains the statistics of all ranks, added
           up; a resume loads them on rank 0, and zeros on the other ranks. */
        SPIN_STATE_SEEN,
        SPIN_STATE_TRACK, /* track of each splat of a frame */
        SPIN_STATE_PLACE  /* row in the output of each splat of a frame */
    } kind;
    float SPIN_DEV *at;
    /* The array in host memory; NULL: the array is in device memory, at `at`. */
    uint32_t *host;
    size_t n;
    bool of_frame; /* whether it belongs to a frame: the one with this index */
    int frame;
};

/* Sets *out [*n], which the caller frees, to the list of all arrays. permutation [frames][splats]
 * becomes the arrays of kind SPIN_STATE_PLACE; it may be NULL if the caller does not use these
 * arrays. */
spin_status spin_state_arrays(struct spin_trainer *t, uint32_t **permutation,
                              struct spin_state_array **out, size_t *n);
/* True if the array contains parameters, which the training optimises, false if it contains
 * anything else, such as moments or statistics. */
bool spin_state_is_parameter(const struct spin_state_array *array);

/* ---- Checkpoints ----------------------------------------------------------------------------- */

struct spin_checkpoint {
    /* Path of the checkpoint file. */
    const char *path;
    /* Identifies the input and the options (refinement.h); a resume fails if the checkpoint file
     * has another fingerprint. */
    const char *fingerprint;
    /* Options that discard the checkpoint (spin_options_restart()), for error messages. */
    const char *restart;
    /* Times, by spin_now_s(), of the start of this run and of its last checkpoint. */
    double start_s, saved_s;
    /* Seconds of work in earlier runs, read from the checkpoint on a resume; otherwise 0. */
    double before_s;
    /* Seconds of refinement, included in the total of spin_checkpoint_seconds(). */
    double refine_s;
    /* Exponentially smoothed loss; 0 before the first iteration. */
    double loss;
    struct spin_simd_paths *simd_paths;
    /* True if a checkpoint can be saved: no iteration is running, and all values are finite. */
    bool sound;
    /* [frames][splats] row of each splat in the output; saved only in a training with tracks. */
    uint32_t **permutation;
    /* Iterations from this one on gather no densification statistics, so checkpoints before them
     * contain none; 0: all iterations may gather statistics. */
    int64_t gather_end;
    /* Iteration of the last checkpoint that this run saved or loaded; -1 if there is none. */
    int64_t saved;
    /* Disk space that is reserved for the next checkpoint or for the output. */
    struct spin_reserve reserve;
    /* Size of the checkpoint when disk space was last reserved, and growth of this size since the
     * previous reservation, in bytes. */
    uint64_t bytes, growth;
    bool failed; /* true if the last attempt to save a checkpoint failed */
    bool warned; /* true if a failure to save has been reported; later failures are not reported */
};

/* Seconds of work so far, including earlier runs. */
double spin_checkpoint_seconds(const struct spin_checkpoint *checkpoint);
spin_status spin_checkpoint_save(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Estimates two sizes in bytes. *state: size of a checkpoint that is saved now. *values: upper
 * bound of the size of those arrays of the checkpoint that the output will contain as well, that
 * is, all but moments and statistics. */
spin_status spin_checkpoint_bytes(const struct spin_checkpoint *checkpoint,
                                  struct spin_trainer *trainer, uint64_t *state, uint64_t *values);
spin_status spin_checkpoint_load(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Reads the sizes of a trainer with tracks from a checkpoint: sets the numbers of tracks in *size,
 * and the numbers of splats of each frame in frame [size->n_frames]. */
spin_status spin_checkpoint_sizes(const struct spin_checkpoint *checkpoint,
                                  struct spin_frame_size *frame, struct spin_trainer_size *size);

/* Fails if a parameter is not finite; the error names the array and the iteration. Also fails if
 * parameters differ between ranks. */
spin_status spin_check_parameters(struct spin_trainer *trainer);
/* Downloads the values [first, first + n) of an array from the trainer's device to `to` [n]. Fails
 * if one of these values is not finite; the error names the array. */
spin_status spin_read_device_values(struct spin_trainer *trainer, const char *name,
                                    const float SPIN_DEV *at, size_t first, size_t n, float *to);
/* Writes an array of n floats in device memory into an archive. Downloads the array in portions, so
 * that the host needs little memory. */
spin_status spin_write_device_array(struct spin_trainer *trainer, struct spin_zip_writer *w,
                                    const char *name, int n_dims, const uint64_t *shape,
                                    const float SPIN_DEV *at, size_t n);
/* True if a recorded fingerprint equals that of this run. Options of earlier versions that have
 * since become constants are ignored if their values equal these constants. */
bool spin_fingerprint_equal(const char *recorded, const char *own);

/* ---- Polyak average -------------------------------------------------------------------------- */

/* Polyak average: the mean of the parameters over the last iterations. Each iteration uses
 * different images, so the parameters fluctuate at the end of a training, in proportion to the
 * learning rates. Their mean over many iterations fluctuates far less, so learning rates need not
 * decay to zero. The methods "tracks" and "4d" use the average. */

/* Plans an average over the last iterations: `share` (0..1) of all `iterations`, excluding those up
 * to `until`. */
struct spin_average spin_average_of(double share, int64_t until, int64_t iterations);
/* All ranks must call this function after each iteration. Every few iterations, it adds the
 * parameters to the mean; after the last iteration, it replaces the parameters by their mean. */
spin_status spin_average_step(struct spin_trainer *t);
/* For a resume: derives the number of iterations averaged so far from the trainer's iteration, and
 * allocates the mean, which the caller then loads from the checkpoint. */
spin_status spin_average_resume(struct spin_trainer *t);
/* Sets *n to the number of averaged values, that is, of parameters. */
spin_status spin_average_values(struct spin_trainer *t, size_t *n);
