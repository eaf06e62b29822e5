/* Reads the sounds of .4dgs files. An audio source record describes a sound, and an audio data
 * record contains its sound file. */
#pragma once

#include "formats/4dgs_streams.h"

struct spin_4dgs_source;

/* The sounds of a file that have been read so far. */
struct spin_4dgs_sounds {
    struct spin_4dgs_source *source; /* [n], allocated */
    size_t n;
    bool old;      /* true: there is a record 09, the older form of sound, which is not read */
    bool declared; /* true: the header declares that the file contains sound */
    bool late;     /* true: a sound record follows the first chunk */
    double start;  /* start in seconds, below 0, from the metadata; 0: the record has the start */
};

/* These functions read the content of records 11 and 12. A malformed record is an error. duration:
 * length of the clip in seconds. */
spin_status spin_4dgs_sound_source(struct spin_4dgs_sounds *sounds, struct spin_4dgs_cursor *c,
                                   double duration);
spin_status spin_4dgs_sound_data(struct spin_4dgs_sounds *sounds, struct spin_4dgs_cursor *c);
/* Checks that each source has its data, and sets *sound to the first sound that has no position in
 * the scene or, if all have one, to the first sound. *sound points into the memory of the records.
 * Adds a line to `notes` for each sound or property that is dropped. */
spin_status spin_4dgs_sounds_end(const struct spin_4dgs_sounds *sounds, struct spin_sound *sound,
                                 char *notes, size_t n_notes);
