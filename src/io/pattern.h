/* File names with a number in them, such as "frame_%04d.ply" or "frame_####.ply": parsing, printing
 * and matching. */
#pragma once

#include "spin.h"

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
