/* Where the data set of a bundle is: bundles are moved with it and without. */
#pragma once

#include "scene/bundle.h"

/* Records the data set's folder for a bundle in `folder`, by its relative and its absolute path.
 * Both exist. */
spin_status spin_bundle_set_data_path(struct spin_bundle_meta *meta, const char *folder,
                                      const char *data);
/* The absolute path of the data set, which may be missing; NULL: the bundle names none. Allocated.
 */
spin_status spin_bundle_data_path(const struct spin_bundle *bundle, char **out);
