#include "run/exported_frames.h"

#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "io/file.h"
#include "io/json.h"

static const spin_json *entry_of(const spin_json *frames, int number)
{
    for (size_t k = 0; k < spin_json_length(frames); k++) {
        const spin_json *entry = spin_json_at(frames, k);
        int64_t is;

        if (spin_json_integer(spin_json_get(entry, "frame"), &is) && is == number)
            return entry;
    }
    return NULL;
}

/* Nothing is set unless all fits. */
static bool take(const spin_json *root, struct spin_frame_info *frame, int n, int *place,
                 struct spin_bundle_meta *meta)
{
    const spin_json *frames = spin_json_get(root, "frames");
    const char *pair = spin_json_string(spin_json_get(root, "pair"));
    int64_t n_source, at;
    bool numbered, placed = spin_json_integer(spin_json_get(root, "source_frames"), &n_source) &&
                            n_source > 0 && n_source <= INT_MAX &&
                            spin_json_bool(spin_json_get(root, "numbered"), &numbered);
    double time;

    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < n; i++) {
            const spin_json *entry = entry_of(frames, frame[i].number);

            if (!entry || !spin_json_number(spin_json_get(entry, "time"), &time) ||
                !isfinite(time) ||
                (placed && (!spin_json_integer(spin_json_get(entry, "source_index"), &at) ||
                            at < 0 || at >= n_source)))
                return false;
            if (pass == 1) {
                frame[i].time = time;
                place[i] = placed ? (int)at : i;
            }
        }
    meta->n_source_frames = placed ? (int)n_source : meta->n_source_frames;
    meta->numbered = placed ? numbered : meta->numbered;
    snprintf(meta->pair, sizeof meta->pair, "%s", pair ? pair : "");
    return true;
}

spin_status spin_exported_frames(const char *input, struct spin_frame_info *frame, int n,
                                 int *place, struct spin_bundle_meta *meta)
{
    const char *generator;
    spin_json *root = NULL;
    char *path = NULL;

    if (!spin_path_is_folder(input))
        return SPIN_OK;
    SPIN_TRY(spin_path_join(input, "sequence.json", &path));
    if (spin_path_exists(path) && spin_json_load(path, &root) == SPIN_OK) {
        generator = spin_json_string(spin_json_get(root, "generator"));
        if (generator && strncmp(generator, "spin4d ", 7) == 0 &&
            !take(root, frame, n, place, meta))
            spin_warn("'%s' does not fit the frames beside it: their times and places in the "
                      "exported clip are not used",
                      path);
    }
    spin_json_free(root);
    free(path);
    return SPIN_OK;
}
