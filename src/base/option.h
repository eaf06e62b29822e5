/* Reads the values of plug-in options: words and numbers. For an invalid value, the functions
 * return SPIN_E_USAGE with the message "option 'KEY' is 'TEXT', expected ...". */
#pragma once

#include "spin.h"

/* Read an option whose value must be one of `words`, a list such as "source|size". *out receives
 * the index of the value in this list; 0 if the option was not given. */
spin_status spin_option_word(const struct spin_plugin_values *v, const char *key, const char *words,
                             int *out);
/* Read a number from `least` to `most`; *out is unchanged if the option was not given. */
spin_status spin_option_number(const struct spin_plugin_values *v, const char *key, double least,
                               double most, double *out);
/* Read an integer from `least` to `most`; *out is unchanged if the option was not given. */
spin_status spin_option_count(const struct spin_plugin_values *v, const char *key, int least,
                              int most, int *out);
