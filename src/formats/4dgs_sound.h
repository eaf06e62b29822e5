/* Sounds in .4dgs files: records of sources, and records with their files. */
#pragma once

#include "formats/4dgs_streams.h"

struct spin_4dgs_source;

/* The sounds of a file so far. */
struct spin_4dgs_sounds {
    struct spin_4dgs_source *source; /* [n], allocated */
    size_t n;
    bool old;      /* there is a record of the older form, which is not read */
    bool declared; /* the header declares sound */
    bool late;     /* a record follows the first chunk */
    double start;  /* from the metadata of spin4d; 0: as the record says */
};

/* Read the content of records 11 and 12. A broken record is an error. */
spin_status spin_4dgs_sound_source(struct spin_4dgs_sounds *sounds, struct spin_4dgs_cursor *c,
                                   double duration);
spin_status spin_4dgs_sound_data(struct spin_4dgs_sounds *sounds, struct spin_4dgs_cursor *c);
/* Checks that each source has its data, and sets *sound to the first one without a place in the
 * scene, or else to the first one. Its data are in the memory of the records. Adds a line to
 * `notes` for each sound or property that is dropped. */
spin_status spin_4dgs_sounds_end(const struct spin_4dgs_sounds *sounds, struct spin_sound *sound,
                                 char *notes, size_t n_notes);
