/* Text for people and for other programs: base64, escapes, sizes, durations. Functions that write
 * to a stream leave errors to ferror(). */
#pragma once

#include "spin.h"

/* open_memstream() whose fclose() fails if memory ran out. With glibc's open_memstream(), text
 * would be lost without an error. */
FILE *spin_text_open(char **text, size_t *n);

/* n bytes as base64, without line breaks. */
void spin_text_base64(FILE *to, const unsigned char *bytes, size_t n);
/* Escaped for HTML text and attribute values; control characters except line feeds are omitted. */
void spin_text_html(FILE *to, const char *text);
/* UTF-8 as a quoted JSON string. Control and invisible characters (see spin_text_tidy()) are
 * escaped; bytes that are not UTF-8 become U+FFFD. */
void spin_text_json(FILE *to, const char *text);
/* Sanitise text from files for a terminal, in place: every byte of a control character, of a
 * bidirectional control, of a zero-width character and of invalid UTF-8 becomes '?'. lines: keep
 * line feeds. */
void spin_text_tidy(char *text, bool lines);

bool spin_text_ends(const char *text, const char *with);
bool spin_text_ends_any_case(const char *text, const char *with);
/* Levenshtein distance between the first n_a bytes of a and all of b; 99 if one of them is longer
 * than 31 bytes. */
int spin_text_distance(const char *a, size_t n_a, const char *b);

/* With decimal units, as for disk sizes: "12.3 MB". Returns text. */
const char *spin_text_bytes(uint64_t bytes, char text[32]);
/* "2:36:12" or "4:05". Returns text. */
const char *spin_text_duration(double seconds, char text[32]);
/* An estimate: "a second", "40 seconds", "12 minutes", "2.6 hours", "3.1 days". Returns text. */
const char *spin_text_about(double seconds, char text[32]);
/* "1 frame", "2 frames", for nouns with a plural in s. Returns text. */
const char *spin_text_count(long long n, const char *noun, char text[48]);
/* "1 of 6 frames has", "2 of 6 frames have": verb_1 and verb are those of one and of several.
 * Returns text. */
const char *spin_text_share(size_t n, size_t of, const char *noun, const char *verb_1,
                            const char *verb, char text[96]);

/* Append a line, formatted as by printf without a newline, to the notes of an importer or a data
 * set. A line that is already there, or that exceeds the capacity, is dropped. */
#define spin_note(of, ...) spin_text_note((of)->notes, sizeof(of)->notes, __VA_ARGS__)
void spin_text_note(char *notes, size_t size, const char *fmt, ...) SPIN_PRINTF(3, 4);
