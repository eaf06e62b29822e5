/* Quantises splats for .4dgs files: everything except positions and times, whose coding depends on
 * the temporal model. */
#pragma once

#include "exporters/lib/quant_error.h"
#include "exporters/lib/splat_rows.h"
#include "formats/4dgs_write.h"

struct spin_4dgs_coder {
    const struct spin_4dgs_coding *coding;
    const struct spin_splat_rows *rows;
    /* Numbers of splats with a clamped colour, and with a clamped SH coefficient; and the largest
     * change of a colour, and of a coefficient, by clamping. */
    uint64_t n_colours, n_sh;
    double lost_colour, lost_sh;
    struct spin_quant_error quant;
};

int32_t spin_4dgs_round(double value, double step);
/* Quantises scale, rotation, colour, opacity and SH of a row. *is: its values, without SH; *shown:
 * receives the values that a reader decodes. Adds the errors of SH to c->quant. */
void spin_4dgs_code_attributes(struct spin_4dgs_coder *c, size_t row,
                               const struct spin_gaussian *is, struct spin_4dgs_splat *to,
                               struct spin_gaussian *shown);
/* Warns about clamped values, and logs the quantisation errors. */
void spin_4dgs_coder_report(const struct spin_4dgs_coder *c);
