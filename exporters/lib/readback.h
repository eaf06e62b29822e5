/* Compares the source with the splats that the importer reads back, and measures the errors of all
 * values. Position errors are also measured relative to the size of the splat, and in pixels of the
 * cameras to which the splat is visible. */
#pragma once

#include "exporters/lib/quant_error.h"
#include "exporters/lib/splat_rows.h"

struct spin_readback {
    struct spin_quant_error quant;
    double sizes;     /* largest position error, relative to the largest scale of the splat */
    double pixels;    /* largest position error in pixels; -1: no splat is visible to any camera */
    double bounds;    /* largest error of a side of a frame's bounding box */
    double reach;     /* largest absolute value of a coordinate */
    uint64_t n;       /* number of splats in all frames */
    uint64_t sh_lost; /* number of splats with nonzero SH above the degree of the file */
    const struct spin_view *view;
    size_t n_views; /* number of views of the current frame, which begin at `view` */
    /* Bounding boxes of the current frame's splats so far, in the source and in the file: minimum x
     * y z, maximum x y z. */
    double is_box[6], there_box[6];
};

/* Resets all errors and counts. */
void spin_readback_begin(struct spin_readback *e);
/* Starts a frame of the job. Errors in pixels are measured in the data set's views of this
 * frame. */
void spin_readback_frame(struct spin_readback *e, const struct spin_export_job *job, int frame);
/* Adds the position error `off`, in the source's units, of a splat at `mean`, in the source's
 * axes. */
void spin_readback_add(struct spin_readback *e, const float mean[3], const float log_scale[3],
                       double off);
/* Compares row i of the source with the file's values: `there`, and the coefficients sh[3 *
 * spin_sh_count(degree)]. Coefficients that the source lacks are compared with zero. */
void spin_readback_row(struct spin_readback *e, const struct spin_splat_rows *rows, size_t i,
                       const struct spin_gaussian *there, const float *sh, int degree);
/* Ends the frame: call it after all rows of the frame. */
void spin_readback_end(struct spin_readback *e);
/* Fails if an error exceeds the rounding error that was measured while the file `output` was
 * written, which is 0 for formats that do not round. */
spin_status spin_readback_verify(const struct spin_readback *e,
                                 const struct spin_quant_error *written, const char *output);
/* Fills *out for a check that rendered no image; a caller that renders sets `rendered` and `psnr`.
 */
void spin_readback_fill_check(const struct spin_readback *e, int n_frames,
                              struct spin_export_check *out);
