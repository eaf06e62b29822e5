#include "formats/gaussian.h"

#include <string.h>

#include "base/number.h"
#include "math/scene_rotation.h"

float spin_opacity_logit(float opacity)
{
    double p = opacity < 1e-13f ? 1e-13 : (double)opacity;

    return p >= 1 ? SPIN_LOGIT_LIMIT : (float)(log(p) - log1p(-p));
}

float spin_byte_logit(unsigned char opacity)
{
    if (opacity == 0)
        return -SPIN_LOGIT_LIMIT;
    if (opacity == 255)
        return SPIN_LOGIT_LIMIT;
    return (float)log(opacity / (255.0 - opacity));
}

void spin_unit_rotation(const float q[4], float out[4])
{
    float square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], scale;
    double wide = 0, sign = q[0] < 0 ? -1 : 1;

    if (square > 1e-30f && square < 1e30f) {
        scale = fabsf(square - 1.0f) <= 2e-7f ? 1.0f : 1.0f / sqrtf(square);
        scale = q[0] < 0 ? -scale : scale;
        for (int k = 0; k < 4; k++)
            out[k] = q[k] * scale;
        return;
    }
    for (int k = 0; k < 4; k++)
        wide += (double)q[k] * q[k];
    for (int k = 0; k < 4; k++)
        out[k] = (float)(sign * q[k] / sqrt(wide));
}

int spin_largest_of_4(const float q[4])
{
    int largest = 0;

    for (int k = 1; k < 4; k++)
        largest = fabsf(q[k]) > fabsf(q[largest]) ? k : largest;
    return largest;
}

void spin_little_endian(void *words, size_t n)
{
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    uint32_t *word = words;

    for (size_t i = 0; i < n; i++)
        word[i] = __builtin_bswap32(word[i]);
#else
    (void)words;
    (void)n;
#endif
}

/* Rotates the n_from SH coefficients of one row; the remaining coefficients of `out` become 0. */
static void place_sh(const float *from, int n_from, const struct spin_scene_rotation *turn,
                     float *out, int n_out)
{
    if (turn->kind == SPIN_TURN_NONE)
        memcpy(out, from, 3 * (size_t)n_from * sizeof *out);
    else
        spin_scene_rotation_sh(turn, n_from, from, out);
    for (int k = 3 * n_from; k < 3 * n_out; k++)
        out[k] = 0;
}

void spin_splats_place(const struct spin_splats *from, unsigned columns,
                       const struct spin_placement *p, size_t first, struct spin_splats *out)
{
    int n_from = spin_sh_count(from->sh_degree), n_out = spin_sh_count(out->sh_degree);
    float log_scale = p->scale == 1 ? 0 : (float)log(p->scale);
    struct spin_scene_rotation turn;

    spin_scene_rotation_from(p->q, &turn);
    for (size_t i = 0, to = first; i < from->n; i++, to++) {
        if (columns & SPIN_COL_MEANS) {
            const float *x = from->means + 3 * i;
            spin_vec3 v = spin_scene_rotation_place(&turn, spin_v3(x[0], x[1], x[2]));
            const float turned[3] = {v.x, v.y, v.z};

            for (size_t c = 0; c < 3; c++)
                out->means[3 * to + c] = (float)(p->scale * turned[c] + p->shift[c]);
        }
        for (size_t c = 0; c < 3 && (columns & SPIN_COL_LOG_SCALES); c++)
            out->log_scales[3 * to + c] = from->log_scales[3 * i + c] + log_scale;
        if (columns & SPIN_COL_QUATS) {
            if (turn.kind == SPIN_TURN_NONE)
                memcpy(out->quats + 4 * to, from->quats + 4 * i, 4 * sizeof *out->quats);
            else
                spin_scene_rotation_quat(&turn, from->quats + 4 * i, out->quats + 4 * to);
        }
        if (columns & SPIN_COL_LOGIT_OPACITIES)
            out->logit_opacities[to] = from->logit_opacities[i];
        if (columns & SPIN_COL_SH)
            place_sh(from->sh + 3 * (size_t)n_from * i, n_from, &turn,
                     out->sh + 3 * (size_t)n_out * to, n_out);
    }
}

/* Returns whether all values of row i are finite. */
static bool is_finite_row(const float *const all[5], const size_t width[5], unsigned columns,
                          size_t i)
{
    for (int p = 0; p < 5; p++)
        if ((columns & 1u << p) && spin_finite_missing(all[p] + i * width[p], width[p]) > 0)
            return false;
    return true;
}

void spin_drop_nonfinite(unsigned columns, struct spin_splats *s, size_t *n_dropped)
{
    const size_t width[5] = {3, 4, 3, 1, 3 + spin_n_rest(s->sh_degree)};
    float *const all[5] = {s->means, s->quats, s->log_scales, s->logit_opacities, s->sh};
    const float *const read[5] = {all[0], all[1], all[2], all[3], all[4]};
    size_t bad = 0, kept = 0;

    *n_dropped = 0;
    for (size_t i = 0; i < s->n; i++)
        bad += !is_finite_row(read, width, columns, i);
    if (bad == 0 || bad > s->n / 1000)
        return;
    for (size_t i = 0; i < s->n; i++) {
        if (!is_finite_row(read, width, columns, i))
            continue;
        for (int p = 0; p < 5 && kept < i; p++)
            if (columns & 1u << p)
                memcpy(all[p] + kept * width[p], all[p] + i * width[p], width[p] * sizeof(float));
        kept++;
    }
    s->n = kept;
    *n_dropped = bad;
}

spin_status spin_check_finite(const char *what, const float *values, size_t n, size_t width)
{
    size_t bad = 0, first = 0;

    for (size_t i = n * width; i-- > 0;) {
        if (!isfinite(values[i])) {
            bad++;
            first = i / width;
        }
    }
    if (bad > 0)
        return spin_malformed("%zu values of '%s' are not finite, the first in row %zu", bad, what,
                              first);
    return SPIN_OK;
}

spin_status spin_check_columns(const char *const what[5], unsigned columns, size_t first, size_t n,
                               const struct spin_splats *s)
{
    const size_t width[5] = {3, 4, 3, 1, 3 + spin_n_rest(s->sh_degree)};
    const float *const all[5] = {s->means, s->quats, s->log_scales, s->logit_opacities, s->sh};

    for (int p = 0; p < 5 && n > 0; p++) /* if n is 0, columns may be NULL */
        if (columns & 1u << p)
            SPIN_TRY(spin_check_finite(what[p], all[p] + first * width[p], n, width[p]));
    return SPIN_OK;
}
