/* Values of plug-in options: words and numbers. An invalid value is SPIN_E_USAGE: "option 'key' is
 * 'text', expected ...". */
#pragma once

#include "spin.h"

/* Index of the option's value in words, such as "source|size"; 0 if the option was not given. */
spin_status spin_option_word(const struct spin_plugin_values *v, const char *key, const char *words,
                             int *out);
/* A number from least to most; *out is unchanged if the option was not given. */
spin_status spin_option_number(const struct spin_plugin_values *v, const char *key, double least,
                               double most, double *out);
/* An integer from least to most; *out is unchanged if the option was not given. */
spin_status spin_option_count(const struct spin_plugin_values *v, const char *key, int least,
                              int most, int *out);
