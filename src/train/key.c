/* Computes fingerprints, which are JSON texts, and keys, which are hashes of such texts. */
#include "train/key.h"

#include <inttypes.h>

#include "base/base.h"
#include "train/options.h"

static void add_images(spin_json *j, const struct spin_plan *plan, const struct spin_photos *photos,
                       int frame)
{
    char text[20];

    snprintf(text, sizeof text, "%016" PRIx64, spin_photos_digest(photos, plan, frame));
    spin_json_set_string(j, "images", text);
}

/* Adds a hash of the names, sizes and CRCs of the input's arrays. Since names are included, an
 * input with swapped or renamed arrays has another hash. */
static void add_members(spin_json *j, const struct spin_zip *zip)
{
    uint64_t hash = SPIN_HASH_BEGIN;
    char text[20];

    for (size_t i = 0; i < zip->n; i++) {
        const struct spin_zip_member *m = &zip->member[i];

        spin_hash(&hash, m->name, strlen(m->name) + 1);
        spin_hash(&hash, &m->size, sizeof m->size);
        spin_hash(&hash, &m->crc, sizeof m->crc);
    }
    snprintf(text, sizeof text, "%016" PRIx64, hash);
    spin_json_set_string(j, "input", text);
}

spin_status spin_frame_key(struct spin_plan *plan, const struct spin_photos *photos, int f,
                           char key[SPIN_FRAME_KEY])
{
    SPIN_FREED char *text = NULL;
    uint64_t hash = SPIN_HASH_BEGIN;
    uint32_t input;
    spin_json *j;

    SPIN_TRY(spin_bundle_checksum(&plan->clip.bundle, spin_plan_index(plan, f),
                                  spin_plan_start_columns(plan), &input));
    j = spin_settings_refine(plan);
    add_images(j, plan, photos, f);
    spin_json_set_integer(j, "frame", spin_plan_info(plan, f)->number);
    spin_json_set_integer(j, "input", input);
    if (plan->o->learn_exposure == SPIN_EXPOSURE_ON)
        spin_json_set(j, "lenses", spin_lenses_to_json(&plan->lenses));
    text = spin_json_text(j, false);
    spin_json_free(j);
    if (!text)
        return spin_fail(SPIN_E_MEMORY, "out of memory while computing the key of a frame");
    spin_hash(&hash, text, strlen(text));
    snprintf(key, SPIN_FRAME_KEY, "%016" PRIx64, hash);
    return SPIN_OK;
}

spin_status spin_fingerprint(const struct spin_plan *plan, const struct spin_refined *refined,
                             const struct spin_photos *photos, const struct spin_device *device,
                             char **out)
{
    const struct spin_retrain_options *o = plan->o;
    bool network = o->method != SPIN_METHOD_FRAMES;
    spin_json *j = network ? spin_field_to_json(&plan->field, true) : spin_json_object();
    spin_json *frames = spin_json_array();

    if (network) { /* these members and the input determine the scene transform */
        spin_json_set_integer(j, "normalise", o->normalise);
        spin_json_set(j, "options", spin_settings_network(plan));
        spin_json_set_string(j, "device", device->op->name);
    }
    for (int f = 0; f < plan->clip.n_frames; f++) {
        spin_json_push_number(frames, spin_plan_info(plan, f)->number);
        spin_json_push_number(frames, (double)plan->counts[f]);
        if (refined)
            spin_json_push_string(frames, refined[f].key);
    }
    spin_json_set(j, "frames", frames);
    add_images(j, plan, photos, -1);
    add_members(j, &plan->clip.bundle.npz.zip);
    *out = spin_json_text(j, false);
    spin_json_free(j);
    return *out ? SPIN_OK
                : spin_fail(SPIN_E_MEMORY,
                            "out of memory while computing the fingerprint of the run");
}

/* ---- Settings -------------------------------------------------------------------------------- */

spin_json *spin_settings_refine(const struct spin_plan *plan)
{
    spin_json *j = spin_options_to_json(plan->o, SPIN_OPTIONS_OF_REFINEMENT);

    spin_json_set_number(j, "spatial_extent", plan->extent);
    if (spin_plan_frame_sh_degree(plan) > 0) {
        spin_json_set_integer(j, "sh_degree", spin_plan_frame_sh_degree(plan));
        spin_json_set_integer(j, "sh_increase_every", spin_plan_sh_increase_every(plan));
    }
    return j;
}

spin_json *spin_settings_network(const struct spin_plan *plan)
{
    spin_json *j = spin_options_to_json(plan->o, SPIN_OPTIONS_OF_NETWORK);
    spin_json *test = spin_json_array();

    for (size_t i = 0; i < plan->clip.views.n; i++)
        if (plan->clip.views.view[i].test &&
            plan->clip.views.view[i].dataset_frame == plan->clip.dataset_frame[0])
            spin_json_push_number(test, plan->clip.views.view[i].camera_id);
    spin_json_set_number(j, "spatial_extent", plan->extent);
    spin_json_set(j, "test_cameras", test);
    if (plan->o->refine > 0)
        spin_json_set(j, "refine", spin_settings_refine(plan));
    return j;
}
