/* What every exporter asks of a frame's rows before it writes them: which can be drawn at all, a
 * rotation of unit length, a finite logit; and the options that go with it.
 *
 * A row that no viewer could draw is left out, as NaN scales are known to hang viewers: one with a
 * NaN or infinity, a rotation of length zero, or a scale whose square leaves the range of float.
 * How many is said once per frame. */
#ifndef SPIN_EXPORTERS_ROWS_H
#define SPIN_EXPORTERS_ROWS_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"

/* In place of an infinite logit: the sigmoid is within 1e-13 of 0 or 1, and finite. */
#define SPIN_ROWS_LOGIT_LIMIT 30.0f
/* exp(2 * 44) is the last whole power that float holds: renderers square the scale. */
#define SPIN_ROWS_LOG_SCALE_LIMIT 44.0f

struct spin_rows {
    float min_logit;     /* rows below are left out */
    unsigned char *keep; /* [room] 1 for a row to write */
    size_t room;
};

static inline spin_status spin_rows_parse_sh(const char *text, int kept, int *out)
{
    *out = kept < 0 ? 0 : kept;
    if (strcmp(text, "keep") == 0)
        return SPIN_OK;
    if (text[0] < '0' || text[0] > '3' || text[1])
        return spin_fail(SPIN_E_USAGE, "--sh '%s': expected 0, 1, 2, 3 or keep", text);
    *out = text[0] - '0';
    return SPIN_OK;
}

static inline spin_status spin_rows_parse_min_opacity(const char *text, struct spin_rows *rows)
{
    char *end;
    double value = strtod(text, &end);

    if (end == text || *end || !(value >= 0 && value < 1))
        return spin_fail(SPIN_E_USAGE, "--min-opacity '%s': expected a number from 0 to below 1",
                         text);
    rows->min_logit = value > 0 ? (float)log(value / (1 - value)) : -INFINITY;
    return SPIN_OK;
}

/* x * 0 is 0 for a finite x and NaN for any other: a sum of them tells without a branch. */
static inline float spin_rows_zeros(const float *x, size_t n)
{
    float sum = 0;

    for (size_t i = 0; i < n; i++)
        sum += x[i] * 0.0f;
    return sum;
}

/* An infinite logit is a saturated opacity and can be written; so can quaternions whose square
 * leaves the range of float. */
static inline bool spin_rows_sane(const struct spin_splats *s, size_t i, size_t n_sh)
{
    const float *q = s->quats + 4 * i, *scale = s->log_scales + 3 * i;
    float sum = spin_rows_zeros(s->means + 3 * i, 3) + spin_rows_zeros(q, 4) +
                spin_rows_zeros(scale, 3) + spin_rows_zeros(s->sh + i * n_sh, n_sh);

    return sum == 0.0f && !isnan(s->logit_opacities[i]) && (q[0] || q[1] || q[2] || q[3]) &&
           scale[0] < SPIN_ROWS_LOG_SCALE_LIMIT && scale[1] < SPIN_ROWS_LOG_SCALE_LIMIT &&
           scale[2] < SPIN_ROWS_LOG_SCALE_LIMIT;
}

/* Mark the rows to write and count them; say how many cannot be drawn. */
static inline spin_status spin_rows_choose(struct spin_rows *rows, const struct spin_splats *s,
                                           int number, size_t *n_kept)
{
    size_t side = (size_t)s->sh_degree + 1, n_bad = 0;

    if (s->n > rows->room) {
        SPIN_TRY(spin_grow(s->n, 1, (void **)&rows->keep));
        rows->room = s->n;
    }
    *n_kept = 0;
    for (size_t i = 0; i < s->n; i++) {
        bool sane = spin_rows_sane(s, i, 3 * side * side);

        rows->keep[i] = sane && s->logit_opacities[i] >= rows->min_logit;
        *n_kept += rows->keep[i];
        n_bad += !sane;
    }
    if (n_bad > 0)
        spin_warn("frame %d: %zu of %zu splats left out: they hold NaN, infinity, a rotation of "
                  "length zero or a scale beyond e^%g",
                  number, n_bad, s->n, (double)SPIN_ROWS_LOG_SCALE_LIMIT);
    return SPIN_OK;
}

static inline void spin_rows_free(struct spin_rows *rows)
{
    free(rows->keep);
    *rows = (struct spin_rows){0};
}

static inline float spin_rows_logit(float logit)
{
    return isinf(logit) ? copysignf(SPIN_ROWS_LOGIT_LIMIT, logit) : logit;
}

/* Unit length, w >= 0. A quaternion that already is of unit length keeps its bits. */
static inline void spin_rows_rotation(const float q[4], float out[4])
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

/* Words of 4 bytes as the files want them. So is every machine this was built on; others swap. */
static inline void spin_rows_little_endian(void *words, size_t n)
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

#endif
