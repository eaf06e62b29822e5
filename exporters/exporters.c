/* The list of exporters, in alphabetical order. */
#include "spin.h"

#define ALL(ONE)                                                                                   \
    ONE(4dgs)                                                                                      \
    ONE(compressed_ply)                                                                            \
    ONE(ftgs)                                                                                      \
    ONE(gltf)                                                                                      \
    ONE(html)                                                                                      \
    ONE(images) ONE(ply) ONE(sog) ONE(sogst) ONE(sogst_ply) ONE(splat) ONE(spz) ONE(stglite)       \
        ONE(streamed_sog) ONE(tsog) ONE(usd) ONE(video)

#define DECLARE(id) extern const struct spin_exporter spin_exporter_##id;
#define LIST(id) &spin_exporter_##id,

ALL(DECLARE)

const struct spin_exporter *const spin_exporters[] = {ALL(LIST) NULL};
