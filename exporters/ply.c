/* Writes one PLY per frame in the layout of 3D Gaussian Splatting (formats/gs_ply.h). Rotations
 * have unit length and w >= 0, as some viewers assume. The axes are those of the training, unless
 * --up or --rotate rotates the scene. */

#include "exporters/lib/frames.h"
#include "formats/gs_ply.h"

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.ply"),
    SPIN_FRAMES_OPTION_FPS,
    SPIN_ROWS_OPTION_SH,
    {0},
};

static size_t row_bytes(const struct spin_frames *x) { return spin_gs_ply_row(x->rows.sh_degree); }

static void code_row(void *self, size_t i, unsigned char *to, struct spin_quant_error *quant)
{
    const struct spin_frames *x = self;
    const struct spin_splat_rows *rows = &x->rows;
    float room[3 * SPIN_SH_MAX];
    struct spin_gs_ply_row row = {.logit = spin_finite_logit(rows->splats->logit_opacities[i]),
                                  .log_scale = rows->splats->log_scales + 3 * i,
                                  .sh = spin_splat_rows_sh(rows, i, room),
                                  .n_sh = spin_splat_rows_n_sh(rows)};

    (void)quant; /* floats are not rounded, so there is no error to report */
    spin_splat_rows_place(rows, i, row.place);
    spin_splat_rows_turned(rows, i, row.rotation);
    spin_gs_ply_code(&row, rows->sh_degree, to);
}

/* ---- One file -------------------------------------------------------------------------------- */

static size_t make_header(const struct spin_frames *x, const struct spin_frame_info *info, size_t n,
                          char text[SPIN_GS_PLY_MAX_HEADER])
{
    char comments[SPIN_FRAMES_MAX_COMMENTS];

    spin_frames_comments(x, info, comments);
    return spin_gs_ply_header(x->rows.sh_degree, n, comments, text);
}

static uint64_t ply_bytes(const void *self, size_t n)
{
    static const struct spin_frame_info info;
    char text[SPIN_GS_PLY_MAX_HEADER];

    return make_header(self, &info, n, text) + (uint64_t)n * row_bytes(self);
}

static spin_status ply_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct spin_frames *x = self;
    char text[SPIN_GS_PLY_MAX_HEADER];
    size_t n_header = make_header(x, info, x->rows.n_kept, text);

    SPIN_TRY(spin_out_write_at(out, 0, text, n_header));
    return spin_frames_write_rows(x, out, n_header, row_bytes(x), code_row);
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static const struct spin_frames_format format = {
    .name = "ply",
    .pattern = "frame_%05d.ply",
    .self_bytes = sizeof(struct spin_frames),
    .bytes = ply_bytes,
    .write = ply_write,
};

SPIN_FRAMES_EXPORTER(
    ply, "ply",
    .summary = "a folder with one 3D Gaussian Splatting PLY per frame, for every viewer",
    .options = options, .checks = true, .antialias = true);
