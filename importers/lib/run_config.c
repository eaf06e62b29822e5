/* Settings of a training from cfg_args, a YAML file and options. */
#include "importers/lib/run_config.h"

#include <ctype.h>
#include <strings.h>

#include "base/base.h"
#include "io/json.h"

/* ---- cfg_args -------------------------------------------------------------------------------- */

enum { CFG_MAX_DEPTH = 32 };

static struct cfg_span trim(struct cfg_span s)
{
    while (s.at < s.end && isspace((unsigned char)s.at[0]))
        s.at++;
    while (s.at < s.end && isspace((unsigned char)s.end[-1]))
        s.end--;
    return s;
}

/* Returns the position behind the quoted text that begins at `at`, or NULL if the closing quote is
 * missing. */
static const char *cfg_skip_text(const char *at, const char *end)
{
    char quote = *at++;

    for (; at < end; at++) {
        if (*at == quote)
            return at + 1;
        if (*at == '\\')
            at++;
    }
    return NULL;
}

/* Returns the end of the value that begins at `at`: the first comma, closing bracket or character
 * `stop` outside of the value's own brackets and quotes, or `end`. `stop` is ':', '=' or, if only
 * commas and brackets end the value, 0. Returns NULL if brackets or quotes do not match. */
static const char *cfg_skip(const char *at, const char *end, char stop)
{
    char open[CFG_MAX_DEPTH];
    int depth = 0;

    while (at < end) {
        char c = *at;

        if (c == '\'' || c == '"') {
            at = cfg_skip_text(at, end);
            if (!at)
                return NULL;
            continue;
        }
        if (depth == 0 && (c == ',' || (stop && c == stop)))
            return at;
        if (c == '(' || c == '[' || c == '{') {
            if (depth == CFG_MAX_DEPTH)
                return NULL;
            open[depth++] = c;
        } else if (c == ')' || c == ']' || c == '}') {
            if (depth == 0)
                return at;
            depth--;
            if (open[depth] != (c == ')' ? '(' : c == ']' ? '[' : '{'))
                return NULL;
        }
        at++;
    }
    return depth == 0 ? at : NULL;
}

/* Reads the next entry "<name><mark><value>" of a list that is separated by commas, and moves *at
 * behind the entry. Returns false at the end of the list. */
static bool cfg_next(const char **at, const char *end, char mark, struct cfg_span *name,
                     struct cfg_span *value)
{
    while (*at < end) {
        const char *stop = cfg_skip(*at, end, mark);

        if (!stop)
            return false;
        *name = trim((struct cfg_span){*at, stop});
        if (stop < end && *stop == mark) {
            const char *last = cfg_skip(stop + 1, end, 0);

            if (!last)
                return false;
            *value = trim((struct cfg_span){stop + 1, last});
            *at = last < end ? last + 1 : end;
            return true;
        }
        *at = stop < end ? stop + 1 : end; /* skip **{...}, whose names are not identifiers */
    }
    return false;
}

bool spin_cfg_is(struct cfg_span s, const char *text)
{
    size_t n = strlen(text);

    return s.at && (size_t)(s.end - s.at) == n && memcmp(s.at, text, n) == 0;
}

struct cfg_span spin_cfg_get(const struct cfg_args *cfg, const char *key)
{
    struct cfg_span found = {NULL, NULL}, name, value;
    const char *at = cfg->all.at;

    while (at && cfg_next(&at, cfg->all.end, '=', &name, &value)) {
        if (spin_cfg_is(name, key))
            found = value;
    }
    return found;
}

struct cfg_span spin_cfg_item(struct cfg_span dict, const char *key)
{
    struct cfg_span found = {NULL, NULL}, name, value;
    const char *at = dict.at;

    if (!at || dict.end - at < 2 || *at != '{')
        return found;
    at++;
    while (cfg_next(&at, dict.end - 1, ':', &name, &value)) {
        if (name.end - name.at < 2 || (*name.at != '\'' && *name.at != '"'))
            continue;
        if (spin_cfg_is((struct cfg_span){name.at + 1, name.end - 1}, key))
            found = value;
    }
    return found;
}

bool spin_cfg_number(struct cfg_span s, double *out)
{
    char text[64], *end;
    double value;

    if (!s.at || s.end == s.at || (size_t)(s.end - s.at) >= sizeof text)
        return false;
    memcpy(text, s.at, (size_t)(s.end - s.at));
    text[s.end - s.at] = '\0';
    if (strspn(text, "+-.0123456789eE_") != strlen(text))
        return false;
    value = strtod(text, &end);
    if (*end != '\0')
        return false;
    *out = value;
    return true;
}

bool spin_cfg_numbers(struct cfg_span s, int n, double *out)
{
    const char *at = s.at, *end;
    int found = 0;

    if (spin_cfg_number(s, &out[0])) {
        for (int i = 1; i < n; i++)
            out[i] = out[0];
        return true;
    }
    if (!at || s.end - at < 2 || (*at != '[' && *at != '('))
        return false;
    end = s.end - 1;
    for (at++; at < end;) {
        const char *last = cfg_skip(at, end, 0);
        struct cfg_span one = {at, last};

        if (!last)
            return false;
        one = trim(one);
        if (one.at == one.end && last == end) /* a comma at the end, as in (1,) */
            break;
        if (found == n || !spin_cfg_number(one, &out[found++]))
            return false;
        at = last < end ? last + 1 : end;
    }
    return found == n;
}

bool spin_cfg_bool(struct cfg_span s, bool *out)
{
    double number;

    if (spin_cfg_is(s, "True") || spin_cfg_is(s, "true")) {
        *out = true;
        return true;
    }
    if (spin_cfg_is(s, "False") || spin_cfg_is(s, "false") || spin_cfg_is(s, "None")) {
        *out = false;
        return true;
    }
    if (!spin_cfg_number(s, &number))
        return false;
    *out = number != 0;
    return true;
}

spin_status spin_cfg_read_bool(const struct cfg_args *cfg, const char *key, bool *out)
{
    struct cfg_span s = spin_cfg_get(cfg, key);

    if (s.at && !spin_cfg_bool(s, out))
        return spin_malformed("'%s': '%s' is '%.*s', expected True or False", cfg->path, key,
                              (int)(s.end - s.at < 40 ? s.end - s.at : 40), s.at);
    return SPIN_OK;
}

spin_status spin_cfg_read_number(const struct cfg_args *cfg, const char *key, double *out)
{
    struct cfg_span s = spin_cfg_get(cfg, key);

    if (s.at && !spin_cfg_number(s, out))
        return spin_malformed("'%s': '%s' is '%.*s', expected a number", cfg->path, key,
                              (int)(s.end - s.at < 40 ? s.end - s.at : 40), s.at);
    return SPIN_OK;
}

spin_status spin_cfg_open(const char *path, struct cfg_args *out)
{
    static const char head[] = "Namespace(";
    struct cfg_span text;
    const char *last;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_text_file_open(path, &out->file));
    SPIN_TRY(spin_strdup(path, &out->path));
    text = trim((struct cfg_span){out->file.text, out->file.text + out->file.n});
    if (out->file.n > CFG_MAX_BYTES)
        return spin_unsupported("'%s' has more than 1 MiB", path);
    if ((size_t)(text.end - text.at) < sizeof head - 1 ||
        memcmp(text.at, head, sizeof head - 1) != 0)
        return spin_malformed("'%s' does not begin with 'Namespace('", path);
    out->all = (struct cfg_span){text.at + sizeof head - 1, text.end};
    for (last = out->all.at; last < text.end && *last != ')';) {
        const char *next = cfg_skip(last, text.end, 0);

        if (!next || next == text.end) {
            last = text.end;
            break;
        }
        last = *next == ',' ? next + 1 : next;
        if (*next != ',' && *next != ')')
            break;
    }
    if (last >= text.end || *last != ')')
        return spin_malformed("'%s': brackets or quotes do not match, or the file is cut short",
                              path);
    out->all.end = last;
    return SPIN_OK;
}

/* ---- YAML ------------------------------------------------------------------------------------ */

/* Reads the next line, trimmed and without its comment, and moves *at behind the line. Returns
 * false at the end of the file. */
static bool yaml_line(const char **at, const char *end, struct cfg_span *line)
{
    const char *stop, *comment;

    if (*at >= end)
        return false;
    stop = memchr(*at, '\n', (size_t)(end - *at));
    stop = stop ? stop : end;
    comment = memchr(*at, '#', (size_t)(stop - *at));
    *line = trim((struct cfg_span){*at, comment ? comment : stop});
    *at = stop + (stop < end);
    return true;
}

struct cfg_span spin_yaml_find(const struct run_config *s, const char *key, const char **next)
{
    const char *at = s->yaml.text, *end = at ? at + s->yaml.n : NULL;
    struct cfg_span line;
    size_t n = strlen(key);

    while (at && yaml_line(&at, end, &line)) {
        if ((size_t)(line.end - line.at) > n && memcmp(line.at, key, n) == 0 && line.at[n] == ':') {
            *next = at;
            return trim((struct cfg_span){line.at + n + 1, line.end});
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

/* Reads two numbers, the value of `key`, which is either "[a, b]" or two lines "- a" and "- b". */
static bool yaml_pair(const struct run_config *s, const char *key, double out[2])
{
    const char *next = NULL, *end;
    struct cfg_span value = spin_yaml_find(s, key, &next), line;

    if (!value.at)
        return false;
    end = s->yaml.text + s->yaml.n;
    if (value.at < value.end)
        return *value.at == '[' && spin_cfg_numbers(value, 2, out);
    for (int i = 0; i < 2; i++) {
        if (!yaml_line(&next, end, &line) || line.at == line.end || *line.at != '-' ||
            !spin_cfg_number(trim((struct cfg_span){line.at + 1, line.end}), &out[i]))
            return false;
    }
    return true;
}

/* ---- Files ----------------------------------------------------------------------------------- */

void spin_yaml_close(struct run_config *s)
{
    spin_text_file_close(&s->yaml);
    free(s->yaml_path);
    s->yaml_path = NULL;
}

void spin_run_config_close(struct run_config *s)
{
    spin_text_file_close(&s->cfg.file);
    free(s->cfg.path);
    spin_yaml_close(s);
}

spin_status spin_yaml_open(const char *path, struct run_config *s)
{
    SPIN_TRY(spin_text_file_open(path, &s->yaml));
    if (s->yaml.n > CFG_MAX_BYTES)
        return spin_malformed("'%s' is too large for a training configuration", path);
    return spin_strdup(path, &s->yaml_path);
}

/* ---- Times ----------------------------------------------------------------------------------- */

spin_status spin_run_config_ratio(const struct run_config *s, double *out)
{
    const char *next;
    bool of_cfg = spin_cfg_get(&s->cfg, "frame_ratio").at != NULL;

    *out = 1;
    spin_cfg_number(spin_yaml_find(s, "frame_ratio", &next), out);
    SPIN_TRY(spin_cfg_read_number(&s->cfg, "frame_ratio", out));
    if (!(*out > 0) || !isfinite(*out))
        return spin_malformed("'%s': frame_ratio is %g, expected a number above 0",
                              of_cfg ? s->cfg.path : s->yaml_path, *out);
    return SPIN_OK;
}

/* Guesses the clip's times from the range of the central 98% of the Gaussians' times. Methods
 * initialise the Gaussians' times over a range that is `spread` times as long as the clip. The
 * guess is therefore the central range, scaled about its midpoint by 1 / (0.98 `spread`); if
 * `spread` is 1, the range is not scaled. Both ends are rounded to multiples of half a power of
 * ten. */
static spin_status guess_times(const float *time, size_t n, double spread, struct clip_times *out)
{
    double low, high, half, step;
    SPIN_FREED float *sorted = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *sorted, (void **)&sorted));
    memcpy(sorted, time, n * sizeof *sorted);
    qsort(sorted, n, sizeof *sorted, spin_by_float);
    low = (double)sorted[(size_t)(0.01 * (double)(n - 1))];
    high = (double)sorted[(size_t)(0.99 * (double)(n - 1) + 0.5)];
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

spin_status spin_run_config_times(const struct run_config *s, const char *asked, const float *time,
                                  size_t n, double ratio, double spread, struct clip_times *out)
{
    double pair[2];

    *out = (struct clip_times){0};
    if (asked) {
        char list[128];

        snprintf(list, sizeof list, "[%.100s]", asked);
        if (!spin_cfg_numbers((struct cfg_span){list, list + strlen(list)}, 2, pair) ||
            !isfinite(pair[0]) || !(pair[1] > pair[0]) || !isfinite(pair[1]))
            return spin_misuse("the range of times is '%s', expected A,B with A < B", asked);
    } else if (s && yaml_pair(s, "time_duration", pair)) {
        if (!isfinite(pair[0]) || !(pair[1] > pair[0]) || !isfinite(pair[1]))
            return spin_malformed("'%s': time_duration is [%g, %g], expected [a, b] with a < b",
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

/* ---- The axes of the data set ---------------------------------------------------------------- */

/* Returns whether a name in the path is one of `words`, a list that ends with NULL. If `last`, only
 * the last name counts. */
static bool path_names(struct cfg_span path, const char *const *words, bool last)
{
    const char *at = path.at, *end = path.end;

    while (end > at && strchr("/\\'\"", end[-1]))
        end--;
    while (end > at) {
        const char *name = end;

        while (name > at && !strchr("/\\'\"", name[-1]))
            name--;
        for (size_t i = 0; words[i]; i++)
            if (strlen(words[i]) == (size_t)(end - name) &&
                strncasecmp(name, words[i], (size_t)(end - name)) == 0)
                return true;
        end = last || name == at ? at : name - 1;
    }
    return false;
}

bool spin_run_config_is_blender(const struct run_config *s)
{
    static const char *const keys[] = {"source_path", "model_path", "expname", "configs", "config"};
    static const char *const sets[] = {"dnerf", "d-nerf", "d_nerf", "nerf_synthetic", NULL};
    static const char *const scenes[] = {"bouncingballs", "hellwarrior", "hook",
                                         "jumpingjacks",  "lego",        "mutant",
                                         "standup",       "trex",        NULL};
    struct cfg_span yaml = {s->yaml_path,
                            s->yaml_path ? s->yaml_path + strlen(s->yaml_path) : NULL};
    bool blender = false;

    if (spin_cfg_bool(spin_cfg_get(&s->cfg, "is_blender"), &blender) && blender)
        return true;
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++)
        if (path_names(spin_cfg_get(&s->cfg, keys[i]), sets, false))
            return true;
    return path_names(yaml, sets, false) ||
           path_names(spin_cfg_get(&s->cfg, "source_path"), scenes, true);
}

/* ---- Camera positions ------------------------------------------------------------------------ */

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
