/* The PLY layout of 3D Gaussian Splatting's reference implementation (Kerbl et al. 2023). Every
 * viewer reads this layout. Files are written as binary little endian. Element `vertex` has float
 * properties in the order
 *
 *     x y z  nx ny nz  f_dc_0..2  f_rest_0..  opacity  scale_0..2  rot_0..3
 *
 * Normals are zero, opacity is a logit, scale_* are natural logarithms, and rot_* is a quaternion w
 * x y z. f_rest_* is channel-major: all coefficients of red above degree 0, then those of green,
 * then those of blue. By contrast, struct spin_splats is coefficient-major. The reader finds
 * properties by name, and accepts any order and any type. */
#pragma once

/* Comment in STG-lite PLYs that store the times for two viewers: SuperSplat-4D reads the properties
 * trbf_center and trbf_scale, OpenSplat4D reads t and scale_t, which have the same values. */
#define SPIN_PLY_TWO_VIEWERS "stglite supersplat4d opensplat4d"

#include "formats/gaussian.h"
#include "io/ply.h"

/* Upper bound on the size in bytes of a PLY header written by spin4d, including comments. */
#define SPIN_GS_PLY_MAX_HEADER 4096

/* ---- Writing --------------------------------------------------------------------------------- */

/* Returns the size of a row in bytes. */
size_t spin_gs_ply_row(int sh_degree);
/* Writes the header of a file with n rows. comments: lines that begin with "comment " and end with
 * a line feed, less than 512 bytes in all. Returns the length of the header, which is then below
 * SPIN_GS_PLY_MAX_HEADER. */
size_t spin_gs_ply_header(int sh_degree, size_t n, const char *comments,
                          char text[SPIN_GS_PLY_MAX_HEADER]);

/* The values of one splat, from which spin_gs_ply_code() makes a row. */
struct spin_gs_ply_row {
    float place[3], rotation[4]; /* position; quaternion w x y z of unit length */
    float logit;                 /* logit of the opacity; must be finite */
    const float *log_scale;      /* [3] natural logarithms of the standard deviations */
    const float *sh;             /* [n_sh][3] SH coefficients */
    int n_sh;
};
/* Writes a row of spin_gs_ply_row() bytes to `out`. Coefficients that row->sh lacks are written as
 * 0; coefficients above sh_degree are not written. */
void spin_gs_ply_code(const struct spin_gs_ply_row *row, int sh_degree, unsigned char *out);

/* ---- Reading --------------------------------------------------------------------------------- */

/* The layout of a parsed file. */
struct spin_gs_ply {
    const struct spin_ply *ply; /* the parsed file; borrowed */
    const struct spin_ply_element *vertex;
    int n_rest; /* number of properties f_rest_* in the file */
    /* Degree that is read, 0 to 3. If the file has degree 4, only its coefficients up to degree 3
     * are read. */
    int sh_degree;
    bool colours; /* true: the file has red, green and blue instead of f_dc_* */
    bool flat;    /* true: 2DGS file without scale_2; splats are made thin along the third axis */
};

/* True if the vertices have any property that is specific to Gaussians. */
bool spin_gs_ply_any(const struct spin_ply_element *vertex);
/* Finds the properties of Gaussians in element `vertex`. A missing property is an error, whose
 * message contains the path and the property. */
spin_status spin_gs_ply_find(const struct spin_ply *ply, struct spin_gs_ply *out);
/* Reads all rows of the file into *out, from row `first` on. The columns of *out must be reserved
 * with at least the file's SH degree; coefficients above the file's degree become 0. Infinite
 * logits, from writers that stored an opacity of exactly 0 or 1, and log scales of -infinity, from
 * scales of 0, are replaced by finite values. Rotations are not normalised. spin_gs_ply_read()
 * refuses all other values that are not finite; spin_gs_ply_load() does not check them. */
void spin_gs_ply_load(const struct spin_gs_ply *file, unsigned columns, size_t first,
                      struct spin_splats *out);
spin_status spin_gs_ply_read(const struct spin_gs_ply *file, unsigned columns, size_t first,
                             struct spin_splats *out);

/* ---- Building blocks for other PLY layouts --------------------------------------------------- */

bool spin_ply_has(const struct spin_ply_element *e, const char *name);
bool spin_ply_has_prefix(const struct spin_ply_element *e, const char *prefix);
/* True if the element has the properties red, green and blue. */
bool spin_ply_has_colours(const struct spin_ply_element *e);
/* Reads x, y and z of all n rows into out [n][3]. Values that are not finite are an error. */
spin_status spin_ply_places(const struct spin_ply *ply, const struct spin_ply_element *e,
                            float *out);
/* Reads red, green and blue of each row i into out[step i .. step i + 2], scaled to 0..1. Unsigned
 * 8-bit and 16-bit integers are divided by the largest value of their type. Values of other types
 * are divided by 255 if any of them is above 1, and otherwise not scaled. */
void spin_ply_colours(const struct spin_ply *ply, const struct spin_ply_element *e, float *out,
                      size_t step);
/* Checks that the values of rows first to first + n - 1 are finite. Error messages contain the path
 * and the properties. */
spin_status spin_ply_check(const struct spin_ply *ply, unsigned columns, size_t first, size_t n,
                           const struct spin_splats *s);
/* Sets *n_rest to the number of properties f_rest_* of an element, and *sh_degree to the SH degree
 * for this number, limited to 3. If `e` is NULL, both results are 0. */
spin_status spin_gs_ply_degree(const struct spin_ply *ply, const struct spin_ply_element *e,
                               int *sh_degree, int *n_rest);
/* Reads the properties f_rest_* of each row i into sh[step i + 3 ..], coefficient-major. Values of
 * integer types are not scaled. */
void spin_gs_ply_rest(const struct spin_ply *ply, const struct spin_ply_element *e, int n_rest,
                      int sh_degree, float *sh, size_t step);
