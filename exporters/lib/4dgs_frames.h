/* Writes a clip that consists of frames as a .4dgs with the temporal model keyframe-delta: the file
 * has one state for each frame, which players show until the next state begins. If row i is the
 * same splat in all frames of the source, splats keep their ids from frame to frame. In other
 * sources, a splat keeps its id as long as none of its quantised values changes. */
#pragma once

#include "exporters/lib/quant_error.h"
#include "exporters/lib/splat_rows.h"
#include "formats/4dgs_write.h"

/* ---- Quantised splats ------------------------------------------------------------------------ */

/* Everything is quantised here except positions and times, whose coding depends on the temporal
 * model. */

struct spin_4dgs_coder {
    const struct spin_4dgs_coding *coding;
    const struct spin_splat_rows *rows;
    /* Numbers of splats with a clamped colour, and with a clamped SH coefficient; and the largest
     * change of a colour, and of a coefficient, by clamping. */
    uint64_t n_colours, n_sh;
    double lost_colour, lost_sh;
    struct spin_quant_error quant;
};

int32_t spin_4dgs_round(double value, double step);
/* Quantises scale, rotation, colour, opacity and SH of a row. *is: its values, without SH; *shown:
 * receives the values that a reader decodes. Adds the errors of SH to c->quant. */
void spin_4dgs_code_attributes(struct spin_4dgs_coder *c, size_t row,
                               const struct spin_gaussian *is, struct spin_4dgs_splat *to,
                               struct spin_gaussian *shown);
/* Warns about clamped values, and logs the quantisation errors. */
void spin_4dgs_coder_report(const struct spin_4dgs_coder *c);

/* ---- Frames ---------------------------------------------------------------------------------- */

/* A state in the form in which it is written. splat: [n], sorted by id; row: [n], row of each splat
 * in its frame. */
struct spin_4dgs_written {
    struct spin_4dgs_splat *splat;
    uint32_t *row;
    size_t n;
};

struct spin_4dgs_frames {
    const struct spin_export_job *job;
    struct spin_splat_rows *rows;
    struct spin_4dgs_coding *coding;
    struct spin_4dgs_writer *writer;
    struct spin_4dgs_coder coder;
    struct spin_sort_rows order;
    struct spin_4dgs_written shown, next;
    int n_frames, key; /* number of frames added, and index of the last keyframe */
    bool begun;        /* true: the header has been written, since there was a frame with splats */
    uint32_t n_ids;
    uint32_t **row_of; /* [job->n_frames] for --check: the rows of each frame, sorted by id */
    size_t *n_of;      /* [job->n_frames] */

    /* The following members describe the current frame. */
    struct spin_4dgs_splat *coded; /* [rows] */
    unsigned char *taken;          /* [rows] 1: the row is a splat of the previous frame */
    uint32_t *mate; /* [shown.n] row of each splat of the previous state; UINT32_MAX: none */
    /* [shown.n] the splats that change: their previous and their new values. */
    struct spin_4dgs_splat *before, *after;
    uint32_t *death; /* [shown.n] ids of the splats that end */
};

/* Adds a frame. Before the first call, set job, rows, coding and writer, and all other members to
 * zero. Free the struct even after a failure. */
spin_status spin_4dgs_frames_add(struct spin_4dgs_frames *x, const struct spin_splats *splats);
/* Writes the end of the file. */
spin_status spin_4dgs_frames_end(struct spin_4dgs_frames *x);
/* --check: compares the committed file with the frames of the job. */
spin_status spin_4dgs_frames_check(struct spin_4dgs_frames *x);
void spin_4dgs_frames_free(struct spin_4dgs_frames *x);
