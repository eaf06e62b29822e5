/* Rounding errors of lossy formats: differences between the values that a reader decodes and those
 * of the bundle, accumulated row by row and logged once at the end. */
#pragma once

#include <math.h>

#include "formats/gaussian.h"

enum spin_quant_error_part {
    SPIN_QUANT_PLACE,    /* position, in world units */
    SPIN_QUANT_SCALE,    /* natural logarithm of a scale: an error of 0.01 is about one percent */
    SPIN_QUANT_ROTATION, /* rotation, in degrees */
    SPIN_QUANT_OPACITY,  /* opacity, in 0..1 */
    SPIN_QUANT_COLOUR,   /* colour of the SH term of degree 0, in 0..1 */
    SPIN_QUANT_SH,       /* SH coefficients above degree 0 */
    SPIN_QUANT_PARTS
};

struct spin_quant_error {
    struct {
        double squares, largest;
        uint64_t n;
    } part[SPIN_QUANT_PARTS];
};

static inline void spin_quant_error_add(struct spin_quant_error *q, enum spin_quant_error_part part,
                                        double error)
{
    error = fabs(error);
    q->part[part].squares += error * error;
    q->part[part].n++;
    if (error > q->part[part].largest)
        q->part[part].largest = error;
}

/* Adds n errors of SH coefficients, faster than n calls of spin_quant_error_add(). */
void spin_quant_error_add_sh(struct spin_quant_error *q, const float *error, size_t n);

double spin_quant_error_distance(const float is[3], const float shown[3]);

void spin_quant_error_add_place(struct spin_quant_error *q, const float is[3],
                                const float shown[3]);

/* Adds the angle in degrees between the rotations of two unit quaternions, 4 asin(d / 2). d is the
 * distance of the quaternions after one of them has been negated if their dot product is negative.
 */
void spin_quant_error_add_rotation(struct spin_quant_error *q, const float is[4],
                                   const float shown[4]);

void spin_quant_error_add_3(struct spin_quant_error *q, enum spin_quant_error_part part,
                            const float is[3], const float shown[3]);

void spin_quant_error_row(struct spin_quant_error *q, const struct spin_gaussian *is,
                          const struct spin_gaussian *shown);

void spin_quant_error_merge(struct spin_quant_error *to, const struct spin_quant_error *from);

double spin_quant_error_rms(const struct spin_quant_error *q, enum spin_quant_error_part part);

/* Logs one line with RMS and largest error of each part; nothing if there are no rows. */
void spin_quant_error_log(const struct spin_quant_error *q, const char *format);
