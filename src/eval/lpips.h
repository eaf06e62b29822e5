/* LPIPS v0.1 (Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual
 * Metric", CVPR 2018): how far apart two pictures are for a network that was trained to name what
 * is in them.
 *
 * The weights are the user's: the network's as torchvision publishes them (features.N.weight and
 * .bias) and the linear heads of the lpips package (lin0.model.1.weight ...), read as data. */
#pragma once

#include "spin.h"

/* LPIPS networks, and the place of each in arrays. */
enum { SPIN_LPIPS_VGG, SPIN_LPIPS_ALEX, SPIN_N_LPIPS };

enum { SPIN_LPIPS_STAGES = 5, SPIN_LPIPS_SMALLEST = 32 /* pixels on a side */ };

struct spin_lpips;

/* Which network the two files belong to is seen from the shapes in them. */
spin_status spin_lpips_open(const char *backbone, const char *lin, int n_threads,
                            struct spin_lpips **out);
void spin_lpips_close(struct spin_lpips *lpips);
int spin_lpips_network(const struct spin_lpips *lpips); /* SPIN_LPIPS_VGG or _ALEX */

/* Every network of which `folder` (or a folder in it) holds both files; out [SPIN_N_LPIPS], NULL
 * where there is none. None at all is an error. */
spin_status spin_lpips_find(const char *folder, int n_threads, struct spin_lpips **out);

/* The distance of two pictures [3][h][w] in 0..1, and each stage's part of it (or NULL). */
spin_status spin_lpips_compare(struct spin_lpips *lpips, int width, int height, const float *image,
                               const float *truth, double *distance,
                               double stages[SPIN_LPIPS_STAGES]);
