/* A file of 4D splats against the clip that it was written from, through the importer that reads
 * it. */
#pragma once

#include "exporters/lib/bells.h"
#include "exporters/lib/sort_rows.h"

struct spin_bells_check {
    const struct spin_bells *bells; /* as written: times and sigmas are those that the file holds */
    const struct spin_splat_filter *rows; /* of bells->view */
    const struct spin_keyed *order; /* [n] row j of the file is row order[j].row of the clip */
    size_t n;
    const char *importer;
    double half[3]; /* what log(1 + |x|) of a place may be off by */
};

/* Fills job->report->check with the most that any frame of the job is off by. SPIN_E_IO where the
 * file is not what was to be written. */
spin_status spin_bells_check(const struct spin_bells_check *of);
