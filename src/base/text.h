/* Text for people and for other programs: base64, escapes, sizes, durations. Functions that write
 * to a stream do not report errors: callers check the stream with ferror(). */
#pragma once

#include "spin.h"

/* A variant of open_memstream(), whose stream makes fclose() fail if memory ran out. With glibc's
 * open_memstream(), text would be lost without an error. */
FILE *spin_text_open(char **text, size_t *n);

/* Write n bytes as base64, without line breaks. */
void spin_text_base64(FILE *to, const unsigned char *bytes, size_t n);
/* Write a text, escaped for HTML text and attribute values. Control characters other than line
 * feeds are omitted. */
void spin_text_html(FILE *to, const char *text);
/* Write a text in UTF-8 as a JSON string, with its quotes. Control and invisible characters (see
 * spin_text_tidy()) are escaped; bytes that are not UTF-8 become U+FFFD. */
void spin_text_json(FILE *to, const char *text);
/* Change a text from a file, in place, so that it can safely be printed on a terminal: each byte
 * that belongs to a control character, a bidirectional control, a zero-width character or invalid
 * UTF-8 becomes '?'. lines: do not change line feeds. */
void spin_text_tidy(char *text, bool lines);

/* Make messages, warnings and notes show the path `shown` instead of `path`, until
 * spin_text_unalias(path). This is for temporary folders into which an archive is unpacked: the
 * user knows only the archive. Both functions are thread-safe. */
void spin_text_alias(const char *path, const char *shown);
void spin_text_unalias(const char *path);
/* In a text with a capacity of `size` bytes, replace every path that has an alias by the alias.
 * A text that would become too long is cut off. */
void spin_text_show_paths(char *text, size_t size);

bool spin_text_ends(const char *text, const char *with);
bool spin_text_ends_any_case(const char *text, const char *with);
/* Returns the Levenshtein distance between the first n_a bytes of `a` and the whole text `b`; 99 if
 * one of the two is longer than 31 bytes. */
int spin_text_distance(const char *a, size_t n_a, const char *b);

/* Format a number of bytes with decimal units, as for disk sizes: "12.3 MB". Returns `text`. */
const char *spin_text_bytes(uint64_t bytes, char text[32]);
/* Format a duration as "2:36:12" (hours, minutes and seconds) or "4:05" (minutes and seconds).
 * Returns `text`. */
const char *spin_text_duration(double seconds, char text[32]);
/* Format an estimated duration as "a second", "40 seconds", "12 minutes", "2.6 hours" or "3.1
 * days". Returns `text`. */
const char *spin_text_about(double seconds, char text[32]);
/* Format a number with its noun, as "1 frame" or "2 frames". The plural of the noun must end in s.
 * Returns `text`. */
const char *spin_text_count(long long n, const char *noun, char text[48]);
/* Format a share as "1 of 6 frames has" or "2 of 6 frames have". verb_1: the verb if n is 1
 * ("has"); verb: the verb for other n ("have"). Returns `text`. */
const char *spin_text_share(size_t n, size_t of, const char *noun, const char *verb_1,
                            const char *verb, char text[96]);

/* Append a line, formatted as by printf without a newline, to the notes of an importer or a data
 * set. The line is dropped if the notes already contain it, or have no space for it. */
#define spin_note(of, ...) spin_text_note((of)->notes, sizeof(of)->notes, __VA_ARGS__)
void spin_text_note(char *notes, size_t size, const char *fmt, ...) SPIN_PRINTF(3, 4);
