/* Splats in the binary container of glTF 2.0, by KHR_gaussian_splatting (Khronos, release candidate of
 * 2026): a frame is a node with a mesh of points, whose attributes are
 *
 *     POSITION                                    3 floats
 *     KHR_gaussian_splatting:ROTATION             4 floats, x y z w, of unit length
 *     KHR_gaussian_splatting:SCALE                3 floats, the standard deviation itself
 *     KHR_gaussian_splatting:OPACITY              1 float, 0..1
 *     KHR_gaussian_splatting:SH_DEGREE_l_COEF_m   3 floats, one coefficient of r g b
 *     COLOR_0                                     4 numbers of 16 bits, linear light and opacity, for
 *                                                 viewers that do not know the extension and draw points
 *
 * Each attribute lies in one piece. io/gltf.h writes the container. */
#ifndef SPIN_FORMATS_GLB_H
#define SPIN_FORMATS_GLB_H

#include "formats/gaussian.h"
#include "io/gltf.h"
#include "io/json.h"
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

/* A file in memory, which is borrowed until the end. */
struct spin_gs_glb {
    spin_json *json;
    const unsigned char *bytes; /* of the binary chunk */
    uint64_t n_bytes;
};

/* The lengths of a GLB and of its chunks; nothing is parsed. n_chunk: bytes of the binary chunk. Errors do
 * not name the file, here and below. */
spin_status spin_glb_chunks(const unsigned char *file, size_t size, uint64_t *n_json,
                            uint64_t *n_chunk);
/* Free also after a failure. Zero it before. */
spin_status spin_gs_glb_open(const unsigned char *file, size_t size, struct spin_gs_glb *out);
void spin_gs_glb_close(struct spin_gs_glb *glb);
size_t spin_gs_glb_n_nodes(const struct spin_gs_glb *glb);
/* The splats of a node, none where it has no mesh. Their SH degree is that of the file. Attributes must be
 * floats, as other component types of the extension are not read. All that comes out is finite; rotations
 * keep their length. */
spin_status spin_gs_glb_read(const struct spin_gs_glb *glb, size_t node, unsigned columns,
                             struct spin_splats *out);

#endif
