/* Writes .4dgs files (the format is described in 4dgs.h) from splats whose values are already
 * quantised. */
#pragma once

#include <stdio.h>

#include "formats/4dgs_states.h"
#include "io/file.h"

/* Parameters of a file that are known before the first chunk. Values of splats are integers in
 * units of `step`; positions are relative to `origin`. */
struct spin_4dgs_coding {
    double duration; /* seconds */
    double fps;      /* frames per second */
    double cutoff;
    double origin[3], step[SPIN_4DGS_N_STEPS];
    double box[6]; /* minimum x y z, maximum x y z of the positions */
    int sh_degree;
    bool up;        /* true: y points up; false: unknown */
    bool antialias; /* true: the splats must be rendered with antialiasing */
    uint64_t n;     /* number of splats */
    /* Number of states from one keyframe to the next, for the temporal model keyframe-delta. 0: the
     * temporal model is gaussian-birth. */
    int key_every;
    double (*window)[2];
    size_t n_windows;
    const struct spin_sound *sound; /* WAV or Opus; NULL: none */
};

/* Sets coding->step and coding->origin for splats with positions inside coding->box and a typical
 * standard deviation of `scale`. All steps are twice the error bounds that the file declares. */
void spin_4dgs_choose_steps(struct spin_4dgs_coding *coding, double scale);

/* ---- Records --------------------------------------------------------------------------------- */

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

/* ---- Chunks ---------------------------------------------------------------------------------- */

/* The changes of a state relative to the previous state. */
struct spin_4dgs_changes {
    const struct spin_4dgs_splat *before,
        *after; /* [n_updates] the same splats before and after the change, sorted by id */
    const struct spin_4dgs_splat *born; /* [n_births] */
    const uint32_t *death;              /* [n_deaths] ids */
    size_t n_updates, n_births, n_deaths;
    size_t n_live; /* number of splats after the changes */
};

/* Writes all records before the first chunk. The caller sets the writer to zero first, and then
 * `out` and `coding`. */
spin_status spin_4dgs_write_begin(struct spin_4dgs_writer *w);
/* Writes a chunk of n splats that are only visible in the interval. If coding->key_every is above
 * 0, the chunk is a keyframe. */
spin_status spin_4dgs_write_chunk(struct spin_4dgs_writer *w, const double interval[2],
                                  const struct spin_4dgs_splat *splat, size_t n);
/* Writes a delta, which must follow a keyframe or another delta. Updates may change all attributes
 * except SH coefficients above degree 0, sigma, flags and window. */
spin_status spin_4dgs_write_delta(struct spin_4dgs_writer *w, const double interval[2],
                                  const struct spin_4dgs_changes *changes);
/* Writes the index and the footer, and replaces the header, since coding->n and coding->box may
 * have changed after spin_4dgs_write_begin(). */
spin_status spin_4dgs_write_end(struct spin_4dgs_writer *w);
void spin_4dgs_write_free(struct spin_4dgs_writer *w);
