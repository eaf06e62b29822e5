/* JSON by Jansson, which is strict and small, limits the nesting depth, and is packaged by every
 * Debian release. This header adds functions that Jansson lacks, and gives the functions of Jansson
 * that spin4d uses names with the prefix spin_json_. Values that are looked up are borrowed from
 * the document. */
#pragma once

#include <jansson.h>

#include "spin.h"

typedef json_t spin_json;

/* Parse a whole file, or a text of n bytes that messages call `what`. NaN and infinities are
 * refused. */
spin_status spin_json_load(const char *path, spin_json **out);
spin_status spin_json_parse(const char *what, const char *text, size_t n, spin_json **out);

/* Read a number, an integer or a bool. These functions return false if j is NULL or of another
 * type. A number without a fraction, such as 3.0, counts as an integer. */
bool spin_json_number(const spin_json *j, double *out);
bool spin_json_integer(const spin_json *j, int64_t *out);
bool spin_json_bool(const spin_json *j, bool *out);

/* Make a JSON value from a text. NULL becomes null; bytes that are not valid UTF-8 become U+FFFD.
 */
spin_json *spin_json_text_value(const char *v);
/* Make a JSON value from a number, or an array from n numbers. NaN and infinities become null. */
spin_json *spin_json_number_value(double v);
spin_json *spin_json_numbers(const double *v, size_t n);

/* In all keys of the object that begin with `from`, replace this prefix by `to`. */
void spin_json_rename(spin_json *object, const char *from, const char *to);

/* Format as text, allocated. Members appear in the order in which they were set; numbers are
 * printed such that reading them gives the same double. indent: print each member on its own line,
 * indented, but an array of plain values on one line. Returns NULL if memory ran out, either now or
 * when this thread created one of the values. */
char *spin_json_text(const spin_json *j, bool indent);

/* Sets *text to the document as indented text, which the caller frees. Frees the document, also
 * after a failure. */
spin_status spin_json_finish(spin_json *document, char **text);

/* Look up a member or item, or read a value or its type. These functions return NULL, 0 or false if
 * the value is absent or of another type. */
#define spin_json_get json_object_get
#define spin_json_at json_array_get
#define spin_json_length json_array_size
#define spin_json_string json_string_value
#define spin_json_is_array json_is_array
#define spin_json_is_object json_is_object
#define spin_json_is_null json_is_null

/* Functions that set or push a value pass its ownership to the container. */
#define spin_json_object json_object
#define spin_json_array json_array
#define spin_json_free json_decref
void spin_json_freed(spin_json **j); /* frees *j, for SPIN_LEAVES() */
#define spin_json_integer_value json_integer
#define spin_json_set json_object_set_new
#define spin_json_push json_array_append_new
#define spin_json_set_string(object, key, v)                                                       \
    json_object_set_new(object, key, spin_json_text_value(v))
#define spin_json_set_number(object, key, v)                                                       \
    json_object_set_new(object, key, spin_json_number_value(v))
#define spin_json_set_integer(object, key, v) json_object_set_new(object, key, json_integer(v))
#define spin_json_set_bool(object, key, v) json_object_set_new(object, key, json_boolean(v))
#define spin_json_set_null(object, key) json_object_set_new(object, key, json_null())
#define spin_json_push_number(array, v) json_array_append_new(array, spin_json_number_value(v))
#define spin_json_push_string(array, v) json_array_append_new(array, spin_json_text_value(v))
/* Add the members of `from` to `to`; both objects then share the values. */
#define spin_json_share(to, from) json_object_update(to, (json_t *)(uintptr_t)(from))
