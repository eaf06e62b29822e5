/* Lists lenses, matches them with cameras, reads and writes them as JSON. */
#include "scene/lens.h"

#include "base/base.h"

/* A camera matches a lens if their image sizes differ by at most the fraction size_tolerance, and
 * their focal lengths, as fractions of the image width, by less than the factor focal_tolerance.
 * Sizes differ since scaled sizes are rounded; focal lengths differ a little between cameras of one
 * model. */
static const double size_tolerance = 0.02, focal_tolerance = 1.2;

static bool is_near(double a, double b, double tolerance) { return fabs(a - b) <= tolerance * b; }

int spin_lenses_find(const struct spin_lenses *lenses, const struct spin_camera *camera)
{
    double focal = camera->fx / camera->width, best = focal_tolerance;
    int found = -1;

    for (int i = 0; i < lenses->n; i++) {
        const struct spin_lens *lens = &lenses->lens[i];
        double ratio = focal > lens->focal ? focal / lens->focal : lens->focal / focal;

        if (is_near(camera->width / lenses->scale, lens->width, size_tolerance) &&
            is_near(camera->height / lenses->scale, lens->height, size_tolerance) && ratio < best) {
            best = ratio;
            found = i;
        }
    }
    return found;
}

spin_status spin_lenses_list(const struct spin_views *views, const struct spin_pair *pairs,
                             size_t n_pairs, double scale, struct spin_lenses *out)
{
    *out = (struct spin_lenses){.scale = scale};
    for (size_t i = 0; i < n_pairs; i++) {
        const struct spin_camera *camera = &views->view[pairs[i].view].camera;

        if (spin_lenses_find(out, camera) >= 0)
            continue;
        SPIN_TRY(spin_grow((size_t)out->n + 1, sizeof *out->lens, (void **)&out->lens));
        out->lens[out->n++] = (struct spin_lens){.width = camera->width / scale,
                                                 .height = camera->height / scale,
                                                 .focal = camera->fx / camera->width};
    }
    return SPIN_OK;
}

void spin_lenses_warn(const struct spin_lenses *lenses, const struct spin_views *views,
                      const struct spin_pair *pairs, size_t n_pairs)
{
    for (size_t i = 0; i < n_pairs && lenses->n > 0; i++) {
        const struct spin_view *view = &views->view[pairs[i].view];

        if (spin_lenses_find(lenses, &view->camera) < 0) {
            spin_warn("camera %d matches none of the learned lenses: its images are rendered "
                      "without lens falloff",
                      view->camera_id);
            return;
        }
    }
}

void spin_lenses_free(struct spin_lenses *lenses)
{
    free(lenses->lens);
    memset(lenses, 0, sizeof *lenses);
}

double spin_lens_corner_r2(const struct spin_lens *lens)
{
    double aspect = lens->height / lens->width;

    return 1 + aspect * aspect;
}

double spin_lenses_corner(const struct spin_lenses *lenses)
{
    double farthest = 1;

    for (int i = 0; i < lenses->n; i++) {
        const struct spin_lens *l = &lenses->lens[i];
        double r2 = spin_lens_corner_r2(l), corner = 1;

        for (int c = 0; c < 3; c++)
            corner += r2 * ((double)l->falloff[c] + r2 * (double)l->falloff[3 + c]) / 3;
        if (fabs(corner - 1) > fabs(farthest - 1))
            farthest = corner;
    }
    return farthest;
}

/* ---- JSON ------------------------------------------------------------------------------------ */

static const char *const coefficient[2] = {"c1", "c2"};

spin_json *spin_lenses_to_json(const struct spin_lenses *lenses)
{
    spin_json *all = spin_json_array();

    for (int i = 0; i < lenses->n; i++) {
        const struct spin_lens *lens = &lenses->lens[i];
        spin_json *one = spin_json_object();

        spin_json_set_number(one, "width", lens->width);
        spin_json_set_number(one, "height", lens->height);
        spin_json_set_number(one, "focal", lens->focal);
        for (int k = 0; k < 2; k++) {
            spin_json *rgb = spin_json_array();

            for (int c = 0; c < 3; c++)
                spin_json_push_number(rgb, (double)lens->falloff[3 * k + c]);
            spin_json_set(one, coefficient[k], rgb);
        }
        spin_json_push(all, one);
    }
    return all;
}

static bool read_lens(const spin_json *json, struct spin_lens *lens)
{
    bool good = spin_json_number(spin_json_get(json, "width"), &lens->width) &&
                spin_json_number(spin_json_get(json, "height"), &lens->height) &&
                spin_json_number(spin_json_get(json, "focal"), &lens->focal) && lens->width > 0 &&
                lens->height > 0 && lens->focal > 0;

    for (int k = 0; k < 6 && good; k++) {
        double value;

        good = spin_json_number(
                   spin_json_at(spin_json_get(json, coefficient[k / 3]), (size_t)k % 3), &value) &&
               fabs(value) <= 100;
        if (good)
            lens->falloff[k] = (float)value;
    }
    return good;
}

spin_status spin_lenses_from_json(const spin_json *json, double scale, struct spin_lenses *out)
{
    size_t n = spin_json_length(json);

    *out = (struct spin_lenses){.scale = scale};
    if (n == 0)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n, sizeof *out->lens, (void **)&out->lens));
    for (int i = 0; i < (int)n; i++)
        if (!read_lens(spin_json_at(json, (size_t)i), &out->lens[i])) {
            spin_lenses_free(out);
            return spin_malformed("meta.json: the size, focal length or falloff of lens %d is "
                                  "missing or out of range",
                                  i);
        }
    out->n = (int)n;
    return SPIN_OK;
}
