/* Where cameras stand: as the user says it, or from the cameras.json that descendants of 3DGS
 * write. */
#pragma once

#include "spin.h"

enum { CAMERA_PLACES_MOST = 64 };

struct camera_places {
    int n;
    float place[CAMERA_PLACES_MOST][3]; /* world units */
};

/* "X,Y,Z" or several with ";" between, the value of --camera; NULL: none. SPIN_E_USAGE. */
spin_status spin_camera_places_parse(const char *text, struct camera_places *out);

/* The different "position"s in the list `path`, in its order; of more than CAMERA_PLACES_MOST that
 * many, evenly spread. At least one; SPIN_E_MALFORMED names the file and the entry. */
spin_status spin_camera_places_load(const char *path, struct camera_places *out);
