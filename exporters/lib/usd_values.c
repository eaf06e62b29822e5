#include "exporters/lib/usd_export.h"

#include "base/base.h"
#include "math/ntc.h"
#include "math/project.h"
#include "math/sh.h"

#define LEAST_HALF 6e-8f /* the smallest positive half float */
#define MOST_HALF 65504.0f

const struct spin_usd_form spin_usd_forms[SPIN_USD_COLUMNS] = {
    {"point3f[]", "positions", NULL, NULL},
    {"quatf[]", "orientations", "quath[]", "orientationsh"},
    {"float3[]", "scales", "half3[]", "scalesh"},
    {"float[]", "opacities", "half[]", "opacitiesh"},
    {"float3[]", "radiance:sphericalHarmonicsCoefficients", "half3[]",
     "radiance:sphericalHarmonicsCoefficientsh"},
};

bool spin_usd_is_half(const struct spin_usd_export *x)
{
    return x->half && spin_usd_forms[x->attribute].type_half;
}

const char *spin_usd_type_of(const struct spin_usd_export *x, enum spin_usd_column a)
{
    return x->half && spin_usd_forms[a].type_half ? spin_usd_forms[a].type_half
                                                  : spin_usd_forms[a].type;
}

const char *spin_usd_name_of(const struct spin_usd_export *x, enum spin_usd_column a)
{
    return x->half && spin_usd_forms[a].type_half ? spin_usd_forms[a].name_half
                                                  : spin_usd_forms[a].name;
}

static float as_half(float v, float least)
{
    float h = spin_half(v);

    return h < least ? least : h > MOST_HALF ? MOST_HALF : h;
}

uint32_t spin_usd_half_bits(float h)
{
    uint32_t bits = spin_bits_of_float(h), sign = bits >> 16 & 0x8000u;

    if (fabsf(h) < 6.1035156e-5f) /* 2^-14 */
        return sign | (uint32_t)(fabsf(h) * 16777216.0f);
    return sign | (((bits >> 13) - (112u << 10)) & 0x7fffu);
}

/* Returns the value of coordinate v after rounding to the decimal places of the output. */
static float rounded_place(const struct spin_usd_export *x, float v)
{
    char text[64];

    if (!x->half || x->frames.file)
        return v;
    snprintf(text, sizeof text, "%.*f", x->decimals, (double)v);
    return strtof(text, NULL);
}

size_t spin_usd_row(const struct spin_usd_export *x, size_t i, float out[SPIN_USD_FLOATS],
                    size_t *group, struct spin_quant_error *quant)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t n_sh = 3 * (size_t)spin_splat_rows_n_sh(rows);
    size_t n = 3 * (size_t)spin_sh_count(rows->sh_degree);
    struct spin_gaussian is, shown;
    float room[3 * SPIN_SH_MAX], lost[SPIN_USD_FLOATS];

    spin_splat_rows_get(rows, i, &is);
    shown = is;
    *group = 3;
    switch (x->attribute) {
    case SPIN_USD_POSITIONS:
        for (int c = 0; c < 3; c++)
            out[c] = rounded_place(x, is.place[c]);
        spin_quant_error_add_place(quant, is.place, out);
        return 3;
    case SPIN_USD_ORIENTATIONS:
        for (int k = 0; k < 4; k++)
            out[k] = spin_usd_is_half(x) ? spin_half(is.rotation[k]) : is.rotation[k];
        spin_unit_rotation(out, shown.rotation);
        spin_quant_error_add_rotation(quant, is.rotation, shown.rotation);
        *group = 4;
        return 4;
    case SPIN_USD_SCALES:
        for (int c = 0; c < 3; c++) {
            out[c] = expf(is.log_scale[c]);
            if (spin_usd_is_half(x))
                out[c] = as_half(out[c], LEAST_HALF);
            shown.log_scale[c] = logf(out[c]);
        }
        spin_quant_error_add_3(quant, SPIN_QUANT_SCALE, is.log_scale, shown.log_scale);
        return 3;
    case SPIN_USD_OPACITIES:
        out[0] = spin_usd_is_half(x) ? spin_half(is.opacity) : is.opacity;
        spin_quant_error_add(quant, SPIN_QUANT_OPACITY, (double)is.opacity - (double)out[0]);
        *group = 1;
        return 1;
    default:
        memset(out, 0, n * sizeof *out);
        memcpy(out, spin_splat_rows_sh(rows, i, room), n_sh * sizeof *out);
        for (size_t k = 0; k < n; k++) {
            float v = out[k];

            out[k] = spin_usd_is_half(x) ? as_half(v, -MOST_HALF) : v;
            lost[k] = v - out[k];
        }
        spin_quant_error_add_sh(quant, lost + 3, n - 3);
        for (size_t c = 0; c < 3; c++)
            spin_quant_error_add(quant, SPIN_QUANT_COLOUR, SPIN_SH_C0 * (double)lost[c]);
        return n;
    }
}

void spin_usd_extent(const struct spin_usd_export *x, float extent[6])
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    bool any = false;
    float place[3];

    memset(extent, 0, 6 * sizeof *extent);
    for (size_t i = 0; i < rows->splats->n; i++) {
        const float *scale = rows->splats->log_scales + 3 * i;
        float q[4], axis[3][3];

        if (!rows->keep[i])
            continue;
        spin_splat_rows_turned(rows, i, q);
        spin_rotation(q, axis);
        spin_splat_rows_place(rows, i, place);
        for (int c = 0; c < 3; c++) {
            float reach = 0;

            for (int k = 0; k < 3; k++)
                reach += axis[c][k] * axis[c][k] * expf(2 * scale[k]);
            reach = 3 * sqrtf(reach);
            extent[c] = any ? spin_minf(extent[c], place[c] - reach) : place[c] - reach;
            extent[3 + c] = any ? spin_maxf(extent[3 + c], place[c] + reach) : place[c] + reach;
        }
        any = true;
    }
}

uint64_t spin_usd_hash(const struct spin_usd_export *x, enum spin_usd_column a)
{
    const struct spin_splats *s = x->frames.rows.splats;
    const float *const column[] = {s->means, s->quats, s->log_scales, s->logit_opacities, s->sh};
    const size_t width[] = {3, 4, 3, 1, 3 * (size_t)spin_sh_count(s->sh_degree)};
    uint64_t hash = SPIN_HASH_BEGIN;

    spin_hash(&hash, x->frames.rows.keep, s->n);
    spin_hash(&hash, column[a], s->n * width[a] * sizeof(float));
    return hash;
}
