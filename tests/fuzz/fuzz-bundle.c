/* Any bytes as a bundle: open, read every frame.  K: fuzz bundle */
#include "scene/bundle.h"
#include "tests/fuzz/input.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const char *path = input_path(data, n);
    struct spin_splats splats = {0};
    struct spin_bundle bundle;
    char *data_path = NULL;

    if (!path || spin_bundle_open(path, &bundle) != SPIN_OK)
        return 0;
    for (int f = 0; f < bundle.meta.n_frames; f++) {
        if (spin_bundle_frame(&bundle, f, bundle.meta.columns, &splats) == SPIN_OK &&
            splats.n != bundle.meta.frame[f].n)
            abort();
        if (bundle.refined.columns &&
            spin_bundle_refined_frame(&bundle, f, bundle.refined.columns, &splats) == SPIN_OK &&
            splats.n != bundle.refined.n[f])
            abort();
    }
    (void)spin_bundle_data_path(&bundle, &data_path);
    free(data_path);
    spin_splats_free(&splats);
    spin_bundle_close(&bundle);
    return 0;
}
