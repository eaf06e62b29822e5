/* Sends splats that one rank read or computed to rank 0, which writes them (io/ranks.h). */
#pragma once

#include "spin.h"

/* Copies these columns from *splats of rank `from` to *splats of rank 0. On other ranks the
 * function does nothing. */
spin_status spin_share_splats(struct spin_splats *splats, unsigned columns, int from);
