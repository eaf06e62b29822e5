/* Notes of an importer. */
#include "importers/lib/notes.h"

#include <stdarg.h>
#include <string.h>

void spin_note(struct spin_sequence_info *sequence, const char *fmt, ...)
{
    size_t used = strlen(sequence->notes), room = sizeof sequence->notes - used;
    va_list args;
    int n;

    va_start(args, fmt);
    n = vsnprintf(sequence->notes + used, room, fmt, args);
    va_end(args);
    if (n < 0 || (size_t)n + 1 >= room)
        sequence->notes[used] = '\0';
    else
        memcpy(sequence->notes + used + n, "\n", 2);
}
