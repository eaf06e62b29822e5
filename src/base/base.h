/* What most sources above this room need: the C library's texts, numbers and memory, and the
 * headers of this room. */
#pragma once

#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/number.h"
#include "base/option.h"
#include "base/pool.h"
#include "base/text.h"
