/* Camera positions, from an option or from the cameras.json that descendants of 3DGS write. */
#pragma once

#include "spin.h"

enum { CAMERA_PLACES_MOST = 64 };

struct camera_places {
    int n;
    float place[CAMERA_PLACES_MOST][3]; /* world units */
};

/* Parses the value of --camera: "X,Y,Z", or several positions separated by ";". NULL yields no
 * positions. Errors are SPIN_E_USAGE. */
spin_status spin_camera_places_parse(const char *text, struct camera_places *out);

/* Reads the distinct "position" values of the list in the file `path`, in order. If there are more
 * than CAMERA_PLACES_MOST, evenly spaced ones are chosen. A list without positions is an error;
 * SPIN_E_MALFORMED names the file and the entry. */
spin_status spin_camera_places_load(const char *path, struct camera_places *out);
