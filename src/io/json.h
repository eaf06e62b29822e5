/* JSON, read and written. Jansson does the work: strict, small, depth-limited, in every Debian.
 * Values are borrowed from the document and die with it. */
#ifndef SPIN_IO_JSON_H
#define SPIN_IO_JSON_H

#include "spin.h"

struct json_t;
typedef struct json_t spin_json;

/* Parse a whole file or text; `what` names it in messages. NaN and infinities are refused. */
spin_status spin_json_load(const char *path, spin_json **out);
spin_status spin_json_parse(const char *what, const char *text, size_t n, spin_json **out);
void spin_json_free(spin_json *json);

/* NULL when absent or of another kind. */
const spin_json *spin_json_get(const spin_json *object, const char *key);
size_t spin_json_length(const spin_json *array); /* 0 when not an array */
bool spin_json_is_array(const spin_json *j);
bool spin_json_is_object(const spin_json *j);
bool spin_json_is_null(const spin_json *j);
const spin_json *spin_json_at(const spin_json *array, size_t index);
bool spin_json_number(const spin_json *j, double *out);
bool spin_json_integer(const spin_json *j, int64_t *out);
bool spin_json_bool(const spin_json *j, bool *out);
const char *spin_json_string(const spin_json *j); /* NULL when not a string */

/* Building. New values are owned by the container they are put into. */
spin_json *spin_json_object(void);
spin_json *spin_json_array(void);
spin_json *spin_json_text_value(const char *v); /* NULL: null; bytes that are not UTF-8: U+FFFD */
spin_json *spin_json_number_value(double v);    /* not finite: null */
spin_json *spin_json_integer_value(int64_t v);
spin_json *spin_json_bool_value(bool v);
void spin_json_set(spin_json *object, const char *key, spin_json *value); /* takes value */
void spin_json_push(spin_json *array, spin_json *value);
void spin_json_set_string(spin_json *object, const char *key, const char *value);
void spin_json_set_number(spin_json *object, const char *key, double value);
void spin_json_set_integer(spin_json *object, const char *key, int64_t value);
void spin_json_set_bool(spin_json *object, const char *key, bool value);
void spin_json_set_null(spin_json *object, const char *key);
/* Every key that begins with `from` begins with `to` instead; values stay. */
void spin_json_rename(spin_json *object, const char *from, const char *to);
/* The values of `from`, which it keeps, become values of `to` as well. */
void spin_json_share(spin_json *to, const spin_json *from);
void spin_json_push_number(spin_json *array, double value);
void spin_json_push_string(spin_json *array, const char *value);

/* The text, allocated; keys in the order they were set; numbers read back to the same double. */
char *spin_json_text(const spin_json *j, bool indent);
/* The same to a stream, every value on a line of its own, and the end of a line: what commands print. */
void spin_json_print(FILE *to, const spin_json *j);

#endif
