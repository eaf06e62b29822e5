/* What was written against what its importer reads: how far each value is off, places also in the
 * sizes of the splats and in pixels of the cameras that see them. */
#pragma once

#include "exporters/lib/quant_error.h"
#include "exporters/lib/splat_filter.h"

struct spin_readback {
    struct spin_quant_error quant;
    double sizes;     /* the most that a place is off, of a splat's largest standard deviation */
    double pixels;    /* the most that a place is off; -1: no camera saw a splat */
    double bounds;    /* the most that a side of a frame's box is off by */
    double reach;     /* the farthest coordinate */
    uint64_t n;       /* splats of all frames */
    uint64_t sh_lost; /* those with SH of a degree that the file does not hold */
    const struct spin_view *view;
    size_t n_views;                 /* of this frame */
    double is_box[6], there_box[6]; /* of this frame so far: least, most */
};

/* Nothing was seen so far. */
void spin_readback_begin(struct spin_readback *e);
/* The cameras from now on are those that the data set has of a frame of the job. */
void spin_readback_frame(struct spin_readback *e, const struct spin_export_job *job, int frame);
/* A splat whose place is off by so much, in the source's axes and units. */
void spin_readback_add(struct spin_readback *e, const float mean[3], const float log_scale[3],
                       double off);
/* Row i of the source against what the file has of it: `there`, and the coefficients sh [3
 * spin_sh_count(degree)]. What the source does not have should read as zero. */
void spin_readback_row(struct spin_readback *e, const struct spin_splat_filter *rows, size_t i,
                       const struct spin_gaussian *there, const float *sh, int degree);
/* All rows of the frame were seen. */
void spin_readback_end(struct spin_readback *e);
/* Sets what *out says of values; the rest of it becomes that of a check without a picture. */
void spin_readback_say(const struct spin_readback *e, int n_frames, struct spin_export_check *out);
