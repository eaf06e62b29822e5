/* Writes a USD stage with a prim of type ParticleField3DGaussianSplat (OpenUSD 26.03): a folder OUT
 * with one layer per frame, and OUT/clip.usda, which plays these layers by value clips. If the
 * output is OUT.usdc, OUT.usdz or OUT.usda, the clip is written to this one file instead, with time
 * samples (lib/usd_file.c).
 *
 * With value clips, a reader opens only the layer of the frame that it shows, whereas a single text
 * file, gigabytes large for a clip of a minute, must be parsed as a whole. Since the prim has the
 * same path in each layer as in the stage, a layer can also be opened on its own.
 *
 * The layout follows OpenUSD's schema and its guide to value clips: scales are standard deviations,
 * opacities are 0 to 1, orientations are w x y z, and SH is one float3 per coefficient, splat after
 * splat. The axes are x right, y up, z back: those of the training, rotated by 180 degrees about x.
 *
 * Attributes that are the same in all frames are stored once, in still.usda, a sublayer of the
 * stage and of each layer. With --half, all numbers except positions are half floats, printed with
 * the fewest digits that are parsed to the same half; positions have enough digits to resolve a
 * millionth of the diagonal of the first frame's bounding box. The cameras of the data set and the
 * camera of --path are UsdGeomCamera prims. Only the ratio of a camera's focal length to its
 * aperture matters, so all apertures have the same width. */
#include "base/base.h"
#include "exporters/lib/usd_export.h"
#include "math/sh.h"

#define DEFAULT_FPS 30
#define BATCH 8 /* number of blocks of rows that are printed in parallel, then written */

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.usda"),
    SPIN_ROWS_OPTION_SH,
    SPIN_FRAMES_OPTION_FPS,
    {"axes", "usd|source", "axes to write without --up; usd: half a turn about x, to x right, y up",
     "usd"},
    {"half", NULL, "write half floats, except for positions: smaller, but not read by all programs",
     NULL},
    {"path", "orbit|spiral|train|FILE",
     "add a moving camera, as in --to images, over the whole clip", NULL},
    {"meters-per-unit", "M", "metres per unit of the scene", "1"},
    {0},
};

/* Prints a value of the current attribute and returns the length of the text. */
static int print_value(const struct spin_usd_export *x, float v, char *to)
{
    int n;

    if (spin_usd_is_half(x))
        return sprintf(to, "%s", x->halves[spin_usd_half_bits(v)]);
    if (x->attribute != SPIN_USD_POSITIONS || !x->half)
        return sprintf(to, "%.9g", (double)v);
    n = sprintf(to, "%.*f", x->decimals, (double)v);
    while (x->decimals > 0 && to[n - 1] == '0')
        n--;
    n -= to[n - 1] == '.';
    return strncmp(to, "-0", (size_t)n) == 0 ? sprintf(to, "0") : n;
}

/* Prints the values of the current attribute of row i as comma-separated tuples such as "(1,2,3)",
 * and returns the end of the text. Unless the row is the first of the array, the text begins with a
 * comma. */
static char *print_row(const struct spin_usd_export *x, size_t i, bool first, char *to,
                       struct spin_quant_error *quant)
{
    float value[SPIN_USD_FLOATS];
    size_t group, n = spin_usd_row(x, i, value, &group, quant);

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
    struct spin_usd_export *x = context;
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

/* Writes an attribute of the current frame: as a time sample or, if the attribute is the same in
 * all frames, as a plain value. */
static spin_status write_attribute(struct spin_usd_export *x, enum spin_usd_column a, int number,
                                   struct spin_out *out)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    bool still = (x->still >> a & 1u) != 0;
    size_t n_blocks = spin_splat_rows_blocks(rows);
    char head[160];

    x->attribute = a;
    if (still)
        snprintf(head, sizeof head, "    %s %s = [", spin_usd_type_of(x, a),
                 spin_usd_name_of(x, a));
    else
        snprintf(head, sizeof head, "    %s %s.timeSamples = {\n        %d: [",
                 spin_usd_type_of(x, a), spin_usd_name_of(x, a), number);
    SPIN_TRY(write_text(out, head));
    for (x->first = 0; x->first < n_blocks; x->first += BATCH) {
        size_t n = n_blocks - x->first < BATCH ? n_blocks - x->first : BATCH;

        spin_pool_run(rows->pool, (int)n, print_block, x);
        for (size_t b = 0; b < n; b++)
            SPIN_TRY(spin_out_write(out, x->text + b * x->stride, x->n_text[b]));
    }
    return write_text(out, still ? "]\n" : "],\n    }\n");
}

/* Prints the beginning of the layer of a frame with n splats, up to the first array. The caller
 * frees *text. */
static spin_status layer_head(const struct spin_usd_export *x, int number, size_t n, char **text,
                              size_t *n_text)
{
    FILE *to = spin_text_open(text, n_text);

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "not enough memory for a USD layer");
    spin_usd_print_head(x, number, number, to);
    fprintf(to,
            "def ParticleField3DGaussianSplat \"" SPIN_USD_PRIM "\" (\n    customData = {\n"
            "        int splats = %zu\n    }\n" SPIN_USD_TEXT_SCHEMAS ")\n{\n",
            n);
    spin_usd_print_uniforms(x, to);
    return fclose(to) == 0 ? SPIN_OK
                           : spin_fail(SPIN_E_MEMORY, "not enough memory for a USD layer");
}

/* Writes still.usda, which contains the attributes that are the same in all frames, with their
 * values in the current frame. */
static spin_status write_still(struct spin_usd_export *x)
{
    SPIN_LEAVES(spin_out_abandon) struct spin_out out = {0};
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_path_join(x->frames.folder.path, SPIN_USD_STILL, &path));
    spin_output_folder_mark(&x->frames.folder, path);
    SPIN_TRY(spin_out_open(path, x->frames.job->force, &out));
    out.sync = x->frames.job->sync;
    SPIN_TRY(write_text(&out, "#usda 1.0\n\nover \"" SPIN_USD_PRIM "\"\n{\n"));
    for (int a = 0; a < SPIN_USD_COLUMNS; a++)
        if (x->still >> a & 1u)
            SPIN_TRY(write_attribute(x, (enum spin_usd_column)a, 0, &out));
    SPIN_TRY(write_text(&out, "}\n"));
    return spin_out_commit(&out);
}

/* Returns the number of decimal places that resolve a millionth of the diagonal of a bounding box.
 * e: minimum x y z, maximum x y z. */
static int decimals_of(const float e[6])
{
    double square = 0, step;

    for (int c = 0; c < 3; c++)
        square += ((double)e[3 + c] - (double)e[c]) * ((double)e[3 + c] - (double)e[c]);
    step = square > 0 && isfinite(square) ? 1e-6 * sqrt(square) : 1e-6;
    return (int)fmin(fmax(ceil(-log10(step)), 0), 20);
}

/* Completes the preparation when the first frame has arrived: allocates the text buffer, writes
 * still.usda, and computes the poses of --path. e: bounding box of the frame. */
static spin_status begin_frames(struct spin_usd_export *x, const float e[6])
{
    size_t n_sh = 3 * (size_t)spin_sh_count(x->frames.rows.sh_degree);

    x->stride = (size_t)SPIN_ROWS_BLOCK * (n_sh > 4 ? n_sh : 4) * (SPIN_USD_NUMBER + 1);
    SPIN_TRY(spin_grow(BATCH, x->stride, (void **)&x->text));
    x->decimals = decimals_of(e);
    if (x->still)
        SPIN_TRY(write_still(x));
    return spin_usd_begin_path(x);
}

static spin_status usd_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct spin_usd_export *x = self;
    size_t n_head;
    char line[256];
    SPIN_FREED char *head = NULL;
    float e[6];

    spin_usd_extent(x, e);
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
    for (int a = 0; a < SPIN_USD_COLUMNS; a++)
        if (!(x->still >> a & 1u))
            SPIN_TRY(write_attribute(x, (enum spin_usd_column)a, info->number, out));
    return write_text(out, "}\n");
}

static uint64_t usd_bytes(const void *self, size_t n)
{
    const struct spin_usd_export *x = self;

    return 2048 + (uint64_t)n * SPIN_USD_NUMBER *
                      (11 + 3 * (uint64_t)spin_sh_count(x->frames.rows.sh_degree));
}

/* ---- The stage ------------------------------------------------------------------------------- */

/* Declares the attributes whose values come from the value clips. */
static void print_attributes(const struct spin_usd_export *x, FILE *to)
{
    fprintf(to, "    float3[] extent\n");
    for (int a = 0; a < SPIN_USD_COLUMNS; a++)
        if (!(x->still >> a & 1u))
            fprintf(to, "    %s %s\n", spin_usd_type_of(x, (enum spin_usd_column)a),
                    spin_usd_name_of(x, (enum spin_usd_column)a));
}

static spin_status print_clips(const struct spin_usd_export *x, FILE *to)
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
                "            string primPath = \"/" SPIN_USD_PRIM
                "\"\n            double2[] times = [");
    for (size_t i = 0; i < f->n_entries; i++)
        fprintf(to, "%s(%d, %d)", i ? ", " : "", f->entry[i].number, f->entry[i].number);
    fprintf(to, "]\n        }\n    }\n");
    return SPIN_OK;
}

static spin_status write_stage(struct spin_usd_export *x, bool manifest)
{
    int first = x->frames.n_entries ? x->frames.entry[0].number : 0;
    int last = x->frames.n_entries ? x->frames.entry[x->frames.n_entries - 1].number : 0;
    SPIN_FREED char *text = NULL;
    size_t n;
    FILE *to = spin_text_open(&text, &n);
    spin_status status = SPIN_OK;

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "not enough memory for the USD stage");
    if (manifest) {
        fprintf(to, "#usda 1.0\n\nover \"" SPIN_USD_PRIM "\"\n{\n");
    } else {
        spin_usd_print_head(x, first, last, to);
        fprintf(to, "def ParticleField3DGaussianSplat \"" SPIN_USD_PRIM "\" (\n");
        status = print_clips(x, to);
        fprintf(to, SPIN_USD_TEXT_SCHEMAS ")\n{\n");
        spin_usd_print_uniforms(x, to);
    }
    print_attributes(x, to);
    fprintf(to, "}\n");
    if (!manifest && status == SPIN_OK)
        status = spin_usd_print_cameras(x, to);
    if (fclose(to) != 0)
        status = spin_fail(SPIN_E_MEMORY, "not enough memory for the USD stage");
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
    struct spin_usd_export *x = self;
    int axes;

    SPIN_TRY(spin_option_word(v, "axes", "usd|source", &axes));
    if (strpbrk(spin_plugin_value(v, "pattern", ""), "@"))
        return spin_misuse("--pattern: a file name in USD cannot contain '@'");
    x->frames.axes = axes == 0 ? half_about_x : NULL;
    x->codes = job->stride > 0 ? job->stride : 1;
    x->frames.fps = job->fps > 0 ? job->fps : DEFAULT_FPS / x->codes;
    x->half = spin_plugin_value(v, "half", NULL) != NULL;
    x->frames.exact = !x->half;
    x->meters = 1;
    SPIN_TRY(spin_option_number(v, "meters-per-unit", 1e-9, 1e9, &x->meters));
    if (x->half)
        SPIN_TRY(spin_usd_make_halves(x));
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

/* Finds the attributes that are the same in all frames. Stops reading frames when no such attribute
 * is left. */
static spin_status find_still(void *self, const struct spin_export_job *job)
{
    struct spin_usd_export *x = self;
    const struct spin_splats *splats;
    uint64_t first[SPIN_USD_COLUMNS];
    unsigned still = (1u << SPIN_USD_COLUMNS) - 1;

    if (!job->again || job->n_frames < 2 || x->frames.file)
        return SPIN_OK;
    for (int f = 0; f < job->n_frames && still; f++) {
        SPIN_TRY(job->again(job->context, f, &splats));
        SPIN_TRY(spin_splat_rows_choose(&x->frames.rows, splats));
        for (int a = 0; a < SPIN_USD_COLUMNS; a++) {
            uint64_t now =
                f == 0 || still >> a & 1u ? spin_usd_hash(x, (enum spin_usd_column)a) : 0;

            first[a] = f == 0 ? now : first[a];
            still &= now == first[a] ? ~0u : ~(1u << a);
        }
    }
    x->still = still;
    return SPIN_OK;
}

static void free_export(void *self)
{
    struct spin_usd_export *x = self;

    free(x->text);
    free(x->halves);
    free(x->camera);
    spin_usd_file_free(x);
    spin_camera_path_free(&x->path);
}

/* The format of a folder with text layers. */
static const struct spin_frames_format format = {
    .name = "usd",
    .pattern = "frame_%05d.usda",
    .self_bytes = sizeof(struct spin_usd_export),
    .lossy = true,
    .packed = true,
    .begin = parse_options,
    .ready = find_still,
    .bytes = usd_bytes,
    .write = usd_write,
    .finish = usd_finish,
    .end = free_export,
};

#define SINGLE(ending)                                                                             \
    {                                                                                              \
        .name = "usd", .pattern = "frame_%05d" ending,                                             \
        .self_bytes = sizeof(struct spin_usd_export), .lossy = true, .packed = true,               \
        .begin = parse_options, .open = spin_usd_file_open, .add = spin_usd_file_add,              \
        .close = spin_usd_file_close, .bytes = usd_bytes, .write = usd_write, .end = free_export,  \
    }
/* The formats for a clip in one file. The extension of the output selects one of them. */
static const struct spin_frames_format singles[] = {SINGLE(".usdc"), SINGLE(".usdz"),
                                                    SINGLE(".usda")};

/* Sets *chosen to the format for an output of this name. If the name is a pattern for one file per
 * frame, these files are text. */
static spin_status choose_format(const char *output, const struct spin_frames_format **chosen)
{
    SPIN_FREED char *folder = NULL;
    const char *pattern;

    *chosen = &format;
    SPIN_TRY(spin_pattern_split(output, &folder, &pattern));
    for (size_t i = 0; i < sizeof singles / sizeof *singles && !spin_path_is_folder(output); i++)
        if (spin_text_ends_any_case(output, strchr(singles[i].pattern, '.')))
            *chosen = &singles[i];
    if (!pattern || *chosen == &format)
        return SPIN_OK;
    if (!spin_text_ends_any_case(output, ".usda"))
        return spin_misuse(
            "'%s': with one file per frame, the files are text: end the pattern with "
            ".usda, or name one file for all frames",
            output);
    *chosen = &format;
    return SPIN_OK;
}

static spin_status begin_usd(const struct spin_export_job *job, void **self)
{
    const struct spin_frames_format *chosen;

    SPIN_TRY(choose_format(job->output, &chosen));
    return spin_frames_begin(chosen, job, self);
}

SPIN_EXPORTER(usd, "usd", SPIN_FRAMES_FUNCTIONS, .begin = begin_usd,
              .summary = "USD (26.03) with cameras: one file with the clip (OUT.usdc, OUT.usdz, "
                         "OUT.usda), or a folder with one text layer per frame",
              .options = options, .looks_at_views = true);
