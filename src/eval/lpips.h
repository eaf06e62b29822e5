/* LPIPS v0.1 (Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual
 * Metric", CVPR 2018): the distance of two images in the features of a network trained for image
 * classification.
 *
 * The user provides the weights: the network's as torchvision publishes them (features.N.weight and
 * .bias) and the linear heads of the lpips package (lin0.model.1.weight ...). Only tensors are
 * read; no pickled code is executed. */
#pragma once

#include "spin.h"

/* LPIPS networks, and their indices in arrays. */
enum { SPIN_LPIPS_VGG, SPIN_LPIPS_ALEX, SPIN_N_LPIPS };

enum { SPIN_LPIPS_STAGES = 5, SPIN_LPIPS_SMALLEST = 32 /* smallest width and height, pixels */ };

struct spin_lpips;

/* The network is detected from the shapes in the two files. */
spin_status spin_lpips_open(const char *backbone, const char *lin, int n_threads,
                            struct spin_lpips **out);
void spin_lpips_close(struct spin_lpips *lpips);
int spin_lpips_network(const struct spin_lpips *lpips); /* SPIN_LPIPS_VGG or _ALEX */

/* Opens every network for which `folder` (or a subfolder) contains both files; out [SPIN_N_LPIPS],
 * NULL for the others. An error if there is none. */
spin_status spin_lpips_find(const char *folder, int n_threads, struct spin_lpips **out);

/* The distance of two images [3][h][w] in 0..1, and the contribution of each stage (or NULL). */
spin_status spin_lpips_compare(struct spin_lpips *lpips, int width, int height, const float *image,
                               const float *truth, double *distance,
                               double stages[SPIN_LPIPS_STAGES]);
