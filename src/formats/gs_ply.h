/* The PLY of 3D Gaussian Splatting's reference implementation (Kerbl et al. 2023), which every
 * viewer reads. Files are written as binary little endian. Element `vertex` has float properties in
 * the order
 *
 *     x y z  nx ny nz  f_dc_0..2  f_rest_0..  opacity  scale_0..2  rot_0..3
 *
 * Normals are zero, opacity is a logit, scale_* are logarithms, and rot_* is w x y z. f_rest_* is
 * channel-major: all coefficients of red above degree 0, then those of green, then those of blue;
 * struct spin_splats is coefficient-major. The reader finds properties by name, and accepts any
 * order and any type. */
#pragma once

/* Comment in STG-lite PLYs with the times of two viewers, which are equal: SuperSplat-4D reads
 * trbf_center and trbf_scale, OpenSplat4D reads t and scale_t. */
#define SPIN_PLY_TWO_VIEWERS "stglite supersplat4d opensplat4d"

#include "formats/gaussian.h"
#include "io/ply.h"

/* Upper bound of the header of any PLY written by spin4d, including its comments, in bytes. */
#define SPIN_GS_PLY_MAX_HEADER 4096

/* ---- Writing --------------------------------------------------------------------------------- */

/* Returns the size of a row in bytes. */
size_t spin_gs_ply_row(int sh_degree);
/* Writes the header of a file with n rows. comments: lines that begin with "comment " and end with
 * a line feed, less than 512 bytes in all. Returns the length of the header, which is then below
 * SPIN_GS_PLY_MAX_HEADER. */
size_t spin_gs_ply_header(int sh_degree, size_t n, const char *comments,
                          char text[SPIN_GS_PLY_MAX_HEADER]);

/* The values that spin_gs_ply_code() writes as a row. */
struct spin_gs_ply_row {
    float place[3], rotation[4]; /* position; quaternion w x y z of unit length */
    float logit;                 /* logit of the opacity; must be finite */
    const float *log_scale;      /* [3] logarithms of the standard deviations */
    const float *sh;             /* [n_sh][3] SH coefficients */
    int n_sh;
};
/* Writes a row of spin_gs_ply_row() bytes. Coefficients that row->sh lacks are written as 0;
 * coefficients above sh_degree are not written. */
void spin_gs_ply_code(const struct spin_gs_ply_row *row, int sh_degree, unsigned char *out);

/* ---- Reading --------------------------------------------------------------------------------- */

/* The layout of a parsed file. */
struct spin_gs_ply {
    const struct spin_ply *ply; /* the parsed file; borrowed */
    const struct spin_ply_element *vertex;
    int n_rest; /* number of properties f_rest_* in the file */
    /* 0 to 3; if a file has degree 4, this is 3, and its coefficients of degree 4 are not read. */
    int sh_degree;
    bool colours; /* the file has red, green and blue instead of f_dc_* */
    bool flat;    /* the file has no scale_2 (2DGS): the splats are thin along their third axis */
};

/* True if the vertices have any property that is specific to Gaussians. */
bool spin_gs_ply_any(const struct spin_ply_element *vertex);
/* Finds all properties of Gaussians in element `vertex`. Error messages contain the path and the
 * property. */
spin_status spin_gs_ply_find(const struct spin_ply *ply, struct spin_gs_ply *out);
/* Reads all rows of the file into *out, from row `first` on. The columns of *out must be reserved
 * with at least the file's SH degree; coefficients above the file's degree become 0. Infinite
 * logits, from writers that stored an opacity of exactly 0 or 1, become finite, and so do log
 * scales of -infinity, which are scales of 0; other values that are not finite are an error.
 * Rotations are not normalised. spin_gs_ply_load() is the same without the check for such values.
 */
void spin_gs_ply_load(const struct spin_gs_ply *file, unsigned columns, size_t first,
                      struct spin_splats *out);
spin_status spin_gs_ply_read(const struct spin_gs_ply *file, unsigned columns, size_t first,
                             struct spin_splats *out);

/* ---- Building blocks for other PLY layouts --------------------------------------------------- */

bool spin_ply_has(const struct spin_ply_element *e, const char *name);
bool spin_ply_has_prefix(const struct spin_ply_element *e, const char *prefix);
/* True if the element has the properties red, green and blue. */
bool spin_ply_has_colours(const struct spin_ply_element *e);
/* Reads x, y, z into out [n][3]. Values that are not finite are an error. */
spin_status spin_ply_places(const struct spin_ply *ply, const struct spin_ply_element *e,
                            float *out);
/* Reads red, green, blue of row i into out[step i .. step i + 2], scaled to 0..1: unsigned 8-bit
 * and 16-bit integers are divided by the largest value of their type, other types by 255 if any
 * value is above 1. */
void spin_ply_colours(const struct spin_ply *ply, const struct spin_ply_element *e, float *out,
                      size_t step);
/* Checks that rows [first, first + n) are finite. Error messages contain the path and the
 * properties. */
spin_status spin_ply_check(const struct spin_ply *ply, unsigned columns, size_t first, size_t n,
                           const struct spin_splats *s);
/* Counts the properties f_rest_* of an element, and derives the SH degree, at most 3, from their
 * number. If `e` is NULL, both results are 0. */
spin_status spin_gs_ply_degree(const struct spin_ply *ply, const struct spin_ply_element *e,
                               int *sh_degree, int *n_rest);
/* Reads the properties f_rest_* of row i into sh[step i + 3 ..], coefficient-major, without scaling
 * their values. */
void spin_gs_ply_rest(const struct spin_ply *ply, const struct spin_ply_element *e, int n_rest,
                      int sh_degree, float *sh, size_t step);
