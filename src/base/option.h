/* Values of plug-ins' options: words and numbers. A value that makes no sense is SPIN_E_USAGE:
 * "option 'key' is 'text', expected ...". */
#pragma once

#include "spin.h"

/* The place of the value in words, "source|size"; 0 when it is not given. */
spin_status spin_option_word(const struct spin_plugin_values *v, const char *key, const char *words,
                             int *out);
/* A number from least to most; *out stays when it is not given. */
spin_status spin_option_number(const struct spin_plugin_values *v, const char *key, double least,
                               double most, double *out);
/* A whole one. */
spin_status spin_option_count(const struct spin_plugin_values *v, const char *key, int least,
                              int most, int *out);
