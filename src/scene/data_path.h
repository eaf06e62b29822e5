/* Finds the data set of a bundle, which may have been moved with it or without it. */
#pragma once

#include "scene/bundle.h"

/* Records the path of the data set, relative to the bundle's folder and absolute. Both folders must
 * exist. */
spin_status spin_bundle_set_data_path(struct spin_bundle_meta *meta, const char *folder,
                                      const char *data);
/* The absolute path of the data set, which may not exist; NULL if the bundle has none.
 * Allocated. */
spin_status spin_bundle_data_path(const struct spin_bundle *bundle, char **out);
