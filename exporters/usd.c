/* Writes a USD stage of ParticleField3DGaussianSplat (the schema of OpenUSD 26.03): OUT/clip.usda,
 * which plays one layer per frame by value clips. All files are text, so no library is needed.
 *
 * With value clips, a reader opens only the layer of the frame that it shows. A single text file
 * with the time samples of all frames would have to be parsed as a whole: gigabytes for a clip of a
 * minute. The time samples of a layer have the path of the prim in the stage, so a layer can also
 * be opened on its own.
 *
 * The layout follows OpenUSD's schema and its guide to value clips: scales are standard deviations,
 * opacities are 0 to 1, orientations are w x y z, and SH is one float3 per coefficient, splat after
 * splat. The axes are x right, y up, z back: those of the training, rotated by 180 degrees about x.
 *
 * Attributes that are the same in all frames are stored once, in still.usda, a sublayer of the
 * stage and of each layer. Numbers are half floats by default, printed with the fewest digits that
 * read back as the same half; positions have enough digits to resolve a millionth of the diagonal
 * of the first frame's bounding box. The cameras of the data set and the camera of --path are
 * UsdGeomCamera prims. Only the ratio of a camera's focal length to its aperture matters, so all
 * apertures have the same width. */
#include "base/base.h"
#include "exporters/lib/camera_path.h"
#include "exporters/lib/frames.h"
#include "math/ntc.h"
#include "math/project.h"
#include "math/sh.h"

#define DEFAULT_FPS 30
#define BATCH 8          /* number of blocks of rows that are printed in parallel, then written */
#define NUMBER 16        /* number of characters of the longest number, with separators */
#define MAX_FLOATS 48    /* largest number of floats of one row in an attribute */
#define LEAST_HALF 6e-8f /* the smallest positive half float */
#define MOST_HALF 65504.0f
#define PRIM "Splats"
#define STILL "still.usda"
#define APERTURE 36.0 /* horizontal aperture of every camera */
#define COLOUR_SPACE "    prepend apiSchemas = [\"ColorSpaceAPI\"]\n"

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.usda"),
    SPIN_ROWS_OPTION_SH,
    SPIN_FRAMES_OPTION_FPS,
    {"axes", "usd|source", "axes to write without --up; usd: x right, y up, half a turn about x",
     "usd"},
    {"float", NULL, "write floats with all digits instead of half floats", NULL},
    {"path", "orbit|spiral|train|FILE",
     "add a moving camera, as in --to images, over the whole clip", NULL},
    {"meters-per-unit", "M", "metres per unit of the scene", "1"},
    {0},
};

enum attribute { POSITIONS, ORIENTATIONS, SCALES, OPACITIES, SH, ATTRIBUTES };

struct form {
    /* type_half, name_half: type and name of the attribute if it consists of half floats; NULL: it
     * always consists of floats. */
    const char *type, *name, *type_half, *name_half;
};

static const struct form forms[ATTRIBUTES] = {
    {"point3f[]", "positions", NULL, NULL},
    {"quatf[]", "orientations", "quath[]", "orientationsh"},
    {"float3[]", "scales", "half3[]", "scalesh"},
    {"float[]", "opacities", "half[]", "opacitiesh"},
    {"float3[]", "radiance:sphericalHarmonicsCoefficients", "half3[]",
     "radiance:sphericalHarmonicsCoefficientsh"},
};

struct export
{
    struct spin_frames frames;
    double codes; /* number of time codes from one frame to the next */
    bool half;
    double meters;     /* metres per unit of the scene */
    int decimals;      /* decimal places of positions, which the first frame determines; unused with
                          --float */
    unsigned still;    /* bit mask: if bit a is 1, attribute a has the same values in all frames */
    char(*halves)[10]; /* [65536] the decimal text of each half float, indexed by the bits of the
                          half */

    /* The following members describe the camera of --path. */
    struct spin_camera_path path;
    bool has_path;
    /* [n_pictures] all poses; NULL before the first frame and without --path. */
    struct spin_camera *camera;

    /* The following members describe the current batch of blocks. */
    enum attribute attribute;
    size_t first;                 /* index of the batch's first block */
    char *text;                   /* [BATCH][stride] text of each block */
    size_t n_text[BATCH], stride; /* length of each block's text, and capacity for one block */
};

/* ---- Numbers --------------------------------------------------------------------------------- */

static float as_half(float v, float least)
{
    float h = spin_half(v);

    return h < least ? least : h > MOST_HALF ? MOST_HALF : h;
}

static bool is_half(const struct export *x) { return x->half && forms[x->attribute].type_half; }

/* Prints v like "%.*g", but removes the plus sign and leading zeros of the exponent. */
static void print_short(char to[24], int digits, double v)
{
    char *e, *from;

    snprintf(to, 24, "%.*g", digits, v);
    e = strchr(to, 'e');
    if (!e)
        return;
    e += e[1] == '-' ? 2 : 1;
    from = e + strspn(e, "+0");
    memmove(e, from, strlen(from) + 1);
}

static uint32_t bits_of_half(float h)
{
    uint32_t bits = spin_bits_of_float(h), sign = bits >> 16 & 0x8000u;

    if (fabsf(h) < 6.1035156e-5f) /* 2^-14 */
        return sign | (uint32_t)(fabsf(h) * 16777216.0f);
    return sign | (((bits >> 13) - (112u << 10)) & 0x7fffu);
}

static float float_of_half(uint32_t half)
{
    uint32_t exponent = half >> 10 & 31u, fraction = half & 1023u;
    float a = exponent ? ldexpf((float)(1024u + fraction), (int)exponent - 25)
                       : ldexpf((float)fraction, -24);

    return half & 0x8000u ? -a : a;
}

static spin_status make_halves(struct export *x)
{
    SPIN_TRY(spin_alloc(65536, sizeof *x->halves, (void **)&x->halves));
    for (uint32_t half = 0; half < 65536; half++) {
        float h = float_of_half(half), back = h + 1;

        if ((half & 0x7c00u) == 0x7c00u) /* infinity and NaN are never written */
            continue;
        for (int digits = 1; digits < 6 && back != h; digits++) {
            char text[24];

            print_short(text, digits, (double)h);
            memcpy(x->halves[half], text, sizeof x->halves[half] - 1);
            back = spin_half(strtof(text, NULL));
        }
    }
    return SPIN_OK;
}

/* Prints a value of the current attribute and returns the length of the text. */
static int print_value(const struct export *x, float v, char *to)
{
    int n;

    if (is_half(x))
        return sprintf(to, "%s", x->halves[bits_of_half(v)]);
    if (x->attribute != POSITIONS || !x->half)
        return sprintf(to, "%.9g", (double)v);
    n = sprintf(to, "%.*f", x->decimals, (double)v);
    while (x->decimals > 0 && to[n - 1] == '0')
        n--;
    n -= to[n - 1] == '.';
    return strncmp(to, "-0", (size_t)n) == 0 ? sprintf(to, "0") : n;
}

/* Returns the value that a reader gets from the text of coordinate v. */
static float rounded_place(const struct export *x, float v)
{
    char text[64];

    if (!x->half)
        return v;
    snprintf(text, sizeof text, "%.*f", x->decimals, (double)v);
    return strtof(text, NULL);
}

/* Copies the values of the current attribute of row i to `out`, adds the rounding errors of the
 * values to quant, and returns the number of values. Sets *group to the number of values in a
 * tuple. */
static size_t take_row(const struct export *x, size_t i, float out[MAX_FLOATS], size_t *group,
                       struct spin_quant_error *quant)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t n_sh = 3 * (size_t)spin_splat_rows_n_sh(rows);
    size_t n = 3 * (size_t)spin_sh_count(rows->sh_degree);
    struct spin_gaussian is, shown;
    float room[3 * SPIN_SH_MAX], lost[MAX_FLOATS];

    spin_splat_rows_get(rows, i, &is);
    shown = is;
    *group = 3;
    switch (x->attribute) {
    case POSITIONS:
        for (int c = 0; c < 3; c++)
            out[c] = rounded_place(x, is.place[c]);
        spin_quant_error_add_place(quant, is.place, out);
        return 3;
    case ORIENTATIONS:
        for (int k = 0; k < 4; k++)
            out[k] = is_half(x) ? spin_half(is.rotation[k]) : is.rotation[k];
        spin_unit_rotation(out, shown.rotation);
        spin_quant_error_add_rotation(quant, is.rotation, shown.rotation);
        *group = 4;
        return 4;
    case SCALES:
        for (int c = 0; c < 3; c++) {
            out[c] = expf(is.log_scale[c]);
            if (is_half(x))
                out[c] = as_half(out[c], LEAST_HALF);
            shown.log_scale[c] = logf(out[c]);
        }
        spin_quant_error_add_3(quant, SPIN_QUANT_SCALE, is.log_scale, shown.log_scale);
        return 3;
    case OPACITIES:
        out[0] = is_half(x) ? spin_half(is.opacity) : is.opacity;
        spin_quant_error_add(quant, SPIN_QUANT_OPACITY, (double)is.opacity - (double)out[0]);
        *group = 1;
        return 1;
    default:
        memset(out, 0, n * sizeof *out);
        memcpy(out, spin_splat_rows_sh(rows, i, room), n_sh * sizeof *out);
        for (size_t k = 0; k < n; k++) {
            float v = out[k];

            out[k] = is_half(x) ? as_half(v, -MOST_HALF) : v;
            lost[k] = v - out[k];
        }
        spin_quant_error_add_sh(quant, lost + 3, n - 3);
        for (size_t c = 0; c < 3; c++)
            spin_quant_error_add(quant, SPIN_QUANT_COLOUR, SPIN_SH_C0 * (double)lost[c]);
        return n;
    }
}

/* Prints the values of the current attribute of row i as comma-separated tuples such as "(1,2,3)",
 * and returns the end of the text. If this is not the first row of the file, the text begins with a
 * comma. */
static char *print_row(const struct export *x, size_t i, bool first, char *to,
                       struct spin_quant_error *quant)
{
    float value[MAX_FLOATS];
    size_t group, n = take_row(x, i, value, &group, quant);

    for (size_t k = 0; k < n; k++) {
        if (k > 0 || !first)
            *to++ = ',';
        if (group > 1 && k % group == 0)
            *to++ = '(';
        to += print_value(x, value[k], to);
        if (group > 1 && k % group == group - 1)
            *to++ = ')';
    }
    return to;
}

static void print_block(void *context, int task)
{
    struct export *x = context;
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t b = x->first + (size_t)task, i = b * SPIN_ROWS_BLOCK, end = i + SPIN_ROWS_BLOCK;
    char *begin = x->text + (size_t)task * x->stride, *to = begin;
    bool first = spin_splat_rows_before(rows, b) == 0;

    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        if (!rows->keep[i])
            continue;
        to = print_row(x, i, first, to, &x->frames.block_quant[b]);
        first = false;
    }
    x->n_text[task] = (size_t)(to - begin);
    spin_splat_rows_release(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
}

/* ---- A layer --------------------------------------------------------------------------------- */

static spin_status write_text(struct spin_out *out, const char *text)
{
    return spin_out_write(out, text, strlen(text));
}

static const char *type_of(const struct export *x, enum attribute a)
{
    return x->half && forms[a].type_half ? forms[a].type_half : forms[a].type;
}

static const char *name_of(const struct export *x, enum attribute a)
{
    return x->half && forms[a].type_half ? forms[a].name_half : forms[a].name;
}

/* Writes an attribute of the current frame: as a time sample or, if the attribute is the same in
 * all frames, as a plain value. */
static spin_status write_attribute(struct export *x, enum attribute a, int number,
                                   struct spin_out *out)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    bool still = (x->still >> a & 1u) != 0;
    size_t n_blocks = spin_splat_rows_blocks(rows);
    char head[160];

    x->attribute = a;
    if (still)
        snprintf(head, sizeof head, "    %s %s = [", type_of(x, a), name_of(x, a));
    else
        snprintf(head, sizeof head, "    %s %s.timeSamples = {\n        %d: [", type_of(x, a),
                 name_of(x, a), number);
    SPIN_TRY(write_text(out, head));
    for (x->first = 0; x->first < n_blocks; x->first += BATCH) {
        size_t n = n_blocks - x->first < BATCH ? n_blocks - x->first : BATCH;

        spin_pool_run(rows->pool, (int)n, print_block, x);
        for (size_t b = 0; b < n; b++)
            SPIN_TRY(spin_out_write(out, x->text + b * x->stride, x->n_text[b]));
    }
    return write_text(out, still ? "]\n" : "],\n    }\n");
}

/* Sets extent to the bounding box of the ellipsoids of all kept splats; the radii of an ellipsoid
 * are three standard deviations. */
static void find_extent(const struct export *x, float extent[6])
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    bool any = false;
    float place[3];

    memset(extent, 0, 6 * sizeof *extent);
    for (size_t i = 0; i < rows->splats->n; i++) {
        const float *scale = rows->splats->log_scales + 3 * i;
        float q[4], axis[3][3];

        if (!rows->keep[i])
            continue;
        spin_splat_rows_turned(rows, i, q);
        spin_rotation(q, axis);
        spin_splat_rows_place(rows, i, place);
        for (int c = 0; c < 3; c++) {
            float reach = 0;

            for (int k = 0; k < 3; k++)
                reach += axis[c][k] * axis[c][k] * expf(2 * scale[k]);
            reach = 3 * sqrtf(reach);
            extent[c] = any ? spin_minf(extent[c], place[c] - reach) : place[c] - reach;
            extent[3 + c] = any ? spin_maxf(extent[3 + c], place[c] + reach) : place[c] + reach;
        }
        any = true;
    }
}

/* Prints the header of a layer. */
static void print_head(const struct export *x, int first, int last, FILE *to)
{
    fprintf(to,
            "#usda 1.0\n(\n%s    defaultPrim = \"" PRIM "\"\n    doc = \"Generated by spin4d %s\"\n"
            "    endTimeCode = %d\n    framesPerSecond = %.9g\n    metersPerUnit = %.9g\n"
            "    startTimeCode = %d\n%s    timeCodesPerSecond = %.9g\n    upAxis = \"Y\"\n)\n\n",
            x->frames.job->antialias
                ? "    customLayerData = {\n        bool antialias = true\n    }\n"
                : "",
            SPIN_VERSION, last, x->frames.fps, x->meters, first,
            x->still ? "    subLayers = [@./" STILL "@]\n" : "", x->frames.fps * x->codes);
}

/* Prints the attributes that never have time samples. Readers take colours without a colour space
 * for linear light; OpenUSD has no name for display values but this one, with the curve and the
 * primaries of sRGB. */
static void print_uniforms(const struct export *x, FILE *to)
{
    fprintf(to,
            "    uniform token colorSpace:name = \"srgb_rec709_scene\"\n"
            "    uniform token projectionModeHint = \"perspective\"\n"
            "    uniform int radiance:sphericalHarmonicsDegree = %d\n"
            "    uniform token sortingModeHint = \"zDepth\"\n",
            x->frames.rows.sh_degree);
}

/* Prints the beginning of the layer of a frame, which has n splats, up to the first attribute. The
 * caller frees *text. */
static spin_status layer_head(const struct export *x, int number, size_t n, char **text,
                              size_t *n_text)
{
    FILE *to = spin_text_open(text, n_text);

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "no memory for a layer of USD");
    print_head(x, number, number, to);
    fprintf(to,
            "def ParticleField3DGaussianSplat \"" PRIM "\" (\n    customData = {\n"
            "        int splats = %zu\n    }\n" COLOUR_SPACE ")\n{\n",
            n);
    print_uniforms(x, to);
    return fclose(to) == 0 ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "no memory for a layer of USD");
}

/* Writes still.usda, which contains the attributes that are the same in all frames; their values
 * are taken from the current frame. */
static spin_status write_still(struct export *x)
{
    SPIN_LEAVES(spin_out_abandon) struct spin_out out = {0};
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_path_join(x->frames.folder.path, STILL, &path));
    spin_output_folder_mark(&x->frames.folder, path);
    SPIN_TRY(spin_out_open(path, x->frames.job->force, &out));
    out.sync = x->frames.job->sync;
    SPIN_TRY(write_text(&out, "#usda 1.0\n\nover \"" PRIM "\"\n{\n"));
    for (int a = 0; a < ATTRIBUTES; a++)
        if (x->still >> a & 1u)
            SPIN_TRY(write_attribute(x, (enum attribute)a, 0, &out));
    SPIN_TRY(write_text(&out, "}\n"));
    return spin_out_commit(&out);
}

/* Returns the number of decimal places that resolve a millionth of the diagonal of this bounding
 * box. */
static int decimals_of(const float e[6])
{
    double square = 0, step;

    for (int c = 0; c < 3; c++)
        square += ((double)e[3 + c] - (double)e[c]) * ((double)e[3 + c] - (double)e[c]);
    step = square > 0 && isfinite(square) ? 1e-6 * sqrt(square) : 1e-6;
    return (int)fmin(fmax(ceil(-log10(step)), 0), 20);
}

/* Called with the first frame. Allocates the text buffer, writes still.usda, and computes the
 * cameras of --path. */
static spin_status begin_frames(struct export *x, const float e[6])
{
    size_t n_sh = 3 * (size_t)spin_sh_count(x->frames.rows.sh_degree);

    x->stride = (size_t)SPIN_ROWS_BLOCK * (n_sh > 4 ? n_sh : 4) * (NUMBER + 1);
    SPIN_TRY(spin_grow(BATCH, x->stride, (void **)&x->text));
    x->decimals = decimals_of(e);
    if (x->still)
        SPIN_TRY(write_still(x));
    if (!x->has_path)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)x->path.n_pictures, sizeof *x->camera, (void **)&x->camera));
    for (int64_t p = 0; p < x->path.n_pictures; p++)
        SPIN_TRY(spin_camera_path_camera(&x->path, p, x->frames.rows.splats, &x->camera[p]));
    return SPIN_OK;
}

static spin_status usd_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;
    size_t n_head;
    char line[256];
    SPIN_FREED char *head = NULL;
    float e[6];

    find_extent(x, e);
    if (!x->text)
        SPIN_TRY(begin_frames(x, e));
    SPIN_TRY(layer_head(x, info->number, x->frames.rows.n_kept, &head, &n_head));
    SPIN_TRY(spin_out_write(out, head, n_head));
    snprintf(line, sizeof line,
             "    float3[] extent.timeSamples = {\n"
             "        %d: [(%.9g, %.9g, %.9g), (%.9g, %.9g, %.9g)],\n    }\n",
             info->number, (double)e[0], (double)e[1], (double)e[2], (double)e[3], (double)e[4],
             (double)e[5]);
    SPIN_TRY(write_text(out, line));
    for (int a = 0; a < ATTRIBUTES; a++)
        if (!(x->still >> a & 1u))
            SPIN_TRY(write_attribute(x, (enum attribute)a, info->number, out));
    return write_text(out, "}\n");
}

static uint64_t usd_bytes(const void *self, size_t n)
{
    const struct export *x = self;

    return 2048 +
           (uint64_t)n * NUMBER * (11 + 3 * (uint64_t)spin_sh_count(x->frames.rows.sh_degree));
}

/* ---- Cameras --------------------------------------------------------------------------------- */

/* Prints the camera-to-world matrix of a camera with x right, y up, z back, in the axes of the
 * file. The rows of the matrix are the three axes and the position of the camera. */
static void print_matrix(const struct export *x, const struct spin_camera *camera, FILE *to)
{
    const double *m = camera->w2c, *q = x->frames.rows.turn_q;
    double back[4] = {q[0], q[1], q[2], q[3]}, row[4][3] = {{0}};

    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            row[r][c] = (r == 0 ? 1 : -1) * m[4 * r + c];
            row[3][c] -= m[4 * r + c] * m[4 * r + 3];
        }
    /* The vector v, rotated by the quaternion (w, u), is v + 2 w u x v + 2 u x (u x v). */
    for (int r = 0; r < 4; r++) {
        double *v = row[r], *u = back + 1, a[3], b[3];

        for (int c = 0; c < 3; c++)
            a[c] = u[(c + 1) % 3] * v[(c + 2) % 3] - u[(c + 2) % 3] * v[(c + 1) % 3];
        for (int c = 0; c < 3; c++)
            b[c] = u[(c + 1) % 3] * a[(c + 2) % 3] - u[(c + 2) % 3] * a[(c + 1) % 3];
        for (int c = 0; c < 3; c++)
            v[c] += 2 * back[0] * a[c] + 2 * b[c];
        fprintf(to, "%s(%.9g, %.9g, %.9g, %d)", r ? ", " : "(", v[0] + 0.0, v[1] + 0.0, v[2] + 0.0,
                r == 3);
    }
    fprintf(to, ")");
}

static double focal_of(const struct spin_camera *camera)
{
    return camera->fx * APERTURE / camera->width;
}

/* Prints a camera with the pose and the focal length of camera[k] at time[k]. All other intrinsics
 * are those of camera[0]. */
static void print_camera(const struct export *x, const char *name, const struct spin_camera *camera,
                         const double *time, size_t n, FILE *to)
{
    double focal = focal_of(camera), high = focal * camera->height / camera->fy;
    bool zooms = false, moves = false;

    for (size_t k = 1; k < n; k++) {
        zooms = zooms || focal_of(&camera[k]) != focal;
        moves = moves || memcmp(camera[k].w2c, camera->w2c, sizeof camera->w2c) != 0;
    }
    fprintf(to,
            "    def Camera \"%s\"\n    {\n        float2 clippingRange = (%.9g, 1000000)\n"
            "        float focalLength = %.9g\n",
            name, 0.05 * spin_camera_near(camera), focal);
    if (zooms) {
        fprintf(to, "        float focalLength.timeSamples = {\n");
        for (size_t k = 0; k < n; k++)
            fprintf(to, "            %.9g: %.9g,\n", time[k], focal_of(&camera[k]));
        fprintf(to, "        }\n");
    }
    fprintf(to,
            "        float horizontalAperture = %.9g\n"
            "        float horizontalApertureOffset = %.9g\n"
            "        float verticalAperture = %.9g\n        float verticalApertureOffset = %.9g\n"
            "        matrix4d xformOp:transform%s",
            APERTURE, (0.5 * camera->width - camera->cx) / camera->fx * focal, high,
            (camera->cy - 0.5 * camera->height) / camera->fy * focal,
            moves ? ".timeSamples = {\n" : " = ");
    for (size_t k = 0; k < (moves ? n : 1); k++) {
        if (moves)
            fprintf(to, "            %.9g: ", time[k]);
        print_matrix(x, &camera[k], to);
        fprintf(to, moves ? ",\n" : "\n");
    }
    fprintf(to, "%s        uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }\n",
            moves ? "        }\n" : "");
}

/* Returns the index of view v among the views with the same camera id and the same data-set
 * frame. */
static int duplicate_index(const struct spin_views *views, size_t v)
{
    size_t first = v;

    while (first > 0 && views->view[first - 1].dataset_frame == views->view[v].dataset_frame &&
           views->view[first - 1].camera_id == views->view[v].camera_id)
        first--;
    return (int)(v - first);
}

static bool find_frame(const struct export *x, const struct spin_view *view, size_t *frame)
{
    for (*frame = 0; *frame < x->frames.n_entries; ++*frame)
        if (x->frames.job->dataset_frame_of[*frame] == view->dataset_frame)
            return true;
    return false;
}

/* Prints each camera of the data set that has a view in the exported frames. */
static spin_status print_rig(const struct export *x, FILE *to)
{
    const struct spin_views *views = x->frames.job->views;
    size_t n_views = views && x->frames.job->dataset_frame_of ? views->n : 0;
    SPIN_FREED struct spin_camera *camera = NULL;
    SPIN_FREED double *time = NULL;
    SPIN_FREED bool *done = NULL;

    SPIN_TRY(spin_alloc(n_views + 1, sizeof *camera, (void **)&camera));
    SPIN_TRY(spin_alloc(n_views + 1, sizeof *time, (void **)&time));
    SPIN_TRY(spin_alloc(n_views + 1, sizeof *done, (void **)&done));
    for (size_t v = 0; v < n_views; v++) {
        const struct spin_view *view = &views->view[v];
        size_t n = 0, frame;
        char name[48], twin[16] = "";

        for (size_t w = v; w < n_views && !done[v]; w++) {
            if (views->view[w].camera_id != view->camera_id ||
                duplicate_index(views, w) != duplicate_index(views, v))
                continue;
            done[w] = w > v;
            if (!find_frame(x, &views->view[w], &frame))
                continue;
            camera[n] = views->view[w].camera;
            time[n++] = x->frames.entry[frame].number;
        }
        if (duplicate_index(views, v) > 0)
            snprintf(twin, sizeof twin, "_%d", duplicate_index(views, v) + 1);
        snprintf(name, sizeof name, "cam_%02d%s", view->camera_id, twin);
        if (n > 0)
            print_camera(x, name, camera, time, n, to);
    }
    return SPIN_OK;
}

/* Prints the camera of --path. Its poses are evenly spaced in time, from the first frame to the end
 * of the last frame. */
static spin_status print_path(const struct export *x, FILE *to)
{
    size_t n = (size_t)x->path.n_pictures;
    double first = x->frames.entry[0].number;
    SPIN_FREED double *time = NULL;
    double span = x->frames.entry[x->frames.n_entries - 1].number + x->codes - first;

    SPIN_TRY(spin_alloc(n, sizeof *time, (void **)&time));
    for (size_t p = 0; p < n; p++)
        time[p] = first + span * (double)p / (double)n;
    print_camera(x, spin_camera_path_name(&x->path), x->camera, time, n, to);
    return SPIN_OK;
}

static spin_status print_cameras(const struct export *x, FILE *to)
{
    spin_status status;

    if (!x->camera && !(x->frames.job->views && x->frames.job->views->n > 0))
        return SPIN_OK;
    fprintf(to, "\ndef Scope \"Cameras\"\n{\n");
    status = print_rig(x, to);
    if (status == SPIN_OK && x->camera)
        status = print_path(x, to);
    fprintf(to, "}\n");
    return status;
}

/* ---- The stage ------------------------------------------------------------------------------- */

/* Declares the attributes whose values the clips provide. */
static void print_attributes(const struct export *x, FILE *to)
{
    fprintf(to, "    float3[] extent\n");
    for (int a = 0; a < ATTRIBUTES; a++)
        if (!(x->still >> a & 1u))
            fprintf(to, "    %s %s\n", type_of(x, (enum attribute)a),
                    name_of(x, (enum attribute)a));
}

static spin_status print_clips(const struct export *x, FILE *to)
{
    const struct spin_frames *f = &x->frames;

    fprintf(to, "    clips = {\n        dictionary default = {\n            double2[] active = [");
    for (size_t i = 0; i < f->n_entries; i++)
        fprintf(to, "%s(%d, %zu)", i ? ", " : "", f->entry[i].number, i);
    fprintf(to, "]\n            asset[] assetPaths = [");
    for (size_t i = 0; i < f->n_entries; i++) {
        SPIN_FREED char *path = NULL;

        SPIN_TRY(spin_pattern_path(&f->pattern, f->folder.path, f->entry[i].number, &path));
        fprintf(to, "%s@./%s@", i ? ", " : "", spin_path_name(path));
    }
    fprintf(to, "]\n            asset manifestAssetPath = @./manifest.usda@\n"
                "            string primPath = \"/" PRIM "\"\n            double2[] times = [");
    for (size_t i = 0; i < f->n_entries; i++)
        fprintf(to, "%s(%d, %d)", i ? ", " : "", f->entry[i].number, f->entry[i].number);
    fprintf(to, "]\n        }\n    }\n");
    return SPIN_OK;
}

static spin_status write_stage(struct export *x, bool manifest)
{
    int first = x->frames.n_entries ? x->frames.entry[0].number : 0;
    int last = x->frames.n_entries ? x->frames.entry[x->frames.n_entries - 1].number : 0;
    SPIN_FREED char *text = NULL;
    size_t n;
    FILE *to = spin_text_open(&text, &n);
    spin_status status = SPIN_OK;

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "no memory for a stage of USD");
    if (manifest) {
        fprintf(to, "#usda 1.0\n\nover \"" PRIM "\"\n{\n");
    } else {
        print_head(x, first, last, to);
        fprintf(to, "def ParticleField3DGaussianSplat \"" PRIM "\" (\n");
        status = print_clips(x, to);
        fprintf(to, COLOUR_SPACE ")\n{\n");
        print_uniforms(x, to);
    }
    print_attributes(x, to);
    fprintf(to, "}\n");
    if (!manifest && status == SPIN_OK)
        status = print_cameras(x, to);
    if (fclose(to) != 0)
        status = spin_fail(SPIN_E_MEMORY, "no memory for a stage of USD");
    SPIN_TRY(status);
    return spin_frames_write_text(&x->frames, manifest ? "manifest.usda" : "clip.usda", text);
}

static spin_status usd_finish(void *self)
{
    SPIN_TRY(write_stage(self, true));
    return write_stage(self, false);
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status parse_options(void *self, const struct spin_export_job *job)
{
    static const double half_about_x[4] = {0, 1, 0, 0};
    const struct spin_plugin_values *v = job->values;
    struct export *x = self;
    int axes;

    SPIN_TRY(spin_option_word(v, "axes", "usd|source", &axes));
    if (strpbrk(spin_plugin_value(v, "pattern", ""), "@"))
        return spin_misuse("--pattern: a file name in USD cannot contain '@'");
    x->frames.axes = axes == 0 ? half_about_x : NULL;
    x->codes = job->stride > 0 ? job->stride : 1;
    x->frames.fps = job->fps > 0 ? job->fps : DEFAULT_FPS / x->codes;
    x->half = spin_plugin_value(v, "float", NULL) == NULL;
    x->frames.exact = !x->half;
    x->meters = 1;
    SPIN_TRY(spin_option_number(v, "meters-per-unit", 1e-9, 1e9, &x->meters));
    if (x->half)
        SPIN_TRY(make_halves(x));
    x->has_path = spin_plugin_value(v, "path", NULL) != NULL;
    if (!x->has_path)
        return SPIN_OK;
    SPIN_TRY(spin_camera_path_begin(&x->path, job));
    if (x->path.path == SPIN_PATH_CAMERA)
        return spin_misuse(
            "--path camera is not needed: the data set's cameras are always written");
    if (x->path.path != SPIN_PATH_FILE)
        x->path.n_pictures = job->n_frames;
    return SPIN_OK;
}

/* Returns a hash of one attribute of all rows of the frame and of the choice of rows to keep. */
static uint64_t hash_attribute(const struct export *x, enum attribute a)
{
    const struct spin_splats *s = x->frames.rows.splats;
    const float *const column[] = {s->means, s->quats, s->log_scales, s->logit_opacities, s->sh};
    const size_t width[] = {3, 4, 3, 1, 3 * (size_t)spin_sh_count(s->sh_degree)};
    uint64_t hash = SPIN_HASH_BEGIN;

    spin_hash(&hash, x->frames.rows.keep, s->n);
    spin_hash(&hash, column[a], s->n * width[a] * sizeof(float));
    return hash;
}

/* Finds the attributes that are the same in all frames. Stops reading frames when no such attribute
 * is left. */
static spin_status find_still(void *self, const struct spin_export_job *job)
{
    struct export *x = self;
    const struct spin_splats *splats;
    uint64_t first[ATTRIBUTES];
    unsigned still = (1u << ATTRIBUTES) - 1;

    if (!job->again || job->n_frames < 2)
        return SPIN_OK;
    for (int f = 0; f < job->n_frames && still; f++) {
        SPIN_TRY(job->again(job->context, f, &splats));
        SPIN_TRY(spin_splat_rows_choose(&x->frames.rows, splats));
        for (int a = 0; a < ATTRIBUTES; a++) {
            uint64_t now = f == 0 || still >> a & 1u ? hash_attribute(x, (enum attribute)a) : 0;

            first[a] = f == 0 ? now : first[a];
            still &= now == first[a] ? ~0u : ~(1u << a);
        }
    }
    x->still = still;
    return SPIN_OK;
}

static void free_export(void *self)
{
    struct export *x = self;

    free(x->text);
    free(x->halves);
    free(x->camera);
    spin_camera_path_free(&x->path);
}

static const struct spin_frames_format format = {
    .name = "usd",
    .pattern = "frame_%05d.usda",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .packed = true,
    .begin = parse_options,
    .ready = find_still,
    .bytes = usd_bytes,
    .write = usd_write,
    .finish = usd_finish,
    .end = free_export,
};

SPIN_FRAMES_EXPORTER(
    usd, "usd", .summary = "a stage of USD (26.03) in a folder, one layer per frame, with cameras",
    .options = options, .looks_at_views = true);
