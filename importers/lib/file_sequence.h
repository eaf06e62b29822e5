/* The files of a clip that has one for each frame, in one folder; or a single file. There is no
 * standard for these: frames go by the last number in the name. */
#pragma once

#include "importers/lib/model.h"

struct spin_file_frame {
    const char *path;
    int number; /* -1: none */
    size_t n;   /* splats; the caller's */
};

/* As long as the model; zero it to begin. */
struct spin_file_sequence {
    struct spin_file_frame *frame;
    size_t n_frames;
};

/* Whether the name ends so, in capitals or not. */
bool spin_file_has_suffix(const char *name, const char *suffix);
/* How many of the folder's names do, hidden ones left out. */
int spin_file_sequence_count(const struct spin_peek *peek, const char *suffix);
/* How sure these names make that a file, or the folder of some, is of the format. */
int spin_file_named(const struct spin_peek *peek, const char *suffix);
bool spin_file_begins(const struct spin_peek *peek, const char *magic);
/* Room for n files; and one more, whose path is the model's. */
spin_status spin_file_sequence_reserve(struct spin_model *m, struct spin_file_sequence *seq,
                                       size_t n);
spin_status spin_file_sequence_add(struct spin_file_sequence *seq, const char *path,
                                   long long number);
/* The files of a folder whose names end so, in any order; none is no error. */
spin_status spin_file_sequence_list(struct spin_model *m, const char *folder, const char *suffix,
                                    struct spin_file_sequence *seq);
/* Those, of which there must be one; or the file `path`, whatever its name. */
spin_status spin_file_sequence_find(struct spin_model *m, const char *path, const char *suffix,
                                    struct spin_file_sequence *seq);
/* Of formats that hold a clip in a file: that file, or the only one of its kind in the folder
 * `path`. */
spin_status spin_file_sequence_one(struct spin_model *m, const char *path, const char *suffix,
                                   const char **out);
/* Numeric order; "frame_10" comes after "frame_9". Without any numbers the order of the names.
 * Notes missing numbers. */
spin_status spin_file_sequence_sort(struct spin_file_sequence *seq,
                                    struct spin_sequence_info *sequence);
