/* Implements --bake-antialias of spin-export, for programs that draw without antialiasing. A
 * program that antialiases widens a splat by the dilation of the rasteriser and lowers its opacity
 * by the factor spin_aa_compensation(); other programs only widen it. The factor depends on the
 * camera and on the size of the image. This module lowers the stored opacities by the mean factor
 * over the training views of the frame that show the splat, for images of one size. */
#pragma once

#include "render/player.h"
#include "scene/clip.h"
#include "spin_run.h"

struct spin_antialias_bake {
    bool bakes;        /* --bake-antialias is given */
    bool measures;     /* the effect of baking is measured for spin_antialias_bake_log() */
    int width, height; /* size of the images; 0: the size of each view, times `scale` */
    double scale;      /* image scale of the training */
    const struct spin_clip *clip;
    const float *background; /* [3] */
    struct spin_player drawing;
    struct spin_splats splats; /* copy of the frame that was baked last */
    double sum_factors, n_splats;
    /* sums of squared differences from antialiased images, with (after) and without (before)
     * baking, and the number of differences */
    double after, before, n_values;
    int n_images;
};

/* Checks the option. Fails if the splats of the clip were trained without antialiasing, or if the
 * clip has no views. */
spin_status spin_antialias_bake_open(struct spin_antialias_bake *b,
                                     const struct spin_export_options *o,
                                     const struct spin_clip *clip, enum spin_splat_source from,
                                     bool antialias, struct spin_device *device);
void spin_antialias_bake_close(struct spin_antialias_bake *b);
/* Replaces *splats by a pointer to a baked copy of frame f of the clip, which is valid until the
 * next call. Without --bake-antialias, *splats stays unchanged. */
spin_status spin_antialias_bake_frame(struct spin_antialias_bake *b, int f,
                                      const struct spin_splats **splats);
/* Logs how much opacities were lowered, and the PSNR of images without antialiasing, compared with
 * antialiased images, with and without baking. */
void spin_antialias_bake_log(const struct spin_antialias_bake *b);
/* Sets *psnr to the PSNR between renders of frame f of the clip without antialiasing and with it,
 * at the size of the training's images, in views of the data set. Sets *psnr to INFINITY if the
 * renders are equal, and to 0 if no view shows the frame. `splats` are those of the frame. */
spin_status spin_antialias_cost(const struct spin_export_options *o, const struct spin_clip *clip,
                                enum spin_splat_source from, struct spin_device *device, int f,
                                const struct spin_splats *splats, double *psnr);
