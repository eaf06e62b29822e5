/* Any bytes as a bundle: open, read every frame, and the tracks of its network.  K: fuzz bundle */
#include "scene/bundle_tracks.h"
#include "tests/fuzz/input.h"

#include <stdlib.h>

enum { MOST = 1000 }; /* splats of a frame that are read */

static void read_tracks(struct spin_bundle *bundle)
{
    static float rows[MOST][SPIN_TRACK_WIDTH];
    struct spin_bundle_tracks tracks = {0};

    if (spin_bundle_tracks_open(bundle, &tracks) == SPIN_OK && tracks.values)
        for (int f = 0; f < bundle->meta.n_frames; f++) {
            size_t n = spin_bundle_count(bundle, f, SPIN_FROM_NETWORK);

            if (n <= MOST)
                (void)spin_bundle_tracks_frame(&tracks, f, n, rows[0], rows[0] + 3 * n);
        }
    spin_bundle_tracks_close(&tracks);
}

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
    if (spin_json_get(bundle.json, "network"))
        read_tracks(&bundle);
    (void)spin_bundle_data_path(&bundle, &data_path);
    free(data_path);
    spin_splats_free(&splats);
    spin_bundle_close(&bundle);
    return 0;
}
