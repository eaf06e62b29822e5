/* Code shared by the exporters that write one file per frame into a folder or, if the name of the
 * output has the extension of the format, a single file. The code of a format encodes the frames;
 * the functions frame(), end() and abort() of the plug-in are implemented here.
 *
 * The folder also contains sequence.json, which lists file, number, time and number of splats of
 * each frame for players. If an export replaces a previous one, all frame files of the previous
 * export are overwritten or removed, so that players do not mix frames of both exports. */
#pragma once

#include "exporters/lib/quant_error.h"
#include "exporters/lib/splat_rows.h"
#include "io/numbered.h"
#include "io/output.h"

#define SPIN_FRAMES_OPTION_PATTERN(fallback)                                                       \
    {                                                                                              \
        "pattern", "PATTERN", "file names, with one %d, %0Nd or #### for the frame number",        \
            fallback                                                                               \
    }
#define SPIN_FRAMES_OPTION_START                                                                   \
    {                                                                                              \
        "start", "N",                                                                              \
            "number of the first frame; the others follow (default: the clip's numbers)", NULL     \
    }
#define SPIN_FRAMES_OPTION_FPS                                                                     \
    {                                                                                              \
        "fps", "F", "frames per second of the sequence; default: the bundle's", NULL               \
    }
#define SPIN_FRAMES_OPTIONS(pattern)                                                               \
    SPIN_FRAMES_OPTION_PATTERN(pattern), SPIN_FRAMES_OPTION_START, SPIN_ROWS_OPTIONS

struct spin_frames_format {
    const char *name;     /* the plug-in's name */
    const char *importer; /* importer that reads the files; NULL: that of the same name */
    const char *pattern;  /* default file name pattern */
    size_t self_bytes; /* size of the format's struct, whose first member is a struct spin_frames */
    bool lossy;  /* true: values are rounded; errors are logged at the end, unless frames->exact */
    bool packed; /* true: files are compressed, and bytes() returns an upper bound */
    bool clips_colours; /* true: the format clamps colours to a range */
    /* Name of a file in the folder with splats that all frames have, and that the files of the
     * frames do not contain; NULL: none. */
    const char *still;

    /* Reads the options of the format, before the common options are read; may set frames->axes.
     * NULL: the format has no options. */
    spin_status (*begin)(void *self, const struct spin_export_job *job);
    /* Called after the common options have been read. NULL: nothing to do. */
    spin_status (*ready)(void *self, const struct spin_export_job *job);
    /* Functions for formats that can store all frames in a single file: open() and close() begin
     * and end this file, and add() appends a frame; write() is not called. NULL: the format stores
     * one frame per file. */
    spin_status (*open)(void *self, const struct spin_export_job *job);
    spin_status (*add)(void *self, const struct spin_frame_info *info,
                       const struct spin_splats *splats);
    spin_status (*close)(void *self);
    /* Returns the size in bytes of a file with n splats, or an upper bound if `packed` is true. */
    uint64_t (*bytes)(const void *self, size_t n);
    /* Called before a frame is written, with all of its rows kept; may keep fewer rows. If the
     * frame needs no file of its own, sets *file to the name of the file in the folder that
     * contains it; write() is then not called. NULL: nothing to do. */
    spin_status (*begin_frame)(void *self, const struct spin_frame_info *info, const char **file);
    /* Writes the file of a frame, which contains the kept rows of frames->rows. */
    spin_status (*write)(void *self, const struct spin_frame_info *info, struct spin_out *out);
    /* Sets *row to the kept rows in the order of the file. NULL: the order is that of frames->sort.
     */
    spin_status (*order)(void *self, const struct spin_keyed **row);
    /* Writes further files after the last frame. NULL: nothing to do. */
    spin_status (*finish)(void *self);
    /* Frees the memory of the format, except its struct. NULL: nothing to free. */
    void (*end)(void *self);
};

/* A frame in sequence.json. */
struct spin_frames_entry {
    int number, source_index;
    double time;
    size_t n;
    const char *file; /* name of the file that contains the frame; NULL: that of the pattern */
};

struct spin_frames {
    const struct spin_frames_format *format;
    /* Rotation w x y z from the axes of the source to those of the format, see
     * spin_splat_rows_begin(). NULL: the axes are the same. */
    const double *axes;
    const char *file; /* path of the single output file; NULL: the output is a folder */
    char *output;     /* job->output or, if job->output is a pattern, its folder */
    int start;        /* number of the first frame; -1: frames keep their numbers */
    bool exact;       /* true: this export does not round values, even if the format is lossy */
    struct spin_output_folder folder;
    struct spin_pattern pattern;
    struct spin_splat_rows rows;
    struct spin_sort_rows order; /* see spin_frames_order() */
    /* Sorts `order`. NULL: rows keep the order of the source. */
    void (*sort)(struct spin_sort_rows *, const struct spin_splats *);
    struct spin_quant_error quant; /* rounding errors of all frames */
    const struct spin_export_job *job;
    double fps;
    /* [n_entries] the frames that have been written; `room` is the capacity. */
    struct spin_frames_entry *entry;
    size_t n_entries, room;
    uint64_t n_splats; /* number of splats, summed over all entries */
    unsigned char *scratch;
    size_t scratch_bytes;
    /* [blocks] rounding errors of the current frame, zeroed before write(). */
    struct spin_quant_error *block_quant;
};

/* Allocates *self with format->self_bytes bytes, which are zero, reads the options, and calls
 * begin() and ready() of the format. */
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
/* Records a frame of n splats for sequence.json and for --check. */
spin_status spin_frames_add(struct spin_frames *frames, const struct spin_frame_info *info,
                            size_t n);
/* Implements --check: reads all frames back and compares them with the bundle. */
spin_status spin_frames_check(struct spin_frames *frames);

/* Writes a text file into the folder; for finish(). */
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

/* Sets *out to scratch memory for all workers: worker w owns at least `bytes` bytes from offset w *
 * frames->scratch_bytes. The contents are lost with the next call. */
spin_status spin_frames_scratch(struct spin_frames *frames, size_t bytes, unsigned char **out);

/* Writes the kept rows in the order of the source, `width` bytes each, from byte `at` of the file
 * on. code() encodes one row, and is called by several threads at the same time. */
typedef void (*spin_frames_code)(void *self, size_t row, unsigned char *out,
                                 struct spin_quant_error *quant);
spin_status spin_frames_write_rows(void *self, struct spin_out *out, uint64_t at, size_t width,
                                   spin_frames_code code);

/* Prints the comment lines of a PLY header, which contain the source, the frame number and the
 * rotation of the axes. */
#define SPIN_FRAMES_MAX_COMMENTS 512
void spin_frames_comments(const struct spin_frames *frames, const struct spin_frame_info *info,
                          char text[SPIN_FRAMES_MAX_COMMENTS]);

/* Logs the size of the output before it is written. Warns if the disk has less free space, unless
 * `at_most` is true, which means that the size is only an upper bound. */
void spin_frames_log_size(const char *output, int n_frames, uint64_t bytes, bool at_most);
