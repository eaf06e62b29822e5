/* The PLY of 3D Gaussian Splatting's reference implementation (Kerbl et al. 2023), which every
 * viewer reads: element vertex, written in binary little endian, with all properties float and in
 * the order
 *
 *     x y z  nx ny nz  f_dc_0..2  f_rest_0..  opacity  scale_0..2  rot_0..3
 *
 * Normals are zero. opacity is a logit, scale_* are logarithms, rot_* is w x y z. f_rest_* is
 * channel-major: all coefficients of red above degree 0, then green, then blue; struct spin_splats
 * is coefficient-major. The reader finds properties by name, in any order and of any type. */
#pragma once

#include "formats/gaussian.h"
#include "io/ply.h"

/* Enough for the header of any PLY written here, with its comments. */
#define SPIN_GS_PLY_MAX_HEADER 4096

/* ---- Writing --------------------------------------------------------------------------------- */

/* Bytes per row. */
size_t spin_gs_ply_row(int sh_degree);
/* Writes the header of a file of n rows. comments: lines that begin with "comment " and end in a
 * line feed. Returns its length, which is below SPIN_GS_PLY_MAX_HEADER if the comments take less
 * than 512 bytes. */
size_t spin_gs_ply_header(int sh_degree, size_t n, const char *comments,
                          char text[SPIN_GS_PLY_MAX_HEADER]);

/* The values of a row. */
struct spin_gs_ply_row {
    float place[3], rotation[4]; /* of unit length */
    float logit;                 /* finite */
    const float *log_scale;      /* [3] */
    const float *sh;             /* [n_sh][3] */
    int n_sh; /* coefficients in sh; files with more get 0, files with fewer drop the rest */
};
void spin_gs_ply_code(const struct spin_gs_ply_row *row, int sh_degree, unsigned char *out);

/* ---- Reading --------------------------------------------------------------------------------- */

/* The columns of a parsed file. */
struct spin_gs_ply {
    const struct spin_ply *ply; /* borrowed */
    const struct spin_ply_element *vertex;
    int n_rest;    /* number of properties f_rest_* */
    int sh_degree; /* of the columns that are read: of degree 4, the last band is dropped */
    bool colours;  /* red, green and blue instead of f_dc_* */
};

/* True if the vertices have any property that only Gaussians have. */
bool spin_gs_ply_any(const struct spin_ply_element *vertex);
/* Finds all columns of Gaussians in element vertex. Errors name the file and the property. */
spin_status spin_gs_ply_find(const struct spin_ply *ply, struct spin_gs_ply *out);
/* Reads into rows `first` and on of columns that are reserved with at least the file's SH degree;
 * coefficients above it become 0. Infinite opacities, from writers that stored exactly 0 or 1, are
 * made finite; all other values must be finite. Rotations are not normalised. */
spin_status spin_gs_ply_read(const struct spin_gs_ply *file, unsigned columns, size_t first,
                             struct spin_splats *out);

/* ---- Parts, for other layouts of PLY
 * ------------------------------------------------------------- */

bool spin_ply_has(const struct spin_ply_element *e, const char *name);
bool spin_ply_has_prefix(const struct spin_ply_element *e, const char *prefix);
/* red, green, blue. */
bool spin_ply_has_colours(const struct spin_ply_element *e);
/* Reads x, y, z to out [n][3]; they must be finite. */
spin_status spin_ply_places(const struct spin_ply *ply, const struct spin_ply_element *e,
                            float *out);
/* Reads red, green, blue as 0..1 to out[0..2], every `step` floats. Integers are divided by the
 * largest value of their type, floats by 255 if any is above 1. */
void spin_ply_colours(const struct spin_ply *ply, const struct spin_ply_element *e, float *out,
                      size_t step);
/* Checks that n rows from `first` on are finite; errors name the file and the properties. */
spin_status spin_ply_check(const struct spin_ply *ply, unsigned columns, size_t first, size_t n,
                           const struct spin_splats *s);
/* The SH degree of an element's f_rest_* (NULL: 0) and their number. */
spin_status spin_gs_ply_degree(const struct spin_ply *ply, const struct spin_ply_element *e,
                               int *sh_degree, int *n_rest);
/* Reads an element's f_rest_* to sh[3..], every `step` floats, without conversion. */
void spin_gs_ply_rest(const struct spin_ply *ply, const struct spin_ply_element *e, int n_rest,
                      int sh_degree, float *sh, size_t step);
