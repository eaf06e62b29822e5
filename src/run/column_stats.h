/* What the attributes of a clip look like: ranges, medians, the share of values that are no
 * numbers. */
#pragma once

#include "io/json.h"

struct spin_series; /* private: one line of the description */

struct spin_column_stats {
    struct spin_series *series; /* of every attribute */
    int n_frames;               /* that will come */
};

spin_status spin_column_stats_open(struct spin_column_stats *d, int n_frames);
/* Take in the columns of one frame. */
void spin_column_stats_frame(struct spin_column_stats *d, unsigned columns,
                             const struct spin_splats *s);
/* "ranges" of the report: an entry for each attribute that came. Medians are of 65,536 values
 * spread over the frames. "finite": no value is NaN or infinite. */
void spin_column_stats_ranges(struct spin_column_stats *d, spin_json *report);
void spin_column_stats_close(struct spin_column_stats *d);
