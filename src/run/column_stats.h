/* Statistics of a clip's attributes: ranges, medians, and the share of non-finite values. */
#pragma once

#include "io/json.h"

struct spin_series; /* private: statistics of one attribute or axis */

struct spin_column_stats {
    struct spin_series *series; /* [number of series] */
    int n_frames;               /* number of frames that will be added */
};

spin_status spin_column_stats_open(struct spin_column_stats *d, int n_frames);
/* Adds the columns of one frame. */
void spin_column_stats_frame(struct spin_column_stats *d, unsigned columns,
                             const struct spin_splats *s);
/* Sets two members of the report: "ranges", with an entry for each attribute that was added, and
 * "finite", which is false if any value is NaN or infinite. Each median is computed from a sample
 * of at most 65,536 values, spread over the frames. */
void spin_column_stats_ranges(struct spin_column_stats *d, spin_json *report);
void spin_column_stats_close(struct spin_column_stats *d);
