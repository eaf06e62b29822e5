/* Splats that one process has read or computed and another writes (io/ranks.h). */
#pragma once

#include "spin.h"

/* Rank 0 gets in *splats these columns of what rank `from` has there; other ranks do nothing. */
spin_status spin_share_splats(struct spin_splats *splats, unsigned columns, int from);
