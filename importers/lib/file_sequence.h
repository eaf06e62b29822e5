/* Clips of one file per frame in a folder, or of a single file. There is no standard for the names
 * of such files: the last number in a name is used as the frame number. */
#pragma once

#include "importers/lib/model.h"

struct spin_file_frame {
    const char *path;
    int number; /* -1: none */
    size_t n;   /* number of splats; set by the caller */
};

/* Freed with the model; zero-initialise it. */
struct spin_file_sequence {
    struct spin_file_frame *frame;
    size_t n_frames;
};

/* Whether the name ends with `suffix`, ignoring case. */
bool spin_file_has_suffix(const char *name, const char *suffix);
/* Number of names in a folder that end with `suffix`, without hidden files and input.ply. */
int spin_file_sequence_count(const struct spin_peek *peek, const char *suffix);
/* The confidence of a probe by name: 70 for a file with this suffix, or a folder that contains such
 * files; else 0. */
int spin_file_named(const struct spin_peek *peek, const char *suffix);
bool spin_file_begins(const struct spin_peek *peek, const char *magic);
/* Reserves space for n files; spin_file_sequence_add() adds one, whose path must live as long as
 * the model. */
spin_status spin_file_sequence_reserve(struct spin_model *m, struct spin_file_sequence *seq,
                                       size_t n);
spin_status spin_file_sequence_add(struct spin_file_sequence *seq, const char *path,
                                   long long number);
/* Lists the files of a folder with this suffix, in any order; an empty list is not an error. */
spin_status spin_file_sequence_list(struct spin_model *m, const char *folder, const char *suffix,
                                    struct spin_file_sequence *seq);
/* Lists the file `path`, whatever its name, or the files of the folder `path` with this suffix,
 * where an empty list is an error. */
spin_status spin_file_sequence_find(struct spin_model *m, const char *path, const char *suffix,
                                    struct spin_file_sequence *seq);
/* For formats with a whole clip per file: sets *out to the file `path`, or to the only file with
 * this suffix in the folder `path`. */
spin_status spin_file_sequence_one(struct spin_model *m, const char *path, const char *suffix,
                                   const char **out);
/* Sorts by frame number ("frame_10" comes after "frame_9"), or by name if no file has one, and
 * notes missing numbers. Refuses duplicate numbers, and a mixture of names with and without
 * numbers. */
spin_status spin_file_sequence_sort(struct spin_file_sequence *seq,
                                    struct spin_sequence_info *sequence);
