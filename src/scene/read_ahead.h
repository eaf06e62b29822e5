/* Decodes images in background threads before they are requested. */
#pragma once

#include "spin.h"

struct spin_read_ahead;

/* Decodes the image of a view to bytes allocated with malloc. Called by several threads at once. */
typedef spin_status (*spin_decode_fn)(void *context, size_t view, uint8_t **rgb);

/* Starts n_threads threads that keep at most `capacity` decoded images. `context` must stay valid
 * until spin_read_ahead_free(). */
spin_status spin_read_ahead_start(int n_threads, size_t capacity, spin_decode_fn decode,
                                  void *context, struct spin_read_ahead **out);
/* Waits for the images that are being decoded, and discards all images. NULL is allowed. */
void spin_read_ahead_free(struct spin_read_ahead *ahead);
/* Returns the maximum number of images that are decoded ahead. */
size_t spin_read_ahead_capacity(const struct spin_read_ahead *ahead);
/* Announces that a view will be requested soon. Views are decoded in the order of announcement. If
 * `capacity` images are announced and not yet taken, the oldest decoded one is discarded; if none
 * is decoded yet, the announcement is ignored. */
void spin_read_ahead_announce(struct spin_read_ahead *ahead, size_t view);
/* Returns the image of an announced view, which the caller frees, and waits if it is being decoded.
 * Returns NULL if the view was not announced, its decoding has not begun, or its decoding failed.
 * The caller then decodes the image itself, which also reports any error. */
uint8_t *spin_read_ahead_take(struct spin_read_ahead *ahead, size_t view);
