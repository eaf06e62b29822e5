/* Writes the records that .4dgs files consist of. Also defines the entries of the index of chunks,
 * which 4dgs_write.h writes. */
#pragma once

#include <stdio.h>

#include "io/file.h"

/* A chunk in the index. Offsets and sizes are in bytes. */
struct spin_4dgs_entry {
    double interval[2];
    uint64_t at, bytes;
    size_t n, n_live;   /* splats in the chunk (for a delta: changes), and in the state */
    uint64_t reference; /* offset of the chunk to whose state a delta is applied */
    uint64_t key;       /* offset of the last keyframe, which may be this chunk */
    unsigned depth;     /* number of deltas since the keyframe, including this one */
    int n_bands;
    struct {
        uint64_t at, bytes;
    } band[3];
};

struct spin_4dgs_coding;

struct spin_4dgs_writer {
    struct spin_out *out;
    const struct spin_4dgs_coding *coding;
    FILE *record; /* collects the content of the current record in `text` */
    char *text;
    size_t n_text;
    struct spin_4dgs_entry *entry; /* [n_entries] the index */
    size_t n_entries;
};

/* These functions append values to a record, in little-endian byte order. */
void spin_4dgs_put_number(FILE *to, uint64_t value, int bytes);
void spin_4dgs_put_double(FILE *to, double value);
void spin_4dgs_put_doubles(FILE *to, const double *value, int n);
/* Appends the length of a text, and the text. */
void spin_4dgs_put_text(FILE *to, const char *text);

/* Begins a record, whose content is written to w->record. */
spin_status spin_4dgs_begin_record(struct spin_4dgs_writer *w);
/* Ends the current record and writes it to the end of the file. */
spin_status spin_4dgs_end_record(struct spin_4dgs_writer *w, unsigned opcode);
