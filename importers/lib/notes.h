/* Notes of an importer: what it assumed, or what is lost. spin-import prints them, one a line. */
#ifndef SPIN_IMPORTERS_LIB_NOTES_H
#define SPIN_IMPORTERS_LIB_NOTES_H

#include "spin.h"

/* Adds one line, as printf; no newline at the end of fmt. A line that does not fit is dropped. */
void spin_note(struct spin_sequence_info *sequence, const char *fmt, ...) SPIN_PRINTF(2, 3);

#endif
