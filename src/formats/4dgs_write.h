/* Writes .4dgs files, which 4dgs.h describes, from splats whose values are quantised already. */
#pragma once

#include "formats/4dgs_records.h"
#include "formats/4dgs_states.h"

/* Parameters of a file that are known before the first chunk. Values of splats are integers in
 * units of `step`; positions are relative to `origin`. */
struct spin_4dgs_coding {
    double duration; /* seconds */
    double fps;      /* frames per second */
    double cutoff;
    double origin[3], step[SPIN_4DGS_N_STEPS];
    double box[6]; /* minimum x y z, maximum x y z of the positions */
    int sh_degree;
    bool up;        /* y points up */
    bool antialias; /* the splats are to be rendered with antialiasing */
    uint64_t n;     /* number of splats */
    /* Number of states from one keyframe to the next; 0: the model is gaussian-birth, else it is
     * keyframe-delta. */
    int key_every;
    double (*window)[2];
    size_t n_windows;
    const struct spin_sound *sound; /* WAV or Opus; NULL: none */
};

/* Sets the steps and the origin for splats with positions in the box and standard deviations around
 * `scale`. All steps are twice the errors that the file states. */
void spin_4dgs_choose_steps(struct spin_4dgs_coding *coding, double scale);

/* The changes of a state relative to the previous state. */
struct spin_4dgs_changes {
    const struct spin_4dgs_splat *before,
        *after; /* [n_updates] the same splats before and after the change, sorted by id */
    const struct spin_4dgs_splat *born; /* [n_births] */
    const uint32_t *death;              /* [n_deaths] ids */
    size_t n_updates, n_births, n_deaths;
    size_t n_live; /* number of splats after the changes */
};

/* Writes everything before the first chunk. Zero the writer before, and set `out` and `coding`. */
spin_status spin_4dgs_write_begin(struct spin_4dgs_writer *w);
/* Writes n splats that are only visible in the interval; a keyframe if coding->key_every is set. */
spin_status spin_4dgs_write_chunk(struct spin_4dgs_writer *w, const double interval[2],
                                  const struct spin_4dgs_splat *splat, size_t n);
/* Writes a delta that follows a keyframe or another delta. Updates may change anything but SH,
 * sigma and window. */
spin_status spin_4dgs_write_delta(struct spin_4dgs_writer *w, const double interval[2],
                                  const struct spin_4dgs_changes *changes);
/* Writes the index and the end of the file, and the header once more, since coding->n and
 * coding->box may have changed. */
spin_status spin_4dgs_write_end(struct spin_4dgs_writer *w);
void spin_4dgs_write_free(struct spin_4dgs_writer *w);
