/* Text files as editors and programs of all systems write them: JSON, COLMAP, YAML, cfg_args. */
#pragma once

#include "spin.h"

/* The text of a file, terminated by NUL. Lines end with a line feed alone, without blanks before
 * it. */
struct spin_text_file {
    char *text;
    size_t n;
};
/* Read a text file in UTF-8. Skips a byte order mark, converts all line ends to line feeds, and
 * removes the blanks before them. UTF-16 and binary files are errors. */
spin_status spin_text_file_open(const char *path, struct spin_text_file *out);
void spin_text_file_close(struct spin_text_file *file);

/* Skip the byte order mark of a text in memory, called `what` in messages. UTF-16 is an error. */
spin_status spin_text_skip_mark(const char *what, const char **text, size_t *n);
