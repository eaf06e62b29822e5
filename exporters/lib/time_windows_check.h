/* --check for files of 4D splats: reads a file back with its importer and compares it with the clip
 * that was written. */
#pragma once

#include "exporters/lib/time_windows.h"
#include "exporters/lib/sort_rows.h"

struct spin_time_windows_check {
    /* The clip, with times and sigmas rounded as in the file. */
    const struct spin_time_windows *windows;
    /* The filter that chose the rows of windows->view to be written. */
    const struct spin_splat_rows *rows;
    const struct spin_keyed *order; /* [n] row j of the file is row order[j].row of windows->clip */
    const uint32_t *row;            /* [n] the same; used if `order` is NULL */
    size_t n;
    /* For clips of frames: loads the rows of frame f into windows->clip and `rows`, and sets *first
     * to the number of the first of them in `row`. NULL: windows->clip contains all rows. */
    spin_status (*load)(void *context, int frame, size_t *first);
    void *context;
    const char *importer;
    /* Tolerance of log(1 + |x|) of coordinates x: half a quantisation step; 0: not quantised. */
    double half[3];
};

/* Fills job->report->check with the largest errors over all frames of the job. Returns SPIN_E_IO if
 * the file does not contain the values that were written. */
spin_status spin_time_windows_check(const struct spin_time_windows_check *of);
