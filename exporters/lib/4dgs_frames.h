/* Writes a clip of frames as a .4dgs of the model keyframe-delta: the file has one state for each
 * frame, which players show until the next one. A splat keeps its id from frame to frame if the
 * source has persistent rows, or if all of its quantised values are equal. */
#pragma once

#include "exporters/lib/4dgs_code.h"
#include "exporters/lib/sort_rows.h"

/* A state as it is written, sorted by id. row: [n] the row of each splat in its frame. */
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
    int n_frames, key; /* number of written frames, and index of the last keyframe; empty frames
                          before the first splat are counted when that splat is written */
    bool begun;        /* the header of the file has been written */
    uint32_t n_ids;
    uint32_t **row_of; /* [job->n_frames] for --check: the rows of each frame, sorted by id */
    size_t *n_of;      /* [job->n_frames] */

    /* The current frame. */
    struct spin_4dgs_splat *coded; /* [rows] */
    unsigned char *taken;          /* [rows] 1 if the row continues a splat of the previous frame */
    uint32_t *mate; /* [shown.n] for each splat of the previous state: the row that continues it */
    /* [shown.n] the splats that change, in the previous and in the next state */
    struct spin_4dgs_splat *before, *after;
    uint32_t *death; /* [shown.n] ids of the splats that end */
};

/* Adds a frame. Before the first call, set job, rows, coding and writer, and zero the other
 * members. Free the struct even after a failure. */
spin_status spin_4dgs_frames_add(struct spin_4dgs_frames *x, const struct spin_splats *splats);
/* Writes the end of the file. */
spin_status spin_4dgs_frames_end(struct spin_4dgs_frames *x);
/* --check: compares the committed file with the frames of the job. */
spin_status spin_4dgs_frames_check(struct spin_4dgs_frames *x);
void spin_4dgs_frames_free(struct spin_4dgs_frames *x);
