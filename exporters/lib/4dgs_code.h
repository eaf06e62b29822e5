/* Quantises splats for .4dgs files: everything except positions and times, which depend on the
 * temporal model. */
#pragma once

#include "exporters/lib/quant_error.h"
#include "exporters/lib/splat_rows.h"
#include "formats/4dgs_write.h"

struct spin_4dgs_coder {
    const struct spin_4dgs_coding *coding;
    const struct spin_splat_rows *rows;
    uint64_t n_colours, n_sh;    /* splats with colours or SH coefficients out of range */
    double lost_colour, lost_sh; /* largest differences by this */
    struct spin_quant_error quant;
};

int32_t spin_4dgs_round(double value, double step);
/* Sets the integers of scale, rotation, colour, opacity and SH to those of a row, and the same
 * members of *shown to what a reader decodes. *is: the row. Adds the errors of SH to the
 * coder's. */
void spin_4dgs_code_look(struct spin_4dgs_coder *c, size_t row, const struct spin_gaussian *is,
                         struct spin_4dgs_splat *to, struct spin_gaussian *shown);
/* Warns about values that were clamped, and logs the errors. */
void spin_4dgs_coder_report(const struct spin_4dgs_coder *c);
