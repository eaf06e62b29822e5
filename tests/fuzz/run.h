/* Fuzz targets of importers: a run is opened and read. */
#ifndef SPIN_TESTS_FUZZ_RUN_H
#define SPIN_TESTS_FUZZ_RUN_H

#include <math.h>
#include <stdlib.h>

#include "spin.h"

/* What an importer takes must be numbers, at the first time, the last, and between. */
static inline void read_run(const struct spin_importer *importer, const char *path,
                            const char *const *pairs)
{
    struct spin_plugin_values values = {pairs};
    struct spin_sequence_info sequence;
    struct spin_splats s = {0};
    void *self = NULL;

    if (importer->open(path, &values, &self, &sequence) == SPIN_OK) {
        for (int i = 0; i < 3; i++) {
            double time = sequence.time_first + (sequence.time_last - sequence.time_first) * i / 2;

            if (importer->frame(self, i, time, sequence.columns, &s) != SPIN_OK)
                continue;
            for (size_t k = 0; k < 3 * s.n; k++) {
                if (!isfinite(s.means[k]) || !isfinite(s.log_scales[k]))
                    abort();
            }
            for (size_t k = 0; k < 4 * s.n; k++) {
                if (!(fabsf(s.quats[k]) <= 1.0001f))
                    abort();
            }
        }
    }
    if (self)
        importer->close(self);
    spin_splats_free(&s);
}

#endif
