/* Images in device memory, by number. */
#pragma once

#include "device/device.h"

enum spin_image_format { SPIN_IMAGE_RGB8, SPIN_IMAGE_F32 };

struct spin_image_store {
    struct spin_device *device;
    struct spin_images images; /* the argument of the device's verbs */
    uint8_t SPIN_DEV *pixels;  /* [n] images */
    uint8_t SPIN_DEV *masks;   /* [n] masks, or NULL */
    uint8_t SPIN_DEV *mattes; /* [n] mattes of max_pixels, see struct spin_view_of_batch; or NULL */
    size_t n, image_bytes, mask_bytes;
    size_t *key;   /* [n] key of each image; SIZE_MAX: no image */
    int64_t *used; /* [n] batch of requests in which each image was last found or inserted */
    int64_t turn;
    size_t next; /* number to try first for the next insertion */
};

/* Reserves memory for n images of up to max_pixels each, with or without masks. */
spin_status spin_image_store_open(struct spin_image_store *s, struct spin_device *device, size_t n,
                                  size_t max_pixels, enum spin_image_format format, bool masks);
void spin_image_store_close(struct spin_image_store *s);

/* Uploads image `number`, in the format of the store. mask: one bit per pixel, lowest first; NULL:
 * all 0. */
void spin_image_store_put(struct spin_image_store *s, uint32_t number, size_t n_pixels,
                          const void *pixels, const uint8_t *mask);

/* Reserves memory for the mattes of all images. */
spin_status spin_image_store_add_mattes(struct spin_image_store *s);
/* Returns the matte of image `number`; NULL if there are no mattes. */
static inline const uint8_t SPIN_DEV *spin_image_store_matte(const struct spin_image_store *s,
                                                             uint32_t number)
{
    return s->mattes ? s->mattes + number * s->images.max_pixels : NULL;
}
/* Uploads the matte of image `number`. */
void spin_image_store_put_matte(struct spin_image_store *s, uint32_t number, size_t n_pixels,
                                const uint8_t *matte);

/* For use as a cache. Begins a new batch of requests: images that are found or inserted during a
 * batch stay in the store until the next batch begins. */
void spin_image_store_begin_batch(struct spin_image_store *s);
/* Finds the number of the image with this key. Returns false if the image is missing: the caller
 * must then upload it as the returned number. At most n images may be requested in one batch. */
bool spin_image_store_find(struct spin_image_store *s, size_t key, uint32_t *number);
