/* Quantises splats to integers within given error bounds, and dequantises them, for the blocks of a
 * page. A row is stored as a key, in units of half a quantisation step, and for each frame a
 * difference from the key, in units of a whole step. The columns are:
 *
 *     0 place x y z      world units, from the centre
 *     3 colour r g b     of the degree 0 term: 0.5 + C0 dc
 *     6 opacity          clamped to 0..1
 *     7 log scale x y z  natural logarithm, world units
 *    10 rotation         rotation vector: axis times angle in radians; in a frame, relative to the
 *                        key's rotation
 *    13 sh               r g b of each coefficient above degree 0
 *
 * A step is slightly less than twice the bound, so rounding to the nearest step stays within the
 * bound. The bound of a rotation is divided among its three numbers; the angle between two
 * rotations is never larger than the distance of their rotation vectors. */
#pragma once

#include "exporters/lib/quant_error.h"

enum {
    SPIN_PAGE_PLACE = 0,
    SPIN_PAGE_COLOUR = 3,
    SPIN_PAGE_OPACITY = 6,
    SPIN_PAGE_SCALE = 7,
    SPIN_PAGE_ROTATION = 10,
    SPIN_PAGE_SH = 13,
    SPIN_PAGE_COLUMNS = SPIN_PAGE_SH + 45
};

/* Largest allowed errors, in the order of enum spin_quant_error_part. */
struct spin_page_bounds {
    double place;    /* error of each coordinate, in world units */
    double scale;    /* error of the natural logarithm of a scale */
    double rotation; /* error in radians */
    double opacity, colour, sh;
};

struct spin_page_space {
    double centre[3];
    struct spin_page_bounds bounds;
};

/* Sets *out to the bounds of --level fine, normal or coarse for a scene of this size; options
 * --bound-* replace single bounds. */
spin_status spin_page_bounds_from(const struct spin_plugin_values *v, double size,
                                  struct spin_page_bounds *out);
double spin_page_step(const struct spin_page_space *space, int column);

/* Quantises a row over n_frames. value[f][SPIN_PAGE_WIDTH] contains the columns above, but with
 * rotations as quaternions w x y z, so SH begins one column later. If present[f] is 0, the row is
 * absent in frame f and gets an opacity of 0 there. Writes key[columns] and the differences of
 * column c in frame f to number[c * pitch + f]. Returns false if a number reaches SPIN_PAGE_MOST.
 */
enum { SPIN_PAGE_WIDTH = SPIN_PAGE_COLUMNS + 1, SPIN_PAGE_VALUE_SH = SPIN_PAGE_SH + 1 };
bool spin_page_number_row(const struct spin_page_space *space, const float *const *value,
                          const uint8_t *present, int n_frames, int n_sh, int32_t *key,
                          int32_t *number, size_t pitch);
/* Quantises a row that exists in one frame only: writes key[columns], in whole steps. Returns false
 * if a number is too large. */
bool spin_page_number_own(const struct spin_page_space *space, const float *value, int n_sh,
                          int32_t *key);
/* Convert a rotation vector to a quaternion w x y z, and a quaternion to the shorter of its two
 * rotation vectors. */
void spin_page_turn_of(const double v[3], double q[4]);
void spin_page_vector_of(const double q[4], double v[3]);
/* Returns the Morton code of a position, to be used as a sort key. */
uint64_t spin_page_place_key(const struct spin_page_space *space, const float place[3]);
/* Adds the differences between decoded values (is) and the source's values (want); those of
 * rotations are in radians. If the row is absent in the source, only the error of its opacity is
 * added. */
void spin_page_errors_add(struct spin_quant_error *q, const double *is, const double *want,
                          bool present, int n_sh);
/* Returns SPIN_E_MALFORMED if an error is larger than its bound. */
spin_status spin_page_errors_check(const struct spin_quant_error *q,
                                   const struct spin_page_bounds *bounds);
/* Decodes a row into value[14 + n_sh], in the layout of spin_page_number_row(). number: the
 * differences from the key; NULL: decode the key itself. */
void spin_page_value_of(const struct spin_page_space *space, const int32_t *key,
                        const int32_t *number, int n_sh, double *value);
