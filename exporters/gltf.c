/* glTF 2.0 with KHR_gaussian_splatting (formats/glb.h): one .glb per frame in a folder, or, when the
 * output's name ends in .glb, one file with the whole clip.
 *
 * glTF has no vertex data that changes with time, so the clip is a node per frame, and an animation
 * that switches them: STEP keys on their scale, 1 while a frame is shown and else 0. A key after the
 * last frame repeats its value, or players would cut it. --visibility switches KHR_node_visibility
 * by KHR_animation_pointer instead, which is what they are for; of the players only Babylon.js knows it.
 * An attribute that is the same in two frames, in all rows, lies in the file once: their meshes share it.
 * With --still-apart the splats that are the same in all frames (lib/still_rows.h) are in one node more,
 * which nothing switches; it comes first in the scene, for players that draw mesh after mesh.
 *
 * Against 3D Gaussian Splatting: quaternions are x y z w, scales and opacities are finished (after
 * exp and sigmoid), one accessor holds one SH coefficient. glTF's axes are x left, y up, z forward;
 * those of a camera's world x right, y down, z forward. Half a turn about z brings one to the other:
 * x and y change sign, the quaternion is multiplied by (0, 0, 0, 1) on the left, SH coefficients of
 * odd order change sign.
 *
 * Attributes lie one after the other in the file, splats in memory; blocks of rows are taken apart
 * and each piece is written to its place, so that a frame is never held twice. */
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "exporters/lib/frames.h"
#include "exporters/lib/still_rows.h"
#include "base/log.h"
#include "base/option.h"
#include "base/mem.h"
#include "formats/glb_scene.h"

#define DEFAULT_FPS 30
#define BLOCK SPIN_ROWS_BLOCK

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.glb"),
    SPIN_ROWS_OPTION_SH,
    {"axes", "gltf|source",
     "axes to write without --up; gltf: x left, y up, z forward, half a turn about z", "gltf"},
    {"fps", "F", "frames per second of a clip in one file; otherwise the bundle's, else 30", NULL},
    {"visibility", NULL,
     "of a clip in one file: switch frames by KHR_node_visibility, which few players know", NULL},
    {"still-apart", NULL,
     "of a clip in one file: splats that are the same in all frames lies in it once, in a node of its own",
     NULL},
    {"no-fallback", NULL, "leave out COLOR_0, for viewers that draw plain points", NULL},
    {0},
};

/* Attribute `which` of n rows, as it lies in the file. */
struct written {
    int which;
    uint64_t n, offset, hash[2];
};

struct export
{
    struct spin_frames frames; /* of one per file; its rows and options serve both */
    bool single;               /* all in one file */
    bool visibility;           /* what the animation switches, instead of scale */
    const char *extras[5];
    bool fallback;
    struct spin_gs_glb_layout layout;
    uint64_t n_bytes; /* of the binary chunk so far */

    /* All in one file. */
    struct spin_out out;
    struct spin_glb glb;
    int n_frames, n_done;
    struct spin_gltf_frame *frame; /* [n_frames] */
    struct spin_gltf_frame shared; /* what all frames show */
    struct written *written;       /* [n_written] attributes so far */
    size_t n_written, written_room;
    struct spin_still_rows still;  /* the same, as rows */
};

/* ---- The clip -------------------------------------------------------------------------------- */

static struct spin_gltf_clip describe(const struct export *x, const struct spin_gltf_frame *frame,
                                      int n_frames)
{
    return (struct spin_gltf_clip){
        .generator = "spin4d " SPIN_VERSION,
        .extras = x->extras,
        .fps = x->frames.fps,
        .extension = SPIN_GS_GLB_EXTENSION,
        .extension_values = spin_gs_glb_values,
        .attribute = x->layout.attribute,
        .n_attributes = x->layout.n,
        .frame = frame,
        .n_frames = n_frames,
        .still = x->still.n > 0 ? &x->shared : NULL,
        .animated = x->single && n_frames > 1,
        .visibility = x->visibility,
        .n_bytes = x->n_bytes,
    };
}

/* ---- Rows ------------------------------------------------------------------------------------ */

struct writing {
    struct export *x;
    struct spin_glb *glb;
    struct spin_gltf_frame *frame;
    unsigned char *scratch;
    float *bounds; /* [blocks][6] low, high */
    atomic_int error;
    uint64_t (*hash)[2]; /* [blocks][attributes], when rows are only looked at */
};

/* Row i of the frame to row `at` of the block's columns. */
static void put_row(const struct export *x, unsigned char *const column[], size_t i, size_t at)
{
    const struct spin_splat_filter *rows = &x->frames.rows;
    struct spin_gaussian row;
    float room[3 * SPIN_SH_MAX];

    spin_splat_filter_take(rows, i, &row);
    spin_gs_glb_code(&x->layout, &row, spin_splat_filter_sh(rows, i, room),
                     spin_splat_filter_n_sh(rows), column, at);
}

static void widen(float *bounds, const float *place)
{
    for (int c = 0; c < 3; c++) {
        bounds[c] = spin_minf(bounds[c], place[c]);
        bounds[3 + c] = spin_maxf(bounds[3 + c], place[c]);
    }
}

/* Each attribute of a block to its place. */
static int put_block(const struct writing *w, unsigned char *const column[], uint64_t first,
                     size_t n)
{
    const struct spin_gs_glb_layout *layout = &w->x->layout;
    uint64_t at = w->frame->offset;
    int error = 0;

    spin_gs_glb_order(layout, column, n);
    for (int a = 0; a < layout->n && !error; a++) {
        if (w->frame->elsewhere[a])
            continue;
        error =
            spin_glb_put(w->glb, at + first * layout->width[a], column[a], n * layout->width[a]);
        at += w->frame->n * layout->width[a];
    }
    return error;
}

/* Two numbers of 64 bits, mixed by different factors: equal ones mean equal bytes. */
static void mix(uint64_t hash[2], uint64_t word)
{
    hash[0] = (hash[0] ^ word) * 0x9e3779b97f4a7c15u;
    hash[0] ^= hash[0] >> 29;
    hash[1] = (hash[1] + word) * 0xd6e8feb86659fd93u;
    hash[1] ^= hash[1] >> 32;
}

static void hash_block(const struct writing *w, int number, unsigned char *const column[], size_t n)
{
    const struct spin_gs_glb_layout *layout = &w->x->layout;

    for (int a = 0; a < layout->n; a++) {
        uint64_t *hash = w->hash[number * layout->n + a];

        for (size_t i = 0; i < n * layout->width[a]; i += 4) { /* no attribute has odd bytes */
            uint32_t word;

            memcpy(&word, column[a] + i, sizeof word);
            mix(hash, word);
        }
    }
}

static void write_block(void *context, int number, int worker)
{
    struct writing *w = context;
    const struct spin_splat_filter *rows = &w->x->frames.rows;
    unsigned char *column[SPIN_GS_GLB_MAX_ATTRIBUTES];
    unsigned char *at = w->scratch + (size_t)worker * w->x->frames.scratch_bytes;
    size_t i = (size_t)number * BLOCK, end = i + BLOCK, n = 0;
    float *bounds = w->bounds + 6 * (size_t)number;
    int error;

    for (int a = 0; a < w->x->layout.n; a++) {
        column[a] = at;
        at += BLOCK * w->x->layout.width[a];
    }
    for (int c = 0; c < 6; c++)
        bounds[c] = c < 3 ? INFINITY : -INFINITY;
    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        if (rows->keep[i]) {
            put_row(w->x, column, i, n);
            widen(bounds, (float *)(void *)column[0] + 3 * n++);
        }
    }
    if (w->hash) {
        hash_block(w, number, column, n);
        return;
    }
    spin_splat_filter_rest(rows, (size_t)number, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
    error = put_block(w, column, spin_splat_filter_before(rows, (size_t)number), n);
    if (error)
        atomic_store(&w->error, error);
}

/* The chosen rows, at frame->offset; fills in the frame's bounds. */
static spin_status write_rows(struct export *x, struct spin_glb *glb, struct spin_gltf_frame *frame)
{
    struct writing w = {.x = x, .glb = glb, .frame = frame};
    size_t n_blocks = spin_splat_filter_blocks(&x->frames.rows);

    SPIN_TRY(spin_frames_scratch(&x->frames, BLOCK * SPIN_GS_GLB_MAX_ROW, &w.scratch));
    SPIN_TRY(spin_alloc(n_blocks + 1, 6 * sizeof *w.bounds, (void **)&w.bounds));
    spin_splat_filter_each(&x->frames.rows, write_block, &w);
    for (int c = 0; c < 3; c++) {
        frame->low[c] = INFINITY;
        frame->high[c] = -INFINITY;
        for (size_t b = 0; b < n_blocks; b++) {
            frame->low[c] = spin_minf(frame->low[c], w.bounds[6 * b + (size_t)c]);
            frame->high[c] = spin_maxf(frame->high[c], w.bounds[6 * b + 3 + (size_t)c]);
        }
    }
    free(w.bounds);
    return w.error ? spin_glb_failed(glb, w.error) : SPIN_OK;
}

/* Which attributes of the frame lie in the file already; the others are remembered for those to come. */
static spin_status find_written(struct export *x, struct spin_gltf_frame *frame)
{
    struct writing w = {.x = x, .frame = frame};
    size_t n_blocks = spin_splat_filter_blocks(&x->frames.rows), n = (size_t)x->layout.n;
    uint64_t at = frame->offset;
    spin_status status;

    SPIN_TRY(spin_frames_scratch(&x->frames, BLOCK * SPIN_GS_GLB_MAX_ROW, &w.scratch));
    SPIN_TRY(spin_alloc((n_blocks + 1) * n, sizeof *w.hash, (void **)&w.hash));
    SPIN_TRY_OUT(spin_alloc(n_blocks + 1, 6 * sizeof *w.bounds, (void **)&w.bounds));
    spin_splat_filter_each(&x->frames.rows, write_block, &w);
    for (size_t a = 0; a < n; a++) {
        struct written now = {.which = (int)a, .n = frame->n, .offset = at};

        for (size_t b = 0; b < n_blocks; b++)
            for (int k = 0; k < 2; k++)
                mix(now.hash, w.hash[b * n + a][k]);
        for (size_t i = 0; i < x->n_written && !frame->elsewhere[a]; i++) {
            const struct written *was = &x->written[i];

            if (was->which == now.which && was->n == now.n &&
                memcmp(was->hash, now.hash, sizeof now.hash) == 0)
                frame->elsewhere[a] = was->offset + 1;
        }
        if (frame->elsewhere[a])
            continue;
        SPIN_TRY_OUT(spin_room(x->n_written, &x->written_room, sizeof *x->written,
                               (void **)&x->written));
        x->written[x->n_written++] = now;
        at += frame->n * x->layout.width[a];
    }
    status = SPIN_OK;
out:
    free(w.hash);
    free(w.bounds);
    return status;
}

/* ---- Files ----------------------------------------------------------------------------------- */

static struct spin_gltf_frame begin_frame(const struct export *x,
                                          const struct spin_frame_info *info)
{
    return (struct spin_gltf_frame){.n = x->frames.rows.n_kept,
                                    .offset = x->n_bytes,
                                    .number = info->number,
                                    .time = info->time};
}

static spin_status gltf_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;
    struct spin_gltf_frame frame;
    struct spin_gltf_clip clip;
    struct spin_glb glb;

    x->n_bytes = 0;
    frame = begin_frame(x, info);
    x->n_bytes = frame.n * x->layout.row;
    clip = describe(x, &frame, 1);
    SPIN_TRY(spin_glb_begin(out, &clip, &glb));
    SPIN_TRY(write_rows(x, &glb, &frame));
    return spin_glb_end(&glb, &clip);
}

static uint64_t gltf_bytes(const void *self, size_t n)
{
    const struct export *x = self;

    return 2048 + (uint64_t)n * x->layout.row + 256 * (uint64_t)x->layout.n; /* JSON: about */
}

/* A frame of a file where all frames share some. */
static spin_status read_scene(const struct spin_map *map, int frame, struct spin_splats *out)
{
    struct spin_gs_glb_scene scene = {0};
    spin_status status = spin_gs_glb_scene_open(map->data, map->size, &scene);

    if (status == SPIN_OK && (size_t)frame >= scene.n_frames)
        status = spin_fail(SPIN_E_MALFORMED, "frame %d of %zu", frame, scene.n_frames);
    if (status == SPIN_OK)
        status = spin_gs_glb_scene_read(&scene, (size_t)frame, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                                        out);
    spin_gs_glb_scene_close(&scene);
    return status;
}

static spin_status gltf_read(void *self, const struct spin_map *map, int frame,
                             struct spin_splats *out)
{
    const struct export *x = self;
    struct spin_glb_file glb = {0};
    spin_status status;

    if (x->still.n > 0)
        return read_scene(map, frame, out);
    status = spin_glb_open(map->data, map->size, &glb);
    if (status == SPIN_OK)
        status =
            spin_gs_glb_read_node(&glb, (size_t)frame, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, out);
    spin_glb_close(&glb);
    return status;
}

/* The node of what all frames share lies behind those of the frames. */
static spin_status gltf_order(void *self, const uint32_t **row)
{
    struct export *x = self;

    *row = NULL;
    return x->still.n > 0 ? spin_still_rows_order(&x->still, &x->frames.rows, 0, row) : SPIN_OK;
}

/* All frames of one size would not fit: said before the hours of writing, not after. */
static void warn_if_large(const struct export *x, uint64_t n_bytes)
{
    double all = (double)x->still.n * (double)x->layout.row + (double)n_bytes * x->n_frames;

    if (x->n_done == 0 && all > (double)UINT32_MAX)
        spin_warn("%d frames like the first may be %.1f GB, a .glb ends at 4.3 GB; see --range, --sh "
                  "and --min-opacity, or give a folder",
                  x->n_frames, all / 1e9);
}

/* Rows chosen, behind what is there. */
static spin_status append_rows(struct export *x, const struct spin_frame_info *info,
                               struct spin_gltf_frame *frame)
{
    *frame = begin_frame(x, info);
    if (x->n_frames > 1 && frame->n > 0)
        SPIN_TRY(find_written(x, frame));
    SPIN_TRY(write_rows(x, &x->glb, frame));
    for (int a = 0; a < x->layout.n; a++)
        x->n_bytes += frame->elsewhere[a] ? 0 : frame->n * x->layout.width[a];
    return SPIN_OK;
}

/* The rows that this frame alone has; what all frames share goes with the first. */
static spin_status add_to_file(struct export *x, const struct spin_frame_info *info,
                               const struct spin_splats *s)
{
    struct spin_splat_filter *rows = &x->frames.rows;
    size_t n;

    SPIN_TRY(spin_splat_filter_choose(rows, s, info->number));
    n = rows->n_kept;
    if (x->still.n > 0)
        SPIN_TRY(spin_still_rows_leave_out(&x->still, rows, info->number));
    warn_if_large(x, rows->n_kept * x->layout.row);
    SPIN_TRY(append_rows(x, info, &x->frame[x->n_done]));
    if (x->n_done == 0 && x->still.n > 0) {
        spin_still_rows_only(&x->still, rows);
        SPIN_TRY(append_rows(x, info, &x->shared));
    }
    x->n_done++;
    return spin_frames_add(&x->frames, info, n);
}

/* Frame f is shown from its own key on; the last one also at the last key. */
static bool is_shown(size_t f, size_t key, size_t n_keys)
{
    return key == f || (key == f + 1 && key + 1 == n_keys);
}

static spin_status write_scales(struct export *x, uint64_t at, size_t n, float *key)
{
    for (size_t f = 0; f + 1 < n; f++, at += 3 * n * sizeof *key) {
        for (size_t i = 0; i < 3 * n; i++)
            key[i] = is_shown(f, i / 3, n);
        spin_little_endian(key, 3 * n);
        SPIN_TRY(spin_glb_write(&x->glb, at, key, 3 * n * sizeof *key));
    }
    x->n_bytes = at;
    return SPIN_OK;
}

static spin_status write_visibilities(struct export *x, uint64_t at, size_t n, unsigned char *key)
{
    size_t n_padded = (n + 3) / 4 * 4;

    for (size_t f = 0; f + 1 < n; f++, at += n_padded) {
        for (size_t i = 0; i < n_padded; i++)
            key[i] = i < n && is_shown(f, i, n);
        SPIN_TRY(spin_glb_write(&x->glb, at, key, n_padded));
    }
    x->n_bytes = at;
    return SPIN_OK;
}

/* Key i is at i / fps. */
static spin_status write_keys(struct export *x, uint64_t at)
{
    size_t n = (size_t)x->n_frames + 1;
    float *key = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(n, 3 * sizeof *key, (void **)&key));
    for (size_t i = 0; i < n; i++)
        key[i] = (float)((double)i / x->frames.fps);
    spin_little_endian(key, n);
    SPIN_TRY_OUT(spin_glb_write(&x->glb, at, key, n * sizeof *key));
    at += n * sizeof *key;
    status = x->visibility ? write_visibilities(x, at, n, (unsigned char *)key)
                           : write_scales(x, at, n, key);
out:
    free(key);
    return status;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static bool ends_in_glb(const char *path)
{
    size_t n = strlen(path);

    return n > 4 && strcmp(path + n - 4, ".glb") == 0;
}

static spin_status begin(void *self, const struct spin_export_job *job)
{
    static const double half_about_z[4] = {0, 0, 0, 1};
    const struct spin_plugin_values *v = job->values;
    struct export *x = self;
    int axes;

    SPIN_TRY(spin_option_word(v, "axes", "gltf|source", &axes));
    x->frames.axes = axes == 0 ? half_about_z : NULL;
    x->fallback = spin_plugin_value(v, "no-fallback", NULL) == NULL;
    x->visibility = spin_plugin_value(v, "visibility", NULL) != NULL;
    if (x->visibility && !x->single)
        return spin_fail(SPIN_E_USAGE, "--visibility is for a clip in one file, OUT.glb");
    if (spin_plugin_value(v, "still-apart", NULL) && !x->single)
        return spin_fail(SPIN_E_USAGE, "--still-apart is for a clip in one file, OUT.glb");
    x->frames.fps = job->fps > 0 ? job->fps : DEFAULT_FPS;
    return spin_option_number(v, "fps", 0.001, 1e6, &x->frames.fps);
}

/* With the options read. */
static void ready(void *self, const struct spin_export_job *job)
{
    struct export *x = self;
    bool plain = x->frames.rows.turn.kind == SPIN_TURN_NONE;

    x->extras[0] = "axes";
    x->extras[1] = x->frames.rows.up ? "y up"
                   : plain           ? "as in the source"
                   : x->frames.axes && !spin_plugin_value(job->values, "rotate", NULL)
                       ? "glTF, from x right, y down, z forward"
                       : "turned by --rotate";
    if (job->source && *job->source) {
        x->extras[2] = "source";
        x->extras[3] = job->source;
    }
    spin_gs_glb_begin(&x->layout, x->frames.rows.sh_degree, x->fallback);
}

static const struct spin_frames_format format = {
    .name = "gltf",
    .pattern = "frame_%05d.glb",
    .self_bytes = sizeof(struct export),
    .begin = begin,
    .ready = ready,
    .bytes = gltf_bytes,
    .write = gltf_write,
    .read = gltf_read,
    .order = gltf_order,
};

static void finish(struct export *x)
{
    free(x->frame);
    free(x->written);
    spin_still_rows_free(&x->still);
    spin_frames_free(&x->frames);
}

static void say_size(const struct export *x, const struct spin_export_job *job)
{
    uint64_t bytes = 0;

    for (int f = 0; f < job->n_frames && job->counts; f++)
        bytes += gltf_bytes(x, job->counts[f] - x->still.n);
    bytes += x->still.n * x->layout.row;
    if (job->counts)
        spin_frames_say_size(job->output, job->n_frames, bytes, /* frames share what is the same */
                             job->n_frames > 1 || x->frames.rows.min_logit > -INFINITY);
}

static spin_status open_single(struct export *x, const struct spin_export_job *job)
{
    struct spin_gltf_clip worst;

    SPIN_TRY(begin(x, job));
    SPIN_TRY(spin_splat_filter_begin(&x->frames.rows, job, x->frames.axes));
    ready(x, job);
    x->n_frames = job->n_frames;
    SPIN_TRY(spin_alloc((size_t)job->n_frames + 1, sizeof *x->frame, (void **)&x->frame));
    if (job->n_frames > 1 && spin_plugin_value(job->values, "still-apart", NULL)) {
        SPIN_TRY(spin_still_rows_find(&x->still, &x->frames.rows, job));
        spin_log(0, "%zu splats are the same in all frames", x->still.n);
    }
    worst = describe(x, x->frame, x->n_frames);
    SPIN_TRY(spin_out_open(job->output, job->force, &x->out));
    x->out.sync = job->sync;
    SPIN_TRY(spin_glb_begin(&x->out, &worst, &x->glb));
    say_size(x, job);
    return SPIN_OK;
}

static spin_status begin_single(const struct spin_export_job *job, void **self)
{
    struct export *x = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->frames.format = &format;
    x->frames.job = job;
    x->single = true;
    status = open_single(x, job);
    if (status != SPIN_OK) {
        spin_out_abandon(&x->out);
        finish(x);
        return status;
    }
    *self = x;
    return SPIN_OK;
}

static spin_status gltf_begin(const struct spin_export_job *job, void **self)
{
    if (ends_in_glb(job->output))
        return begin_single(job, self);
    return spin_frames_begin(&format, job, self);
}

static spin_status gltf_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats)
{
    struct export *x = self;

    return x->single ? add_to_file(x, info, splats) : spin_frames_frame(self, frame, info, splats);
}

static spin_status end_single(struct export *x)
{
    uint64_t keys_offset = x->n_bytes, length;
    struct spin_gltf_clip clip;

    x->n_frames = x->n_done;
    if (x->n_frames > 1)
        SPIN_TRY(write_keys(x, keys_offset));
    clip = describe(x, x->frame, x->n_frames);
    clip.keys_offset = keys_offset;
    SPIN_TRY(spin_glb_end(&x->glb, &clip));
    SPIN_TRY(spin_out_length(&x->out, &length));
    if (x->frames.rows.report)
        x->frames.rows.report->bytes = length;
    SPIN_TRY(spin_out_commit(&x->out));
    return x->frames.job->check ? spin_frames_check(&x->frames, x->frames.job->output) : SPIN_OK;
}

static spin_status gltf_end(void *self)
{
    struct export *x = self;
    spin_status status;

    if (!x->single)
        return spin_frames_end(self);
    status = end_single(x);
    spin_out_abandon(&x->out);
    finish(x);
    return status;
}

static void gltf_abort(void *self)
{
    struct export *x = self;

    if (!x->single) {
        spin_frames_abort(self);
        return;
    }
    spin_out_abandon(&x->out);
    finish(x);
}

extern const struct spin_exporter spin_exporter_gltf;
const struct spin_exporter spin_exporter_gltf = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "gltf",
    .summary = "GLB with KHR_gaussian_splatting: one per frame, or one with the clip (OUT.glb)",
    .options = options,
    .checks = true,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = gltf_begin,
    .frame = gltf_frame,
    .end = gltf_end,
    .abort = gltf_abort,
};
