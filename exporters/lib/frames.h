/* Exporters that write one file per frame into a folder, or a single file if the output's name has
 * the format's extension. A format only provides its bytes; the plug-in's frame, end and abort are
 * the functions below.
 *
 * The folder also gets sequence.json for players: name, number, time and splat count of each frame.
 * An export that replaces another one removes that one's other frames, so that players do not mix
 * both. */
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
    const char *name;     /* of the plug-in */
    const char *importer; /* the one that reads the files; NULL: the one of the same name */
    const char *pattern;  /* default file name pattern */
    size_t self_bytes;    /* size of the struct that begins with a struct spin_frames */
    bool lossy;           /* log the rounding error at the end, unless frames->exact */
    bool packed;          /* compressed: bytes() is an upper bound */
    bool clips_colours;   /* clamps colours to a range */

    /* Reads the format's own options, before the common ones; may set frames->axes. NULL: none. */
    spin_status (*begin)(void *self, const struct spin_export_job *job);
    /* Called after the common options are read. NULL: nothing to do. */
    spin_status (*ready)(void *self, const struct spin_export_job *job);
    /* For a format whose single file can hold all frames: open() and close() begin and end it, and
     * add() handles each frame in place of write(). NULL: a file holds one frame. */
    spin_status (*open)(void *self, const struct spin_export_job *job);
    spin_status (*add)(void *self, const struct spin_frame_info *info,
                       const struct spin_splats *splats);
    spin_status (*close)(void *self);
    /* Size in bytes of a file of n splats; an upper bound if `packed`. */
    uint64_t (*bytes)(const void *self, size_t n);
    /* Writes the kept rows. */
    spin_status (*write)(void *self, const struct spin_frame_info *info, struct spin_out *out);
    /* The kept rows in the order of the file. NULL: as sorted by frames->sort. */
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
    struct spin_quant_error quant;            /* of all frames */
    const struct spin_export_job *job;
    double fps;
    struct spin_frames_entry *entry; /* [room] */
    size_t n_entries, room;
    uint64_t n_splats; /* of all entries */
    unsigned char *scratch;
    size_t scratch_bytes;
    struct spin_quant_error *block_quant; /* [blocks] of the current frame, zeroed before write() */
};

/* Makes *self, zeroed before format->begin() is called. */
spin_status spin_frames_begin(const struct spin_frames_format *format,
                              const struct spin_export_job *job, void **self);
spin_status spin_frames_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats);
spin_status spin_frames_end(void *self);
void spin_frames_abort(void *self);
/* Defines an exporter whose struct spin_frames_format is called `format`; see SPIN_EXPORTER(). */
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

/* Writes the kept rows in the source's order, `width` bytes each, from byte `at` of the file on.
 * code() is called on all threads; each block is written straight to its offset. */
typedef void (*spin_frames_code)(void *self, size_t row, unsigned char *out,
                                 struct spin_quant_error *quant);
spin_status spin_frames_write_rows(void *self, struct spin_out *out, uint64_t at, size_t width,
                                   spin_frames_code code);

/* Prints the comment lines of a PLY header: source, frame number, rotation of the axes. */
#define SPIN_FRAMES_MAX_COMMENTS 512
void spin_frames_comments(const struct spin_frames *frames, const struct spin_frame_info *info,
                          char text[SPIN_FRAMES_MAX_COMMENTS]);

/* Logs how much is about to be written; warns if the disk has less free space. */
void spin_frames_say_size(const char *output, int n_frames, uint64_t bytes, bool at_most);
