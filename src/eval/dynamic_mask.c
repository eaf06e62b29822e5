/* Reads masks of dynamic pixels from the files of the data set, or computes them from its images.
 */
#include "eval/dynamic_mask.h"

#include "base/base.h"
#include "io/image.h"

enum {
    MOST_ROWS = SPIN_MOVING_ROWS,
    FEWEST_ROWS = 3,
    FRIENDS = 4 /* a dynamic pixel with fewer dynamic neighbours is a speck */
};

/* A pixel is dynamic if it differs from the median by more than this. The threshold is above the
 * noise of JPEG and of a good camera (standard deviation about 4 of 255), and below the contrast of
 * a ball in front of a wall. */
static const float threshold = 20.0f / 255.0f;

struct spin_median {
    int camera_id;
    uint8_t *rgb; /* [h][w][3] median; NULL: the camera moves, or has too few frames */
};

/* ---- The median over time -------------------------------------------------------------------- */

static bool same_camera(const struct spin_camera *a, const struct spin_camera *b)
{
    if (a->width != b->width || a->height != b->height)
        return false;
    if (fabs(a->fx - b->fx) + fabs(a->fy - b->fy) + fabs(a->cx - b->cx) + fabs(a->cy - b->cy) >
        0.05)
        return false;
    for (int i = 0; i < 12; i++)
        if (fabs(a->w2c[i] - b->w2c[i]) > 1e-4)
            return false;
    return true;
}

size_t spin_moving_views(const struct spin_views *views, int camera_id, size_t chosen[MOST_ROWS])
{
    size_t n = 0, k = 0, seen = 0, first = 0;

    for (size_t i = 0; i < views->n; i++) {
        if (views->view[i].camera_id != camera_id)
            continue;
        if (n++ == 0)
            first = i;
        else if (!same_camera(&views->view[first].camera, &views->view[i].camera))
            return 0;
    }
    for (size_t i = 0; i < views->n && k < MOST_ROWS; i++) {
        if (views->view[i].camera_id != camera_id)
            continue;
        if (n <= MOST_ROWS || seen * (MOST_ROWS - 1) >= k * (n - 1))
            chosen[k++] = i;
        seen++;
    }
    return k;
}

static uint8_t median_of(uint8_t *value, size_t n)
{
    for (size_t i = 1; i < n; i++) {
        uint8_t v = value[i];
        size_t j = i;

        for (; j > 0 && value[j - 1] > v; j--)
            value[j] = value[j - 1];
        value[j] = v;
    }
    return value[n / 2];
}

static spin_status make_median(struct spin_dynamic_mask *m, int camera_id, uint8_t **out)
{
    size_t chosen[MOST_ROWS], n = spin_moving_views(m->views, camera_id, chosen), plane;
    uint8_t value[MOST_ROWS];
    SPIN_FREED uint8_t *all = NULL, *median = NULL;

    *out = NULL;
    if (n < FEWEST_ROWS)
        return SPIN_OK;
    plane = (size_t)m->views->view[chosen[0]].camera.width *
            (size_t)m->views->view[chosen[0]].camera.height;
    SPIN_TRY(spin_alloc(n * plane, 3, (void **)&all));
    SPIN_TRY(spin_alloc(plane, 3, (void **)&median));
    for (size_t k = 0; k < n; k++) {
        SPIN_TRY(spin_image_cache_get(m->pixels, chosen[k], m->image));
        for (size_t i = 0; i < plane; i++)
            for (size_t c = 0; c < 3; c++)
                all[(3 * i + c) * n + k] = (uint8_t)lrintf(255.0f * m->image[c * plane + i]);
    }
    for (size_t i = 0; i < 3 * plane; i++) {
        memcpy(value, all + i * n, n);
        median[i] = median_of(value, n);
    }
    *out = median;
    median = NULL;
    return SPIN_OK;
}

static spin_status find_median(struct spin_dynamic_mask *m, int camera_id, const uint8_t **out)
{
    struct spin_median *one;

    for (size_t i = 0; i < m->n_medians; i++) {
        if (m->median[i].camera_id == camera_id) {
            *out = m->median[i].rgb;
            return SPIN_OK;
        }
    }
    SPIN_TRY(spin_grow(m->n_medians + 1, sizeof *m->median, (void **)&m->median));
    one = &m->median[m->n_medians];
    one->camera_id = camera_id;
    SPIN_TRY(make_median(m, camera_id, &one->rgb));
    m->n_medians++;
    *out = one->rgb;
    return SPIN_OK;
}

/* ---- The rule -------------------------------------------------------------------------------- */

/* Counts the pixels of value 1 among the eight neighbours of (x, y). */
static int count_around(int width, int height, const uint8_t *map, int x, int y)
{
    int sum = 0;

    for (int v = y > 0 ? y - 1 : 0; v <= y + 1 && v < height; v++)
        for (int u = x > 0 ? x - 1 : 0; u <= x + 1 && u < width; u++)
            sum += map[(size_t)v * (size_t)width + (size_t)u];
    return sum - map[(size_t)y * (size_t)width + (size_t)x];
}

void spin_dynamic_mask_rule(int width, int height, const float *truth, const uint8_t *median,
                            uint8_t *scratch, uint8_t *mask)
{
    size_t plane = (size_t)width * (size_t)height;

    for (size_t i = 0; i < plane; i++) {
        float most = 0;

        for (size_t c = 0; c < 3; c++)
            most = fmaxf(most, fabsf(truth[c * plane + i] - (float)median[3 * i + c] / 255.0f));
        mask[i] = most > threshold;
    }
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            size_t i = (size_t)y * (size_t)width + (size_t)x;

            scratch[i] = mask[i] && count_around(width, height, mask, x, y) >= FRIENDS;
        }
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            size_t i = (size_t)y * (size_t)width + (size_t)x;

            mask[i] = scratch[i] || count_around(width, height, scratch, x, y) > 0;
        }
}

/* ---- Masks of the data set ------------------------------------------------------------------- */

static const float black[3];

/* Reads a foreground mask with values 0 and 1, or 0 and 255. If the size of the mask differs from
 * that of the image, the mask is sampled at the centres of the image's pixels. */
static spin_status read_mask(struct spin_dynamic_mask *m, const struct spin_view *view)
{
    int width = view->camera.width, height = view->camera.height, w, h;
    uint8_t most = 0;
    SPIN_FREED uint8_t *rgb = NULL;

    SPIN_TRY(spin_image_read(view->mask, black, &w, &h, &rgb));
    for (size_t i = 0; i < 3 * (size_t)w * (size_t)h; i++)
        most = rgb[i] > most ? rgb[i] : most;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            size_t row = (size_t)(((int64_t)2 * y + 1) * h / (2 * height));
            size_t column = (size_t)(((int64_t)2 * x + 1) * w / (2 * width));
            uint8_t v = rgb[3 * (row * (size_t)w + column)];

            m->mask[(size_t)y * (size_t)width + (size_t)x] = most > 1 ? v >= 128 : v;
        }
    return SPIN_OK;
}

/* Sets the mask to 1 where alpha is above 0.5. Alpha is computed from the image composited over
 * white and over black, whose difference is 1 - alpha. */
static spin_status read_alpha(struct spin_dynamic_mask *m, const struct spin_view *view)
{
    static const float white[3] = {1, 1, 1};
    int width = view->camera.width, height = view->camera.height;
    size_t plane = (size_t)width * (size_t)height;
    SPIN_FREED float *over_white = NULL;

    SPIN_TRY(spin_alloc(plane, 3 * sizeof(float), (void **)&over_white));
    SPIN_TRY(spin_image_load(view->path, width, height, black, m->image));
    SPIN_TRY(spin_image_load(view->path, width, height, white, over_white));
    for (size_t i = 0; i < plane; i++)
        m->mask[i] = over_white[i] - m->image[i] < 0.5f;
    return SPIN_OK;
}

bool spin_views_have_alpha(const struct spin_views *views, const struct spin_pair *pairs, size_t n)
{
    int width, height, channels;

    for (size_t i = 0; i < n; i++)
        if (spin_image_size(views->view[pairs[i].view].path, &width, &height, &channels) !=
                SPIN_OK ||
            channels % 2 != 0)
            return false;
    return n > 0;
}

/* ---- Opening and finding --------------------------------------------------------------------- */

static bool all_have_masks(const struct spin_views *views, const struct spin_pair *pairs, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!views->view[pairs[i].view].mask)
            return false;
    return n > 0;
}

static bool some_have_medians(const struct spin_views *views, const struct spin_pair *pairs,
                              size_t n)
{
    size_t chosen[MOST_ROWS];

    for (size_t i = 0; i < n && pairs[i].frame == pairs[0].frame; i++)
        if (spin_moving_views(views, views->view[pairs[i].view].camera_id, chosen) >= FEWEST_ROWS)
            return true;
    return false;
}

static spin_status alloc_buffers(struct spin_dynamic_mask *m)
{
    size_t n = spin_views_pixels(m->views);

    SPIN_TRY(spin_alloc(n, 3 * sizeof(float), (void **)&m->image));
    SPIN_TRY(spin_alloc(n, 2, (void **)&m->mask));
    m->room = n;
    return SPIN_OK;
}

spin_status spin_dynamic_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   enum spin_dynamic_from from, const struct spin_pair *pairs,
                                   size_t n_pairs, struct spin_dynamic_mask *m)
{
    bool masks = all_have_masks(views, pairs, n_pairs);
    bool medians = some_have_medians(views, pairs, n_pairs);

    memset(m, 0, sizeof *m);
    m->views = views;
    m->pixels = pixels;
    if (from == SPIN_DYNAMIC_AUTO)
        from = masks ? SPIN_DYNAMIC_MASKS : medians ? SPIN_DYNAMIC_IMAGES : SPIN_DYNAMIC_OFF;
    if (from == SPIN_DYNAMIC_MASKS && !masks)
        return spin_not_found(
            "cannot use --dynamic masks: some views have no foreground mask; use --dynamic images");
    if (from == SPIN_DYNAMIC_IMAGES && !medians)
        return spin_unsupported("cannot use --dynamic images: no camera is static in three frames "
                                "or more; omit the option");
    m->from = from;
    return from == SPIN_DYNAMIC_OFF ? SPIN_OK : alloc_buffers(m);
}

spin_status spin_subject_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs,
                                   struct spin_dynamic_mask *m)
{
    *m = (struct spin_dynamic_mask){.views = views, .pixels = pixels};
    m->from = SPIN_DYNAMIC_MASKS;
    m->alpha = !all_have_masks(views, pairs, n_pairs);
    if (m->alpha && !spin_views_have_alpha(views, pairs, n_pairs))
        return spin_not_found("cannot use --mask: some views have no foreground mask, and not all "
                              "images have alpha; omit the option");
    return alloc_buffers(m);
}

void spin_dynamic_mask_close(struct spin_dynamic_mask *m)
{
    for (size_t i = 0; i < m->n_medians; i++)
        free(m->median[i].rgb);
    for (size_t i = 0; m->kept && i < m->views->n; i++)
        free(m->kept[i]);
    free(m->kept);
    free(m->median);
    free(m->image);
    free(m->mask);
    memset(m, 0, sizeof *m);
}

spin_status spin_dynamic_mask_keep(struct spin_dynamic_mask *m)
{
    SPIN_TRY(spin_alloc(m->views->n, sizeof *m->kept, (void **)&m->kept));
    return SPIN_OK;
}

void spin_dynamic_mask_bits(const struct spin_dynamic_mask *m, size_t n, uint8_t *bits)
{
    memset(bits, 0, (n + 7) / 8);
    for (size_t i = 0; i < n; i++)
        bits[i / 8] |= (uint8_t)(m->mask[i] << i % 8);
}

static spin_status store_mask(struct spin_dynamic_mask *m, size_t view, size_t plane)
{
    SPIN_TRY(spin_alloc(plane / 8 + 1, 1, (void **)&m->kept[view]));
    spin_dynamic_mask_bits(m, plane, m->kept[view]);
    return SPIN_OK;
}

static spin_status compute_mask(struct spin_dynamic_mask *m, size_t view, const float *truth)
{
    const struct spin_view *v = &m->views->view[view];
    const uint8_t *median = NULL;

    if (m->from == SPIN_DYNAMIC_MASKS)
        return m->alpha ? read_alpha(m, v) : read_mask(m, v);
    SPIN_TRY(find_median(m, v->camera_id, &median));
    if (median && !truth) {
        SPIN_TRY(spin_image_cache_get(m->pixels, view, m->image));
        truth = m->image;
    }
    if (median)
        spin_dynamic_mask_rule(v->camera.width, v->camera.height, truth, median, m->mask + m->room,
                               m->mask);
    return SPIN_OK;
}

spin_status spin_dynamic_mask_find(struct spin_dynamic_mask *m, size_t view, const float *truth,
                                   size_t *n)
{
    const struct spin_camera *camera = &m->views->view[view].camera;
    size_t plane = (size_t)camera->width * (size_t)camera->height;
    const uint8_t *kept = m->kept ? m->kept[view] : NULL;

    *n = 0;
    if (m->from == SPIN_DYNAMIC_OFF)
        return SPIN_OK;
    memset(m->mask, 0, plane);
    if (kept)
        for (size_t i = 0; i < plane; i++)
            m->mask[i] = kept[i / 8] >> i % 8 & 1;
    else
        SPIN_TRY(compute_mask(m, view, truth));
    if (m->kept && !kept)
        SPIN_TRY(store_mask(m, view, plane));
    for (size_t i = 0; i < plane; i++)
        *n += m->mask[i];
    return SPIN_OK;
}
