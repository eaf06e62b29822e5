/* Frame numbers in the names of files and folders: splats, images and videos.
 *
 * There is no standard for such names, so all names of a sequence are compared. The frame number is
 * the number that increases from name to name. Numbers that are equal in all names ("_v2",
 * "_30fps"), hashes, and numbers whose words say otherwise ("psnr_28.1", "12034pts") are not frame
 * numbers. A decimal number and a time stamp ("2026-09-11_12-00-05.250") are one number each. If
 * two numbers count and the names do not say which of them is the frame number, the names are
 * refused. */
#pragma once

#include "spin.h"

struct spin_numbering {
    const char *const *name; /* [n] names, without folders */
    size_t n;
    const int *group;    /* [n] names of one group are a sequence, e.g. of one camera; NULL: all */
    const char *pattern; /* a pattern for spin_pattern_parse() that the frames match; NULL: none */
    bool folders;        /* the names are those of folders, in which a dot begins no extension */
};

struct spin_numbers {
    /* [n] the frame number of each name; -1: the names have no numbers, or their numbers are
     * decimal, negative or above INT_MAX, and have an order only; also -1 for names that do not
     * match the pattern. */
    int *number;
    size_t *order;   /* [n_frames] indices of the names that are frames, in the order of frames */
    size_t n_frames; /* n, or the number of names that match the pattern */
    bool numbered;   /* the names have numbers, be it in `number` or only in `order` */
};

/* Reads the frame numbers of n names. Fails with SPIN_E_MALFORMED if two names of a group have the
 * same number, if a name lacks a number that the others have, or if two readings are possible; the
 * message names both readings as patterns. Names without numbers are sorted by
 * spin_compare_names(). *out is allocated. */
spin_status spin_numbered_read(const struct spin_numbering *names, struct spin_numbers *out);
void spin_numbers_free(struct spin_numbers *numbers);

/* Whether a name has a digit before its extension. */
bool spin_name_has_number(const char *name);

/* Compares names such that "cam2" precedes "cam10". */
int spin_compare_names(const char *a, const char *b);

/* Returns the camera number in the last component of a path, or else in the components before it:
 * the number after the word "cam" or "camera", such as 7 in "cam07_0001.png", "left-Cam_7" and
 * "camera 7/0001.png". The word must stand alone: "webcam1" and "camping_1" have none. Returns -1
 * if there is none. */
int spin_camera_number(const char *path);
