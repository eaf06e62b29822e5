#include "run/antialias_bake.h"

#include <string.h>

#include "base/base.h"
#include "formats/gaussian.h"
#include "math/project.h"
#include "math/quat.h"
#include "scene/clip.h"

enum { MOST_IMAGES = 8, COST_IMAGES = 3 };

/* Prepares the calculation for splats of the clip, without starting it. */
static void begin(struct spin_antialias_bake *b, const struct spin_export_options *o,
                  const struct spin_clip *clip, enum spin_splat_source from)
{
    *b = (struct spin_antialias_bake){.bakes = o->bake_antialias,
                                      .width = o->bake_size[0],
                                      .height = o->bake_size[1],
                                      .scale = 1,
                                      .clip = clip,
                                      .background = o->background};
    spin_json_number(spin_json_get(spin_json_get(spin_training_of(&clip->bundle, from), "options"),
                                   "image_scale"),
                     &b->scale);
}

spin_status spin_antialias_bake_open(struct spin_antialias_bake *b,
                                     const struct spin_export_options *o,
                                     const struct spin_clip *clip, enum spin_splat_source from,
                                     bool antialias, struct spin_device *device)
{
    begin(b, o, clip, from);
    if (!b->bakes)
        return SPIN_OK;
    if (!antialias)
        return spin_unsupported("--bake-antialias: these splats were not trained with "
                                "antialiasing, so there is nothing to bake: omit the option");
    if (!clip->has_views)
        return spin_misuse("--bake-antialias needs the cameras of the data set: give --data DIR");
    return spin_player_open(&b->drawing, device, NULL, SPIN_FROM_SOURCE);
}

void spin_antialias_bake_close(struct spin_antialias_bake *b)
{
    spin_player_close(&b->drawing);
    spin_splats_free(&b->splats);
}

/* Returns the camera of a view, scaled to the image size that opacities are baked for. */
static struct spin_camera camera_of(const struct spin_antialias_bake *b, const struct spin_view *v)
{
    struct spin_camera c = v->camera;
    int width = b->width > 0 ? b->width : (int)fmax(1, round(b->scale * c.width));
    int height = b->width > 0 ? b->height : (int)fmax(1, round(b->scale * c.height));

    c.fx *= (double)width / c.width;
    c.cx *= (double)width / c.width;
    c.fy *= (double)height / c.height;
    c.cy *= (double)height / c.height;
    c.width = width;
    c.height = height;
    return c;
}

/* Sets *factor to the factor by which antialiasing lowers the opacity of row i in one view, and
 * *distance to the distance of the splat from the camera. Returns whether the view shows the centre
 * of the splat. If not, *factor is that of the same splat at the same distance, but in the middle
 * of the image. */
static bool view_factor(const struct spin_camera *camera, const struct spin_splats *s, size_t i,
                        float *factor, double *distance)
{
    const struct spin_camera_f32 c = spin_camera_f32_from(camera);
    const struct spin_projection lens = {c.fx, c.fy, c.cx, c.cy, c.limit_x, c.limit_y, c.r, c.t};
    const float *m = s->means + 3 * i;
    spin_vec3 p = spin_to_camera(lens.r, lens.t, spin_v3(m[0], m[1], m[2]));
    float q[4], scale[3];
    double x = (double)p.z > 0 ? camera->fx * (double)p.x / (double)p.z + camera->cx : -1;
    double y = (double)p.z > 0 ? camera->fy * (double)p.y / (double)p.z + camera->cy : -1;
    bool shows = (double)p.z > spin_camera_near(camera) && x >= 0 && x < camera->width && y >= 0 &&
                 y < camera->height;
    struct spin_projected_cov f;

    *distance = sqrt((double)spin_dot3(p, p));
    if (!shows)
        p = spin_v3(0, 0, spin_maxf((float)*distance, (float)spin_camera_near(camera)));
    memcpy(q, s->quats + 4 * i, sizeof q);
    spin_quat_normalise(q);
    for (int k = 0; k < 3; k++)
        scale[k] = expf(s->log_scales[3 * i + (size_t)k]);
    spin_projected_cov_from(&lens, p, scale, q, &f);
    *factor = spin_aa_compensation(&f);
    return shows;
}

/* Returns the mean factor of row i over the training views that show the splat; if no view shows
 * it, the factor of the nearest view. */
static double row_factor(const struct spin_antialias_bake *b, const struct spin_splats *s, size_t i,
                         const struct spin_view *view, size_t n_views)
{
    double sum = 0, nearest = 1, least = INFINITY;
    int n = 0;

    for (size_t v = 0; v < n_views; v++) {
        const struct spin_camera camera = camera_of(b, &view[v]);
        double distance;
        float factor;

        if (view[v].test)
            continue;
        if (view_factor(&camera, s, i, &factor, &distance)) {
            sum += (double)factor;
            n++;
        } else if (distance < least) {
            least = distance;
            nearest = (double)factor;
        }
    }
    return n > 0 ? sum / n : nearest;
}

/* Sets *view to the views of frame f of the clip and returns their number. A frame that is not
 * paired with a row of the data set gets the views of row 0. */
static size_t views_of(const struct spin_antialias_bake *b, int f, const struct spin_view **view)
{
    const struct spin_views *views = &b->clip->views;
    int row = b->clip->dataset_frame[f] >= 0 ? b->clip->dataset_frame[f] : 0;
    size_t first = 0, n = 0;

    while (first < views->n && views->view[first].dataset_frame < row)
        first++;
    while (first + n < views->n && views->view[first + n].dataset_frame == row)
        n++;
    *view = views->view + first;
    return n;
}

/* Draws splats into image [3][h][w], clamped to 0..1. */
static spin_status draw(struct spin_antialias_bake *b, const struct spin_splats *splats,
                        const struct spin_camera *camera, float *image)
{
    size_t n = 3 * (size_t)camera->width * (size_t)camera->height;

    SPIN_TRY(spin_player_show_splats(&b->drawing, splats));
    SPIN_TRY(spin_player_draw(&b->drawing, camera, b->background, image));
    for (size_t i = 0; i < n; i++)
        image[i] = spin_minf(spin_maxf(image[i], 0), 1);
    return SPIN_OK;
}

static double squared_distance(const float *a, const float *b, size_t n)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++)
        sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
    return sum;
}

/* Measures the effect of baking in one view. The reference image shows the original splats with
 * antialiasing. Adds the squared differences between this image and two others, which are drawn
 * without antialiasing, to b->after (baked splats) and b->before (original splats). */
static spin_status measure(struct spin_antialias_bake *b, const struct spin_splats *original,
                           const struct spin_view *view)
{
    const struct spin_camera camera = camera_of(b, view);
    size_t n = 3 * (size_t)camera.width * (size_t)camera.height;
    struct spin_splats plain = *original;
    SPIN_FREED float *image = NULL;

    SPIN_TRY(spin_alloc(2 * n, sizeof *image, (void **)&image));
    plain.antialias = true;
    SPIN_TRY(draw(b, &plain, &camera, image));
    if (b->bakes) {
        SPIN_TRY(draw(b, &b->splats, &camera, image + n));
        b->after += squared_distance(image, image + n, n);
    }
    plain.antialias = false;
    SPIN_TRY(draw(b, &plain, &camera, image + n));
    b->before += squared_distance(image, image + n, n);
    b->n_values += (double)n;
    b->n_images++;
    return SPIN_OK;
}

spin_status spin_antialias_bake_frame(struct spin_antialias_bake *b, int f,
                                      const struct spin_splats **splats)
{
    const struct spin_splats *original = *splats;
    const struct spin_view *view;
    SPIN_FREED unsigned char *mark = NULL;
    size_t n_views;

    if (!b->bakes)
        return SPIN_OK;
    n_views = views_of(b, f, &view);
    SPIN_TRY(spin_alloc(original->n + 1, 1, (void **)&mark));
    memset(mark, 1, original->n);
    SPIN_TRY(spin_splats_select(original, mark, &b->splats));
    b->splats.antialias = false;
    for (size_t i = 0; i < original->n; i++) {
        double factor = row_factor(b, original, i, view, n_views);
        double opacity = 1 / (1 + exp(-(double)original->logit_opacities[i]));

        b->splats.logit_opacities[i] = spin_opacity_logit((float)(factor * opacity));
        b->sum_factors += b->measures ? factor : 0;
    }
    b->n_splats += b->measures ? (double)original->n : 0;
    *splats = &b->splats;
    if (!b->measures || n_views == 0 || b->n_images >= MOST_IMAGES)
        return SPIN_OK;
    return measure(b, original, &view[(size_t)f % n_views]);
}

static double decibels(double squares, double n)
{
    return squares > 0 ? 10 * log10(n / squares) : INFINITY;
}

void spin_antialias_bake_log(const struct spin_antialias_bake *b)
{
    char size[64] = "the size of the training's images", count[48];

    if (!b->bakes || b->n_splats == 0)
        return;
    if (b->width > 0)
        snprintf(size, sizeof size, "%d x %d pixels", b->width, b->height);
    spin_log(
        0,
        "antialiasing baked for %s: opacities are multiplied by %.3f on average; compared with "
        "antialiased images, the PSNR of %s is %.2f dB, or %.2f dB without baking",
        size, b->sum_factors / b->n_splats, spin_text_count(b->n_images, "image", count),
        decibels(b->after, b->n_values), decibels(b->before, b->n_values));
}

spin_status spin_antialias_cost(const struct spin_export_options *o, const struct spin_clip *clip,
                                enum spin_splat_source from, struct spin_device *device, int f,
                                const struct spin_splats *splats, double *psnr)
{
    SPIN_LEAVES(spin_antialias_bake_close) struct spin_antialias_bake b;
    const struct spin_view *view;
    size_t n_views;

    begin(&b, o, clip, from);
    SPIN_TRY(spin_player_open(&b.drawing, device, NULL, SPIN_FROM_SOURCE));
    n_views = views_of(&b, f, &view);
    for (size_t v = 0; v < n_views; v += (n_views + COST_IMAGES - 1) / COST_IMAGES)
        SPIN_TRY(measure(&b, splats, &view[v]));
    *psnr = b.n_images > 0 ? decibels(b.before, b.n_values) : 0;
    return SPIN_OK;
}
