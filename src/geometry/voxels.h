/* A coarse voxel grid of a clip: it shows how opaque each part of space is, where walls are, and
 * which splats move. It needs neither renders nor matches between the splats of different frames.
 */
#pragma once

#include "spin.h"

enum { SPIN_VOXEL_FRAMES = 8, SPIN_VOXEL_SIDE = 80 };

/* Reads a frame of a clip, with all attribute columns. The splats stay valid until the next
 * call. */
typedef spin_status (*spin_voxel_read_fn)(void *context, int frame, const struct spin_splats **out);

struct spin_voxel_splat {
    float at[3], rgb[3];
    float opacity, area; /* area: opacity times the integral of the Gaussian over the plane of its
                            two longest axes */
    float largest;       /* largest standard deviation */
    float axis[2][3];    /* the two longest axes of the ellipsoid */
    float count;         /* number of splats that this one represents, above 1 in large frames */
    int frame;           /* sampled frame, 0..n_frames - 1 */
};

struct spin_voxels {
    double low[3], cell;
    int dim[3];
    size_t n;     /* number of cells */
    int n_frames; /* number of sampled frames that contain splats */
    /* Splats of the sampled frames, at most about 100,000 of each. */
    struct spin_voxel_splat *splat;
    size_t n_splats, capacity;
    /* [n] opaque area in each sampled frame, blurred over 3 x 3 x 3 cells */
    float *mass[SPIN_VOXEL_FRAMES];
    float *mean; /* [n] mean of `mass` over the frames */
    /* [n] 0..2: mean colour; 3: mean of the squared length of the colour; weighted by `mass` */
    float *colour[4];
    float *opacity; /* [n] mean extinction per unit of length over the frames, not blurred */
    float *haze;    /* [n] the same; splats of many cells, such as haze, cover all of them */
    float *walls;   /* [n] extinction by static parts, which most frames contain, blurred */
};

/* Reads up to SPIN_VOXEL_FRAMES of n_frames frames. Fails with SPIN_E_UNSUPPORTED if these frames
 * have no opacities, or no splat with a finite position. */
spin_status spin_voxels_open(struct spin_voxels *v, int n_frames, spin_voxel_read_fn read,
                             void *context);
void spin_voxels_close(struct spin_voxels *v);

/* Returns the index of the cell that contains a point; SIZE_MAX: outside of the grid. */
size_t spin_voxels_find(const struct spin_voxels *v, const double at[3]);
void spin_voxels_centre(const struct spin_voxels *v, size_t cell, double out[3]);
/* Returns the opaque area of a splat, limited to its opacity times the area of a side of a cell,
 * and multiplied by the number of splats that it represents. */
double spin_voxels_area(const struct spin_voxels *v, const struct spin_voxel_splat *s);
/* Returns the optical depth of a field such as v->opacity from the point `from` to `from + along`,
 * estimated by n samples. */
double spin_voxels_depth(const struct spin_voxels *v, const float *field, const double from[3],
                         const double along[3], int n);
/* Returns whether a splat is dynamic: in more than a fifth of the sampled frames, its cell has much
 * less mass than on average, or its colour is far from the mean colour of the cell. Always false if
 * only one frame was sampled. */
bool spin_voxels_moves(const struct spin_voxels *v, const struct spin_voxel_splat *s);
