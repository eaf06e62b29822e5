/* Camera positions, from an option or from the cameras.json that descendants of 3DGS write. */
#pragma once

#include "spin.h"

enum { CAMERA_PLACES_MOST = 64 };

struct camera_places {
    int n;
    float place[CAMERA_PLACES_MOST][3]; /* world units */
};

/* Parses the value of --camera, "X,Y,Z" or several separated by ";"; NULL: none. SPIN_E_USAGE. */
spin_status spin_camera_places_parse(const char *text, struct camera_places *out);

/* Reads the distinct "position" values of the list `path`, in order; of more than
 * CAMERA_PLACES_MOST, that many evenly spaced. At least one; SPIN_E_MALFORMED names the file and
 * the entry. */
spin_status spin_camera_places_load(const char *path, struct camera_places *out);
