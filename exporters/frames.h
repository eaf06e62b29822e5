/* A folder of one file per frame: the options, the rows and the names that such exporters share. */
#ifndef SPIN_EXPORTERS_FRAMES_H
#define SPIN_EXPORTERS_FRAMES_H

#include "exporters/rows.h"
#include "io/folder.h"

#define SPIN_FRAMES_OPTION_PATTERN(fallback)                                                       \
    {                                                                                              \
        "pattern", "PATTERN", "file names; one %d or %0Nd stands for the frame number", fallback   \
    }
#define SPIN_FRAMES_OPTION_SH                                                                      \
    {                                                                                              \
        "sh", "DEGREE",                                                                            \
            "SH degree to write, 0 to 3: cut off, or filled up with zeros; keep: as it is", "keep" \
    }
#define SPIN_FRAMES_OPTION_MIN_OPACITY                                                             \
    {                                                                                              \
        "min-opacity", "V", "leave out splats whose opacity is below V, 0 to 1", "0"               \
    }

struct spin_frames {
    struct spin_out_folder folder;
    struct spin_pattern pattern;
    struct spin_rows rows;
    bool force;
};

/* Read --pattern and --min-opacity, then make or take the folder. Zero frames before. */
static inline spin_status spin_frames_begin(struct spin_frames *frames,
                                            const struct spin_export_job *job, const char *pattern)
{
    const struct spin_plugin_values *v = job->values;

    frames->force = job->force;
    SPIN_TRY(spin_pattern_parse(spin_plugin_value(v, "pattern", pattern), &frames->pattern));
    SPIN_TRY(spin_rows_parse_min_opacity(spin_plugin_value(v, "min-opacity", "0"), &frames->rows));
    SPIN_TRY(spin_out_folder_begin(job->output, job->force, &frames->folder));
    if (frames->folder.n_before > 0)
        spin_warn("folder '%s' was not empty: files that are not overwritten stay in it",
                  job->output);
    return SPIN_OK;
}

/* Choose the frame's rows and open its file. */
static inline spin_status spin_frames_open(struct spin_frames *frames, const struct spin_splats *s,
                                           int number, size_t *n_kept, struct spin_out *out)
{
    char *path = NULL;
    spin_status status;

    SPIN_TRY(spin_rows_choose(&frames->rows, s, number, n_kept));
    SPIN_TRY(spin_pattern_path(&frames->pattern, frames->folder.path, number, &path));
    status = spin_out_open(path, frames->force, out);
    free(path);
    return status;
}

static inline void spin_frames_end(struct spin_frames *frames)
{
    spin_out_folder_end(&frames->folder);
    spin_rows_free(&frames->rows);
}

static inline void spin_frames_abandon(struct spin_frames *frames)
{
    spin_out_folder_abandon(&frames->folder);
    spin_rows_free(&frames->rows);
}

#endif
