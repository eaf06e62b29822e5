/* Camera positions, from an option or from the cameras.json that descendants of 3DGS write. */
#pragma once

#include "spin.h"

enum { CAMERA_PLACES_MOST = 64 };

struct camera_places {
    int n;
    float place[CAMERA_PLACES_MOST][3]; /* [n] positions in world units */
};

/* Parses the value of --camera: "X,Y,Z", or several positions separated by ";". NULL yields no
 * positions. Errors are SPIN_E_USAGE. */
spin_status spin_camera_places_parse(const char *text, struct camera_places *out);

/* Reads the file `path`, a list of cameras, and stores their positions without duplicates, in the
 * order of the list. If there are more than CAMERA_PLACES_MOST, keeps CAMERA_PLACES_MOST of them,
 * evenly spaced in the list. An empty list, or an entry without a position, is an error; the
 * message names the file and the entry. */
spin_status spin_camera_places_load(const char *path, struct camera_places *out);
