/* Writes glTF 2.0 with KHR_gaussian_splatting (formats/glb.h): a folder with one .glb per frame or,
 * if the output's name ends in .glb, a single file with the whole clip.
 *
 * Vertex data cannot change over time in glTF. A clip is therefore stored as one node per frame,
 * and an animation with STEP interpolation sets the scale of each node: 1 while the frame of the
 * node is shown, 0 otherwise. An additional key frame at the end repeats the last value, so that
 * players show the last frame for its whole duration. Values of an attribute that are the same in
 * several frames are stored once. --still-apart moves the splats that are equal in all frames
 * (lib/static_rows.h) to a separate node without animation. This node is the first of the scene:
 * players that draw meshes one by one then draw the static splats first.
 *
 * Differences from the PLY of 3D Gaussian Splatting: quaternions are x y z w, scales and opacities
 * are stored after their activation (exp, sigmoid), and each SH coefficient has its own accessor.
 * The axes of glTF are x left, y up, z forward; those of the training are x right, y down, z
 * forward. A rotation by 180 degrees about z converts between them: x and y change sign,
 * quaternions are multiplied from the left by w x y z = (0, 0, 0, 1), and SH coefficients of odd
 * order m change sign.
 *
 * In the file, each attribute is an array over all splats of a frame. Rows are converted in blocks,
 * and the values of a block are written directly to their offsets in these arrays, so that no
 * second copy of the frame is in memory. */
#include <stdatomic.h>

#include "base/base.h"
#include "exporters/lib/frames.h"
#include "exporters/lib/static_rows.h"
#include "formats/glb.h"

#define DEFAULT_FPS 30
#define BLOCK SPIN_ROWS_BLOCK

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.glb"),
    SPIN_ROWS_OPTION_SH,
    {"axes", "gltf|source",
     "axes to write without --up; gltf: half a turn about z, to x left, y up, z forward", "gltf"},
    {"fps", "F", "frames per second of a clip in one file; default: the bundle's, else 30", NULL},
    {"still-apart", NULL,
     "for a clip in one file: store splats that are the same in all frames once, in a node of "
     "their own",
     NULL},
    {0},
};

struct export
{
    /* Rows and options. frames.folder is not used if the output is a single file. */
    struct spin_frames frames;
    struct spin_glb_clip clip;      /* description of the current file */
    struct spin_glb_column *column; /* [clip.n_columns] the columns written so far */
    size_t column_room;

    /* The following members are for a clip in a single file. */
    struct spin_out out;
    int n_done;
    struct spin_glb_frame *frame;  /* [clip.n_frames] */
    struct spin_glb_frame shared;  /* the static splats of --still-apart */
    struct spin_static_rows still; /* the source rows of the static splats */
};

/* ---- Rows ------------------------------------------------------------------------------------ */

struct writing {
    struct export *x;
    const struct spin_glb_frame *frame;
    bool fresh[SPIN_GLB_MAX_ATTRIBUTES]; /* true: values that the file does not yet contain */
    unsigned char *scratch;
    float *bounds; /* [blocks][6] minimum x y z, maximum x y z of the positions in a block */
    /* [blocks][attributes] hashes of the columns, set by the hashing pass; NULL: writing pass. */
    uint64_t (*hash)[2];
    atomic_int error;
};

/* Converts the rows of a block to columns. In the hashing pass, hashes all columns; in the writing
 * pass, writes those for which w->fresh is true. */
static void write_block(void *context, int number)
{
    struct writing *w = context;
    const struct export *x = w->x;
    const struct spin_splat_rows *rows = &x->frames.rows;
    const struct spin_glb_clip *clip = &x->clip;
    unsigned char *column[SPIN_GLB_MAX_ATTRIBUTES];
    unsigned char *to = w->scratch + (size_t)spin_pool_worker() * x->frames.scratch_bytes;
    size_t b = (size_t)number, i = b * BLOCK, end = i + BLOCK, n = 0;
    float *bounds = w->bounds + 6 * b;
    int error = 0;

    for (int a = 0; a < clip->n_attributes; to += BLOCK * clip->width[a++])
        column[a] = to;
    for (int c = 0; c < 6; c++)
        bounds[c] = c < 3 ? INFINITY : -INFINITY;
    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        struct spin_gaussian row;
        float room[3 * SPIN_SH_MAX];

        if (!rows->keep[i])
            continue;
        spin_splat_rows_get(rows, i, &row);
        spin_glb_code(clip, &row, spin_splat_rows_sh(rows, i, room), spin_splat_rows_n_sh(rows),
                      column, n++);
        for (int c = 0; c < 3; c++) {
            bounds[c] = spin_minf(bounds[c], row.place[c]);
            bounds[3 + c] = spin_maxf(bounds[3 + c], row.place[c]);
        }
    }
    for (int a = 0; a < clip->n_attributes && w->hash; a++)
        spin_static_hash(w->hash[number * clip->n_attributes + a], column[a],
                         n * clip->width[a] / 4);
    if (w->hash)
        return;
    spin_splat_rows_release(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
    spin_glb_order(clip, column, n);
    for (int a = 0; a < clip->n_attributes && !error; a++)
        if (w->fresh[a])
            error = spin_glb_put(clip,
                                 x->column[w->frame->column[a]].offset +
                                     spin_splat_rows_before(rows, b) * clip->width[a],
                                 column[a], n * clip->width[a]);
    if (error)
        atomic_store(&w->error, error);
}

/* Assigns a column of the file to each attribute of the frame: an existing column with the same
 * hash or, if there is none or w->hash is NULL, a new column. */
static spin_status find_columns(struct writing *w, struct spin_glb_frame *frame)
{
    struct export *x = w->x;
    struct spin_glb_clip *clip = &x->clip;
    size_t n_blocks = spin_splat_rows_blocks(&x->frames.rows), n = (size_t)clip->n_attributes;

    for (size_t a = 0; a < n; a++) {
        struct spin_glb_column now = {.attribute = (int)a, .n = frame->n, .offset = clip->n_bytes};
        size_t same = clip->n_columns;

        for (size_t b = 0; b < n_blocks && w->hash; b++)
            spin_static_hash(now.hash, w->hash[b * n + a], sizeof *w->hash / 4);
        for (size_t i = 0; i < clip->n_columns && w->hash && same == clip->n_columns; i++) {
            const struct spin_glb_column *was = &x->column[i];

            if (was->attribute == now.attribute && was->n == now.n &&
                memcmp(was->hash, now.hash, sizeof now.hash) == 0)
                same = i;
        }
        frame->column[a] = same;
        w->fresh[a] = same == clip->n_columns;
        if (!w->fresh[a])
            continue;
        SPIN_TRY(spin_array_grow(clip->n_columns, &x->column_room, sizeof *x->column,
                                 (void **)&x->column));
        x->column[clip->n_columns++] = now;
        clip->n_bytes += frame->n * clip->width[a];
    }
    clip->column = x->column;
    return SPIN_OK;
}

/* Appends the kept rows to the file. For a clip, a first pass hashes the attributes to find those
 * that the file already contains. */
static spin_status write_rows(struct export *x, const struct spin_frame_info *info,
                              struct spin_glb_frame *frame)
{
    size_t n_blocks = spin_splat_rows_blocks(&x->frames.rows);
    struct writing w = {.x = x, .frame = frame};
    spin_status status;

    *frame = (struct spin_glb_frame){
        .n = x->frames.rows.n_kept, .number = info->number, .time = info->time};
    if (frame->n == 0)
        return SPIN_OK;
    SPIN_TRY(spin_frames_scratch(&x->frames, BLOCK * x->clip.row, &w.scratch));
    SPIN_TRY_OUT(spin_alloc(n_blocks, 6 * sizeof *w.bounds, (void **)&w.bounds));
    if (x->clip.n_frames > 1) {
        SPIN_TRY_OUT(
            spin_alloc(n_blocks * (size_t)x->clip.n_attributes, sizeof *w.hash, (void **)&w.hash));
        spin_splat_rows_each(&x->frames.rows, write_block, &w);
    }
    SPIN_TRY_OUT(find_columns(&w, frame));
    free(w.hash);
    w.hash = NULL;
    spin_splat_rows_each(&x->frames.rows, write_block, &w);
    for (int c = 0; c < 3; c++) {
        struct spin_glb_column *places = &x->column[frame->column[SPIN_GLB_POSITION]];

        places->low[c] = INFINITY;
        places->high[c] = -INFINITY;
        for (size_t b = 0; b < n_blocks; b++) {
            places->low[c] = spin_minf(places->low[c], w.bounds[6 * b + (size_t)c]);
            places->high[c] = spin_maxf(places->high[c], w.bounds[6 * b + 3 + (size_t)c]);
        }
    }
    status = w.error ? spin_glb_failed(&x->clip, w.error) : SPIN_OK;
out:
    free(w.hash);
    free(w.bounds);
    return status;
}

/* ---- Files ----------------------------------------------------------------------------------- */

static spin_status gltf_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;
    struct spin_glb_frame frame;

    x->clip.out = out;
    x->clip.frame = &frame;
    x->clip.n_columns = 0;
    x->clip.n_bytes = 0;
    SPIN_TRY(write_rows(x, info, &frame));
    return spin_glb_end(&x->clip);
}

static uint64_t gltf_bytes(const void *self, size_t n)
{
    return spin_glb_bytes(&((const struct export *)self)->clip, n);
}

/* Sets *row to the rows in the order in which the importer reads a frame: first the rows of the
 * frame's node, then the static splats. If there are no static splats, sets *row to NULL, which
 * means the order of the source. */
static spin_status gltf_order(void *self, const struct spin_keyed **row)
{
    struct export *x = self;

    *row = NULL;
    return x->still.n > 0 ? spin_static_rows_order(&x->still, &x->frames.rows, 0, row) : SPIN_OK;
}

/* Appends a frame to the single file. The static splats of --still-apart are written only once,
 * after the other splats of the first frame. */
static spin_status add_to_file(void *self, const struct spin_frame_info *info,
                               const struct spin_splats *s)
{
    struct export *x = self;
    struct spin_splat_rows *rows = &x->frames.rows;
    double all;
    size_t n;

    SPIN_TRY(spin_splat_rows_choose(rows, s));
    n = rows->n_kept;
    if (x->still.n > 0)
        SPIN_TRY(spin_static_rows_leave_out(&x->still, rows, info->number));
    all = (double)x->clip.row *
          ((double)x->still.n + (double)rows->n_kept * (double)x->clip.n_frames);
    if (x->n_done == 0 && all > (double)UINT32_MAX) /* warn early: writing may take hours */
        spin_warn(
            "%d frames as large as the first need up to %.1f GB, but a .glb cannot exceed 4.3 GB: "
            "reduce the clip with --range, --sh or --min-opacity, or write a folder",
            x->clip.n_frames, all / 1e9);
    SPIN_TRY(write_rows(x, info, &x->frame[x->n_done]));
    if (x->n_done == 0 && x->still.n > 0) {
        spin_static_rows_only(&x->still, rows);
        SPIN_TRY(write_rows(x, info, &x->shared));
    }
    x->n_done++;
    return spin_frames_add(&x->frames, info, n);
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status parse_options(void *self, const struct spin_export_job *job)
{
    static const double half_about_z[4] = {0, 0, 0, 1};
    const struct spin_plugin_values *v = job->values;
    struct export *x = self;
    int axes;

    SPIN_TRY(spin_glb_can_write());
    SPIN_TRY(spin_option_word(v, "axes", "gltf|source", &axes));
    x->frames.axes = axes == 0 ? half_about_z : NULL;
    x->frames.fps = job->fps > 0 ? job->fps : DEFAULT_FPS;
    return SPIN_OK;
}

/* Sets x->clip, the description of the files to be written, after all options have been read. */
static spin_status begin_clip(void *self, const struct spin_export_job *job)
{
    struct export *x = self;
    const struct spin_splat_rows *rows = &x->frames.rows;
    bool single = x->frames.file != NULL;

    if (spin_plugin_value(job->values, "still-apart", NULL) && !single)
        return spin_misuse("--still-apart needs a clip in a single file: name the output OUT.glb");

    x->clip = (struct spin_glb_clip){
        .out = &x->out,
        .sh_degree = rows->sh_degree,
        .axes = rows->up                            ? "y up"
                : rows->turn.kind == SPIN_TURN_NONE ? "as in the source"
                : x->frames.axes && !spin_plugin_value(job->values, "rotate", NULL)
                    ? "glTF, from x right, y down, z forward"
                    : "turned by --rotate",
        .source = job->source,
        .fps = x->frames.fps,
        .antialias = job->antialias,
        .n_frames = single ? job->n_frames : 1,
        .animated = single && job->n_frames > 1,
    };
    spin_glb_begin(&x->clip);
    return SPIN_OK;
}

static void free_export(void *self)
{
    struct export *x = self;

    spin_out_abandon(&x->out);
    free(x->frame);
    free(x->column);
    spin_static_rows_free(&x->still);
}

static spin_status open_single(void *self, const struct spin_export_job *job)
{
    struct export *x = self;
    size_t n;
    char count[48];

    SPIN_TRY(spin_alloc((size_t)job->n_frames + 1, sizeof *x->frame, (void **)&x->frame));
    if (job->n_frames > 1 && spin_plugin_value(job->values, "still-apart", NULL)) {
        SPIN_TRY(spin_static_rows_find(&x->still, &x->frames.rows, job));
        spin_log(0, "written only once, since identical in all frames: %s",
                 spin_text_count((long long)x->still.n, "splat", count));
    }
    SPIN_TRY(spin_out_open(job->output, job->force, &x->out));
    x->out.sync = job->sync;
    n = x->still.n;
    for (int f = 0; f < job->n_frames && job->counts; f++)
        n += job->counts[f] - x->still.n;
    /* The size is only an upper bound if options drop splats, or if there are several frames, which
     * may share columns. */
    if (job->counts)
        spin_frames_log_size(job->output, job->n_frames, gltf_bytes(x, n),
                             job->n_frames > 1 || job->counts_are_bounds);
    return SPIN_OK;
}

static spin_status close_single(void *self)
{
    struct export *x = self;
    uint64_t length;

    x->clip.n_frames = x->n_done;
    x->clip.animated = x->n_done > 1;
    x->clip.frame = x->frame;
    x->clip.still = &x->shared;
    SPIN_TRY(spin_glb_end(&x->clip));
    SPIN_TRY(spin_out_length(&x->out, &length));
    if (x->frames.rows.report)
        x->frames.rows.report->bytes = length;
    return spin_out_commit(&x->out);
}

static const struct spin_frames_format format = {
    .name = "gltf",
    .pattern = "frame_%05d.glb",
    .self_bytes = sizeof(struct export),
    .begin = parse_options,
    .ready = begin_clip,
    .open = open_single,
    .add = add_to_file,
    .close = close_single,
    .bytes = gltf_bytes,
    .write = gltf_write,
    .order = gltf_order,
    .end = free_export,
};

SPIN_FRAMES_EXPORTER(
    gltf, "gltf",
    .summary = "GLB with KHR_gaussian_splatting: one per frame, or one with the clip (OUT.glb)",
    .options = options, .checks = true);
