#include "run/import_frames.h"

#include "base/base.h"

/* ---- Times of a data set's frames ------------------------------------------------------------ */

/* Returns whether the data set probably stores no times: its frames have the times 0, 1, 2, ...,
 * and these extend beyond the time range of the method. */
static bool rows_are_counted(const struct spin_sequence_info *t, const struct spin_frame_info *all,
                             int n)
{
    for (int i = 0; i < n; i++) {
        if (all[i].time != i)
            return false;
    }
    return n > 1 && n - 1 > t->time_last + 0.1 * (t->time_last - t->time_first);
}

/* Sets the time of each frame for a method whose times are frame numbers: to the number of the
 * frame minus that of the first frame, or to the index of the frame if `numbered` is false. */
static void set_counted_times(struct spin_sequence_info *t, bool numbered,
                              struct spin_frame_info *all, int n)
{
    bool counted = true;

    for (int i = 0; i < n; i++) {
        double time = numbered ? all[i].number - all[0].number : i;

        counted = counted && all[i].time == time;
        all[i].time = time;
    }
    if (!counted)
        spin_note(t,
                  "the data set's frames get the times of the method, 0 to %g, instead of their "
                  "own (to keep their own, give --frame-times data)",
                  all[n - 1].time);
}

/* Adds a note if the times cover less than half of the method's time range or extend far beyond it.
 * Data set and method then probably use different units of time. */
static void note_different_range(struct spin_sequence_info *t, const struct spin_frame_info *all,
                                 int n)
{
    double first = all[0].time, last = all[0].time, span = t->time_last - t->time_first;

    for (int i = 1; i < n; i++) {
        first = all[i].time < first ? all[i].time : first;
        last = all[i].time > last ? all[i].time : last;
    }
    if (n > 1 && (last - first < 0.5 * span || last > t->time_last + 0.5 * span ||
                  first < t->time_first - 0.5 * span))
        spin_note(t,
                  "the times of the data set are %g to %g, but those of the method are %g to %g: "
                  "check that their units agree (see --frame-times)",
                  first, last, t->time_first, t->time_last);
}

void spin_frame_times(const char *rule, bool numbered, struct spin_sequence_info *t,
                      struct spin_frame_info *all, int n)
{
    bool automatic = !rule || strcmp(rule, "auto") == 0;
    bool half_open = automatic ? t->half_open : strcmp(rule, "count") == 0;
    double span = t->time_last - t->time_first, steps = half_open ? n : n > 1 ? n - 1 : 1;

    if (automatic && t->counts_frames) {
        set_counted_times(t, numbered, all, n);
        note_different_range(t, all, n);
        return;
    }
    if (!automatic && strcmp(rule, "data") == 0)
        return;
    if (automatic && !rows_are_counted(t, all, n)) {
        note_different_range(t, all, n);
        return;
    }
    for (int i = 0; i < n; i++)
        all[i].time = t->time_first + span * i / steps;
    spin_note(t,
              "%s evenly spaced over the times %g to %g, frame i of n at i/%s of the range (see "
              "--frame-times)",
              automatic ? "the data set stores no frame times, so its frames are"
                        : "the frames of the data set are",
              all[0].time, all[n - 1].time, half_open ? "n" : "(n-1)");
}

/* ---- sequence.json of an exported clip ------------------------------------------------------- */

/* Returns the entry of the frame with this number, or NULL, and sets *next to the index after it.
 * The search begins at *next, since entries are mostly in the order of the frames. The name of a
 * still's file may contain no number, so the only entry belongs to the only frame. */
static const spin_json *entry_of(const spin_json *frames, int number, int n_frames, size_t *next)
{
    size_t n = spin_json_length(frames);

    if (n_frames == 1 && n == 1)
        return spin_json_at(frames, 0);
    for (size_t i = 0; i < n; i++) {
        size_t k = (*next + i) % n;
        const spin_json *entry = spin_json_at(frames, k);
        int64_t is;

        if (spin_json_integer(spin_json_get(entry, "frame"), &is) && is == number) {
            *next = k + 1;
            return entry;
        }
    }
    return NULL;
}

/* Applies sequence.json to the frames, and returns whether the file lists all frames. Pass 0 checks
 * all entries and pass 1 sets the values, so that either all values are set or none. */
static bool apply_sequence(const spin_json *root, struct spin_frame_info *frame, int n, int *place,
                           struct spin_bundle_meta *meta)
{
    const spin_json *frames = spin_json_get(root, "frames");
    const char *pair = spin_json_string(spin_json_get(root, "pair"));
    int64_t n_source, at, number;
    size_t next = 0;
    bool numbered, placed = spin_json_integer(spin_json_get(root, "source_frames"), &n_source) &&
                            n_source > 0 && n_source <= INT_MAX &&
                            spin_json_bool(spin_json_get(root, "numbered"), &numbered);
    double time, fps, stride = n < 2 ? 1 : (frame[n - 1].number - frame[0].number) / (n - 1.0);

    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < n; i++) {
            const spin_json *entry = entry_of(frames, frame[i].number, n, &next);

            if (!entry || !spin_json_number(spin_json_get(entry, "time"), &time) ||
                !isfinite(time) ||
                (placed && (!spin_json_integer(spin_json_get(entry, "source_index"), &at) ||
                            at < 0 || at >= n_source)))
                return false;
            if (pass == 1) {
                if (n == 1 && spin_json_integer(spin_json_get(entry, "frame"), &number))
                    frame[i].number = (int)number;
                frame[i].time = time;
                place[i] = placed ? (int)at : i;
            }
        }
    spin_json_bool(spin_json_get(root, "identity"), &meta->identity);
    if (spin_json_number(spin_json_get(root, "fps"), &fps) && isfinite(fps) && fps > 0)
        meta->fps = fps * stride;
    meta->n_source_frames = placed ? (int)n_source : meta->n_source_frames;
    meta->numbered = placed ? numbered : meta->numbered;
    snprintf(meta->pair, sizeof meta->pair, "%s", pair ? pair : "");
    return true;
}

/* Loads sequence.json from the folder of exported frames. Sets *root to NULL if the file does not
 * exist or was not written by spin-export. */
static spin_status open_sequence(const char *input, char **path, spin_json **root)
{
    const char *generator;

    *path = NULL;
    *root = NULL;
    if (!spin_path_is_folder(input))
        return SPIN_OK;
    SPIN_TRY(spin_path_join(input, "sequence.json", path));
    if (!spin_path_exists(*path) || spin_json_load(*path, root) != SPIN_OK)
        return SPIN_OK;
    generator = spin_json_string(spin_json_get(*root, "generator"));
    if (generator && strncmp(generator, "spin4d ", 7) == 0)
        return SPIN_OK;
    spin_json_free(*root);
    *root = NULL;
    return SPIN_OK;
}

spin_status spin_exported_frames(const char *input, struct spin_frame_info *frame, int n,
                                 int *place, struct spin_bundle_meta *meta)
{
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
    SPIN_FREED char *path = NULL;

    SPIN_TRY(open_sequence(input, &path, &root));
    if (root && !apply_sequence(root, frame, n, place, meta))
        spin_warn("'%s' does not match the frames in its folder: ignoring the times and indices in "
                  "this file",
                  path);
    return SPIN_OK;
}

spin_status spin_exported_data(const char *input, char **data, char **from)
{
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
    const spin_json *json;
    const char *folder, *name;
    SPIN_FREED char *path = NULL;

    *data = *from = NULL;
    SPIN_TRY(open_sequence(input, &path, &root));
    json = spin_json_get(root, "data");
    folder = spin_json_string(spin_json_get(json, "path"));
    name = spin_json_string(spin_json_get(json, "from"));
    if (folder && *folder == '/')
        SPIN_TRY(spin_strdup(folder, data));
    else if (folder)
        SPIN_TRY(spin_path_join(input, folder, data));
    if (*data && name)
        SPIN_TRY(spin_strdup(name, from));
    if (*data && !spin_path_exists(*data)) {
        free(*data);
        free(*from);
        *data = *from = NULL;
    }
    return SPIN_OK;
}
