/* Splats in GLB, the binary container of glTF 2.0, as defined by KHR_gaussian_splatting (Khronos,
 * release candidate of 2026): a mesh primitive of points with the attributes
 *
 *     POSITION                                    3 floats
 *     KHR_gaussian_splatting:ROTATION             4 floats, x y z w, of unit length
 *     KHR_gaussian_splatting:SCALE                3 floats, standard deviations (no logarithm)
 *     KHR_gaussian_splatting:OPACITY              1 float, 0..1
 *     KHR_gaussian_splatting:SH_DEGREE_l_COEF_m   3 floats, one coefficient of r g b
 *     COLOR_0                                     4 integers of 16 bits: linear r g b and opacity,
 *                                                 for viewers that can only draw points
 *
 * The reader also accepts integers where KHR_gaussian_splatting or KHR_mesh_quantization allow
 * them, and SPZ data instead of the attributes (KHR_gaussian_splatting_compression_spz_2, a draft).
 */
#pragma once

#include "formats/gaussian.h"
#include "formats/glb_shim.h"
#include "formats/spz.h"
#include "io/file.h"
#include "io/json.h"
#include "math/sh.h"

#define SPIN_GLB_SPLATS "KHR_gaussian_splatting"

enum { SPIN_GLB_POSITION, SPIN_GLB_ROTATION, SPIN_GLB_SCALE, SPIN_GLB_OPACITY, SPIN_GLB_SH };
/* Constants of glTF: the types of components (signed and unsigned integers, floats), and the modes
 * of a mesh primitive. */
enum { SPIN_GLB_I8 = 5120, SPIN_GLB_U8, SPIN_GLB_I16, SPIN_GLB_U16, SPIN_GLB_F32 = 5126 };
enum { SPIN_GLB_POINTS = 0, SPIN_GLB_TRIANGLES = 4 };

/* Sets `name` to the name of an attribute. attribute: for SH coefficient k, SPIN_GLB_SH + k. */
void spin_glb_attribute_name(int attribute, char name[SPIN_GLB_NAME]);

/* ---- The container --------------------------------------------------------------------------- */

struct spin_glb_file {
    spin_json *json;
    const unsigned char *bytes; /* the content of the binary chunk; borrowed */
    uint64_t n_bytes;
};

/* Opens a file in memory. The memory must stay valid until spin_glb_close(). Set *out to zero
 * before the call, and close it even after a failure. Error messages of the functions in this
 * header do not contain the path. */
spin_status spin_glb_open(const unsigned char *file, size_t size, struct spin_glb_file *out);
void spin_glb_close(struct spin_glb_file *glb);

/* Returns item `index` of a top-level list of the JSON document ("nodes", "accessors", ...), or
 * NULL if the item does not exist or `index` is not an integer. */
const spin_json *spin_glb_item(const struct spin_glb_file *glb, const char *list,
                               const spin_json *index);
int64_t spin_glb_integer(const spin_json *object, const char *key, int64_t fallback);

/* ---- Numbers --------------------------------------------------------------------------------- */

/* Sets of component types: SPIN_GLB_IS() is the bit of a type; SPIN_GLB_NORMALISED() converts a set
 * of integer types to the set of the same types as normalised integers. */
#define SPIN_GLB_IS(component) (1u << ((component)-SPIN_GLB_I8))
#define SPIN_GLB_NORMALISED(bits) ((bits) << 8)

/* A table of n rows with `width` numbers each. stride: bytes from one row to the next. */
struct spin_glb_numbers {
    const unsigned char *at;
    size_t n, width, stride;
    int component;
    bool normalised;
};

/* Finds the data of an accessor in the binary chunk. width: required numbers per row, 1, 3 or 4;
 * allowed: set of allowed component types. Fails with SPIN_E_MALFORMED if the accessor has another
 * width or type, or if the data extend beyond the chunk. */
spin_status spin_glb_find(const struct spin_glb_file *glb, const spin_json *accessor, size_t width,
                          unsigned allowed, struct spin_glb_numbers *out);
/* Reads row i. Normalised integers are mapped to 0..1 if unsigned, to -1..1 if signed. */
void spin_glb_row(const struct spin_glb_numbers *numbers, size_t i, float *out);

/* ---- Splats ---------------------------------------------------------------------------------- */

/* The splats of one mesh primitive. */
struct spin_gs_glb_points {
    const struct spin_glb_file *glb; /* borrowed */
    const spin_json *attributes;
    size_t n;
    int sh_degree;
    bool linear; /* true: the colours are linear; false: sRGB */
    /* SPZ data, which are read instead of the attributes, and have the axes of SPZ; NULL: none. */
    const unsigned char *packed;
    size_t n_packed;
    struct spin_spz_header spz;
};

/* True if a mesh primitive contains splats. */
bool spin_gs_glb_is_splats(const spin_json *primitive);
/* Checks the primitive and sets all members of *out; does not read the splats. */
spin_status spin_gs_glb_find(const struct spin_glb_file *glb, const spin_json *primitive,
                             struct spin_gs_glb_points *out);
/* Reads the splats, in the coordinates of the mesh and with the SH degree of the primitive. Values
 * that are not finite are an error. Rotations are not normalised. */
spin_status spin_gs_glb_read(const struct spin_gs_glb_points *points, unsigned columns,
                             struct spin_splats *out);

/* ---- Scenes ---------------------------------------------------------------------------------- */

/* The visible splats of the scene of a file, transformed by its nodes. A file can contain a clip:
 * an animation shows the frames, which are nodes, in turn. To do so, STEP key frames change the
 * scale of the nodes or their KHR_node_visibility. */

/* A mesh primitive with splats, and the transform from its node to the scene. */
struct spin_gs_glb_piece {
    struct spin_gs_glb_points points;
    struct spin_placement placement;
    size_t node;
};

struct spin_gs_glb_frame {
    size_t n; /* number of splats in the frame */
    /* The mesh primitives that are visible in this frame: scene->shown[first] to
     * scene->shown[first + n_shown - 1]. */
    size_t first, n_shown;
    int number; /* frame number in the extras of the frame's node; -1: none */
    /* Start of the frame in seconds: the time in the extras if all frames have one, otherwise the
     * time of the animation. */
    double time;
    double extras_time; /* private: time in the extras; NaN: none */
};

struct spin_gs_glb_scene {
    struct spin_glb_file file;
    /* [n_pieces] mesh primitives that are not permanently hidden. */
    struct spin_gs_glb_piece *piece;
    struct spin_gs_glb_frame *frame; /* [n_frames], at least one */
    /* Indices in piece[] of the primitives that frame 0 shows, then of those of frame 1, and so on.
     */
    size_t *shown;
    size_t n_pieces, n_frames;
    int sh_degree;  /* largest SH degree of all mesh primitives */
    bool linear;    /* true: a mesh primitive has linear colours instead of sRGB */
    bool antialias; /* true: the extras or SPZ data require antialiasing */
    double fps;     /* frames per second, from the extras; 0: unknown */
    /* True: the file contains animations that are ignored: further animations after the first, or
     * channels of the first animation that do more than show and hide nodes. */
    bool moves;
    bool others;            /* true: meshes without splats were skipped */
    struct spin_splats raw; /* private: splats of a mesh primitive before the transform */
};

/* Opens a file in memory. The memory must stay valid until spin_gs_glb_scene_close(). Set *out to
 * zero before the call, and close it even after a failure. Error messages do not contain the path.
 */
spin_status spin_gs_glb_scene_open(const unsigned char *file, size_t size,
                                   struct spin_gs_glb_scene *out);
void spin_gs_glb_scene_close(struct spin_gs_glb_scene *scene);
/* Reads the splats of a frame, 0..n_frames - 1, in the axes of glTF and with the SH degree of the
 * scene. Values that are not finite are an error. Rotations are normalised. */
spin_status spin_gs_glb_scene_read(struct spin_gs_glb_scene *scene, size_t frame, unsigned columns,
                                   struct spin_splats *out);

/* ---- Writing --------------------------------------------------------------------------------- */

/* The frames of a clip are written to one .glb. Each attribute of a frame is a contiguous array, a
 * column; all are floats except the 16-bit COLOR_0. Columns are written to their final offsets, in
 * any order. The JSON precedes the binary data in the file but depends on all of them, so it is
 * written last, into reserved space. */

/* Loads the shared object that contains tinygltf, which creates the JSON. If it is missing, the
 * error message explains how to install it. */
spin_status spin_glb_can_write(void);
/* Sets the members of *clip that describe the attributes, which depend on clip->sh_degree, and the
 * number of bytes to reserve for the JSON. */
void spin_glb_begin(struct spin_glb_clip *clip);
/* Returns the size in bytes of a file with n_rows splats. spin_glb_begin() must have been called.
 */
uint64_t spin_glb_bytes(const struct spin_glb_clip *clip, uint64_t n_rows);

/* Writes a splat to row `at` of all columns, in native byte order. sh: n_sh coefficients [k][3];
 * missing coefficients are written as 0. */
void spin_glb_code(const struct spin_glb_clip *clip, const struct spin_gaussian *row,
                   const float *sh, int n_sh, unsigned char *const column[], size_t at);
/* Converts rows 0 to n - 1 of all columns from native byte order to little endian. */
void spin_glb_order(const struct spin_glb_clip *clip, unsigned char *const column[], size_t n);

/* Writes data at offset `at` of the binary chunk. Thread-safe. Returns 0, or an error code, for
 * which spin_glb_failed() sets the error message. */
int spin_glb_put(const struct spin_glb_clip *clip, uint64_t at, const void *data, size_t bytes);
/* Converts an error code of spin_glb_put() to a status with a message. SPIN_E_UNSUPPORTED if the
 * file would exceed 4 GiB, the limit of the format. */
spin_status spin_glb_failed(const struct spin_glb_clip *clip, int error);
/* Completes the file: appends the animation's data to the binary chunk, then writes the JSON and
 * the headers. Bytes [0, clip->n_bytes) of the chunk must have been written. */
spin_status spin_glb_end(struct spin_glb_clip *clip);
