/* Photographs in device memory, by number. */
#pragma once

#include "device/device.h"

enum spin_image_format { SPIN_IMAGE_RGB8, SPIN_IMAGE_F32 };

struct spin_image_store {
    struct spin_device *device;
    struct spin_images images; /* what the device's verbs take */
    uint8_t SPIN_DEV *pixels;  /* [n] pictures */
    uint8_t SPIN_DEV *masks;   /* [n] masks, or NULL */
    size_t n, image_bytes, mask_bytes;
    size_t *key;   /* [n] of what lies at each number; SIZE_MAX: nothing */
    int64_t *used; /* [n] turn in which it was last found */
    int64_t turn;
    size_t next;
};

/* Room for n pictures of up to max_pixels, with a mask each or none. */
spin_status spin_image_store_open(struct spin_image_store *s, struct spin_device *device, size_t n,
                                  size_t max_pixels, enum spin_image_format format, bool masks);
void spin_image_store_close(struct spin_image_store *s);

/* Picture `number` = pixels, as the format says. mask: a bit a pixel, lowest first; or NULL: all 0.
 */
void spin_image_store_put(struct spin_image_store *s, uint32_t number, size_t n_pixels,
                          const void *pixels, const uint8_t *mask);

/* The store as a cache: what is found in one turn stays until the next one begins. */
void spin_image_store_turn(struct spin_image_store *s);
/* The number where `key` lies. False: it is not there; the number is where the caller shall put it.
 * A turn must not ask for more than n. */
bool spin_image_store_find(struct spin_image_store *s, size_t key, uint32_t *number);
