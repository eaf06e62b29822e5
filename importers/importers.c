/* The importers, alphabetical. A new one is a file here and a line below. */
#include "spin.h"

extern const struct spin_importer spin_importer_3dgstream;
extern const struct spin_importer spin_importer_4dgaussian;
extern const struct spin_importer spin_importer_d3dgs;
extern const struct spin_importer spin_importer_dash;
extern const struct spin_importer spin_importer_deformable3dgs;
extern const struct spin_importer spin_importer_ed3dgs;
extern const struct spin_importer spin_importer_ex4dgs;
extern const struct spin_importer spin_importer_gltf;
extern const struct spin_importer spin_importer_grid4d;
extern const struct spin_importer spin_importer_hybrid4dgs;
extern const struct spin_importer spin_importer_ksplat;
extern const struct spin_importer spin_importer_modecgs;
extern const struct spin_importer spin_importer_omg4;
extern const struct spin_importer spin_importer_ply;
extern const struct spin_importer spin_importer_realtime4dgs;
extern const struct spin_importer spin_importer_rotor4dgs;
extern const struct spin_importer spin_importer_sog;
extern const struct spin_importer spin_importer_spacetimegs;
extern const struct spin_importer spin_importer_splat;
extern const struct spin_importer spin_importer_spz;
extern const struct spin_importer spin_importer_tc3dgs;
extern const struct spin_importer spin_importer_views_colmap;
extern const struct spin_importer spin_importer_views_dynerf;
extern const struct spin_importer spin_importer_views_panoptic;
extern const struct spin_importer spin_importer_views_transforms;

const struct spin_importer *const spin_importers[] = {
    &spin_importer_3dgstream,
    &spin_importer_4dgaussian,
    &spin_importer_d3dgs,
    &spin_importer_dash,
    &spin_importer_deformable3dgs,
    &spin_importer_ed3dgs,
    &spin_importer_ex4dgs,
    &spin_importer_gltf,
    &spin_importer_grid4d,
    &spin_importer_hybrid4dgs,
    &spin_importer_ksplat,
    &spin_importer_modecgs,
    &spin_importer_omg4,
    &spin_importer_ply,
    &spin_importer_realtime4dgs,
    &spin_importer_rotor4dgs,
    &spin_importer_sog,
    &spin_importer_spacetimegs,
    &spin_importer_splat,
    &spin_importer_spz,
    &spin_importer_tc3dgs,
    &spin_importer_views_colmap,
    &spin_importer_views_dynerf,
    &spin_importer_views_panoptic,
    &spin_importer_views_transforms,
    NULL,
};
