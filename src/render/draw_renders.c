#include "render/draw_renders.h"

#include <pthread.h>

#include "base/base.h"
#include "io/image.h"
#include "render/player.h"
#include "scene/renders.h"

/* The most recently rendered bundle stays open with its current frame, since images are mostly read
 * frame by frame. Renders use a CPU device of their own, since a training may be using its device
 * at the same time. */
static struct {
    pthread_mutex_t mutex;
    int users, n_threads;
    bool open;
    struct spin_bundle bundle;
    struct spin_device device;
    struct spin_player player;
    float *image;
} drawing = {.mutex = PTHREAD_MUTEX_INITIALIZER};

static void close_bundle(void)
{
    if (!drawing.open)
        return;
    spin_player_close(&drawing.player);
    spin_device_close(&drawing.device);
    spin_bundle_close(&drawing.bundle);
    drawing.open = false;
}

static spin_status open_bundle(const char *path)
{
    spin_status status;

    if (drawing.open && strcmp(drawing.bundle.path, path) == 0)
        return SPIN_OK;
    close_bundle();
    SPIN_TRY(spin_bundle_open(path, &drawing.bundle));
    status = spin_device_open("cpu", drawing.n_threads, &drawing.device);
    if (status != SPIN_OK) {
        spin_bundle_close(&drawing.bundle);
        return status;
    }
    status = spin_player_open(&drawing.player, &drawing.device, &drawing.bundle, SPIN_FROM_SOURCE);
    if (status != SPIN_OK) {
        spin_device_close(&drawing.device);
        spin_bundle_close(&drawing.bundle);
        return status;
    }
    drawing.open = true;
    return SPIN_OK;
}

static void store_bytes(const float *image, size_t plane, uint8_t *rgb)
{
    for (size_t i = 0; i < plane; i++)
        for (size_t c = 0; c < 3; c++) {
            float v = image[c * plane + i];

            rgb[3 * i + c] = (uint8_t)lrintf(255 * (v > 0 ? v < 1 ? v : 1 : 0));
        }
}

static spin_status draw_frame(const char *bundle, int frame, const struct spin_camera *camera,
                              const float background[3], uint8_t **rgb)
{
    static const float black[3];
    size_t plane = (size_t)camera->width * (size_t)camera->height;

    SPIN_TRY(open_bundle(bundle));
    if (frame < 0 || frame >= drawing.bundle.meta.n_frames)
        return spin_not_found(
            "cannot render an image of '%s': the bundle has no frame with index %d", bundle, frame);
    if (drawing.player.now_frame != frame)
        SPIN_TRY(spin_player_show(&drawing.player, frame));
    SPIN_TRY(spin_grow(3 * plane, sizeof *drawing.image, (void **)&drawing.image));
    SPIN_TRY(
        spin_player_draw(&drawing.player, camera, background ? background : black, drawing.image));
    SPIN_TRY(spin_alloc(plane, 3, (void **)rgb));
    store_bytes(drawing.image, plane, *rgb);
    return SPIN_OK;
}

static spin_status draw_image(const char *path, const float background[3], int *width, int *height,
                              uint8_t **rgb)
{
    SPIN_FREED char *bundle = NULL;
    struct spin_camera camera;
    spin_status status = SPIN_OK;
    int frame;

    SPIN_TRY(spin_renders_parse(path, &bundle, &frame, &camera));
    *width = camera.width;
    *height = camera.height;
    if (!rgb)
        return SPIN_OK;
    pthread_mutex_lock(&drawing.mutex);
    status = draw_frame(bundle, frame, &camera, background, rgb);
    pthread_mutex_unlock(&drawing.mutex);
    return status;
}

int spin_renders_begin(int n_threads)
{
    pthread_mutex_lock(&drawing.mutex);
    if (drawing.users++ == 0)
        drawing.n_threads = n_threads;
    spin_drawn_images_set(draw_image);
    pthread_mutex_unlock(&drawing.mutex);
    return 0;
}

void spin_renders_end(const int *renders)
{
    (void)renders;
    pthread_mutex_lock(&drawing.mutex);
    if (--drawing.users == 0) {
        close_bundle();
        free(drawing.image);
        drawing.image = NULL;
        spin_drawn_images_set(NULL);
    }
    pthread_mutex_unlock(&drawing.mutex);
}
