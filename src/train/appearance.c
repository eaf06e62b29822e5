/* Measures the brightness of points of the scene in the training images, and compares it with the
 * point's median brightness over time in the same camera. */
#include "train/appearance.h"

#include "base/base.h"

enum {
    FRAMES = 32, /* largest number of examined frames, which are evenly spaced over the clip */
    /* A brightness that differs from the median by more than this, of 255, deviates. Noise and JPEG
       change a mean of 3 x 3 pixels by less. */
    THRESHOLD = 5,
    CAMERAS = 2,      /* number of cameras that must deviate, at least */
    NONE = UINT8_MAX, /* stands for a brightness if the point is outside the image */
};

struct look {
    const struct spin_plan *plan;
    struct spin_photos *photos;
    size_t n;
    const float *place;
    int n_frames;    /* number of examined frames */
    uint8_t *image;  /* [max pixels][3] */
    uint8_t *bright; /* [n][n_frames] brightness of each point in the current camera */
    /* [n][n_frames] number of cameras, at most 255, in whose image a point is (seen), and in which
     * its brightness deviates (changed). */
    uint8_t *seen, *changed;
};

/* Returns the mean brightness of the 3 x 3 pixels around the projection of a point, 0 to 254; NONE
 * if they are not all inside the image. */
static uint8_t brightness(const struct spin_camera *camera, const uint8_t *image, const float at[3])
{
    double p[3];
    int x, y, sum = 0;

    if (!spin_camera_project(camera, at, p))
        return NONE;
    p[0] = floor(p[0]);
    p[1] = floor(p[1]);
    if (!(p[0] >= 1 && p[1] >= 1 && p[0] < camera->width - 1 && p[1] < camera->height - 1))
        return NONE;
    x = (int)p[0];
    y = (int)p[1];
    for (int j = -1; j <= 1; j++) {
        const uint8_t *row =
            image + 3 * ((size_t)(y + j) * (size_t)camera->width + (size_t)(x - 1));

        for (int i = 0; i < 9; i += 3)
            sum += row[i] + 2 * row[i + 1] + row[i + 2];
    }
    return (uint8_t)(sum / 36 < NONE ? sum / 36 : NONE - 1);
}

static int compare_bytes(const void *a, const void *b)
{
    return *(const uint8_t *)a - *(const uint8_t *)b;
}

/* Returns the median brightness of a point over the frames in which it is inside the image; NONE if
 * there is no such frame. */
static uint8_t median_of(const uint8_t *bright, int n_frames)
{
    uint8_t value[FRAMES];
    size_t n = 0;

    for (int f = 0; f < n_frames; f++)
        if (bright[f] != NONE)
            value[n++] = bright[f];
    if (n == 0)
        return NONE;
    qsort(value, n, 1, compare_bytes);
    return value[n / 2];
}

/* Returns the index of a frame among the examined frames; -1 if it is not examined. */
static int examined_index(const struct look *l, int frame)
{
    int64_t all = l->plan->clip.n_frames, k = (int64_t)frame * l->n_frames / all;

    return (k * all + l->n_frames - 1) / l->n_frames == frame ? (int)k : -1;
}

/* Adds one camera to the counts `seen` and `changed` of each point and frame. */
static spin_status count_camera(struct look *l, int camera_id)
{
    size_t n_frames = (size_t)l->n_frames;

    memset(l->bright, NONE, l->n * n_frames);
    for (size_t v = 0; v < l->plan->n_train; v++) {
        const struct spin_pair *pair = &l->plan->train[v];
        const struct spin_view *view = &l->plan->clip.views.view[pair->view];
        int f = examined_index(l, pair->frame);

        if (view->camera_id != camera_id || f < 0)
            continue;
        if (spin_cancelled())
            return spin_fail_cancelled();
        SPIN_TRY(spin_image_cache_get_rgb8(&l->photos->cache, pair->view, l->image));
        for (size_t i = 0; i < l->n; i++)
            l->bright[i * n_frames + (size_t)f] =
                brightness(&view->camera, l->image, l->place + 3 * i);
    }
    for (size_t i = 0; i < l->n; i++) {
        uint8_t *bright = l->bright + i * n_frames, median = median_of(bright, l->n_frames);

        for (size_t k = i * n_frames; k < (i + 1) * n_frames; k++) {
            bool sees = l->bright[k] != NONE && l->seen[k] < UINT8_MAX;

            l->seen[k] = (uint8_t)(l->seen[k] + sees);
            l->changed[k] =
                (uint8_t)(l->changed[k] + (sees && abs(l->bright[k] - median) > THRESHOLD));
        }
    }
    return SPIN_OK;
}

spin_status spin_appearance_varies(const struct spin_plan *plan, struct spin_photos *photos,
                                   size_t n, const float *place, uint8_t *varies)
{
    struct look l = {.plan = plan, .photos = photos, .n = n, .place = place};
    SPIN_FREED void *block = NULL;
    size_t cells;

    l.n_frames = plan->clip.n_frames < FRAMES ? plan->clip.n_frames : FRAMES;
    cells = n * (size_t)l.n_frames;
    SPIN_TRY(spin_alloc(cells + plan->max_pixels + 1, 3, &block));
    l.image = block;
    l.bright = l.image + 3 * plan->max_pixels;
    l.seen = l.bright + cells;
    l.changed = l.seen + cells;
    memset(l.seen, 0, 2 * cells);
    for (int c = 0; c < plan->n_cameras; c++)
        SPIN_TRY(count_camera(&l, plan->camera[c]));
    memset(varies, 0, n);
    for (size_t k = 0; k < cells; k++)
        varies[k / (size_t)l.n_frames] |= l.changed[k] >= CAMERAS && 2 * l.changed[k] > l.seen[k];
    return SPIN_OK;
}
