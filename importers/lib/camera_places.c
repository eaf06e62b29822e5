/* Camera positions from an option and from cameras.json. */
#include "importers/lib/camera_places.h"

#include "base/base.h"
#include "importers/lib/run_config.h"
#include "io/json.h"

/* Limit of distinct positions in cameras.json; further ones are ignored. */
enum { MOST_DIFFERENT = 1024 };

spin_status spin_camera_places_parse(const char *text, struct camera_places *out)
{
    const char *at = text;

    out->n = 0;
    while (at && *at) {
        size_t n = strcspn(at, ";");
        double xyz[3] = {0, 0, 0};
        char list[128];

        snprintf(list, sizeof list, "[%.*s]", n < 100 ? (int)n : 100, at);
        if (n >= 100 || !spin_cfg_numbers((struct cfg_span){list, list + strlen(list)}, 3, xyz))
            return spin_misuse("--camera '%.*s': expected X,Y,Z", (int)n, at);
        if (out->n == CAMERA_PLACES_MOST)
            return spin_misuse("--camera: too many positions, at most %d are allowed",
                               CAMERA_PLACES_MOST);
        for (int d = 0; d < 3; d++)
            out->place[out->n][d] = (float)xyz[d];
        out->n++;
        at += n + (at[n] == ';');
    }
    return SPIN_OK;
}

/* Appends the position of one entry to place [*n][3], unless `place` already contains this position
 * or is full. */
static spin_status add_entry(const char *path, const spin_json *list, size_t entry,
                             float (*place)[3], size_t *n)
{
    const spin_json *position = spin_json_get(spin_json_at(list, entry), "position");
    float xyz[3];

    if (spin_json_length(position) != 3)
        return spin_malformed("'%s': entry %zu has no 'position' of three numbers", path, entry);
    for (size_t d = 0; d < 3; d++) {
        double value;

        if (!spin_json_number(spin_json_at(position, d), &value) || !(fabs(value) < 1e18))
            return spin_malformed("'%s': 'position' of entry %zu is not three numbers", path,
                                  entry);
        xyz[d] = (float)value;
    }
    for (size_t i = 0; i < *n; i++) {
        if (memcmp(place[i], xyz, sizeof xyz) == 0)
            return SPIN_OK;
    }
    if (*n < MOST_DIFFERENT)
        memcpy(place[(*n)++], xyz, sizeof xyz);
    return SPIN_OK;
}

spin_status spin_camera_places_load(const char *path, struct camera_places *out)
{
    float place[MOST_DIFFERENT][3];
    spin_json *list;
    size_t n = 0;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_json_load(path, &list));
    for (size_t i = 0; i < spin_json_length(list) && status == SPIN_OK; i++)
        status = add_entry(path, list, i, place, &n);
    spin_json_free(list);
    SPIN_TRY(status);
    if (n == 0)
        return spin_malformed("'%s' is not a list of cameras, or is empty", path);
    out->n = n < CAMERA_PLACES_MOST ? (int)n : CAMERA_PLACES_MOST;
    for (int i = 0; i < out->n; i++)
        memcpy(out->place[i], place[(size_t)i * n / (size_t)out->n], sizeof *place);
    return SPIN_OK;
}
