/* The log of a training (--log): a JSON object a line. */
#ifndef SPIN_TRAIN_JOURNAL_H
#define SPIN_TRAIN_JOURNAL_H

#include <stdio.h>

#include "spin.h"

struct spin_journal {
    const char *path;
    FILE *file;     /* NULL: none is written, or no longer */
    char error[96]; /* why no longer */
};

/* path NULL: none is written. */
spin_status spin_journal_open(struct spin_journal *journal, const char *path, bool append);
/* After a line, and with flush at once. A journal that cannot be written ends here, with a warning: the
 * training goes on. */
void spin_journal_check(struct spin_journal *journal, bool flush);
/* Journal->error says what was not written; empty: all was. */
void spin_journal_close(struct spin_journal *journal);

#endif
