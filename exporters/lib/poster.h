/* The poster of a page: a PNG file with the first view of the clip. */
#pragma once

#include "exporters/lib/initial_view.h"

/* The size in pixels that previews of links expect. */
enum { SPIN_POSTER_WIDTH = 1200, SPIN_POSTER_HEIGHT = 630 };

/* Renders the splats from `view` and writes the image to `out`, which must be open. Like the page,
 * the image shows at least the field of view of `view`, both horizontally and vertically. */
spin_status spin_poster_write(const struct spin_export_job *job,
                              const struct spin_initial_view *view,
                              const struct spin_splats *splats, struct spin_out *out);
