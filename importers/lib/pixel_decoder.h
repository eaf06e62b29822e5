/* The network of SpacetimeGaussians' full model, which makes the colour of a pixel:
 *
 *     ending(base + W2 relu(W1 [view, time, origin of the ray, direction of the ray]))
 *
 * base, view and time, three numbers each, are blended from the Gaussians over black; the ray is in world
 * coordinates, its direction of unit length. What ordinary Gaussians can hold of it: the colour of a pixel
 * that one Gaussian covers alone, as SH of degree 1 fitted to the colours for given cameras. */
#ifndef SPIN_IMPORTERS_LIB_PIXEL_DECODER_H
#define SPIN_IMPORTERS_LIB_PIXEL_DECODER_H

#include "importers/lib/camera_places.h"
#include "importers/lib/mlp_eval.h"

enum { PIXEL_INPUTS = 12, PIXEL_HIDDEN = 6 };

/* Floats of scratch for a block. */
#define PIXEL_SCRATCH ((size_t)(PIXEL_INPUTS + PIXEL_HIDDEN + 3) * MLP_BLOCK)

struct pixel_decoder {
    enum pixel_ending { PIXEL_SIGMOID, PIXEL_CLAMP, PIXEL_AS_IS } ending;
    struct mlp_linear hidden, rgb; /* W1, W2; n_in == 0: there is no network */
    struct camera_places cameras;
};

/* What a Gaussian adds to pixels. */
struct pixel_splat {
    double place[3]; /* world units */
    float base[3], view[3], time[3];
};

/* The state dict at `path`: mlp1.weight, mlp2.weight, 1x1 convolutions without bias. Errors name the file. */
spin_status spin_pixel_decoder_load(const char *path, struct pixel_decoder *out);
void spin_pixel_decoder_free(struct pixel_decoder *d);

/* The SH coefficient of degree 0 for a colour 0..1, and for the base colour without the network. */
float spin_pixel_dc(double colour);
float spin_pixel_base_dc(const struct pixel_decoder *d, float base);

/* sh [n][4][3] of n splats, at most MLP_BLOCK, for at least one camera; splat has MLP_BLOCK entries, all set.
 * scratch: PIXEL_SCRATCH floats. */
void spin_pixel_decoder_sh(const struct pixel_decoder *d, const struct pixel_splat *splat, int n,
                           float *scratch, float *sh);

#endif
