/* Lines to a file, and what becomes of the file. */
#include "train/journal.h"

#include <errno.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"

spin_status spin_journal_open(struct spin_journal *journal, const char *path, bool append)
{
    journal->path = path;
    if (!path)
        return SPIN_OK;
    journal->file = fopen(path, append ? "a" : "w");
    if (!journal->file)
        return spin_fail(SPIN_E_IO, "cannot write the log '%s': %s", path, strerror(errno));
    return SPIN_OK;
}

void spin_journal_check(struct spin_journal *journal, bool flush)
{
    if (!ferror(journal->file) && (!flush || fflush(journal->file) == 0))
        return;
    snprintf(journal->error, sizeof journal->error, "%s", strerror(errno ? errno : EIO));
    spin_warn("cannot write the log '%s': %s; the work goes on without it", journal->path,
              journal->error);
    fclose(journal->file);
    journal->file = NULL;
}

void spin_journal_close(struct spin_journal *journal)
{
    if (journal->file)
        spin_journal_check(journal, true);
    if (journal->file && fclose(journal->file) != 0)
        snprintf(journal->error, sizeof journal->error, "%s", strerror(errno));
    journal->file = NULL;
}
