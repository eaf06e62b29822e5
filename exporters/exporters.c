/* The exporters, one per line, alphabetical. */
#include "spin.h"

extern const struct spin_exporter spin_exporter_compressed_ply;
extern const struct spin_exporter spin_exporter_ftgs;
extern const struct spin_exporter spin_exporter_gltf;
extern const struct spin_exporter spin_exporter_html;
extern const struct spin_exporter spin_exporter_images;
extern const struct spin_exporter spin_exporter_ply;
extern const struct spin_exporter spin_exporter_sog;
extern const struct spin_exporter spin_exporter_sogst;
extern const struct spin_exporter spin_exporter_sogst_ply;
extern const struct spin_exporter spin_exporter_splat;
extern const struct spin_exporter spin_exporter_spz;
extern const struct spin_exporter spin_exporter_tsog;
extern const struct spin_exporter spin_exporter_usd;
extern const struct spin_exporter spin_exporter_video;

const struct spin_exporter *const spin_exporters[] = {
    &spin_exporter_compressed_ply,
    &spin_exporter_ftgs,
    &spin_exporter_gltf,
    &spin_exporter_html,
    &spin_exporter_images,
    &spin_exporter_ply,
    &spin_exporter_sog,
    &spin_exporter_sogst,
    &spin_exporter_sogst_ply,
    &spin_exporter_splat,
    &spin_exporter_spz,
    &spin_exporter_tsog,
    &spin_exporter_usd,
    &spin_exporter_video,
    NULL,
};
