/* The exporters, one per line, alphabetical. */
#include "spin.h"

extern const struct spin_exporter spin_exporter_images;
extern const struct spin_exporter spin_exporter_ply;

const struct spin_exporter *const spin_exporters[] = {
    &spin_exporter_images,
    &spin_exporter_ply,
    NULL,
};
