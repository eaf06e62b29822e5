/* Code that exporters of frames share, see frames.h. The rows of a frame are divided into blocks.
 * Threads encode blocks in parallel, and write each block directly to its offset in the file, so
 * that no second copy of the frame is in memory. */
#include "exporters/lib/frames.h"

#include <stdatomic.h>

#include "base/base.h"
#include "io/ply.h"

/* ---- Sizes ----------------------------------------------------------------------------------- */

void spin_frames_log_size(const char *output, int n_frames, uint64_t bytes, bool at_most)
{
    char size[32], left[32];
    SPIN_FREED char *folder = NULL;
    uint64_t room;

    if (spin_path_folder(output, &folder) != SPIN_OK)
        return;
    room = spin_path_free_bytes(spin_path_is_folder(output) ? output : folder);
    spin_log(0, "writing %d %s to '%s': %s%s", n_frames, n_frames == 1 ? "frame" : "frames", output,
             at_most ? "at most " : "", spin_text_bytes(bytes, size));
    if (bytes > room && !at_most)
        spin_warn("the disk of '%s' has only %s free", output, spin_text_bytes(room, left));
}

static void say_size(const struct spin_frames *x, const struct spin_export_job *job)
{
    uint64_t bytes = 0;

    for (int f = 0; f < job->n_frames && job->counts; f++)
        bytes += x->format->bytes(x, job->counts[f]);
    if (job->counts)
        spin_frames_log_size(x->output, job->n_frames, bytes,
                             x->format->packed || job->counts_are_bounds);
}

/* ---- Begin and end --------------------------------------------------------------------------- */

static void free_frames(struct spin_frames *x)
{
    if (x->format->end)
        x->format->end(x);
    spin_output_folder_end(&x->folder);
    spin_splat_rows_end(&x->rows);
    spin_sort_rows_free(&x->order);
    free(x->output);
    free(x->entry);
    free(x->scratch);
    free(x->block_quant);
    free(x);
}

/* Splits an output such as "out/frame_####.ply" into a folder and a pattern. */
static spin_status split_output(struct spin_frames *x, const struct spin_export_job *job,
                                const char **pattern)
{
    SPIN_TRY(spin_pattern_split(job->output, &x->output, pattern));
    if (*pattern && spin_plugin_value(job->values, "pattern", NULL))
        return spin_misuse("the output '%s' is already a pattern: omit --pattern", job->output);
    return *pattern ? SPIN_OK : spin_strdup(job->output, &x->output);
}

/* Sets x->file, the path of a single output file, if the output has the extension of the format
 * ("clip.spz") and is not an existing folder. */
static spin_status choose_file(struct spin_frames *x, const struct spin_export_job *job)
{
    const char *ending = strchr(x->format->pattern, '.');
    size_t n = strlen(x->output), n_ending = strlen(ending);

    if (n <= n_ending || !spin_text_ends_any_case(x->output, ending) ||
        spin_path_is_folder(x->output))
        return SPIN_OK;
    x->file = x->output;
    if (x->format->open)
        return SPIN_OK;
    if (job->n_frames != 1)
        return spin_misuse("cannot write %d frames to the single file '%s': name a folder "
                           "('%.*s/'), or select one frame with --range",
                           job->n_frames, job->output, (int)(n - n_ending), job->output);
    if (spin_path_is_taken(job->output) && !x->job->force)
        return spin_fail(SPIN_E_IO, "cannot write '%s': it exists; use --force to overwrite",
                         job->output);
    return SPIN_OK;
}

/* Sets *out to the path of a frame's file, which the caller frees. */
static spin_status path_of(const struct spin_frames *x, int number, char **out)
{
    return x->file ? spin_strdup(x->file, out)
                   : spin_pattern_path(&x->pattern, x->folder.path, number, out);
}

static spin_status begin_frames(struct spin_frames *x, const struct spin_export_job *job)
{
    const struct spin_plugin_values *v = job->values;
    const char *pattern;

    x->job = job;
    x->fps = job->fps;
    x->start = -1;
    SPIN_TRY(split_output(x, job, &pattern));
    SPIN_TRY(spin_option_count(v, "start", 0, INT_MAX - job->n_frames, &x->start));
    if (x->format->begin)
        SPIN_TRY(x->format->begin(x, job));
    SPIN_TRY(spin_option_number(v, "fps", 0.001, 1e6, &x->fps));
    SPIN_TRY(choose_file(x, job));
    if (!pattern)
        pattern = spin_plugin_value(v, "pattern", x->format->pattern);
    SPIN_TRY(spin_pattern_parse(pattern, &x->pattern));
    SPIN_TRY(spin_splat_rows_begin(&x->rows, job, x->axes));
    if (x->format->ready)
        SPIN_TRY(x->format->ready(x, job));
    if (x->file && x->format->open)
        return x->format->open(x, job);
    if (!x->file)
        SPIN_TRY(spin_output_folder_begin(x->output, job->force, x->pattern.after, &x->folder));
    say_size(x, job);
    return SPIN_OK;
}

spin_status spin_frames_begin(const struct spin_frames_format *format,
                              const struct spin_export_job *job, void **self)
{
    struct spin_frames *x = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(1, format->self_bytes, (void **)&x));
    x->format = format;
    status = begin_frames(x, job);
    if (status != SPIN_OK) {
        free_frames(x);
        return status;
    }
    *self = x;
    return SPIN_OK;
}

/* ---- sequence.json --------------------------------------------------------------------------- */

spin_status spin_frames_add(struct spin_frames *x, const struct spin_frame_info *info, size_t n)
{
    SPIN_TRY(spin_array_grow(x->n_entries, &x->room, sizeof *x->entry, (void **)&x->entry));
    x->entry[x->n_entries] = (struct spin_frames_entry){
        .number = info->number,
        .source_index = x->job->source_index ? x->job->source_index[x->n_entries] : 0,
        .time = info->time,
        .n = n};
    x->n_entries++;
    x->n_splats += n;
    if (x->rows.report)
        x->rows.report->splats_mean = (double)x->n_splats / (double)x->n_entries;
    return SPIN_OK;
}

static spin_status entries_json(const struct spin_frames *x, spin_json *list)
{
    for (size_t i = 0; i < x->n_entries; i++) {
        const struct spin_frames_entry *e = &x->entry[i];
        spin_json *item = spin_json_object();
        char *path = NULL;

        spin_json_push(list, item);
        SPIN_TRY(spin_pattern_path(&x->pattern, x->folder.path, e->number, &path));
        spin_json_set_string(item, "file", e->file ? e->file : spin_path_name(path));
        free(path);
        spin_json_set_integer(item, "frame", e->number);
        spin_json_set_number(item, "time", e->time);
        if (x->job->source_index)
            spin_json_set_integer(item, "source_index", e->source_index);
        spin_json_set_integer(item, "splats", (int64_t)e->n);
    }
    return SPIN_OK;
}

spin_status spin_frames_write_text(struct spin_frames *x, const char *name, const char *text)
{
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_path_join(x->folder.path, name, &path));
    if (!text)
        return spin_fail(SPIN_E_MEMORY, "not enough memory for '%s'", path);
    spin_output_folder_mark(&x->folder, path);
    if (x->rows.report)
        x->rows.report->bytes += strlen(text);
    return spin_out_whole(path, text, strlen(text), x->job->sync);
}

/* Adds two keys to sequence.json: "identity", which is true if row i is the same splat in all
 * frames, and "data", the path of the data set. "data" is omitted if the scene was rotated, since
 * the cameras of the data set then do not match the splats. */
static spin_status add_belongings(const struct spin_frames *x, spin_json *root)
{
    bool turned = fabs(x->rows.turn_q[0]) < 1 - 1e-9;
    bool same = x->job->identity && !x->sort && !x->format->order;
    SPIN_FREED char *folder = NULL, *path = NULL;

    for (size_t i = 1; i < x->n_entries; i++)
        same = same && x->entry[i].n == x->entry[0].n;
    same = same && !(x->rows.report && x->rows.report->rows_differ);
    spin_json_set_bool(root, "identity", same);
    if (!x->job->data || turned)
        return SPIN_OK;
    SPIN_TRY(spin_path_absolute(x->folder.path, &folder));
    SPIN_TRY(spin_path_relative(folder, x->job->data, &path));
    spin_json_set(root, "data", json_pack("{s:s, s:s}", "path", path, "from", x->job->data_from));
    return SPIN_OK;
}

static spin_status write_sequence(struct spin_frames *x)
{
    spin_json *turn = spin_json_array(), *list = spin_json_array();
    SPIN_LEAVES(spin_json_freed) spin_json *root = spin_json_object();
    SPIN_FREED char *text = NULL;

    spin_json_set_string(root, "generator", "spin4d " SPIN_VERSION);
    spin_json_set_string(root, "format", x->format->name);
    spin_json_set_string(root, "source", x->job->source);
    spin_json_set_bool(root, "retrained", x->job->retrained);
    spin_json_set_number(root, "fps", x->fps > 0 ? x->fps : (double)NAN);
    for (int k = 0; k < 4; k++)
        spin_json_push_number(turn, x->rows.turn_q[k]);
    spin_json_set(root, "turned_by", turn);
    if (x->job->source_index) {
        spin_json_set_integer(root, "source_frames", x->job->n_source_frames);
        spin_json_set_bool(root, "numbered", x->job->numbered);
    }
    if (x->job->pair && *x->job->pair)
        spin_json_set_string(root, "pair", x->job->pair);
    if (x->format->still)
        spin_json_set_string(root, "static", x->format->still);
    SPIN_TRY(add_belongings(x, root));
    spin_json_set(root, "frames", list);
    SPIN_TRY(entries_json(x, list));
    text = spin_json_text(root, true);
    return spin_frames_write_text(x, SPIN_SEQUENCE, text);
}

/* ---- The plug-in's functions ----------------------------------------------------------------- */

static spin_status write_frame(struct spin_frames *x, const struct spin_frame_info *info,
                               struct spin_out *out)
{
    size_t n = spin_splat_rows_blocks(&x->rows);

    SPIN_TRY(spin_grow(n + 1, sizeof *x->block_quant, (void **)&x->block_quant));
    memset(x->block_quant, 0, (n + 1) * sizeof *x->block_quant);
    SPIN_TRY(x->format->write(x, info, out));
    /* Blocks are merged in a fixed order, so that sums are reproducible. */
    for (size_t b = 0; b < n; b++)
        spin_quant_error_merge(&x->quant, &x->block_quant[b]);
    return SPIN_OK;
}

spin_status spin_frames_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats)
{
    struct spin_frames *x = self;
    SPIN_LEAVES(spin_out_abandon) struct spin_out out = {0};
    struct spin_frame_info shifted = *info;
    SPIN_FREED char *path = NULL;
    const char *file = NULL;
    uint64_t length;
    size_t n;

    (void)frame;
    if (x->start >= 0)
        shifted.number = x->start + (int)x->n_entries;
    info = &shifted;
    if (x->file && x->format->add)
        return x->format->add(x, info, splats);
    SPIN_TRY(spin_splat_rows_choose(&x->rows, splats));
    n = x->rows.n_kept;
    if (x->format->begin_frame)
        SPIN_TRY(x->format->begin_frame(x, info, &file));
    if (file) {
        SPIN_TRY(spin_frames_add(x, info, n));
        x->entry[x->n_entries - 1].file = file;
        return SPIN_OK;
    }
    SPIN_TRY(path_of(x, info->number, &path));
    SPIN_TRY(spin_out_open(path, x->job->force, &out));
    out.sync = x->job->sync;
    spin_output_folder_mark(&x->folder, path);
    SPIN_TRY(write_frame(x, info, &out));
    SPIN_TRY(spin_out_length(&out, &length));
    SPIN_TRY(spin_frames_add(x, info, n));
    if (x->rows.report)
        x->rows.report->bytes += length;
    return spin_out_commit(&out);
}

/* Warns if colours were clamped, which is recognised by the RMS error: rounding alone causes 0.0011
 * in .splat and 0.0021 in SPZ, so an error above 0.004 must come from clamping. */
static void warn_clipped(const struct spin_frames *x)
{
    double rms = spin_quant_error_rms(&x->quant, SPIN_QUANT_COLOUR);

    if (x->format->clips_colours && rms > 0.004)
        spin_warn(
            "'%s' clamps bright and dark colours, with errors of up to %.2g on a scale from 0 to "
            "1: write ply, sog or compressed-ply to keep these colours",
            x->format->name, x->quant.part[SPIN_QUANT_COLOUR].largest);
}

spin_status spin_frames_end(void *self)
{
    struct spin_frames *x = self;
    size_t n_empty = 0;
    spin_status status = SPIN_OK;

    if (x->format->finish && !x->file)
        SPIN_TRY_OUT(x->format->finish(x));
    if (!x->file)
        SPIN_TRY_OUT(write_sequence(x));
    else if (x->format->close)
        SPIN_TRY_OUT(x->format->close(x));
    for (size_t i = 0; i < x->n_entries; i++)
        n_empty += x->entry[i].n == 0;
    spin_splat_rows_warn_empty(n_empty, x->n_entries);
    if (x->format->lossy && !x->exact)
        spin_quant_error_log(&x->quant, x->format->name);
    warn_clipped(x);
    if (x->job->check)
        SPIN_TRY_OUT(spin_frames_check(x));
    spin_output_folder_remove_former(&x->folder);
out:
    if (status != SPIN_OK)
        spin_output_folder_abandon(&x->folder);
    free_frames(x);
    return status;
}

/* Aborts the export. Frames that are complete are kept. The folder is removed if it is empty and
 * was created by this export. */
void spin_frames_abort(void *self)
{
    struct spin_frames *x = self;

    spin_output_folder_abandon(&x->folder);
    free_frames(x);
}

/* ---- For write() ----------------------------------------------------------------------------- */

spin_status spin_frames_scratch(struct spin_frames *x, size_t bytes, unsigned char **out)
{
    bytes = (bytes + 63) / 64 * 64; /* rounded up, so that workers do not share a cache line */
    if (bytes > x->scratch_bytes) {
        SPIN_TRY(spin_grow((size_t)spin_splat_rows_workers(&x->rows), bytes, (void **)&x->scratch));
        x->scratch_bytes = bytes;
    }
    *out = x->scratch;
    return SPIN_OK;
}

struct writing {
    struct spin_frames *x;
    struct spin_out *out;
    uint64_t at;
    size_t width, stride;
    spin_frames_code code;
    unsigned char *scratch;
    atomic_int error;
};

static void write_block(void *context, int b)
{
    struct writing *w = context;
    const struct spin_splat_rows *rows = &w->x->rows;
    unsigned char *piece = w->scratch + (size_t)spin_pool_worker() * w->stride, *to = piece;
    size_t first = (size_t)b * SPIN_ROWS_BLOCK, end = first + SPIN_ROWS_BLOCK;
    int error;

    end = end < rows->splats->n ? end : rows->splats->n;
    for (size_t i = first; i < end; i++) {
        if (rows->keep[i]) {
            w->code(w->x, i, to, &w->x->block_quant[b]);
            to += w->width;
        }
    }
    spin_splat_rows_release(rows, (size_t)b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
    error = spin_out_put(w->out, w->at + spin_splat_rows_before(rows, (size_t)b) * w->width, piece,
                         (size_t)(to - piece));
    if (error)
        atomic_store(&w->error, error);
}

spin_status spin_frames_write_rows(void *self, struct spin_out *out, uint64_t at, size_t width,
                                   spin_frames_code code)
{
    struct writing w = {.x = self, .out = out, .at = at, .width = width, .code = code};

    SPIN_TRY(spin_frames_scratch(w.x, SPIN_ROWS_BLOCK * width, &w.scratch));
    w.stride = w.x->scratch_bytes;
    spin_splat_rows_each(&w.x->rows, write_block, &w);
    return w.error ? spin_out_failed(out, w.error) : SPIN_OK;
}

/* ---- Comments -------------------------------------------------------------------------------- */

/* Copies a text, and replaces control characters by '_', so that a name that was read from a file
 * cannot add lines to the header. */
static void copy_printable(const char *text, char *out, size_t n_out)
{
    size_t n = 0;

    for (; text[n] && n + 1 < n_out; n++)
        out[n] = (unsigned char)text[n] < 32 || text[n] == 127 ? '_' : text[n];
    out[n] = '\0';
}

void spin_frames_comments(const struct spin_frames *x, const struct spin_frame_info *info,
                          char text[SPIN_FRAMES_MAX_COMMENTS])
{
    const size_t room = SPIN_FRAMES_MAX_COMMENTS;
    const double *q = x->rows.turn_q;
    char source[64];
    size_t at = (size_t)snprintf(text, room, "comment Generated by spin4d %s\n", SPIN_VERSION);

    if (x->job->source && *x->job->source) {
        copy_printable(x->job->source, source, sizeof source);
        at += (size_t)snprintf(text + at, room - at, "comment source %s%s\n", source,
                               x->job->retrained ? ", attributes retrained" : "");
    }
    at += (size_t)snprintf(text + at, room - at, "comment frame %d, time %.9g\n", info->number,
                           info->time);
    if (x->rows.turn.kind != SPIN_TURN_NONE)
        at += (size_t)snprintf(text + at, room - at,
                               "comment turned by w x y z %.9g %.9g %.9g %.9g\n", q[0], q[1], q[2],
                               q[3]);
    if (x->job->antialias)
        at += (size_t)snprintf(text + at, room - at, SPIN_PLY_ANTIALIASED);
    if (x->rows.up)
        snprintf(text + at, room - at, "comment Vertical axis: y\n");
}
