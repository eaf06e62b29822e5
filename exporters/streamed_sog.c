/* Writes the static splats of a clip as a streamed SOG with levels of detail, and the other splats
 * as one SOG per frame. A single frame is static as a whole. */
#include "base/base.h"
#include "exporters/lib/frames.h"
#include "exporters/lib/sog_levels_out.h"
#include "exporters/lib/static_rows.h"
#include "io/webp.h"

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.sog"),
    SPIN_FRAMES_OPTION_FPS,
    SPIN_ROWS_OPTION_SH,
    {"levels", "N",
     "number of levels of detail, 1 to 8; each has a quarter of the splats of the one before", "4"},
    {"level", "N", "effort of WebP, 0 (fast) to 9 (small)", "3"},
    {0},
};

struct export
{
    struct spin_frames frames;
    struct spin_sog_images images;
    struct spin_sog_levels_out levels;
    struct spin_static_rows still;
};

/* Copies the kept rows, as they are written, to *out. */
static spin_status copy_rows(const struct spin_splat_rows *rows, struct spin_splats *out)
{
    const struct spin_splats *s = rows->splats;
    size_t n_sh = 3 * (size_t)spin_sh_count(rows->sh_degree);
    size_t n_is = 3 * (size_t)spin_splat_rows_n_sh(rows), k = 0;
    float room[3 * SPIN_SH_MAX];

    SPIN_TRY(spin_splats_reserve(out, rows->n_kept, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                                 rows->sh_degree));
    for (size_t i = 0; i < s->n; i++) {
        if (!rows->keep[i])
            continue;
        spin_splat_rows_place(rows, i, out->means + 3 * k);
        spin_splat_rows_turned(rows, i, out->quats + 4 * k);
        for (size_t c = 0; c < 3; c++)
            out->log_scales[3 * k + c] = spin_finite_log_scale(s->log_scales[3 * i + c]);
        out->logit_opacities[k] = spin_finite_logit(s->logit_opacities[i]);
        memset(out->sh + n_sh * k, 0, n_sh * sizeof *out->sh);
        memcpy(out->sh + n_sh * k, spin_splat_rows_sh(rows, i, room), n_is * sizeof *out->sh);
        k++;
    }
    return SPIN_OK;
}

/* Writes the kept rows as streamed SOG. */
static spin_status write_levels(struct export *x)
{
    SPIN_LEAVES(spin_splats_free) struct spin_splats splats = {0};
    const struct spin_export_job *job = x->frames.job;
    size_t n = 0;
    char count[48], coarse[48];

    SPIN_TRY(copy_rows(&x->frames.rows, &splats));
    x->levels.output = &x->frames.folder;
    x->levels.pool = x->frames.rows.pool;
    x->levels.effort = x->images.level;
    x->levels.antialias = job->antialias;
    x->levels.sync = job->sync;
    SPIN_TRY(spin_sog_levels_write(&x->levels, &splats));
    spin_quant_error_merge(&x->frames.quant, &x->levels.quant);
    if (job->report)
        job->report->bytes += x->levels.bytes;
    n = x->levels.counts[x->levels.n_levels - 1];
    spin_log(0, "streamed SOG: %s at level 0, %s at level %d; %zu chunks, %.1f MB",
             spin_text_count((long long)splats.n, "splat", count),
             spin_text_count((long long)n, "splat", coarse), x->levels.n_levels - 1,
             x->levels.n_chunks, (double)x->levels.bytes / 1e6);
    return SPIN_OK;
}

static spin_status streamed_begin_frame(void *self, const struct spin_frame_info *info,
                                        const char **file)
{
    struct export *x = self;

    if (x->frames.job->n_frames == 1) {
        *file = SPIN_SOG_INDEX;
        return x->frames.rows.n_kept > 0 ? write_levels(x)
                                         : spin_unsupported("the frame has no splats to write");
    }
    return spin_static_rows_leave_out(&x->still, &x->frames.rows, info->number);
}

static spin_status streamed_write(void *self, const struct spin_frame_info *info,
                                  struct spin_out *out)
{
    struct export *x = self;
    struct spin_splat_rows *rows = &x->frames.rows;

    (void)info;
    SPIN_TRY(spin_frames_order(&x->frames));
    SPIN_TRY(spin_sog_images_encode(&x->images, rows, x->frames.job->antialias,
                                    x->frames.order.item, x->frames.block_quant));
    SPIN_TRY(spin_sog_images_write_zip(&x->images, out));
    if (x->frames.n_entries == 0) {
        spin_static_rows_only(&x->still, rows);
        SPIN_TRY(write_levels(x));
    }
    return SPIN_OK;
}

static uint64_t streamed_bytes(const void *self, size_t n)
{
    return 2 * spin_sog_images_most_bytes(((const struct export *)self)->frames.rows.sh_degree, n);
}

static spin_status write_index(void *self)
{
    struct export *x = self;

    return x->levels.index ? spin_frames_write_text(&x->frames, SPIN_SOG_INDEX, x->levels.index)
                           : SPIN_OK;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status parse_options(void *self, const struct spin_export_job *job)
{
    struct export *x = self;

    x->frames.sort = spin_sort_rows_by_place;
    x->images.level = 3;
    x->levels.n_levels = 4;
    SPIN_TRY(spin_option_count(job->values, "level", 0, 9, &x->images.level));
    SPIN_TRY(
        spin_option_count(job->values, "levels", 1, SPIN_SOG_MOST_LEVELS, &x->levels.n_levels));
    return spin_webp_need();
}

/* Finds the static splats of a clip. */
static spin_status find_static(void *self, const struct spin_export_job *job)
{
    struct export *x = self;
    char count[48];

    if (job->n_frames == 1)
        return SPIN_OK;
    SPIN_TRY(spin_static_rows_find(&x->still, &x->frames.rows, job));
    if (x->still.n == 0)
        return spin_unsupported(
            "no splat is the same in all %d frames, and only such splats can be "
            "streamed: write the frames with --to sog, or select one frame with "
            "--range",
            job->n_frames);
    spin_log(0, "the same in all frames, and streamed: %s",
             spin_text_count((long long)x->still.n, "splat", count));
    return SPIN_OK;
}

static void free_export(void *self)
{
    struct export *x = self;

    spin_sog_images_free(&x->images);
    spin_sog_levels_out_free(&x->levels);
    spin_static_rows_free(&x->still);
}

static const struct spin_frames_format format = {
    .name = "streamed-sog",
    .importer = "sog",
    .pattern = "frame_%05d.sog",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .packed = true,
    .still = SPIN_SOG_INDEX,
    .begin = parse_options,
    .ready = find_static,
    .bytes = streamed_bytes,
    .begin_frame = streamed_begin_frame,
    .write = streamed_write,
    .finish = write_index,
    .end = free_export,
};

SPIN_FRAMES_EXPORTER(streamed_sog, "streamed-sog",
                     .summary = "a folder with the static splats at several levels of detail, for "
                                "PlayCanvas, and a SOG with the others per frame",
                     .options = options, .antialias = true);
