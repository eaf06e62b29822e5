/* Splats in the binary container of glTF 2.0, by KHR_gaussian_splatting (Khronos, release candidate of
 * 2026): a mesh of points, whose attributes are
 *
 *     POSITION                                    3 floats
 *     KHR_gaussian_splatting:ROTATION             4 floats, x y z w, of unit length
 *     KHR_gaussian_splatting:SCALE                3 floats, the standard deviation itself
 *     KHR_gaussian_splatting:OPACITY              1 float, 0..1
 *     KHR_gaussian_splatting:SH_DEGREE_l_COEF_m   3 floats, one coefficient of r g b
 *     COLOR_0                                     4 numbers of 16 bits, linear light and opacity, for
 *                                                 viewers that do not know the extension and draw points
 *
 * Written are floats, each attribute in one piece; io/gltf.h writes the container. Read are also the integers
 * that the extension and KHR_mesh_quantization allow, and an SPZ in place of the attributes
 * (KHR_gaussian_splatting_compression_spz_2, a draft). */
#ifndef SPIN_FORMATS_GLB_H
#define SPIN_FORMATS_GLB_H

#include "formats/glb_accessor.h"
#include "formats/spz.h"
#include "io/gltf.h"
#include "math/sh.h"

#define SPIN_GS_GLB_EXTENSION "KHR_gaussian_splatting"
#define SPIN_GS_GLB_MAX_ATTRIBUTES (4 + SPIN_SH_MAX + 1)
/* Bytes of a row of all attributes, at most. */
#define SPIN_GS_GLB_MAX_ROW (4 * (3 + 4 + 3 + 1 + 3 * SPIN_SH_MAX) + 8)

/* ---- Writing --------------------------------------------------------------------------------- */

/* The attributes in the order of the file. Points into itself: not to be copied. */
struct spin_gs_glb_layout {
    int sh_degree;
    bool fallback; /* COLOR_0 is one of them, the last */
    int n;
    struct spin_gltf_attribute attribute[SPIN_GS_GLB_MAX_ATTRIBUTES];
    size_t width[SPIN_GS_GLB_MAX_ATTRIBUTES]; /* bytes a row */
    size_t row;                               /* their sum */
    char name[SPIN_SH_MAX][64];
};

/* What the extension says of each mesh: pairs of key and value, NULL at the end. */
extern const char *const spin_gs_glb_values[];

void spin_gs_glb_begin(struct spin_gs_glb_layout *layout, int sh_degree, bool fallback);
/* A row to place `at` of each attribute's column, from the first n_sh coefficients [k][3]; more are written
 * as 0. The columns are in this machine's byte order until spin_gs_glb_order(), which is given rows 0..n. */
void spin_gs_glb_code(const struct spin_gs_glb_layout *layout, const struct spin_gaussian *row,
                      const float *sh, int n_sh, unsigned char *const column[], size_t at);
void spin_gs_glb_order(const struct spin_gs_glb_layout *layout, unsigned char *const column[],
                       size_t n);

/* ---- Reading --------------------------------------------------------------------------------- */

/* Splats of one mesh primitive. */
struct spin_gs_glb_points {
    const struct spin_glb_file *glb; /* borrowed */
    const spin_json *attributes;
    size_t n;
    int sh_degree;
    bool linear; /* colours are of linear light */
    /* In place of the attributes: an SPZ, of which axes are those of a SPZ. NULL: there is none. */
    const unsigned char *packed;
    size_t n_packed;
    struct spin_spz_header spz;
};

/* Whether a mesh primitive holds splats. */
bool spin_gs_glb_is_splats(const spin_json *primitive);
spin_status spin_gs_glb_find(const struct spin_glb_file *glb, const spin_json *primitive,
                             struct spin_gs_glb_points *out);
/* As the mesh has them, and in the SH degree of the file. All that comes out is finite; rotations keep
 * their length. */
spin_status spin_gs_glb_read(const struct spin_gs_glb_points *points, unsigned columns,
                             struct spin_splats *out);
/* The first primitive of a node's mesh, nothing where it has none. */
spin_status spin_gs_glb_read_node(const struct spin_glb_file *glb, size_t node, unsigned columns,
                                  struct spin_splats *out);

#endif
