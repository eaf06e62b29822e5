#include "exporters/lib/quant_error.h"

#include "base/log.h"

void spin_quant_error_add_sh(struct spin_quant_error *q, const float *error, size_t n)
{
    float squares = 0, largest = 0;

    for (size_t i = 0; i < n; i++) {
        squares += error[i] * error[i];
        largest = fabsf(error[i]) > largest ? fabsf(error[i]) : largest;
    }
    q->part[SPIN_QUANT_SH].squares += (double)squares;
    q->part[SPIN_QUANT_SH].n += n;
    q->part[SPIN_QUANT_SH].largest = fmax(q->part[SPIN_QUANT_SH].largest, (double)largest);
}

static double distance(const float *a, const float *b, int n)
{
    double sum = 0;

    for (int i = 0; i < n; i++)
        sum += ((double)a[i] - b[i]) * ((double)a[i] - b[i]);
    return sqrt(sum);
}

double spin_quant_error_distance(const float is[3], const float shown[3])
{
    return distance(is, shown, 3);
}

void spin_quant_error_add_place(struct spin_quant_error *q, const float is[3], const float shown[3])
{
    spin_quant_error_add(q, SPIN_QUANT_PLACE, distance(is, shown, 3));
}

void spin_quant_error_add_rotation(struct spin_quant_error *q, const float is[4],
                                   const float shown[4])
{
    double d = distance(is, shown, 4);

    d = d * d > 2 ? sqrt(fmax(4 - d * d, 0)) : d; /* q and -q are the same rotation */
    spin_quant_error_add(q, SPIN_QUANT_ROTATION,
                         4 * asin(fmin(d / 2, 1)) * (180 / 3.14159265358979));
}

void spin_quant_error_add_3(struct spin_quant_error *q, enum spin_quant_error_part part,
                            const float is[3], const float shown[3])
{
    for (int c = 0; c < 3; c++)
        spin_quant_error_add(q, part, (double)is[c] - shown[c]);
}

void spin_quant_error_row(struct spin_quant_error *q, const struct spin_gaussian *is,
                          const struct spin_gaussian *shown)
{
    spin_quant_error_add_place(q, is->place, shown->place);
    spin_quant_error_add_rotation(q, is->rotation, shown->rotation);
    spin_quant_error_add(q, SPIN_QUANT_OPACITY, (double)is->opacity - shown->opacity);
    spin_quant_error_add_3(q, SPIN_QUANT_SCALE, is->log_scale, shown->log_scale);
    spin_quant_error_add_3(q, SPIN_QUANT_COLOUR, is->colour, shown->colour);
}

void spin_quant_error_merge(struct spin_quant_error *to, const struct spin_quant_error *from)
{
    for (int p = 0; p < SPIN_QUANT_PARTS; p++) {
        to->part[p].squares += from->part[p].squares;
        to->part[p].n += from->part[p].n;
        to->part[p].largest = fmax(to->part[p].largest, from->part[p].largest);
    }
}

double spin_quant_error_rms(const struct spin_quant_error *q, enum spin_quant_error_part part)
{
    return q->part[part].n ? sqrt(q->part[part].squares / (double)q->part[part].n) : 0;
}

void spin_quant_error_log(const struct spin_quant_error *q, const char *format)
{
    double r[SPIN_QUANT_PARTS], m[SPIN_QUANT_PARTS];

    for (int p = 0; p < SPIN_QUANT_PARTS; p++) {
        r[p] = spin_quant_error_rms(q, (enum spin_quant_error_part)p);
        m[p] = q->part[p].largest;
    }
    if (q->part[SPIN_QUANT_PLACE].n == 0)
        return;
    spin_log(0,
             "%s rounds values; rms error (largest error in parentheses): position %.3g (%.3g), "
             "log scale %.2g (%.2g), "
             "rotation %.2g deg (%.2g deg), opacity %.2g (%.2g), colour %.2g (%.2g), "
             "sh %.2g (%.2g)",
             format, r[0], m[0], r[1], m[1], r[2], m[2], r[3], m[3], r[4], m[4], r[5], m[5]);
}
