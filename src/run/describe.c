/* spin_bundle_describe(): what meta.json and the names of the members say. */
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "spin_run.h"
#include "base/text.h"
#include "scene/bundle.h"

/* Splats of all frames: the source's, refined ones, or trained ones. */
struct counts {
    size_t least, most;
    double mean;
};

static struct counts count(const struct spin_bundle *b, enum spin_splat_source from)
{
    struct counts c = {.least = SIZE_MAX};

    for (int f = 0; f < b->meta.n_frames; f++) {
        size_t n = spin_bundle_count(b, f, from);

        c.least = n < c.least ? n : c.least;
        c.most = n > c.most ? n : c.most;
        c.mean += (double)n;
    }
    c.mean /= b->meta.n_frames;
    return c;
}

/* A refining or the training of a clip, as meta.json tells it. */
struct stage {
    const char *name;
    const spin_json *json; /* NULL: there was none */
    enum spin_splat_source from;
    unsigned columns; /* that it gives */
    int sh_degree;    /* -1: none */
};

struct description {
    struct spin_bundle bundle;
    struct spin_bundle_bytes bytes, unpacked;
    char *data; /* path; NULL: none */
    struct stage stage[2];
};

static const struct {
    const char *key, *name; /* in JSON; in text */
    size_t offset;
} parts[] = {
    {"source", "source", offsetof(struct spin_bundle_bytes, source)},
    {"refined", "refined", offsetof(struct spin_bundle_bytes, refined)},
    {"positions", "values of frames", offsetof(struct spin_bundle_bytes, positions)},
    {"tracks", "tracks", offsetof(struct spin_bundle_bytes, tracks)},
    {"table", "table", offsetof(struct spin_bundle_bytes, table)},
    {"heads", "heads", offsetof(struct spin_bundle_bytes, heads)},
};
enum { N_PARTS = sizeof parts / sizeof *parts };

static uint64_t bytes_of(const struct spin_bundle_bytes *bytes, int part)
{
    return *(const uint64_t *)(const void *)((const char *)bytes + parts[part].offset);
}

static long long integer_of(const spin_json *object, const char *key)
{
    int64_t value = 0;

    spin_json_integer(spin_json_get(object, key), &value);
    return (long long)value;
}

static const char *text_of(const spin_json *object, const char *key)
{
    const char *text = spin_json_string(spin_json_get(object, key));

    return text ? text : "";
}

/* Rows of the network's table. */
static long long rows_of(const spin_json *field)
{
    int64_t rows = 0;
    long long levels = integer_of(field, "levels");

    spin_json_integer(
        spin_json_at(spin_json_get(field, "offset"), levels > 0 ? (size_t)levels : 0), &rows);
    return (long long)rows;
}

/* ---- JSON -------------------------------------------------------------------------------------- */

/* A part of meta.json once more. */
static void copy_json(spin_json *to, const char *key, const spin_json *from)
{
    char *text = from ? spin_json_text(from, false) : NULL;
    spin_json *copy = NULL;

    if (text && spin_json_parse("meta.json", text, strlen(text), &copy) == SPIN_OK)
        spin_json_set(to, key, copy);
    else
        spin_json_set_null(to, key);
    free(text);
}

static void set_range(spin_json *to, const char *key, double first, double last)
{
    spin_json *range = spin_json_array();

    spin_json_push_number(range, first);
    spin_json_push_number(range, last);
    spin_json_set(to, key, range);
}

/* What the source and every stage have. */
static void set_splats(spin_json *to, struct counts counts, unsigned columns, int sh_degree,
                       bool antialias)
{
    spin_json *splats = spin_json_object();

    spin_json_set_integer(splats, "min", (int64_t)counts.least);
    spin_json_set_number(splats, "mean", counts.mean);
    spin_json_set_integer(splats, "max", (int64_t)counts.most);
    spin_json_set(to, "splats", splats);
    if (columns & SPIN_COL_SH)
        spin_json_set_integer(to, "sh_degree", sh_degree);
    else
        spin_json_set_null(to, "sh_degree");
    spin_json_set_bool(to, "antialias", antialias);
    spin_json_set(to, "attributes", spin_column_names(columns));
}

/* The network, or null. */
static spin_json *field_json(const spin_json *field)
{
    static const char *const numbers[] = {"levels", "features", "hidden"};
    spin_json *to;

    if (!spin_json_is_object(field))
        return spin_json_text_value(NULL);
    to = spin_json_object();
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        spin_json_set_integer(to, numbers[i], integer_of(field, numbers[i]));
    spin_json_set_integer(to, "rows", rows_of(field));
    return to;
}

static spin_json *stage_json(const struct description *d, const struct stage *stage)
{
    spin_json *to = spin_json_object();
    bool antialias = false;

    spin_json_bool(spin_json_get(stage->json, "antialias"), &antialias);
    set_splats(to, count(&d->bundle, stage->from), stage->columns, stage->sh_degree, antialias);
    copy_json(to, "before", spin_json_get(stage->json, "before"));
    copy_json(to, "test", spin_json_get(stage->json, "test"));
    if (stage->from == SPIN_FROM_TRAINED) {
        spin_json_set(to, "field", field_json(spin_json_get(stage->json, "field")));
        spin_json_set_string(to, "device", text_of(stage->json, "device"));
    }
    copy_json(to, "options", spin_json_get(stage->json, "options"));
    return to;
}

static spin_json *bytes_json(const struct spin_bundle_bytes *bytes)
{
    spin_json *to = spin_json_object();

    spin_json_set_integer(to, "file", (int64_t)bytes->file);
    for (int i = 0; i < N_PARTS; i++)
        spin_json_set_integer(to, parts[i].key, (int64_t)bytes_of(bytes, i));
    return to;
}

static void write_json(const struct description *d, FILE *out)
{
    const struct spin_bundle_meta *meta = &d->bundle.meta;
    const struct spin_frame_info *first = meta->frame, *last = first + meta->n_frames - 1;
    spin_json *root = spin_json_object();
    char *text;

    spin_json_set_string(root, "bundle", d->bundle.path);
    spin_json_set_string(root, "generator", text_of(d->bundle.json, "generator"));
    spin_json_set_string(root, "from", meta->from);
    spin_json_set_string(root, "variant", meta->variant);
    spin_json_set_string(root, "upstream", meta->upstream);
    spin_json_set_string(root, "data", d->data);
    spin_json_set_string(root, "data_from", d->data ? meta->data_from : NULL);
    spin_json_set_bool(root, "data_there", d->data && spin_path_exists(d->data));
    spin_json_set_integer(root, "frames", meta->n_frames);
    spin_json_set_integer(root, "source_frames", meta->n_source_frames);
    spin_json_set_bool(root, "numbered", meta->numbered);
    set_range(root, "numbers", first->number, last->number);
    set_range(root, "times", first->time, last->time);
    set_splats(root, count(&d->bundle, SPIN_FROM_SOURCE), meta->columns, meta->sh_degree,
               meta->antialias);
    spin_json_set(root, "static", spin_column_names(meta->static_columns));
    for (int i = 0; i < 2; i++)
        if (d->stage[i].json)
            spin_json_set(root, d->stage[i].name, stage_json(d, &d->stage[i]));
    spin_json_set(root, "bytes", bytes_json(&d->bytes));
    spin_json_set(root, "bytes_unpacked", bytes_json(&d->unpacked));
    text = spin_json_text(root, true);
    fprintf(out, "%s\n", text ? text : "null");
    free(text);
    spin_json_free(root);
}

#define WIDTH 80 /* of a line of settings, without the indent and its last word */

/* ---- Text -------------------------------------------------------------------------------------- */

/* What comes from the file or is a path, as one line. */
static void __attribute__((format(printf, 2, 3))) write_line(FILE *out, const char *fmt, ...)
{
    char line[8192];
    va_list args;

    va_start(args, fmt);
    vsnprintf(line, sizeof line, fmt, args);
    va_end(args);
    spin_text_tidy(line, false);
    fprintf(out, "%s\n", line);
}

static void write_splats(FILE *out, const char *what, struct counts c)
{
    fprintf(out, "%-12s%zu", what, c.least);
    if (c.least == c.most)
        fprintf(out, " a frame");
    else
        fprintf(out, " to %zu a frame, mean %.1f", c.most, c.mean);
}

static void write_columns(FILE *out, const char *what, unsigned columns, int sh_degree)
{
    fprintf(out, "%-11s", what);
    for (unsigned column = SPIN_COL_MEANS; column <= SPIN_COL_RGB; column <<= 1)
        if (columns & column)
            fprintf(out, " %s", spin_column_name((enum spin_column)column));
    if (sh_degree >= 0 && columns & SPIN_COL_SH)
        fprintf(out, " (SH degree %d)", sh_degree);
    fprintf(out, "\n");
}

static void write_quality(FILE *out, const char *when, const spin_json *quality)
{
    double psnr, ssim;

    if (spin_json_number(spin_json_get(quality, "psnr"), &psnr) &&
        spin_json_number(spin_json_get(quality, "ssim"), &ssim))
        fprintf(out, "            held-out views %s: %.2f dB, SSIM %.4f\n", when, psnr, ssim);
}

/* JSON without quotes and outer braces, in lines that break behind commas. */
static void write_options(FILE *out, const spin_json *options)
{
    char *text = options ? spin_json_text(options, false) : NULL;
    size_t n = text ? strlen(text) : 0, column = 0;

    if (n > 2)
        fprintf(out, "            settings: ");
    for (size_t i = 1; i + 1 < n; i++) {
        if (text[i] == '"')
            continue;
        fputc(text[i], out);
        if (text[i] == ',' && ++column > WIDTH) {
            fprintf(out, "\n            ");
            column = 0;
        } else if (text[i] == ',' || text[i] == ':') {
            fputc(' ', out);
        }
        column++;
    }
    if (n > 2)
        fputc('\n', out);
    free(text);
}

static void write_stage(const struct description *d, const struct stage *stage, FILE *out)
{
    const spin_json *json = stage->json, *options = spin_json_get(json, "options");
    const spin_json *field = spin_json_get(json, "field");

    write_splats(out, stage->name, count(&d->bundle, stage->from));
    fprintf(out, ", %lld iterations", integer_of(options, "iterations"));
    if (stage->from == SPIN_FROM_TRAINED && !spin_json_is_object(field))
        write_line(out, " on %s, no network", text_of(json, "device"));
    else if (stage->from == SPIN_FROM_TRAINED)
        write_line(out, " on %s; %lld levels of %lld features, %lld rows, hidden width %lld",
                   text_of(json, "device"), integer_of(field, "levels"),
                   integer_of(field, "features"), rows_of(field), integer_of(field, "hidden"));
    else
        fprintf(out, " each\n");
    write_columns(out, "            attributes:", stage->columns, stage->sh_degree);
    write_quality(out, "before", spin_json_get(json, "before"));
    write_quality(out, "after", spin_json_get(json, "test"));
    write_options(out, options);
}

static void write_text(const struct description *d, FILE *out)
{
    const struct spin_bundle_meta *meta = &d->bundle.meta;
    const struct spin_frame_info *first = meta->frame, *last = first + meta->n_frames - 1;
    char size[32];

    write_line(out, "bundle      %s, by %s", d->bundle.path, text_of(d->bundle.json, "generator"));
    write_line(out, "from        %s%s%s", meta->from, *meta->variant ? ", " : "", meta->variant);
    write_line(out, "upstream    %s", meta->upstream);
    if (d->data)
        write_line(out, "data        %s, %s%s", d->data, meta->data_from,
                   spin_path_exists(d->data) ? "" : ": it is not there");
    fprintf(out, "frames      %d of the source's %d, numbers %d to %d%s, times %.10g to %.10g\n",
            meta->n_frames, meta->n_source_frames, first->number, last->number,
            meta->numbered ? "" : " (counted)", first->time, last->time);
    write_splats(out, "splats", count(&d->bundle, SPIN_FROM_SOURCE));
    write_columns(out, "\nattributes ", meta->columns, meta->sh_degree);
    if (meta->static_columns)
        write_columns(out, "static", meta->static_columns, -1);
    for (int i = 0; i < 2; i++)
        if (d->stage[i].json)
            write_stage(d, &d->stage[i], out);
    fprintf(out, "size        %s", spin_text_bytes(d->bytes.file, size));
    for (int i = 0; i < N_PARTS; i++)
        if (bytes_of(&d->bytes, i) > 0)
            fprintf(out, ", %s %s", parts[i].name, spin_text_bytes(bytes_of(&d->bytes, i), size));
    if (d->unpacked.file != d->bytes.file)
        fprintf(out, "; unpacked %s", spin_text_bytes(d->unpacked.file, size));
    fputc('\n', out);
}

/* ---- The call ---------------------------------------------------------------------------------- */

static void find_stages(struct description *d)
{
    const struct spin_bundle *b = &d->bundle;
    const spin_json *trained = spin_json_get(b->json, "trained");

    if (b->refined.columns)
        d->stage[0] = (struct stage){"refined", spin_json_get(b->json, "refined"),
                                     SPIN_FROM_REFINED, b->refined.columns, b->refined.sh_degree};
    if (trained)
        d->stage[1] = (struct stage){"trained", trained, SPIN_FROM_TRAINED,
                                     SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                                     (int)integer_of(trained, "sh_degree")};
}

spin_status spin_bundle_describe(const char *path, bool json, char **text)
{
    struct description d = {0};
    size_t n = 0;
    FILE *out;
    spin_status status;

    *text = NULL;
    if (!spin_bundle_looks_like(path))
        return spin_fail(SPIN_E_NOT_RECOGNISED, "'%s' is no bundle", path);
    SPIN_TRY(spin_bundle_open(path, &d.bundle));
    SPIN_TRY_OUT(spin_bundle_data_path(&d.bundle, &d.data));
    spin_bundle_weigh(&d.bundle, &d.bytes, &d.unpacked);
    find_stages(&d);
    out = open_memstream(text, &n);
    if (out && json)
        write_json(&d, out);
    else if (out)
        write_text(&d, out);
    if (!out || fclose(out) != 0)
        status = spin_fail(SPIN_E_MEMORY, "no memory to describe '%s'", path);
out:
    free(d.data);
    spin_bundle_close(&d.bundle);
    return status;
}
