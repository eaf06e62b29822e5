#include "io/drawn_image.h"

#include <sys/stat.h>

#include "base/base.h"
#include "io/file.h"

static spin_draw_image_fn draw_image;

void spin_drawn_images_set(spin_draw_image_fn draw) { draw_image = draw; }

bool spin_image_is_drawn(const char *path) { return strstr(path, SPIN_DRAWN_MARK) != NULL; }

spin_status spin_drawn_image_read(const char *path, const float background[3], int *width,
                                  int *height, uint8_t **rgb)
{
    if (!draw_image)
        return spin_unsupported("cannot read the image '%s': this command does not render images",
                                path);
    return draw_image(path, background, width, height, rgb);
}

spin_status spin_drawn_image_check(const char *path, int *width, int *height,
                                   struct spin_digest *digest)
{
    uint64_t hash = SPIN_HASH_BEGIN;
    SPIN_FREED char *bundle = NULL;
    struct stat st;

    SPIN_TRY(spin_drawn_image_read(path, NULL, width, height, NULL));
    SPIN_TRY(spin_strdup(path, &bundle));
    *strstr(bundle, SPIN_DRAWN_MARK) = '\0';
    if (stat(bundle, &st) != 0)
        return spin_not_found(
            "cannot render the images of the data set: bundle '%s' does not exist", bundle);
    spin_hash(&hash, path, strlen(path));
    digest->size = (uint64_t)st.st_size;
    digest->crc = (uint32_t)(hash ^ hash >> 32);
    return SPIN_OK;
}
