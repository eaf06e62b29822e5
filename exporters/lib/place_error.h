/* How far places are off, in the sizes of the splats and in pixels of the cameras that see them. */
#pragma once

#include "spin.h"

struct spin_place_error {
    double sizes;  /* the most, of a splat's largest standard deviation */
    double pixels; /* the most; -1: no camera saw a splat */
    const struct spin_view *view;
    size_t n_views; /* of this frame */
};

/* Nothing was seen so far. */
void spin_place_error_begin(struct spin_place_error *e);
/* The cameras from now on are those that the data set has of a frame of the job. */
void spin_place_error_frame(struct spin_place_error *e, const struct spin_export_job *job,
                            int frame);
/* A splat whose place is off by so much, in the source's axes and units. */
void spin_place_error_add(struct spin_place_error *e, const float mean[3], const float log_scale[3],
                          double off);
/* Sets both of *out. */
void spin_place_error_say(const struct spin_place_error *e, struct spin_export_check *out);
