/* The importers, alphabetical. A new one is a file here and a line below. */
#include "spin.h"

extern const struct spin_importer spin_importer_d3dgs;
extern const struct spin_importer spin_importer_ply;
extern const struct spin_importer spin_importer_views_panoptic;

const struct spin_importer *const spin_importers[] = {
    &spin_importer_d3dgs,
    &spin_importer_ply,
    &spin_importer_views_panoptic,
    NULL,
};
