#include "formats/4dgs_records.h"

#include <stdlib.h>
#include <string.h>

#include "base/text.h"

void spin_4dgs_put_number(FILE *to, uint64_t value, int bytes)
{
    for (int b = 0; b < bytes; b++)
        fputc((int)(value >> (8 * b) & 255), to);
}

void spin_4dgs_put_double(FILE *to, double value)
{
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    spin_4dgs_put_number(to, bits, 8);
}

void spin_4dgs_put_doubles(FILE *to, const double *value, int n)
{
    for (int k = 0; k < n; k++)
        spin_4dgs_put_double(to, value[k]);
}

void spin_4dgs_put_text(FILE *to, const char *text)
{
    spin_4dgs_put_number(to, strlen(text), 4);
    fputs(text, to);
}

spin_status spin_4dgs_begin_record(struct spin_4dgs_writer *w)
{
    w->record = spin_text_open(&w->text, &w->n_text);
    return w->record ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "no memory for a record");
}

spin_status spin_4dgs_end_record(struct spin_4dgs_writer *w, unsigned opcode)
{
    unsigned char head[9] = {(unsigned char)opcode};
    bool failed = fclose(w->record) != 0;
    spin_status status = SPIN_OK;

    w->record = NULL;
    if (failed)
        status = spin_fail(SPIN_E_MEMORY, "no memory for a record");
    for (int b = 0; b < 8; b++)
        head[1 + b] = (unsigned char)((uint64_t)w->n_text >> (8 * b));
    if (status == SPIN_OK)
        status = spin_out_write(w->out, head, sizeof head);
    if (status == SPIN_OK)
        status = spin_out_write(w->out, w->text, w->n_text);
    free(w->text);
    w->text = NULL;
    return status;
}
