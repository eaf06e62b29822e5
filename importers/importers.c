/* The importers in alphabetical order. To add an importer, add its file to this folder and its name
 * to the list below. */
#include "spin.h"

#define ALL(ONE)                                                                                   \
    ONE(3dgstream)                                                                                 \
    ONE(4dgaussian)                                                                                \
    ONE(4dgs)                                                                                      \
    ONE(d3dgs)                                                                                     \
    ONE(dash)                                                                                      \
    ONE(deformable3dgs)                                                                            \
    ONE(ed3dgs)                                                                                    \
    ONE(ex4dgs)                                                                                    \
    ONE(freetimegs)                                                                                \
    ONE(freetimegspp)                                                                              \
    ONE(gaussianflow)                                                                              \
    ONE(gifstream)                                                                                 \
    ONE(gltf)                                                                                      \
    ONE(grid4d)                                                                                    \
    ONE(hybrid4dgs)                                                                                \
    ONE(ksplat) ONE(modecgs) ONE(omg4) ONE(ply) ONE(points) ONE(realtime4dgs) ONE(rotor4dgs)       \
        ONE(scgs) ONE(shapeofmotion) ONE(sog) ONE(sogst) ONE(spacetimegs) ONE(splat) ONE(splat4d)  \
            ONE(spz) ONE(stglite) ONE(tc3dgs) ONE(tsog) ONE(usd) ONE(views_4danyone)               \
                ONE(views_colmap) ONE(views_dynerf) ONE(views_easyvolcap) ONE(views_panoptic)      \
                    ONE(views_technicolor) ONE(views_transforms)

#define DECLARE(id) extern const struct spin_importer spin_importer_##id;
#define LIST(id) &spin_importer_##id,

ALL(DECLARE)

const struct spin_importer *const spin_importers[] = {ALL(LIST) NULL};
