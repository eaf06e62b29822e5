/* A fixed number of slots for images in device memory, with optional masks and mattes. */
#pragma once

#include "device/device.h"

enum spin_image_format { SPIN_IMAGE_RGB8, SPIN_IMAGE_F32 };

struct spin_image_store {
    struct spin_device *device;
    struct spin_images images; /* the images as an argument of device verbs */
    uint8_t SPIN_DEV *pixels;  /* [n] images */
    uint8_t SPIN_DEV *masks;   /* [n] masks, or NULL */
    uint8_t SPIN_DEV *mattes;  /* [n][max_pixels] mattes, see struct spin_view_of_batch; or NULL */
    size_t n, image_bytes, mask_bytes;
    size_t *key;   /* [n] key of the image in each slot; SIZE_MAX: the slot is empty */
    int64_t *used; /* [n] value of `turn` when each slot was last found or filled */
    int64_t turn;  /* number of the current batch of requests */
    size_t next;   /* slot to try first for the next insertion */
};

/* Reserves memory for n images of up to max_pixels pixels each, with or without masks. */
spin_status spin_image_store_open(struct spin_image_store *s, struct spin_device *device, size_t n,
                                  size_t max_pixels, enum spin_image_format format, bool masks);
void spin_image_store_close(struct spin_image_store *s);

/* Uploads pixels, in the format of the store, and a mask to slot `number`. mask: one bit per pixel,
 * the lowest bit of a byte first; NULL: all bits are 0. */
void spin_image_store_put(struct spin_image_store *s, uint32_t number, size_t n_pixels,
                          const void *pixels, const uint8_t *mask);

/* Reserves memory for the mattes of all images. */
spin_status spin_image_store_add_mattes(struct spin_image_store *s);
/* Returns the matte of slot `number`; NULL if the store has no mattes. */
static inline const uint8_t SPIN_DEV *spin_image_store_matte(const struct spin_image_store *s,
                                                             uint32_t number)
{
    return s->mattes ? s->mattes + number * s->images.max_pixels : NULL;
}
/* Uploads a matte to slot `number`. */
void spin_image_store_put_matte(struct spin_image_store *s, uint32_t number, size_t n_pixels,
                                const uint8_t *matte);

/* The next three functions use the store as a cache. spin_image_store_begin_batch() begins a batch
 * of requests: images that are found or inserted during a batch stay in the store until the next
 * batch begins. */
void spin_image_store_begin_batch(struct spin_image_store *s);
/* Returns whether the image with this key is in the store. */
bool spin_image_store_has(const struct spin_image_store *s, size_t key);
/* Sets *number to the slot of the image with this key. Returns false if the image is missing: the
 * caller must then upload it to slot *number. At most n images may be requested in one batch. */
bool spin_image_store_find(struct spin_image_store *s, size_t key, uint32_t *number);
