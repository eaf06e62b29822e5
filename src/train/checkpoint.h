/* The unfinished state of a network training, beside the output: written whole or not at all, and
 * read by
 * --resume. */
#pragma once

#include "io/output.h"
#include "train/code_paths.h"
#include "train/step.h"

struct spin_checkpoint {
    const char *path;        /* of the state */
    const char *fingerprint; /* what must be equal for a resume */
    const char *restart;     /* the options that discard the state, for errors */
    double start_s, saved_s; /* when this run began to work, when it last saved: spin_now_s() */
    double before_s;         /* seconds worked before the state was saved that was resumed */
    double refine_s;         /* of all seconds, those of the refinement */
    double loss;             /* of the last steps, smoothed; 0: of none */
    struct spin_code_paths *code_paths;
    bool sound; /* the trainer stands between two steps, all finite: its state can be saved */
    uint32_t **permutation;      /* [frames][splats] kept in the state when there are tracks */
    int64_t saved;               /* iteration of the state that is kept; -1: none is */
    struct spin_reserve reserve; /* of the disk, for the next state or the output */
    uint64_t bytes,
        growth;  /* of the state when that was last reserved; by the last densification */
    bool failed; /* the last attempt to save did */
    bool warned; /* that a state cannot be saved */
};

/* Seconds of work so far, those before a resume too. */
double spin_checkpoint_seconds(const struct spin_checkpoint *checkpoint);
spin_status spin_checkpoint_save(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* About the bytes of a state saved now, and at most those of the values that the output keeps of
 * it. */
spin_status spin_checkpoint_bytes(const struct spin_checkpoint *checkpoint,
                                  struct spin_trainer *trainer, uint64_t *state, uint64_t *values);
spin_status spin_checkpoint_load(struct spin_checkpoint *checkpoint, struct spin_trainer *trainer);
/* Sizes of a trainer with tracks as the state has them: its tracks, and its frames
 * [size->n_frames]. */
spin_status spin_checkpoint_sizes(const struct spin_checkpoint *checkpoint,
                                  struct spin_frame_size *frame, struct spin_trainer_size *size);

/* All parameters are finite; else an error that names the array and the iteration. */
spin_status spin_check_parameters(struct spin_trainer *trainer);
/* Values of an array on the trainer's device to the host. They must be finite. */
spin_status spin_read_device_values(struct spin_trainer *trainer, const char *name,
                                    const float SPIN_DEV *at, size_t first, size_t n, float *to);
/* The array into an archive, piece by piece. */
spin_status spin_write_device_array(struct spin_trainer *trainer, struct spin_zip_writer *w,
                                    const char *name, int n_dims, const uint64_t *shape,
                                    const float SPIN_DEV *at, size_t n);
