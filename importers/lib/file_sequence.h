/* Clips that consist of a folder with one file per frame, or of a single file. io/numbered.h reads
 * the frame numbers in the names. */
#pragma once

#include "importers/lib/model.h"

/* Option of importers of file sequences, see spin_file_sequence_sort(). */
#define SPIN_FILE_SEQUENCE_OPTION                                                                  \
    {                                                                                              \
        "pattern", "PATTERN",                                                                      \
            "file names, with one %d, %0Nd or #### for the frame number and * for other text",     \
            NULL                                                                                   \
    }

struct spin_file_frame {
    const char *path;
    const char *name; /* the file or folder whose name contains the frame number */
    int number;       /* frame number; -1: the name contains none */
    size_t n;         /* number of splats, which the caller sets */
};

/* The files of a clip. The caller zero-initialises the struct; the memory is freed with the model.
 */
struct spin_file_sequence {
    struct spin_file_frame *frame;
    size_t n_frames;
};

/* Whether the name ends with `suffix`, ignoring case. */
bool spin_file_has_suffix(const char *name, const char *suffix);
/* Returns the number of entries of the input folder whose names end with `suffix`, ignoring case;
 * hidden files, input.ply and environment.sog do not count. */
int spin_file_sequence_count(const struct spin_peek *peek, const char *suffix);
/* Returns the confidence of a probe that examines names only: 70 if the input is a file whose name
 * ends with `suffix`, or a folder that contains such a file, otherwise 0. */
int spin_file_named(const struct spin_peek *peek, const char *suffix);
bool spin_file_begins(const struct spin_peek *peek, const char *magic);
/* spin_file_sequence_reserve() empties the list and allocates memory for n files.
 * spin_file_sequence_add() appends a file, whose texts must live as long as the model. */
spin_status spin_file_sequence_reserve(struct spin_model *m, struct spin_file_sequence *seq,
                                       size_t n);
void spin_file_sequence_add(struct spin_file_sequence *seq, const char *path, const char *name);
/* Lists those files of a folder whose names end with `suffix`, in any order. An empty list is not
 * an error. */
spin_status spin_file_sequence_list(struct spin_model *m, const char *folder, const char *suffix,
                                    struct spin_file_sequence *seq);
/* If `path` is a file, lists this file, whatever its name. If it is a folder, lists those of its
 * files whose names end with `suffix`; it is an error if there are none. */
spin_status spin_file_sequence_find(struct spin_model *m, const char *path, const char *suffix,
                                    struct spin_file_sequence *seq);
/* For formats with a whole clip per file: sets *out to `path` if that is a file. If it is a folder,
 * sets *out to the only file in it whose name ends with `suffix`; it is an error if there is no
 * such file or more than one. */
spin_status spin_file_sequence_one(struct spin_model *m, const char *path, const char *suffix,
                                   const char **out);
/* Reads the frame numbers of the names, and sorts the frames by them, see spin_numbered_read(). If
 * option `pattern` is given, its text before the first slash selects the frames and their numbers.
 * If the names have no numbers, or the numbers have gaps, adds a note to `sequence`. folders:
 * true if the names are names of folders. */
spin_status spin_file_sequence_sort(struct spin_model *m, struct spin_file_sequence *seq,
                                    bool folders, struct spin_sequence_info *sequence);
