/* Values between key frames: positions, rotations, and an opacity that is on between two times (Ex4DGS, Lee
 * et al., NeurIPS 2024). */
#ifndef SPIN_IMPORTERS_LIB_KEYFRAMES_H
#define SPIN_IMPORTERS_LIB_KEYFRAMES_H

enum keyframes_kind { KEYFRAMES_LINEAR, KEYFRAMES_CUBE, KEYFRAMES_PCHIP };

/* A time between two keys; the curves also look at one key on either side of the two. */
struct keyframes {
    enum keyframes_kind kind;
    int key;     /* the one before the time */
    double part; /* of the way to the next, 0 to 1 */
    double time; /* in keys: key + part */
};

/* y[step k] for every key k. */
double spin_keyframes_value(const struct keyframes *at, const float *y, int step);

/* quats[4 k], of any length but zero; out is of unit length. */
void spin_keyframes_turn(const struct keyframes *at, const float *quats, float out[4]);

/* The share of its opacity that a Gaussian shows, 0 to 1. The two times, in keys, may come in any order;
 * log_width: of the edge before them and of the edge after; least_width is added to both. */
double spin_keyframes_visibility(const struct keyframes *at, const float times[2],
                                 const float log_width[2], double least_width);

#endif
