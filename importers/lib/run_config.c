/* Settings of a run from cfg_args, YAML and options. */
#include "importers/lib/run_config.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/mem.h"

/* ---- YAML ------------------------------------------------------------------------------------ */

/* The next line from *at on, without comment and spaces around it. */
static bool yaml_line(const char **at, const char *end, struct cfg_span *line)
{
    const char *stop, *comment;

    if (*at >= end)
        return false;
    stop = memchr(*at, '\n', (size_t)(end - *at));
    stop = stop ? stop : end;
    comment = memchr(*at, '#', (size_t)(stop - *at));
    *line = spin_cfg_trim((struct cfg_span){*at, comment ? comment : stop});
    *at = stop + (stop < end);
    return true;
}

struct cfg_span spin_yaml_find(const struct run_config *s, const char *key, const char **next)
{
    const char *at = (const char *)s->yaml.data, *end = at ? at + s->yaml.size : NULL;
    struct cfg_span line;
    size_t n = strlen(key);

    while (at && yaml_line(&at, end, &line)) {
        if ((size_t)(line.end - line.at) > n && memcmp(line.at, key, n) == 0 && line.at[n] == ':') {
            *next = at;
            return spin_cfg_trim((struct cfg_span){line.at + n + 1, line.end});
        }
    }
    return (struct cfg_span){NULL, NULL};
}

bool spin_yaml_bool(const struct run_config *s, const char *key, bool fallback)
{
    const char *next;
    bool value = fallback;

    return spin_cfg_bool(spin_yaml_find(s, key, &next), &value) ? value : fallback;
}

/* [a, b], or two lines "- a" and "- b". */
static bool yaml_pair(const struct run_config *s, const char *key, double out[2])
{
    const char *next = NULL, *end;
    struct cfg_span value = spin_yaml_find(s, key, &next), line;

    if (!value.at)
        return false;
    end = (const char *)s->yaml.data + s->yaml.size;
    if (value.at < value.end)
        return *value.at == '[' && spin_cfg_numbers(value, 2, out);
    for (int i = 0; i < 2; i++) {
        if (!yaml_line(&next, end, &line) || line.at == line.end || *line.at != '-' ||
            !spin_cfg_number(spin_cfg_trim((struct cfg_span){line.at + 1, line.end}), &out[i]))
            return false;
    }
    return true;
}

/* ---- Files ----------------------------------------------------------------------------------- */

void spin_run_config_close(struct run_config *s)
{
    spin_cfg_close(&s->cfg);
    spin_map_close(&s->yaml);
    free(s->yaml_path);
    memset(s, 0, sizeof *s);
}

static spin_status run_config_open_yaml(struct run_config *s, const char *path)
{
    SPIN_TRY(spin_map_open(path, &s->yaml));
    if (s->yaml.size > CFG_MAX_BYTES)
        return spin_fail(SPIN_E_MALFORMED, "'%s' is too large for a training configuration", path);
    return spin_strdup(path, &s->yaml_path);
}

/* The first *.yaml or *.yml of the folder that has `key`. Training leaves none there; users put a
 * copy. */
static spin_status run_config_find_yaml(struct run_config *s, const char *folder, const char *key)
{
    char **names = NULL;
    size_t n = 0;
    spin_status status;

    SPIN_TRY(spin_folder_list(folder, &names, &n));
    status = SPIN_OK;
    for (size_t i = 0; i < n && !s->yaml_path && status == SPIN_OK; i++) {
        const char *dot = strrchr(names[i], '.'), *next;
        char *path = NULL;

        if (!dot || (strcmp(dot, ".yaml") != 0 && strcmp(dot, ".yml") != 0))
            continue;
        status = spin_path_join(folder, names[i], &path);
        if (status == SPIN_OK && !spin_path_is_folder(path))
            status = run_config_open_yaml(s, path);
        free(path);
        if (s->yaml_path && !spin_yaml_find(s, key, &next).at) {
            spin_map_close(&s->yaml);
            free(s->yaml_path);
            s->yaml_path = NULL;
        }
    }
    spin_folder_list_free(names);
    return status;
}

spin_status spin_run_config_open(const char *file, const char *config, const char *key,
                                 struct run_config *s)
{
    char *folder = NULL, *path = NULL;
    spin_status status;

    memset(s, 0, sizeof *s);
    SPIN_TRY_OUT(spin_path_folder(file, &folder));
    SPIN_TRY_OUT(spin_path_join(folder, "cfg_args", &path));
    if (spin_path_exists(path))
        SPIN_TRY_OUT(spin_cfg_open(path, &s->cfg));
    status = config ? run_config_open_yaml(s, config) : run_config_find_yaml(s, folder, key);
out:
    free(folder);
    free(path);
    return status;
}

/* ---- Times ----------------------------------------------------------------------------------- */

spin_status spin_run_config_ratio(const struct run_config *s, double *out)
{
    const char *next;

    *out = 1;
    spin_cfg_number(spin_yaml_find(s, "frame_ratio", &next), out);
    SPIN_TRY(spin_cfg_read_number(&s->cfg, "frame_ratio", out));
    if (!(*out > 0) || !isfinite(*out))
        return spin_fail(SPIN_E_MALFORMED, "frame_ratio is %g", *out);
    return SPIN_OK;
}

int spin_compare_times(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

/* The central 98% of the Gaussians' own times, narrowed about its middle and rounded. Methods
 * spread initial times beyond the clip: `spread` is how much wider than it. */
static spin_status guess_times(const double *time, size_t n, double spread, struct clip_times *out)
{
    double *sorted, low, high, half, step;

    SPIN_TRY(spin_alloc(n, sizeof *sorted, (void **)&sorted));
    memcpy(sorted, time, n * sizeof *sorted);
    qsort(sorted, n, sizeof *sorted, spin_compare_times);
    low = sorted[(size_t)(0.01 * (double)(n - 1))];
    high = sorted[(size_t)(0.99 * (double)(n - 1) + 0.5)];
    free(sorted);
    half = 0.5 * (high - low) / (spread > 1 ? 0.98 * spread : 1);
    step = half > 0 ? pow(10, floor(log10(2 * half))) / 2 : 0;
    out->first = 0.5 * (low + high) - half;
    out->last = 0.5 * (low + high) + half;
    if (step > 0) {
        out->first = step * nearbyint(out->first / step) + 0.0;
        out->last = step * nearbyint(out->last / step) + 0.0;
    }
    if (out->last <= out->first)
        out->last = out->first + 1;
    out->guessed = true;
    return SPIN_OK;
}

spin_status spin_run_config_times(const struct run_config *s, const char *asked, const double *time,
                                  size_t n, double ratio, double spread, struct clip_times *out)
{
    double pair[2];

    *out = (struct clip_times){0};
    if (asked) {
        char *end = NULL;

        pair[0] = strtod(asked, &end);
        if (end == asked || *end != ',')
            return spin_fail(SPIN_E_USAGE, "the range of times is '%s', expected A,B", asked);
        asked = end + 1;
        pair[1] = strtod(asked, &end);
        if (end == asked || *end != '\0' || !isfinite(pair[0]) || !(pair[1] > pair[0]) ||
            !isfinite(pair[1]))
            return spin_fail(SPIN_E_USAGE,
                             "the range of times ends with '%s', expected A,B with "
                             "A < B",
                             asked);
    } else if (s && yaml_pair(s, "time_duration", pair)) {
        if (!isfinite(pair[0]) || !(pair[1] > pair[0]) || !isfinite(pair[1]))
            return spin_fail(SPIN_E_MALFORMED,
                             "'%s': time_duration is [%g, %g], expected [a, b] with a < b",
                             s->yaml_path, pair[0], pair[1]);
    } else {
        SPIN_TRY(guess_times(time, n, spread, out));
        out->first *= ratio;
        out->last *= ratio;
        return SPIN_OK;
    }
    out->first = pair[0];
    out->last = pair[1];
    return SPIN_OK;
}
