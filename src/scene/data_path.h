/* Finds the data set of a bundle, even if the bundle was moved, alone or together with the data
 * set. */
#pragma once

#include "scene/bundle.h"

/* Stores two paths of the data set `data` in *meta: one relative to `folder`, the folder of the
 * bundle, and the absolute one. Data set and folder must exist. */
spin_status spin_bundle_set_data_path(struct spin_bundle_meta *meta, const char *folder,
                                      const char *data);
/* Sets *out to the absolute path of the data set, which need not exist, or to NULL if the bundle
 * has no data set. The caller frees *out. */
spin_status spin_bundle_data_path(const struct spin_bundle *bundle, char **out);
