/* Text for other programs and for people: base64, escapes, sizes, durations. What is written to a
 * stream leaves its errors there, for ferror(). */
#pragma once

#include "spin.h"

/* open_memstream() whose fclose() fails when memory ran out. That of glibc drops what it has no
 * memory for, and neither ferror() nor fclose() tell. */
FILE *spin_text_open(char **text, size_t *n);

/* n bytes as base64, without line ends. */
void spin_text_base64(FILE *to, const unsigned char *bytes, size_t n);
/* As text or the value of an attribute of HTML; control characters but line feeds are left out. */
void spin_text_html(FILE *to, const char *text);
/* UTF-8 as a string of JSON, in its quotes. Control and invisible characters, as of
 * spin_text_tidy(), are escaped; bytes that are not UTF-8 become U+FFFD. */
void spin_text_json(FILE *to, const char *text);
/* For a terminal, as text from files may hold its commands or change how the rest is read: every
 * byte of a control character, of a control of writing direction, of a zero-width character and of
 * what is not UTF-8 becomes '?', in place. With `lines` line feeds stay. */
void spin_text_tidy(char *text, bool lines);

bool spin_text_ends(const char *text, const char *with);
bool spin_text_ends_any_case(const char *text, const char *with);
/* How many characters must be put in, taken out or changed between the first n_a of a and b; 99
 * where one is longer than 31. */
int spin_text_distance(const char *a, size_t n_a, const char *b);

/* Powers of 1000, as disks are sold: "12.3 MB". Returns text. */
const char *spin_text_bytes(uint64_t bytes, char text[32]);
/* "2:36:12" or "4:05". Returns text. */
const char *spin_text_duration(double seconds, char text[32]);
/* For an estimate: "a second", "40 seconds", "12 minutes", "2.6 hours", "3.1 days". Returns text.
 */
const char *spin_text_about(double seconds, char text[32]);
/* "1 frame", "2 frames": a noun with an s. Returns text. */
const char *spin_text_count(long long n, const char *noun, char text[48]);

/* A line of an importer's notes, or a data set's, as printf; no newline at the end of fmt. One that
 * does not fit, or is there already, is dropped. */
#define spin_note(of, ...) spin_text_note((of)->notes, sizeof(of)->notes, __VA_ARGS__)
void spin_text_note(char *notes, size_t size, const char *fmt, ...) SPIN_PRINTF(3, 4);
