/* Frame numbers in the names of files and folders: splats, images and videos.
 *
 * There is no standard for such names, so all names of a sequence are compared. The frame number is
 * the number that differs from name to name. Numbers that are equal in all names ("_v2", "_30fps"),
 * hashes, and numbers that a word marks as something else ("psnr_28.1", "12034pts") are not frame
 * numbers. A decimal number is one number, and so is a time stamp ("2026-09-11_12-00-05.250"). If
 * two numbers could be the frame number, and no word such as "frame" decides, the names are
 * refused. */
#pragma once

#include "spin.h"

struct spin_numbering {
    const char *const *name; /* [n] names, without folders */
    size_t n;
    /* [n] Names with equal values form a sequence, e.g. of one camera; NULL: all names do. */
    const int *group;
    /* Only names that match this pattern (spin_pattern_match()) are frames; NULL: all names are. */
    const char *pattern;
    bool folders; /* the names are names of folders, where a dot does not begin an extension */
};

struct spin_numbers {
    /* [n] the frame number of each name. -1 for names that do not match the pattern; -1 for all
     * names if they contain no numbers, or if some number is decimal, negative or above INT_MAX, so
     * that the numbers only define the order. */
    int *number;
    size_t *order;   /* [n_frames] indices of the names that are frames, in the order of frames */
    size_t n_frames; /* n, or the number of names that match the pattern */
    bool numbered;   /* frame numbers were found, even if they only define the order */
};

/* Finds the frame numbers of n names. Fails with SPIN_E_MALFORMED if two names of a group have the
 * same number, if a name lacks a number that other names have, or if two numbers could be the frame
 * number; the message then shows a pattern for each of these two. Names without numbers are sorted
 * by spin_compare_names(). *out is allocated. */
spin_status spin_numbered_read(const struct spin_numbering *names, struct spin_numbers *out);
void spin_numbers_free(struct spin_numbers *numbers);

/* Whether a name has a digit before its extension. */
bool spin_name_has_number(const char *name);

/* Compares names such that "cam2" precedes "cam10". */
int spin_compare_names(const char *a, const char *b);

/* Returns the camera number in a path: the number after the word "cam" or "camera", such as 7 in
 * "cam07_0001.png", "left-Cam_7" and "camera 7/0001.png". The last component that contains such a
 * number counts. In "webcam1" and "camping_1", the letters "cam" are part of another word and do
 * not count. Returns -1 if no component has a camera number. */
int spin_camera_number(const char *path);

/* ---- Patterns -------------------------------------------------------------------------------- */

/* File names with a number in them, such as "frame_%04d.ply" or "frame_####.ply": parsing, printing
 * and matching. */

/* A file name with a number in it, split into its parts. */
struct spin_pattern {
    const char *text;
    int n_before; /* number of bytes before the number */
    bool zeros;   /* pad the number with zeros to `width` digits */
    int width;
    const char *after; /* text after the number */
};
/* Parse `text`, a file name that must contain exactly one %d, %0Nd with N from 1 to 9, or a run of
 * 1 to 9 '#', which equals %0Nd; otherwise returns SPIN_E_USAGE, with a message about the option
 * --pattern. *out points into `text`. */
spin_status spin_pattern_parse(const char *text, struct spin_pattern *out);
/* *out receives "folder/name", where the name contains the number; allocated. */
spin_status spin_pattern_path(const struct spin_pattern *pattern, const char *folder, int number,
                              char **out);
/* Whether a name matches the pattern. The number may be negative; '*' before or after the number
 * matches any characters, and upper and lower case are not distinguished. *digits receives the
 * position of the number in the name. */
bool spin_pattern_match(const struct spin_pattern *pattern, const char *name, const char **digits);
/* Split a path such as "run/frame_%d/a.ply" before the first component with a number field: *folder
 * receives the part before it ("run", or "."), allocated, and *rest the remainder, which points
 * into `path`. If no component has a field, or if a file of this name exists, *rest is NULL. */
spin_status spin_pattern_split(const char *path, char **folder, const char **rest);
