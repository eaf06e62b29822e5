/* Common code of exporters that write one file per frame into a folder, or a single file if the
 * output's name has the format's extension. A format only encodes a frame; the functions frame, end
 * and abort of the plug-in are those below.
 *
 * The folder also contains sequence.json for players: name, number, time and splat count of each
 * frame. If an export replaces a previous one, all frame files of the previous one are overwritten
 * or removed, so that players do not mix the two. */
#pragma once

#include "exporters/lib/quant_error.h"
#include "exporters/lib/sort_rows.h"
#include "exporters/lib/splat_filter.h"
#include "io/output.h"

#define SPIN_FRAMES_OPTION_PATTERN(fallback)                                                       \
    {                                                                                              \
        "pattern", "PATTERN", "file names, with one %d or %0Nd for the frame number", fallback     \
    }
#define SPIN_FRAMES_OPTION_FPS                                                                     \
    {                                                                                              \
        "fps", "F", "frames per second of the sequence; default: the bundle's", NULL               \
    }
#define SPIN_FRAMES_OPTIONS(pattern) SPIN_FRAMES_OPTION_PATTERN(pattern), SPIN_ROWS_OPTIONS

struct spin_frames_format {
    const char *name;     /* the plug-in's name */
    const char *importer; /* the importer that reads the files; NULL: it has the same name */
    const char *pattern;  /* default file name pattern */
    size_t self_bytes; /* size of the format's struct, whose first member is a struct spin_frames */
    bool lossy;        /* log the rounding error at the end, unless frames->exact */
    bool packed;       /* files are compressed, and bytes() is an upper bound */
    bool clips_colours; /* clamps colours to a range */

    /* Reads the format's own options, before the common ones; may set frames->axes. NULL: none. */
    spin_status (*begin)(void *self, const struct spin_export_job *job);
    /* Called after the common options are read. NULL: nothing to do. */
    spin_status (*ready)(void *self, const struct spin_export_job *job);
    /* For a format that can store all frames in a single file: open() and close() begin and end
     * that file, and add() appends each frame; write() is not called. NULL: one frame per file. */
    spin_status (*open)(void *self, const struct spin_export_job *job);
    spin_status (*add)(void *self, const struct spin_frame_info *info,
                       const struct spin_splats *splats);
    spin_status (*close)(void *self);
    /* Size in bytes of a file of n splats; an upper bound if `packed`. */
    uint64_t (*bytes)(const void *self, size_t n);
    /* Writes the kept rows. */
    spin_status (*write)(void *self, const struct spin_frame_info *info, struct spin_out *out);
    /* Sets *row to the kept rows in the order of the file. NULL: the order of frames->sort. */
    spin_status (*order)(void *self, const struct spin_keyed **row);
    /* Writes further files after the last frame. NULL: nothing to do. */
    spin_status (*finish)(void *self);
    /* Frees the format's own memory. NULL: none. */
    void (*end)(void *self);
};

/* A frame in sequence.json. */
struct spin_frames_entry {
    int number, source_index;
    double time;
    size_t n;
};

struct spin_frames {
    const struct spin_frames_format *format;
    const double *axes; /* w x y z, see spin_splat_filter_begin(); NULL: the source's */
    const char *file;   /* the single output file; NULL: a folder */
    bool exact;         /* this export does not round */
    struct spin_output_folder folder;
    struct spin_pattern pattern;
    struct spin_splat_filter rows;
    struct spin_sort_rows order; /* see spin_frames_order() */
    void (*sort)(struct spin_sort_rows *,
                 const struct spin_splats *); /* NULL: the source's order */
    struct spin_quant_error quant;            /* rounding errors of all frames */
    const struct spin_export_job *job;
    double fps;
    struct spin_frames_entry *entry; /* [n_entries], with a capacity of `room` */
    size_t n_entries, room;
    uint64_t n_splats; /* sum over all entries */
    unsigned char *scratch;
    size_t scratch_bytes;
    struct spin_quant_error *block_quant; /* [blocks] of the current frame, zeroed before write() */
};

/* Allocates *self with format->self_bytes zero bytes, reads the options, and calls the format's
 * begin() and ready(). */
spin_status spin_frames_begin(const struct spin_frames_format *format,
                              const struct spin_export_job *job, void **self);
spin_status spin_frames_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats);
spin_status spin_frames_end(void *self);
void spin_frames_abort(void *self);
/* Defines an exporter. A struct spin_frames_format named `format` must be in scope; see
 * SPIN_EXPORTER(). */
#define SPIN_FRAMES_EXPORTER(id, label, ...)                                                       \
    static spin_status spin_begin_##id(const struct spin_export_job *job, void **self)             \
    {                                                                                              \
        return spin_frames_begin(&format, job, self);                                              \
    }                                                                                              \
                                                                                                   \
    SPIN_EXPORTER(id, label, SPIN_FRAMES_FUNCTIONS, .begin = spin_begin_##id, __VA_ARGS__)
#define SPIN_FRAMES_FUNCTIONS                                                                      \
    .frame = spin_frames_frame, .end = spin_frames_end, .abort = spin_frames_abort
/* Records a frame for sequence.json and for the check. */
spin_status spin_frames_add(struct spin_frames *frames, const struct spin_frame_info *info,
                            size_t n);
/* --check: reads all frames back and compares them. */
spin_status spin_frames_check(struct spin_frames *frames);

/* For finish(): writes a text file of this name into the folder. */
spin_status spin_frames_write_text(struct spin_frames *frames, const char *name, const char *text);

/* ---- For write() ----------------------------------------------------------------------------- */

/* Fills frames->order with the kept rows, sorted by frames->sort. */
static inline spin_status spin_frames_order(struct spin_frames *frames)
{
    SPIN_TRY(spin_sort_rows_fill(&frames->order, &frames->rows));
    if (frames->sort)
        frames->sort(&frames->order, frames->rows.splats);
    return SPIN_OK;
}

/* Scratch memory of `bytes` for each worker, contiguous; the contents are not preserved. */
spin_status spin_frames_scratch(struct spin_frames *frames, size_t bytes, unsigned char **out);

/* Writes the kept rows in the source's order, `width` bytes each, beginning at byte `at` of the
 * file. code() encodes one row and is called on all threads. */
typedef void (*spin_frames_code)(void *self, size_t row, unsigned char *out,
                                 struct spin_quant_error *quant);
spin_status spin_frames_write_rows(void *self, struct spin_out *out, uint64_t at, size_t width,
                                   spin_frames_code code);

/* Prints the comment lines of a PLY header: source, frame number, rotation of the axes. */
#define SPIN_FRAMES_MAX_COMMENTS 512
void spin_frames_comments(const struct spin_frames *frames, const struct spin_frame_info *info,
                          char text[SPIN_FRAMES_MAX_COMMENTS]);

/* Logs the size of the output before it is written. Warns if the disk has less free space, except
 * if the size is only an upper bound (at_most). */
void spin_frames_say_size(const char *output, int n_frames, uint64_t bytes, bool at_most);
