/* Sound tracks. This file recognises the format of a sound file by its content, and never decodes
 * the sound: exports store the file byte for byte, except that spin_sound_align() can cut or extend
 * WAV files. Only videos decode the sound and encode it again (video_sound_ffmpeg.c). */
#pragma once

#include "spin.h"

#define SPIN_SOUND_LIMIT (128u << 20) /* bytes; the limit of TSOG */

/* Sets name, type, data and size; start is 0 and the gain is 1. `name` may be a path. The data are
 * borrowed. SPIN_E_UNSUPPORTED if the format is unknown, SPIN_E_MALFORMED if there are no data or
 * too many. */
spin_status spin_sound_set(struct spin_sound *s, const char *name, const void *data, size_t size);
/* Returns the formats that spin_sound_set() recognises, for messages. */
const char *spin_sound_formats(void);
/* Returns the media type, such as "audio/wav". */
const char *spin_sound_mime(const struct spin_sound *s);
/* Returns the file extension for the format of the sound, such as ".wav". */
const char *spin_sound_ending(const struct spin_sound *s);
/* Returns the duration in seconds of a WAV or Opus file; 0 if it is unknown. */
double spin_sound_seconds(const struct spin_sound *s);
/* Copies a WAV sound, and shifts its samples so that the copy starts with the clip (out->start is
 * 0): the samples before the first frame are removed, or silence is inserted at the beginning. *out
 * refers to *owned, which the caller frees. If this is unnecessary, or impossible as for all
 * compressed formats, *out is a copy of *s, and *owned is NULL. */
spin_status spin_sound_align(const struct spin_sound *s, struct spin_sound *out,
                             unsigned char **owned);
