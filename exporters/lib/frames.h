/* A folder of one file per frame, or one file for one frame when the output's name has the ending
 * of the format's files: what all such exporters do, so that a format says only how its bytes are
 * made. begin, frame, end and abort of the plug-in are those below.
 *
 * Beside the frames lies sequence.json: their names, numbers, times and counts, for players. An
 * export that replaces another one removes the frames of that which it does not write, so that
 * players do not show both. */
#pragma once

#include "exporters/lib/quant_error.h"
#include "exporters/lib/sort_rows.h"
#include "exporters/lib/splat_filter.h"
#include "io/output.h"

#define SPIN_FRAMES_OPTION_PATTERN(fallback)                                                       \
    {                                                                                              \
        "pattern", "PATTERN", "file names; one %d or %0Nd stands for the frame number", fallback   \
    }
#define SPIN_FRAMES_OPTION_FPS                                                                     \
    {                                                                                              \
        "fps", "F", "frames per second of the sequence; otherwise the bundle's", NULL              \
    }
#define SPIN_FRAMES_OPTIONS(pattern) SPIN_FRAMES_OPTION_PATTERN(pattern), SPIN_ROWS_OPTIONS

struct spin_frames_format {
    const char *name;     /* as the plug-in's */
    const char *importer; /* that reads the files; NULL: that of the same name */
    const char *pattern;  /* of file names */
    size_t self_bytes;    /* of the struct that begins with a struct spin_frames */
    bool lossy;           /* says its error at the end, unless frames->exact */
    bool packed;          /* bytes() is an upper bound */
    bool clips_colours;   /* colours outside of a range are cut off */

    /* Own options. May change frames->axes before the common ones are read. NULL: none. */
    spin_status (*begin)(void *self, const struct spin_export_job *job);
    /* The common options are read too. NULL: nothing to do. */
    spin_status (*ready)(void *self, const struct spin_export_job *job);
    /* One file takes all frames, where the output is named so: it is opened and closed by these,
     * and add() gets what frame() gets. NULL: a file holds one frame. */
    spin_status (*open)(void *self, const struct spin_export_job *job);
    spin_status (*add)(void *self, const struct spin_frame_info *info,
                       const struct spin_splats *splats);
    spin_status (*close)(void *self);
    /* Bytes of a file of n splats: exact, or at most that where it is packed. */
    uint64_t (*bytes)(const void *self, size_t n);
    /* Write the chosen rows. */
    spin_status (*write)(void *self, const struct spin_frame_info *info, struct spin_out *out);
    /* The chosen rows in the order of the file. NULL: that of frames->sort. */
    spin_status (*order)(void *self, const struct spin_keyed **row);
    /* What else lies beside the frames, of which all are whole now. NULL: nothing. */
    spin_status (*finish)(void *self);
    /* Release own memory. NULL: none. */
    void (*end)(void *self);
};

/* What sequence.json says of a frame. */
struct spin_frames_entry {
    int number, source_index;
    double time;
    size_t n;
};

/* A file of the export that was in the folder before. */
struct spin_frames_former {
    char *name;
    bool written; /* by this export too */
};

struct spin_frames {
    const struct spin_frames_format *format;
    const double *axes; /* w x y z, see spin_splat_filter_begin(); NULL: the source's */
    const char *file;   /* the output is this file, of one frame or of all; NULL: a folder */
    bool exact;         /* nothing is rounded */
    struct spin_output_folder folder;
    struct spin_frames_former *former; /* [n_former] by name */
    size_t n_former;
    struct spin_pattern pattern;
    struct spin_splat_filter rows;
    struct spin_sort_rows order; /* see spin_frames_order() */
    void (*sort)(struct spin_sort_rows *,
                 const struct spin_splats *); /* NULL: the source's order */
    struct spin_quant_error quant;            /* of the clip */
    const struct spin_export_job *job;
    double fps;
    struct spin_frames_entry *entry; /* [room] */
    size_t n_entries, room;
    uint64_t n_splats; /* of all entries */
    unsigned char *scratch;
    size_t scratch_bytes;
    struct spin_quant_error
        *block_quant; /* [blocks] of the frame at hand, for write(): zero at first */
};

/* Makes *self; format->begin() sees it with everything else zero. */
spin_status spin_frames_begin(const struct spin_frames_format *format,
                              const struct spin_export_job *job, void **self);
spin_status spin_frames_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats);
spin_status spin_frames_end(void *self);
void spin_frames_abort(void *self);
/* Defines such an exporter, of the format that is called `format`; see SPIN_EXPORTER(). */
#define SPIN_FRAMES_EXPORTER(id, label, ...)                                                       \
    static spin_status spin_begin_##id(const struct spin_export_job *job, void **self)             \
    {                                                                                              \
        return spin_frames_begin(&format, job, self);                                              \
    }                                                                                              \
                                                                                                   \
    SPIN_EXPORTER(id, label, SPIN_FRAMES_FUNCTIONS, .begin = spin_begin_##id, __VA_ARGS__)
#define SPIN_FRAMES_FUNCTIONS                                                                      \
    .frame = spin_frames_frame, .end = spin_frames_end, .abort = spin_frames_abort
/* What sequence.json and the check know of a frame. */
spin_status spin_frames_add(struct spin_frames *frames, const struct spin_frame_info *info,
                            size_t n);
/* --check: read all frames back. */
spin_status spin_frames_check(struct spin_frames *frames);

/* For finish(): a file of this name in the folder. */
spin_status spin_frames_write_text(struct spin_frames *frames, const char *name, const char *text);

/* ---- For write() ------------------------------------------------------------------------------
 */

/* The chosen rows in frames->order, sorted by frames->sort. */
static inline spin_status spin_frames_order(struct spin_frames *frames)
{
    SPIN_TRY(spin_sort_rows_fill(&frames->order, &frames->rows));
    if (frames->sort)
        frames->sort(&frames->order, frames->rows.splats);
    return SPIN_OK;
}

/* bytes for each worker, one after the other; contents are not kept. */
spin_status spin_frames_scratch(struct spin_frames *frames, size_t bytes, unsigned char **out);

/* The kept rows in the source's order, `width` bytes each, from byte `at` of the file on: blocks
 * are coded side by side and go straight to their places. */
typedef void (*spin_frames_code)(void *self, size_t row, unsigned char *out,
                                 struct spin_quant_error *quant);
spin_status spin_frames_write_rows(void *self, struct spin_out *out, uint64_t at, size_t width,
                                   spin_frames_code code);

/* The comments of a PLY header, lines: where the splats come from, which frame, how they lie. */
#define SPIN_FRAMES_MAX_COMMENTS 512
void spin_frames_comments(const struct spin_frames *frames, const struct spin_frame_info *info,
                          char text[SPIN_FRAMES_MAX_COMMENTS]);

/* How much will be written where, said before it is; a warning when the disk has less. */
void spin_frames_say_size(const char *output, int n_frames, uint64_t bytes, bool at_most);
