/* Implements --scale and --translate of spin-export. These transform the splats that remain after
 * the row filter, in frames and in 4D splats, and the cameras of the data set. */
#pragma once

#include "spin_run.h"
#include "scene/clip.h"

struct spin_scene_move {
    bool moves; /* false: the options leave the scene unchanged */
    double scale;
    double translate[3];       /* applied after the scale; contains the shift of the clip */
    bool warned;               /* the warning about coarse positions was printed */
    struct spin_splats splats; /* copy of the frame that was transformed last */
    struct spin_splats_4d splats_4d;
    struct spin_views views; /* the views of the clip with transformed cameras */
};

/* Initialises m from the options. `shift` [3] is added to positions before the options apply. */
void spin_scene_move_open(struct spin_scene_move *m, const struct spin_export_options *o,
                          const double *shift);
void spin_scene_move_close(struct spin_scene_move *m);

/* Scales and translates these splats in place. */
void spin_scene_move_rows(const struct spin_scene_move *m, struct spin_splats *splats);
/* Replace the pointer by a pointer to a scaled and translated copy, which is valid until the next
 * call. If the options leave the scene unchanged, the pointer stays unchanged too. */
spin_status spin_scene_move_frame(struct spin_scene_move *m, const struct spin_splats **splats);
spin_status spin_scene_move_4d(struct spin_scene_move *m, const struct spin_splats_4d **splats_4d);
/* Sets *out to the views of the clip, with cameras that are transformed like the scene; or to NULL
 * if the clip has no views. */
spin_status spin_scene_move_views(struct spin_scene_move *m, const struct spin_clip *clip,
                                  const struct spin_views **out);
