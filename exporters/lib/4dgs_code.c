#include "exporters/lib/4dgs_code.h"

#include "base/base.h"

/* A value that exceeds the range of the format by less than this does not count as clamped, since
 * float rounding can be the cause. */
#define NEAR 1e-5

int32_t spin_4dgs_round(double value, double step)
{
    return (int32_t)spin_4dgs_clamp(rint(value / step), INT32_MIN, INT32_MAX);
}

/* Quantises a rotation. The largest component of the quaternion x y z w is made positive and
 * omitted. */
static void code_rotation(const float wxyz[4], double step, struct spin_4dgs_splat *to)
{
    const float q[4] = {wxyz[1], wxyz[2], wxyz[3], wxyz[0]};
    int32_t *bin = spin_4dgs_bin(to, SPIN_4DGS_ROTATION);
    int largest = 0;

    for (int k = 1; k < 4; k++)
        largest = fabsf(q[k]) > fabsf(q[largest]) ? k : largest;
    spin_4dgs_bin(to, SPIN_4DGS_LARGEST)[0] = largest;
    for (int k = 0; k < 4; k++)
        if (k != largest)
            *bin++ = spin_4dgs_round(q[largest] < 0 ? -(double)q[k] : (double)q[k], step);
}

static void code_colour(struct spin_4dgs_coder *coder, const float colour[3],
                        struct spin_4dgs_splat *to)
{
    int32_t *bin = spin_4dgs_bin(to, SPIN_4DGS_COLOUR), rgb[3];
    bool clamped = false;

    for (int c = 0; c < 3; c++) {
        double inside = spin_4dgs_clamp((double)colour[c], 0, 1);

        coder->lost_colour = fmax(coder->lost_colour, fabs(inside - (double)colour[c]));
        clamped |= fabs(inside - (double)colour[c]) > NEAR;
        rgb[c] = spin_4dgs_round(inside, coder->coding->step[SPIN_4DGS_STEP_COLOUR]);
    }
    coder->n_colours += clamped;
    bin[0] = rgb[1];
    bin[1] = rgb[0] - rgb[1];
    bin[2] = rgb[2] - rgb[1];
}

static double decode_sh(unsigned char code) { return code * 8 / 255.0 - 4; }

static void code_sh(struct spin_4dgs_coder *coder, size_t k, struct spin_4dgs_splat *to)
{
    size_t n = (size_t)spin_splat_rows_n_sh(coder->rows);
    float rotated[3 * SPIN_SH_MAX], off[SPIN_4DGS_REST];
    const float *sh = spin_splat_rows_sh(coder->rows, k, rotated);
    bool clamped = false;

    memset(to->sh, 128, sizeof to->sh);
    for (size_t i = 3; i < 3 * n; i++) {
        double value = (double)sh[i], inside = spin_4dgs_clamp(value, -4, 4);

        coder->lost_sh = fmax(coder->lost_sh, fabs(inside - value));
        clamped |= fabs(inside - value) > NEAR;
        to->sh[i - 3] = (unsigned char)rint((inside + 4) * 255 / 8);
        off[i - 3] = (float)(decode_sh(to->sh[i - 3]) - value);
    }
    coder->n_sh += clamped;
    if (n > 1)
        spin_quant_error_add_sh(&coder->quant, off, 3 * n - 3);
}

void spin_4dgs_code_attributes(struct spin_4dgs_coder *coder, size_t row,
                               const struct spin_gaussian *is, struct spin_4dgs_splat *to,
                               struct spin_gaussian *shown)
{
    const double *step = coder->coding->step;
    const int32_t *colour = spin_4dgs_bin(to, SPIN_4DGS_COLOUR);
    int32_t *scale = spin_4dgs_bin(to, SPIN_4DGS_SCALE);
    int32_t *opacity = spin_4dgs_bin(to, SPIN_4DGS_OPACITY);

    code_rotation(is->rotation, step[SPIN_4DGS_STEP_ROTATION], to);
    code_colour(coder, is->colour, to);
    code_sh(coder, row, to);
    *opacity = spin_4dgs_round((double)is->opacity, step[SPIN_4DGS_STEP_OPACITY]);
    shown->opacity = (float)(*opacity * step[SPIN_4DGS_STEP_OPACITY]);
    spin_4dgs_rotation(spin_4dgs_bin(to, SPIN_4DGS_ROTATION), *spin_4dgs_bin(to, SPIN_4DGS_LARGEST),
                       step[SPIN_4DGS_STEP_ROTATION], shown->rotation);
    for (int c = 0; c < 3; c++) {
        scale[c] = spin_4dgs_round((double)is->log_scale[c], step[SPIN_4DGS_STEP_SCALE]);
        shown->log_scale[c] = (float)(scale[c] * step[SPIN_4DGS_STEP_SCALE]);
        shown->colour[c] = (float)((colour[0] + (c == 1 ? 0 : colour[c == 0 ? 1 : 2])) *
                                   step[SPIN_4DGS_STEP_COLOUR]);
    }
}

void spin_4dgs_coder_report(const struct spin_4dgs_coder *c)
{
    if (c->n_colours > 0)
        spin_warn("a .4dgs stores colours of 0 to 1: those of %llu splats are clamped, by up to "
                  "%.2g",
                  (unsigned long long)c->n_colours, c->lost_colour);
    if (c->n_sh > 0)
        spin_warn("a .4dgs stores SH coefficients of -4 to 4: those of %llu splats are clamped, by "
                  "up to %.2g",
                  (unsigned long long)c->n_sh, c->lost_sh);
    spin_quant_error_log(&c->quant, "a .4dgs");
}
