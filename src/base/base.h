/* Includes the headers that most sources in other folders need: basic ones of this folder, and
 * those of the C library for strings, numbers and memory. */
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
