/* A splat as whole numbers within stated bounds, and back: what a page's blocks hold. A row has a
 * key, in half steps, and in each frame its distance to it, in whole steps (columns in this order):
 *
 *     0 place x y z      world units, from the centre
 *     3 colour r g b     of the degree 0 term: 0.5 + C0 dc
 *     6 opacity          0..1; outside it is cut
 *     7 log scale x y z  natural logarithm, world units
 *    10 rotation         a vector along the axis, as long as the angle in radians: that of the key from no
 *                        turn, that of a frame from the key's
 *    13 sh               coefficient by coefficient, r g b within
 *
 * A step is twice the bound, so the nearest number is within it; of a rotation's three numbers each
 * has its share, and turning in the curved space of rotations only shortens distances. */
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

/* The most that a value may be off by. The order is that of enum spin_quant_error_part. */
struct spin_page_bounds {
    double place;    /* world units, of each coordinate */
    double scale;    /* of the logarithm */
    double rotation; /* radians */
    double opacity, colour, sh;
};

struct spin_page_space {
    double centre[3];
    struct spin_page_bounds bounds;
};

/* Bounds by name, "fine|normal|coarse" by 0, 1, 2, for a scene of this size; then the user's own of
 * --bound-*. */
spin_status spin_page_bounds_from(const struct spin_plugin_values *v, double size,
                                  struct spin_page_bounds *out);
double spin_page_step(const struct spin_page_space *space, int column);

/* A row over n_frames: value[f][SPIN_PAGE_COLUMNS + 1], where the rotation takes four, w x y z,
 * before sh. present[f] 0: not there, it is drawn with no opacity. key[columns] and number[c *
 * pitch + f]. False when a number would be SPIN_PAGE_MOST or more. */
enum { SPIN_PAGE_WIDTH = SPIN_PAGE_COLUMNS + 1, SPIN_PAGE_VALUE_SH = SPIN_PAGE_SH + 1 };
bool spin_page_number_row(const struct spin_page_space *space, const float *const *value,
                          const uint8_t *present, int n_frames, int n_sh, int32_t *key,
                          int32_t *number, size_t pitch);
/* A row that one frame alone has: its key, in whole steps, columns of them. */
bool spin_page_number_own(const struct spin_page_space *space, const float *value, int n_sh,
                          int32_t *key);
/* A turn from its vector, w x y z; and back, the shorter way round. */
void spin_page_turn_of(const double v[3], double q[4]);
void spin_page_vector_of(const double q[4], double v[3]);
/* A place on a Morton curve, for sorting. */
uint64_t spin_page_place_key(const struct spin_page_space *space, const float place[3]);
/* Adds how far the values that a reader has are from those wanted, rotations in radians; of what is
 * not there only the opacity counts. SPIN_E_MALFORMED: one of the largest is more than its bound.
 */
void spin_page_errors_add(struct spin_quant_error *q, const double *is, const double *want,
                          bool present, int n_sh);
spin_status spin_page_errors_judge(const struct spin_quant_error *q,
                                   const struct spin_page_bounds *bounds);
/* What a reader makes of them: value[14 + n_sh] as above. number NULL: the key. */
void spin_page_value_of(const struct spin_page_space *space, const int32_t *key,
                        const int32_t *number, int n_sh, double *value);
