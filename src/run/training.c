#include "run/training.h"

#include "base/base.h"

const spin_json *spin_training_of(const struct spin_bundle *bundle, enum spin_splat_source from)
{
    return spin_json_get(bundle->json, from == SPIN_FROM_TRAINED   ? "trained"
                                       : from == SPIN_FROM_REFINED ? "refined"
                                                                   : "trained_4d");
}

void spin_training_warn_background(const struct spin_bundle *bundle, enum spin_splat_source from,
                                   const float background[3], const char *what)
{
    const spin_json *taught =
        spin_json_get(spin_json_get(spin_training_of(bundle, from), "options"), "background");
    double value[3] = {0};
    bool differs = false;

    for (size_t c = 0; c < spin_json_length(taught) && c < 3; c++)
        differs |= spin_json_number(spin_json_at(taught, c), &value[c]) &&
                   fabs(value[c] - (double)background[c]) > 1e-6;
    if (differs)
        spin_warn("the splats were trained over a different background: --background %g,%g,%g %s "
                  "over that of the training",
                  value[0], value[1], value[2], what);
}

void spin_training_warn_scale(const struct spin_bundle *bundle, enum spin_splat_source from,
                              double image_scale)
{
    double taught = image_scale;

    spin_json_number(
        spin_json_get(spin_json_get(spin_training_of(bundle, from), "options"), "image_scale"),
        &taught);
    if (taught != image_scale)
        spin_warn("the splats were trained on images of a different size: --scale %g measures at "
                  "the same size",
                  taught);
}

void spin_training_warn_test_cameras(const struct spin_clip *clip, int n_test_cameras)
{
    if (clip->n_trained_test_cameras > 0)
        spin_warn("%s used to train '%s': these views are not held out",
                  spin_text_share((size_t)clip->n_trained_test_cameras, (size_t)n_test_cameras,
                                  "--test-cams camera", "was", "were", (char[96]){0}),
                  clip->bundle.path);
}
