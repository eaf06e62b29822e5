/* Writes a clip that consists of frames as a .4dgs with the temporal model keyframe-delta: the file
 * has one state for each frame, which players show until the next state begins. If row i is the
 * same splat in all frames of the source, splats keep their ids from frame to frame. In other
 * sources, a splat keeps its id as long as none of its quantised values changes. */
#pragma once

#include "exporters/lib/4dgs_code.h"
#include "exporters/lib/sort_rows.h"

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
