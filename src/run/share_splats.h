/* Sends splats that one rank read or computed to rank 0, which writes them (io/ranks.h). */
#pragma once

#include "spin.h"

/* Rank 0 receives these columns into *splats from *splats of rank `from`; other ranks do nothing.
 */
spin_status spin_share_splats(struct spin_splats *splats, unsigned columns, int from);
