/* Checkpoint of an unfinished training, stored beside the output: replaced atomically, and read by
 * --resume. */
#pragma once

#include "io/output.h"
#include "train/code_paths.h"
#include "train/step.h"

struct spin_checkpoint {
    const char *path;        /* path of the checkpoint */
    const char *fingerprint; /* must be equal for a resume */
    const char *restart;     /* the options that discard the checkpoint, for errors */
    double start_s, saved_s; /* spin_now_s() when this run started, and when it last saved */
    double before_s;         /* seconds of work in the resumed checkpoint */
    double refine_s;         /* seconds of refinement, part of the total */
    double loss;             /* smoothed loss; 0: none yet */
    struct spin_code_paths *code_paths;
    bool sound; /* the state can be saved: no iteration is running, and values are finite */
    /* [frames][splats] row of each splat in the output; saved if there are tracks. */
    uint32_t **permutation;
    int64_t saved;               /* iteration of the checkpoint on disk; -1: none */
    struct spin_reserve reserve; /* disk space for the next checkpoint or the output */
    uint64_t bytes, growth; /* size when space was last reserved; its growth by a densification */
    bool failed;            /* the last attempt to save failed */
    bool warned;            /* the user was warned that saving fails */
};

/* Seconds of work so far, including those before a resume. */
double spin_checkpoint_seconds(const struct spin_checkpoint *checkpoint);
spin_status spin_checkpoint_save(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Estimates sizes in bytes: *state, of a checkpoint saved now; *values, an upper bound of the part
 * of it that the output keeps. */
spin_status spin_checkpoint_bytes(const struct spin_checkpoint *checkpoint,
                                  struct spin_trainer *trainer, uint64_t *state, uint64_t *values);
spin_status spin_checkpoint_load(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Reads the sizes of a trainer with tracks from a checkpoint: the numbers of tracks into *size, and
 * those of each frame into frame [size->n_frames]. */
spin_status spin_checkpoint_sizes(const struct spin_checkpoint *checkpoint,
                                  struct spin_frame_size *frame, struct spin_trainer_size *size);

/* Fails if a parameter is not finite, naming the array and the iteration, or if parameters differ
 * between ranks. */
spin_status spin_check_parameters(struct spin_trainer *trainer);
/* Downloads values of an array from the trainer's device. They must be finite. */
spin_status spin_read_device_values(struct spin_trainer *trainer, const char *name,
                                    const float SPIN_DEV *at, size_t first, size_t n, float *to);
/* Writes an array of the device into an archive, a portion at a time. */
spin_status spin_write_device_array(struct spin_trainer *trainer, struct spin_zip_writer *w,
                                    const char *name, int n_dims, const uint64_t *shape,
                                    const float SPIN_DEV *at, size_t n);
