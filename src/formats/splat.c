#include "formats/splat.h"

#include <string.h>

#include "math/quat.h"
#include "math/sh.h"

void spin_splat_code(const struct spin_gaussian *row, unsigned char out[SPIN_SPLAT_ROW])
{
    float scale[3];

    for (int c = 0; c < 3; c++)
        scale[c] = expf(row->log_scale[c]);
    memcpy(out, row->place, sizeof row->place);
    memcpy(out + 12, scale, sizeof scale);
    spin_little_endian(out, 6);
    for (int c = 0; c < 3; c++)
        out[24 + c] = spin_byte_of(row->colour[c] * 255);
    out[27] = spin_byte_of(row->opacity * 255);
    for (int k = 0; k < 4; k++)
        out[28 + k] = spin_byte_of(row->rotation[k] * 128 + 128);
}

void spin_splat_decode_bytes(const unsigned char in[SPIN_SPLAT_ROW], struct spin_gaussian *out)
{
    for (int c = 0; c < 3; c++)
        out->colour[c] = in[24 + c] / 255.0f;
    out->opacity = in[27] / 255.0f;
    for (int k = 0; k < 4; k++)
        out->rotation[k] = ((float)in[28 + k] - 128) / 128;
    spin_quat_normalise(out->rotation);
}

static void read_row(const unsigned char *in, unsigned columns, size_t i, struct spin_splats *out)
{
    struct spin_gaussian row;
    float place_scale[6];

    memcpy(place_scale, in, sizeof place_scale);
    spin_little_endian(place_scale, 6);
    spin_splat_decode_bytes(in, &row);
    if (columns & SPIN_COL_MEANS)
        memcpy(out->means + 3 * i, place_scale, 3 * sizeof *out->means);
    if (columns & SPIN_COL_QUATS)
        memcpy(out->quats + 4 * i, row.rotation, sizeof row.rotation);
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        out->logit_opacities[i] = spin_byte_logit(in[27]);
    for (size_t c = 0; c < 3; c++) {
        if (columns & SPIN_COL_LOG_SCALES) /* NaN stays NaN; spin_splat_read() reports it */
            out->log_scales[3 * i + c] =
                logf(place_scale[3 + c] < 1e-38f ? 1e-38f : place_scale[3 + c]);
        if (columns & SPIN_COL_SH)
            out->sh[3 * i + c] = (row.colour[c] - 0.5f) / (float)SPIN_SH_C0;
    }
}

spin_status spin_splat_read(const unsigned char *bytes, size_t n_bytes, unsigned columns,
                            struct spin_splats *out)
{
    static const char *const what[5] = {"position", "rotation", "scale", "opacity", "colour"};
    size_t n = n_bytes / SPIN_SPLAT_ROW;

    if (n_bytes % SPIN_SPLAT_ROW != 0)
        return spin_malformed("size of %zu bytes, expected a multiple of %d", n_bytes,
                              SPIN_SPLAT_ROW);
    SPIN_TRY(spin_splats_reserve(out, n, columns, 0));
    for (size_t i = 0; i < n; i++)
        read_row(bytes + SPIN_SPLAT_ROW * i, columns, i, out);
    return spin_check_columns(what, columns, 0, n, out);
}
