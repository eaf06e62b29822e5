/* Stores images in device memory. */
#include "render/image_store.h"

#include <stdlib.h>
#include <string.h>

#include "base/mem.h"

spin_status spin_image_store_open(struct spin_image_store *s, struct spin_device *device, size_t n,
                                  size_t max_pixels, enum spin_image_format format, bool masks)
{
    spin_status status = SPIN_OK;

    memset(s, 0, sizeof *s);
    s->device = device;
    s->n = n;
    s->image_bytes = 3 * max_pixels * (format == SPIN_IMAGE_F32 ? sizeof(float) : 1);
    s->mask_bytes = masks ? (max_pixels + 7) / 8 : 0;
    SPIN_TRY_OUT(spin_alloc(n + 1, sizeof *s->key + sizeof *s->used, (void **)&s->key));
    s->used = (int64_t *)(s->key + n);
    memset(s->key, 0xff, n * sizeof *s->key);
    SPIN_TRY_OUT(device->op->reserve(device, n * s->image_bytes, (void SPIN_DEV **)&s->pixels));
    if (masks)
        SPIN_TRY_OUT(device->op->reserve(device, n * s->mask_bytes, (void SPIN_DEV **)&s->masks));
    if (format == SPIN_IMAGE_F32)
        s->images.f32 = (const float SPIN_DEV *)s->pixels;
    else
        s->images.rgb8 = s->pixels;
    s->images.mask = s->masks;
    s->images.max_pixels = max_pixels;
    s->images.mask_weight[0] = s->images.mask_weight[1] = 1;
out:
    if (status != SPIN_OK)
        spin_image_store_close(s);
    return status;
}

void spin_image_store_close(struct spin_image_store *s)
{
    if (!s->device)
        return;
    s->device->op->release(s->device, s->pixels);
    s->device->op->release(s->device, s->masks);
    s->device->op->release(s->device, s->mattes);
    free(s->key);
    memset(s, 0, sizeof *s);
}

void spin_image_store_put(struct spin_image_store *s, uint32_t number, size_t n_pixels,
                          const void *pixels, const uint8_t *mask)
{
    const struct spin_device_ops *op = s->device->op;
    size_t bytes = n_pixels * (s->images.f32 ? 3 * sizeof(float) : 3);

    op->upload(s->device, s->pixels + number * s->image_bytes, pixels, bytes);
    if (mask)
        op->upload(s->device, s->masks + number * s->mask_bytes, mask, (n_pixels + 7) / 8);
    else if (s->masks)
        op->zero(s->device, s->masks + number * s->mask_bytes, s->mask_bytes);
}

spin_status spin_image_store_add_mattes(struct spin_image_store *s)
{
    return s->device->op->reserve(s->device, s->n * s->images.max_pixels,
                                  (void SPIN_DEV **)&s->mattes);
}

void spin_image_store_put_matte(struct spin_image_store *s, uint32_t number, size_t n_pixels,
                                const uint8_t *matte)
{
    s->device->op->upload(s->device, s->mattes + number * s->images.max_pixels, matte, n_pixels);
}

void spin_image_store_begin_batch(struct spin_image_store *s) { s->turn++; }

bool spin_image_store_has(const struct spin_image_store *s, size_t key)
{
    for (size_t i = 0; i < s->n; i++)
        if (s->key[i] == key)
            return true;
    return false;
}

bool spin_image_store_find(struct spin_image_store *s, size_t key, uint32_t *number)
{
    for (size_t i = 0; i < s->n; i++)
        if (s->key[i] == key) {
            s->used[i] = s->turn;
            *number = (uint32_t)i;
            return true;
        }
    for (size_t i = 0; i < s->n && s->used[s->next] == s->turn; i++)
        s->next = (s->next + 1) % s->n;
    *number = (uint32_t)s->next;
    s->key[s->next] = key;
    s->used[s->next] = s->turn;
    s->next = (s->next + 1) % s->n;
    return false;
}
