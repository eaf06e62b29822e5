/* --scale and --translate of spin-export, which move what the row filter leaves: frames, 4D splats
 * and the cameras of the data set alike. */
#pragma once

#include "spin_run.h"
#include "scene/clip.h"

struct spin_scene_move {
    bool moves; /* false: the options change nothing */
    double scale;
    const double *translate;   /* [3], applied after the scale */
    struct spin_splats splats; /* the frame moved last */
    struct spin_splats_4d splats_4d;
    struct spin_views views; /* with transformed cameras */
};

/* Options must outlive m. */
void spin_scene_move_open(struct spin_scene_move *m, const struct spin_export_options *o);
void spin_scene_move_close(struct spin_scene_move *m);

/* Moves splats in place. */
void spin_scene_move_rows(const struct spin_scene_move *m, struct spin_splats *splats);
/* Replace *splats by a moved copy that is valid until the next call; the same if nothing moves. */
spin_status spin_scene_move_frame(struct spin_scene_move *m, const struct spin_splats **splats);
spin_status spin_scene_move_4d(struct spin_scene_move *m, const struct spin_splats_4d **splats_4d);
/* The views of the clip with their cameras transformed like the scene; NULL if there are none. */
spin_status spin_scene_move_views(struct spin_scene_move *m, const struct spin_clip *clip,
                                  const struct spin_views **out);
