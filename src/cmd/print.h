/* Sizes, durations and JSON on stdout. */
#ifndef SPIN_CMD_PRINT_H
#define SPIN_CMD_PRINT_H

#include <stdbool.h>

/* "12.3 MB" into text. */
const char *spin_print_bytes(double bytes, char text[32]);
/* A path without control characters, into text. */
const char *spin_print_path(const char *path, char text[4096]);
/* "2940", or "2940.5" when it is not whole, into text. */
const char *spin_print_mean(double mean, char text[32]);
/* "1 frame", "2 frames" into text. */
const char *spin_print_count(long long n, const char *noun, char text[48]);
/* "2 h 36 min" into text. */
const char *spin_print_seconds(double seconds, char text[32]);

/* One JSON document to stdout, printed when its outermost bracket is closed. key NULL inside arrays and at
 * the top. Numbers round trip; NaN and infinities become null. At most 8 brackets are open. */
void spin_print_open(const char *key, char bracket);        /* '{' or '[' */
void spin_print_close(char bracket);                        /* '}' or ']' */
void spin_print_string(const char *key, const char *value); /* NULL: null */
void spin_print_number(const char *key, double value);
void spin_print_integer(const char *key, long long value);
void spin_print_bool(const char *key, bool value);
void spin_print_null(const char *key);

#endif
