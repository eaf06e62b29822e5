/* What the attributes of a clip look like: ranges, medians, the share of values that are no numbers. */
#ifndef SPIN_CORE_DESCRIBE_H
#define SPIN_CORE_DESCRIBE_H

#include "spin.h"

struct spin_series; /* private: one line of the description */

struct spin_describe {
    struct spin_series *series; /* [SPIN_IMPORT_MAX_RANGES] */
    int n_frames;               /* that will come */
};

spin_status spin_describe_open(struct spin_describe *d, int n_frames);
/* Take in the columns of one frame. */
void spin_describe_frame(struct spin_describe *d, unsigned columns, const struct spin_splats *s);
/* One entry for each attribute that came. Medians are of 65,536 values spread over the frames. */
void spin_describe_ranges(struct spin_describe *d, struct spin_import_report *report);
void spin_describe_close(struct spin_describe *d);

#endif
