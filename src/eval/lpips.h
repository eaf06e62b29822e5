/* LPIPS v0.1 (Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual
 * Metric", CVPR 2018): the distance of two images in the features of a network trained for image
 * classification.
 *
 * The user provides two files of weights: those of the network as published by torchvision
 * (features.N.weight and features.N.bias), and the linear heads of the lpips package
 * (lin0.model.1.weight ...). Only tensors are read; no pickled code is executed. */
#pragma once

#include "spin.h"

/* LPIPS networks, and their indices in arrays. */
enum { SPIN_LPIPS_VGG, SPIN_LPIPS_ALEX, SPIN_N_LPIPS };

enum { SPIN_LPIPS_STAGES = 5, SPIN_LPIPS_SMALLEST = 32 /* smallest width and height, pixels */ };

struct spin_lpips;

/* Loads a network from two files, its weights and its linear heads. The shapes of the tensors
 * determine the network. SPIN_E_USAGE if the files are of different networks. */
spin_status spin_lpips_open(const char *backbone, const char *lin, int n_threads,
                            struct spin_lpips **out);
void spin_lpips_close(struct spin_lpips *lpips);
int spin_lpips_network(const struct spin_lpips *lpips); /* SPIN_LPIPS_VGG or _ALEX */

/* Opens every network of which `folder` or a subfolder contains both files. out [SPIN_N_LPIPS]: the
 * open networks; NULL: no files. SPIN_E_NOT_FOUND if there are files for no network. */
spin_status spin_lpips_find(const char *folder, int n_threads, struct spin_lpips **out);

/* Computes the distance between two images [3][h][w] with values 0..1. stages, or NULL: receives
 * the contribution of each stage. */
spin_status spin_lpips_compare(struct spin_lpips *lpips, int width, int height, const float *image,
                               const float *truth, double *distance,
                               double stages[SPIN_LPIPS_STAGES]);
