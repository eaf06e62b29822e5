/* LPIPS v0.1 (Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual
 * Metric", CVPR 2018): the distance between the features of two images in a network that was
 * trained for image classification.
 *
 * The user provides two files of weights: the network as published by torchvision (tensors
 * features.N.weight and features.N.bias), and the linear heads of the Python package lpips (tensors
 * lin0.model.1.weight to lin4.model.1.weight). Only tensors are read; no pickled code is executed.
 */
#pragma once

#include "spin.h"

/* LPIPS networks; the constants are also indices of arrays [SPIN_N_LPIPS]. */
enum { SPIN_LPIPS_VGG, SPIN_LPIPS_ALEX, SPIN_N_LPIPS };

enum { SPIN_LPIPS_STAGES = 5, SPIN_LPIPS_SMALLEST = 32 /* smallest width and height, pixels */ };

struct spin_lpips;

/* Loads a network from two files: `backbone`, the weights of the network, and `lin`, the linear
 * heads. The shapes of the tensors determine which network it is. SPIN_E_NOT_RECOGNISED if a file
 * contains no such weights; SPIN_E_USAGE if the files are for different networks. */
spin_status spin_lpips_open(const char *backbone, const char *lin, int n_threads,
                            struct spin_lpips **out);
void spin_lpips_close(struct spin_lpips *lpips);
int spin_lpips_network(const struct spin_lpips *lpips); /* SPIN_LPIPS_VGG or SPIN_LPIPS_ALEX */

/* Opens all networks of which `folder` or its subfolders contain both files. out [SPIN_N_LPIPS]:
 * the opened networks; NULL if a file is missing. SPIN_E_NOT_FOUND if no network has both files. */
spin_status spin_lpips_find(const char *folder, int n_threads, struct spin_lpips **out);

/* Computes the distance between two images [3][h][w] with values 0..1. stages receives the
 * contribution of each stage to the distance; it may be NULL. */
spin_status spin_lpips_compare(struct spin_lpips *lpips, int width, int height, const float *image,
                               const float *truth, double *distance,
                               double stages[SPIN_LPIPS_STAGES]);
