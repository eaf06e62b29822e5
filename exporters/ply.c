/* One PLY per frame in the layout of 3D Gaussian Splatting's reference implementation (Kerbl et al.
 * 2023), which every viewer reads: binary little endian, element vertex, all properties float, in
 * the order x y z, nx ny nz, f_dc, f_rest, opacity, scale, rot.
 *
 * f_rest is channel-major: all coefficients of red, then green, then blue; ours lie the other way.
 * Rotations are written at unit length with w >= 0, which some viewers assume. Axes are those of the
 * training unless --up or --rotate turn them. */
#include <string.h>

#include "exporters/lib/frames.h"
#include "io/ply.h"

#define MAX_HEADER 4096

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.ply"),
    SPIN_ROWS_OPTION_SH,
    {0},
};

static size_t n_rest(const struct spin_frames *x)
{
    return 3 * (size_t)spin_sh_count(x->rows.sh_degree) - 3;
}

static size_t row_bytes(const struct spin_frames *x) { return (17 + n_rest(x)) * sizeof(float); }

/* ---- Rows ------------------------------------------------------------------------------------ */

/* [coefficient][channel] to channel-major, n of the n_to coefficients are there. */
static void write_sh(const float *sh, size_t n, size_t n_to, float *out)
{
    memcpy(out, sh, 3 * sizeof *out);
    out += 3;
    for (size_t c = 0; c < 3; c++) {
        for (size_t k = 1; k < n; k++)
            *out++ = sh[3 * k + c];
        for (size_t k = n; k < n_to; k++)
            *out++ = 0.0f;
    }
}

static void code_row(void *self, size_t i, unsigned char *to, struct spin_quant_error *quant)
{
    const struct spin_frames *x = self;
    const struct spin_splat_filter *rows = &x->rows;
    size_t n_to = (size_t)spin_sh_count(rows->sh_degree);
    float room[3 * SPIN_SH_MAX], *out = (float *)(void *)to;

    (void)quant; /* nothing is lost */
    spin_splat_filter_place(rows, i, out);
    memset(out + 3, 0, 3 * sizeof *out); /* normals */
    write_sh(spin_splat_filter_sh(rows, i, room), (size_t)spin_splat_filter_n_sh(rows), n_to,
             out + 6);
    out += 6 + 3 * n_to;
    out[0] = spin_splat_filter_logit(rows->splats->logit_opacities[i]);
    memcpy(out + 1, rows->splats->log_scales + 3 * i, 3 * sizeof *out);
    spin_splat_filter_turned(rows, i, out + 4);
    spin_splat_filter_little_endian(to, row_bytes(x) / 4);
}

/* ---- One file -------------------------------------------------------------------------------- */

static size_t make_header(const struct spin_frames *x, const struct spin_frame_info *info, size_t n,
                          char text[MAX_HEADER])
{
    size_t at = (size_t)snprintf(text, MAX_HEADER, "ply\nformat binary_little_endian 1.0\n");

    at += spin_frames_comments(x, info, text + at, MAX_HEADER - at);
    at += (size_t)snprintf(text + at, MAX_HEADER - at,
                           "element vertex %zu\n"
                           "property float x\nproperty float y\nproperty float z\n"
                           "property float nx\nproperty float ny\nproperty float nz\n"
                           "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n",
                           n);
    for (size_t i = 0; i < n_rest(x); i++)
        at += (size_t)snprintf(text + at, MAX_HEADER - at, "property float f_rest_%zu\n", i);
    at +=
        (size_t)snprintf(text + at, MAX_HEADER - at,
                         "property float opacity\n"
                         "property float scale_0\nproperty float scale_1\nproperty float scale_2\n"
                         "property float rot_0\nproperty float rot_1\nproperty float rot_2\n"
                         "property float rot_3\nend_header\n");
    return at;
}

static uint64_t ply_bytes(const void *self, size_t n)
{
    static const struct spin_frame_info info;
    char text[MAX_HEADER];

    return make_header(self, &info, n, text) + (uint64_t)n * row_bytes(self);
}

static spin_status ply_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct spin_frames *x = self;
    char text[MAX_HEADER];
    size_t n_header = make_header(x, info, x->rows.n_kept, text);

    SPIN_TRY(spin_out_write_at(out, 0, text, n_header));
    return spin_frames_write_rows(x, out, n_header, row_bytes(x), code_row);
}

/* The very header that would be written, and rows to its end. */
static bool ply_complete(void *self, const struct spin_frame_info *info, const struct spin_map *map,
                         size_t *n)
{
    char text[MAX_HEADER];
    size_t n_header = make_header(self, info, 0, text);

    if (map->size < n_header)
        return false;
    *n = (map->size - n_header) / row_bytes(self); /* digits of the count are fewer than a row */
    n_header = make_header(self, info, *n, text);
    return map->size == n_header + *n * row_bytes(self) && memcmp(map->data, text, n_header) == 0;
}

/* Every property by its name. */
static spin_status ply_read(void *self, const struct spin_map *map, int frame,
                            struct spin_splats *out)
{
    const struct spin_frames *x = self;
    size_t n_sh = (size_t)spin_sh_count(x->rows.sh_degree), n_targets = 0;
    struct spin_ply_target target[14 + 3 * SPIN_SH_MAX];
    const struct spin_ply_element *e;
    struct spin_ply ply;
    spin_status status;

    (void)frame;
    SPIN_TRY(spin_ply_parse("PLY", map->data, map->size, &ply));
    e = spin_ply_find_element(&ply, "vertex");
    if (!e) {
        status = spin_fail(SPIN_E_MALFORMED, "no element 'vertex'");
        goto out;
    }
    SPIN_TRY_OUT(spin_splats_reserve(out, (size_t)e->count, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                                     x->rows.sh_degree));
    for (size_t i = 0; i < 11 + 3 * n_sh; i++) {
        static const char *const plain[] = {"x",       "y",       "z",       "opacity",
                                            "scale_0", "scale_1", "scale_2", "rot_0",
                                            "rot_1",   "rot_2",   "rot_3"};
        float *const into[] = {out->means,           out->means + 1,  out->means + 2,
                               out->logit_opacities, out->log_scales, out->log_scales + 1,
                               out->log_scales + 2,  out->quats,      out->quats + 1,
                               out->quats + 2,       out->quats + 3};
        static const size_t step[] = {3, 3, 3, 1, 3, 3, 3, 4, 4, 4, 4};
        size_t k = i < 11 ? 0 : i - 11, rest = k < 3 ? 0 : k - 3;
        size_t c = k < 3 ? k : rest / (n_sh - 1);
        size_t coefficient = k < 3 ? 0 : 1 + rest % (n_sh - 1);
        char name[32];

        if (i < 11)
            snprintf(name, sizeof name, "%s", plain[i]);
        else
            snprintf(name, sizeof name, k < 3 ? "f_dc_%zu" : "f_rest_%zu", k < 3 ? k : rest);
        target[n_targets] =
            (struct spin_ply_target){.property = spin_ply_find(e, name),
                                     .out = i < 11 ? into[i] : out->sh + 3 * coefficient + c,
                                     .step = i < 11 ? step[i] : 3 * n_sh};
        if (target[n_targets++].property < 0) {
            status = spin_fail(SPIN_E_MALFORMED, "no property '%s'", name);
            goto out;
        }
    }
    spin_ply_columns(&ply, e, target, n_targets);
out:
    spin_ply_close(&ply);
    return status;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static const struct spin_frames_format format = {
    .name = "ply",
    .pattern = "frame_%05d.ply",
    .self_bytes = sizeof(struct spin_frames),
    .bytes = ply_bytes,
    .write = ply_write,
    .complete = ply_complete,
    .read = ply_read,
};

static spin_status ply_begin(const struct spin_export_job *job, void **self)
{
    return spin_frames_begin(&format, job, self);
}

extern const struct spin_exporter spin_exporter_ply;
const struct spin_exporter spin_exporter_ply = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "ply",
    .summary = "a folder with one 3D Gaussian Splatting PLY per frame, for every viewer",
    .options = options,
    .checks = true,
    .antialias = true,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = ply_begin,
    .frame = spin_frames_frame,
    .end = spin_frames_end,
    .abort = spin_frames_abort,
    .skip = spin_frames_skip,
};
