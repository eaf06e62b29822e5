/* Splats in the binary container of glTF 2.0, by KHR_gaussian_splatting (Khronos, release candidate
 * of 2026): a mesh of points, whose attributes are
 *
 *     POSITION                                    3 floats
 *     KHR_gaussian_splatting:ROTATION             4 floats, x y z w, of unit length
 *     KHR_gaussian_splatting:SCALE                3 floats, the standard deviation itself
 *     KHR_gaussian_splatting:OPACITY              1 float, 0..1
 *     KHR_gaussian_splatting:SH_DEGREE_l_COEF_m   3 floats, one coefficient of r g b
 *     COLOR_0                                     4 numbers of 16 bits, linear light and opacity,
 *                                                 for viewers that can only draw points
 *
 * The reader also accepts the integers that the extension and KHR_mesh_quantization allow, and an
 * SPZ instead of the attributes (KHR_gaussian_splatting_compression_spz_2, a draft).
 * formats/glb_scene.h reads a file, formats/glb_write.h writes one. */
#pragma once

#include "formats/glb_shim.h"
#include "formats/spz.h"
#include "io/json.h"
#include "math/sh.h"

#define SPIN_GLB_SPLATS "KHR_gaussian_splatting"

enum { SPIN_GLB_POSITION, SPIN_GLB_ROTATION, SPIN_GLB_SCALE, SPIN_GLB_OPACITY, SPIN_GLB_SH };
/* Constants of glTF: component types and modes of a mesh primitive. */
enum { SPIN_GLB_I8 = 5120, SPIN_GLB_U8, SPIN_GLB_I16, SPIN_GLB_U16, SPIN_GLB_F32 = 5126 };
enum { SPIN_GLB_POINTS = 0, SPIN_GLB_TRIANGLES = 4 };

/* The name of an attribute; SPIN_GLB_SH + k: coefficient k. */
void spin_glb_attribute_name(int attribute, char name[SPIN_GLB_NAME]);

/* ---- The container --------------------------------------------------------------------------- */

/* A file in memory, which must stay valid until the close. */
struct spin_glb_file {
    spin_json *json;
    const unsigned char *bytes; /* of the binary chunk */
    uint64_t n_bytes;
};

/* Zero *out before the call, and close it even after a failure. Errors do not name the file, here
 * and below. */
spin_status spin_glb_open(const unsigned char *file, size_t size, struct spin_glb_file *out);
void spin_glb_close(struct spin_glb_file *glb);

/* The item of one of the document's lists, by an index that another object contains; NULL if it
 * does not exist. */
const spin_json *spin_glb_item(const struct spin_glb_file *glb, const char *list,
                               const spin_json *index);
int64_t spin_glb_integer(const spin_json *object, const char *key, int64_t fallback);

/* ---- Numbers --------------------------------------------------------------------------------- */

/* Component types as bits: plain, and normalised integers. */
#define SPIN_GLB_IS(component) (1u << ((component)-SPIN_GLB_I8))
#define SPIN_GLB_NORMALISED(bits) ((bits) << 8)

/* n rows of `width` numbers, `stride` bytes apart. */
struct spin_glb_numbers {
    const unsigned char *at;
    size_t n, width, stride;
    int component;
    bool normalised;
};

/* Finds an accessor of rows of `width` (1, 3 or 4) numbers of one of the `allowed` types, which
 * must be entirely in the binary chunk. */
spin_status spin_glb_find(const struct spin_glb_file *glb, const spin_json *accessor, size_t width,
                          unsigned allowed, struct spin_glb_numbers *out);
/* Reads row i; normalised integers become 0..1 or -1..1. */
void spin_glb_row(const struct spin_glb_numbers *numbers, size_t i, float *out);

/* ---- Splats ---------------------------------------------------------------------------------- */

/* The splats of one mesh primitive. */
struct spin_gs_glb_points {
    const struct spin_glb_file *glb; /* borrowed */
    const spin_json *attributes;
    size_t n;
    int sh_degree;
    bool linear; /* colours are linear */
    /* An SPZ instead of the attributes, in the axes of SPZ; NULL: none. */
    const unsigned char *packed;
    size_t n_packed;
    struct spin_spz_header spz;
};

/* True if a mesh primitive contains splats. */
bool spin_gs_glb_is_splats(const spin_json *primitive);
spin_status spin_gs_glb_find(const struct spin_glb_file *glb, const spin_json *primitive,
                             struct spin_gs_glb_points *out);
/* Reads the splats in the coordinates of the mesh and the SH degree of the file. All values are
 * checked to be finite; rotations are not normalised. */
spin_status spin_gs_glb_read(const struct spin_gs_glb_points *points, unsigned columns,
                             struct spin_splats *out);
