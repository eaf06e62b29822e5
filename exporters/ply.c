/* One PLY per frame in the layout of 3D Gaussian Splatting's reference implementation (Kerbl et al.
 * 2023), which every viewer reads: binary little endian, element vertex, all properties float, in
 * the order x y z, nx ny nz, f_dc, f_rest, opacity, scale, rot.
 *
 * f_rest is channel-major: all coefficients of red, then green, then blue; ours lie the other way.
 * Rotations are written at unit length with w >= 0, which some viewers assume. Axes stay those of
 * the training. A row that no viewer could draw (a NaN or infinity, a rotation of length zero) is
 * left out, as NaN scales are known to hang viewers; how many is said once per frame. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "io/folder.h"

/* Rows per piece: 248 bytes a row, about half a megabyte. */
#define BLOCK 2048
#define MAX_ROW 62
/* In place of an infinite logit: the sigmoid is within 1e-13 of 0 or 1, and finite. */
#define LOGIT_LIMIT 30.0f

static const struct spin_plugin_option options[] = {
    {"pattern", "PATTERN", "file names; one %d or %0Nd stands for the frame number",
     "frame_%05d.ply"},
    {"sh", "DEGREE", "SH degree to write, 0 to 3: cut off, or filled up with zeros; keep: as it is",
     "keep"},
    {"min-opacity", "V", "leave out splats whose opacity is below V, 0 to 1", "0"},
    {0},
};

/* A validated --pattern, taken apart. */
struct pattern {
    const char *text;
    int n_before; /* bytes before the field */
    bool zeros;
    int width;
    const char *after; /* rest after the field */
};

struct export
{
    struct spin_out_folder folder;
    struct pattern pattern;
    bool force;
    const char *source;
    int sh_degree;       /* written */
    float min_logit;     /* rows below are left out */
    unsigned char *keep; /* [n_keep] */
    size_t n_keep;
    float block[BLOCK * MAX_ROW];
};

/* ---- Options --------------------------------------------------------------------------------- */

static spin_status fail_pattern(const char *text)
{
    return spin_fail(SPIN_E_USAGE,
                     "--pattern '%s': expected a file name with exactly one %%d or %%0Nd, N 1 to 9",
                     text);
}

static spin_status parse_pattern(const char *text, struct pattern *out)
{
    const char *field = strchr(text, '%');
    const char *at;

    *out = (struct pattern){.text = text};
    if (!field || strchr(text, '/'))
        return fail_pattern(text);
    at = field + 1;
    if (*at == '0') {
        out->zeros = true;
        at++;
        if (*at < '1' || *at > '9')
            return fail_pattern(text);
        out->width = *at++ - '0';
    }
    if (*at != 'd' || strchr(at, '%'))
        return fail_pattern(text);
    out->n_before = (int)(field - text);
    out->after = at + 1;
    return SPIN_OK;
}

static spin_status parse_sh(const char *text, int kept, int *out)
{
    *out = kept < 0 ? 0 : kept;
    if (strcmp(text, "keep") == 0)
        return SPIN_OK;
    if (text[0] < '0' || text[0] > '3' || text[1])
        return spin_fail(SPIN_E_USAGE, "--sh '%s': expected 0, 1, 2, 3 or keep", text);
    *out = text[0] - '0';
    return SPIN_OK;
}

static spin_status parse_min_opacity(const char *text, float *out)
{
    char *end;
    double value = strtod(text, &end);

    if (end == text || *end || !(value >= 0 && value < 1))
        return spin_fail(SPIN_E_USAGE, "--min-opacity '%s': expected a number from 0 to below 1",
                         text);
    *out = value > 0 ? (float)log(value / (1 - value)) : -INFINITY;
    return SPIN_OK;
}

/* ---- Rows ------------------------------------------------------------------------------------ */

/* x * 0 is 0 for a finite x and NaN for any other: a sum of them tells without a branch. */
static float zeros_of(const float *x, size_t n)
{
    float sum = 0;

    for (size_t i = 0; i < n; i++)
        sum += x[i] * 0.0f;
    return sum;
}

static float square_of(const float q[4])
{
    return q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
}

/* Is everything of this row a number, and the rotation one. An infinite logit is a saturated
 * opacity and can be written; so can quaternions whose square leaves the range of float. */
static bool row_is_sane(const struct spin_splats *s, size_t i, size_t n_sh)
{
    const float *q = s->quats + 4 * i;
    float sum = zeros_of(s->means + 3 * i, 3) + zeros_of(q, 4) +
                zeros_of(s->log_scales + 3 * i, 3) + zeros_of(s->sh + i * n_sh, n_sh);

    return sum == 0.0f && !isnan(s->logit_opacities[i]) && (q[0] || q[1] || q[2] || q[3]);
}

/* Mark the rows to write; how many there are, and how many were not sane. */
static size_t choose_rows(struct export *x, const struct spin_splats *s, size_t *n_bad)
{
    size_t side = (size_t)s->sh_degree + 1, n_kept = 0;

    *n_bad = 0;
    for (size_t i = 0; i < s->n; i++) {
        bool sane = row_is_sane(s, i, 3 * side * side);

        x->keep[i] = sane && s->logit_opacities[i] >= x->min_logit;
        n_kept += x->keep[i];
        *n_bad += !sane;
    }
    return n_kept;
}

/* Unit length, w >= 0. A quaternion that already is of unit length keeps its bits. */
static void write_rotation(const float q[4], float out[4])
{
    float square = square_of(q), scale;

    if (square > 1e-30f && square < 1e30f) {
        scale = fabsf(square - 1.0f) <= 2e-7f ? 1.0f : 1.0f / sqrtf(square);
        scale = q[0] < 0 ? -scale : scale;
        for (int i = 0; i < 4; i++)
            out[i] = q[i] * scale;
        return;
    }
    double wide = 0, sign = q[0] < 0 ? -1 : 1;

    for (int i = 0; i < 4; i++)
        wide += (double)q[i] * q[i];
    for (int i = 0; i < 4; i++)
        out[i] = (float)(sign * q[i] / sqrt(wide));
}

/* [coefficient][channel] to channel-major, n_from coefficients in, n_to out, without the first. */
static void write_sh_rest(const float *sh, size_t n_from, size_t n_to, float *out)
{
    size_t n_both = n_from < n_to ? n_from : n_to;

    for (size_t c = 0; c < 3; c++) {
        for (size_t k = 1; k < n_both; k++)
            *out++ = sh[3 * k + c];
        for (size_t k = n_both; k < n_to; k++)
            *out++ = 0.0f;
    }
}

static void write_row(const struct spin_splats *s, size_t i, size_t n_from, size_t n_to, float *out)
{
    const float *sh = s->sh + i * 3 * n_from;
    float logit = s->logit_opacities[i];

    memcpy(out, s->means + 3 * i, 3 * sizeof(float));
    memset(out + 3, 0, 3 * sizeof(float)); /* normals */
    memcpy(out + 6, sh, 3 * sizeof(float));
    write_sh_rest(sh, n_from, n_to, out + 9);
    out += 6 + 3 * n_to;
    out[0] = isinf(logit) ? copysignf(LOGIT_LIMIT, logit) : logit;
    memcpy(out + 1, s->log_scales + 3 * i, 3 * sizeof(float));
    write_rotation(s->quats + 4 * i, out + 4);
}

/* The file is little endian; so is every machine this was built on, and others swap here. */
static void to_little_endian(float *value, size_t n)
{
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    for (size_t i = 0; i < n; i++) {
        uint32_t bits;

        memcpy(&bits, &value[i], sizeof bits);
        bits = __builtin_bswap32(bits);
        memcpy(&value[i], &bits, sizeof bits);
    }
#else
    (void)value;
    (void)n;
#endif
}

/* ---- One file -------------------------------------------------------------------------------- */

/* Names come from a file: no line of theirs may become a line of ours. */
static void copy_printable(const char *text, char *out, size_t n_out)
{
    size_t n = 0;

    for (; text[n] && n + 1 < n_out; n++)
        out[n] = (unsigned char)text[n] < 32 || text[n] == 127 ? '_' : text[n];
    out[n] = '\0';
}

static spin_status write_header(const struct export *x, size_t n, struct spin_out *out)
{
    size_t n_rest = 3 * (size_t)((x->sh_degree + 1) * (x->sh_degree + 1) - 1);
    char text[4096], source[64];
    int at = snprintf(text, sizeof text,
                      "ply\nformat binary_little_endian 1.0\ncomment Generated by spin4d %s\n",
                      SPIN_VERSION);

    if (x->source && *x->source) {
        copy_printable(x->source, source, sizeof source);
        at += snprintf(text + at, sizeof text - (size_t)at, "comment source %s\n", source);
    }
    at += snprintf(text + at, sizeof text - (size_t)at,
                   "element vertex %zu\n"
                   "property float x\nproperty float y\nproperty float z\n"
                   "property float nx\nproperty float ny\nproperty float nz\n"
                   "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n",
                   n);
    for (size_t i = 0; i < n_rest; i++)
        at += snprintf(text + at, sizeof text - (size_t)at, "property float f_rest_%zu\n", i);
    at += snprintf(text + at, sizeof text - (size_t)at,
                   "property float opacity\n"
                   "property float scale_0\nproperty float scale_1\nproperty float scale_2\n"
                   "property float rot_0\nproperty float rot_1\nproperty float rot_2\n"
                   "property float rot_3\nend_header\n");
    return spin_out_write(out, text, (size_t)at);
}

static spin_status write_rows(struct export *x, const struct spin_splats *s, struct spin_out *out)
{
    size_t n_from = (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    size_t n_to = (size_t)((x->sh_degree + 1) * (x->sh_degree + 1));
    size_t width = 14 + 3 * n_to, n = 0;

    for (size_t i = 0; i < s->n; i++) {
        if (x->keep[i])
            write_row(s, i, n_from, n_to, x->block + width * n++);
        if (n == BLOCK || (n > 0 && i + 1 == s->n)) {
            to_little_endian(x->block, width * n);
            SPIN_TRY(spin_out_write(out, x->block, width * n * sizeof(float)));
            n = 0;
        }
    }
    return SPIN_OK;
}

static spin_status write_file(struct export *x, const char *path, const struct spin_splats *s,
                              size_t n_kept)
{
    struct spin_out out;
    spin_status status;

    SPIN_TRY(spin_out_open(path, x->force, &out));
    SPIN_TRY_OUT(write_header(x, n_kept, &out));
    SPIN_TRY_OUT(write_rows(x, s, &out));
    return spin_out_commit(&out);
out:
    spin_out_abandon(&out);
    return status;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static void finish(struct export *x)
{
    free(x->keep);
    free(x);
}

static spin_status ply_begin(const struct spin_export_job *job, void **self)
{
    const struct spin_plugin_values *v = job->values;
    struct export *x = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->force = job->force;
    x->source = job->source;
    SPIN_TRY_OUT(parse_pattern(spin_plugin_value(v, "pattern", "frame_%05d.ply"), &x->pattern));
    SPIN_TRY_OUT(parse_sh(spin_plugin_value(v, "sh", "keep"), job->sh_degree, &x->sh_degree));
    SPIN_TRY_OUT(parse_min_opacity(spin_plugin_value(v, "min-opacity", "0"), &x->min_logit));
    SPIN_TRY_OUT(spin_out_folder_begin(job->output, job->force, &x->folder));
    if (x->folder.n_before > 0)
        spin_warn("folder '%s' was not empty: files that are not overwritten stay in it",
                  job->output);
    *self = x;
    return SPIN_OK;
out:
    finish(x);
    return status;
}

static spin_status ply_frame(void *self, int frame, const struct spin_frame_info *info,
                             const struct spin_splats *splats)
{
    struct export *x = self;
    const struct pattern *p = &x->pattern;
    char name[512], *path = NULL;
    size_t n_kept, n_bad;
    spin_status status;

    (void)frame;
    if (splats->n > x->n_keep) {
        SPIN_TRY(spin_grow(splats->n, 1, (void **)&x->keep));
        x->n_keep = splats->n;
    }
    n_kept = choose_rows(x, splats, &n_bad);
    if (n_bad > 0)
        spin_warn("frame %d: %zu of %zu splats left out: they hold NaN, infinity or a rotation of "
                  "length zero",
                  info->number, n_bad, splats->n);
    if (snprintf(name, sizeof name, p->zeros ? "%.*s%0*d%s" : "%.*s%*d%s", p->n_before, p->text,
                 p->width, info->number, p->after) >= (int)sizeof name)
        return spin_fail(SPIN_E_USAGE, "--pattern makes too long a name: '%.40s...'", name);
    SPIN_TRY(spin_path_join(x->folder.path, name, &path));
    status = write_file(x, path, splats, n_kept);
    free(path);
    return status;
}

static spin_status ply_end(void *self)
{
    struct export *x = self;

    spin_out_folder_end(&x->folder);
    finish(x);
    return SPIN_OK;
}

static void ply_abort(void *self)
{
    struct export *x = self;

    spin_out_folder_abandon(&x->folder);
    finish(x);
}

extern const struct spin_exporter spin_exporter_ply;
const struct spin_exporter spin_exporter_ply = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "ply",
    .summary = "a folder with one 3D Gaussian Splatting PLY per frame, for every viewer",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = ply_begin,
    .frame = ply_frame,
    .end = ply_end,
    .abort = ply_abort,
};
