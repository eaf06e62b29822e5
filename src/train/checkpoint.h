/* Checkpoint of an unfinished training, stored beside the output: replaced atomically, and read by
 * --resume. */
#pragma once

#include "io/output.h"
#include "train/code_paths.h"
#include "train/step.h"

struct spin_checkpoint {
    const char *path;        /* of the checkpoint */
    const char *fingerprint; /* must be equal for a resume */
    const char *restart;     /* the options that discard the checkpoint, for errors */
    double start_s, saved_s; /* when this run started to work, and last saved: spin_now_s() */
    double before_s;         /* seconds of work before the checkpoint that was resumed */
    double refine_s;         /* part of all seconds that refinement took */
    double loss;             /* of the last iterations, smoothed; 0: none yet */
    struct spin_code_paths *code_paths;
    bool sound;             /* between two iterations, with finite values: the state can be saved */
    uint32_t **permutation; /* [frames][splats] saved if there are tracks */
    int64_t saved;          /* iteration of the checkpoint on disk; -1: none */
    struct spin_reserve reserve; /* disk space for the next checkpoint or the output */
    uint64_t bytes, growth;      /* size when space was last reserved; by the last densification */
    bool failed;                 /* the last attempt to save failed */
    bool warned;                 /* the user was warned that saving fails */
};

/* Seconds of work so far, including those before a resume. */
double spin_checkpoint_seconds(const struct spin_checkpoint *checkpoint);
spin_status spin_checkpoint_save(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Estimates in bytes: *state, a checkpoint saved now; *values, at most, what the output keeps of
 * it. */
spin_status spin_checkpoint_bytes(const struct spin_checkpoint *checkpoint,
                                  struct spin_trainer *trainer, uint64_t *state, uint64_t *values);
spin_status spin_checkpoint_load(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Reads the sizes of a trainer with tracks from a checkpoint: of its tracks, and frame
 * [size->n_frames]. */
spin_status spin_checkpoint_sizes(const struct spin_checkpoint *checkpoint,
                                  struct spin_frame_size *frame, struct spin_trainer_size *size);

/* Fails if a parameter is not finite, with the name of the array and the iteration, or if ranks
 * differ. */
spin_status spin_check_parameters(struct spin_trainer *trainer);
/* Downloads values of an array from the trainer's device. They must be finite. */
spin_status spin_read_device_values(struct spin_trainer *trainer, const char *name,
                                    const float SPIN_DEV *at, size_t first, size_t n, float *to);
/* Writes an array of the device into an archive, a portion at a time. */
spin_status spin_write_device_array(struct spin_trainer *trainer, struct spin_zip_writer *w,
                                    const char *name, int n_dims, const uint64_t *shape,
                                    const float SPIN_DEV *at, size_t n);
