/* One page that plays the clip: splats, player and all in a single .html file that needs no server
 * and no network. Where the bundle has both the imported and the retrained attributes the page
 * switches between them.
 *
 * The player is exporters/html/, our own in WebGL 2; html_pack.h says how a frame is written. Blocks
 * come one after the other as frames do, what the page must know of the whole clip comes at the end,
 * so that one frame is in memory at a time. */
#include <ctype.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/option.h"
#include "base/mem.h"
#include "base/text.h"
#include "exporters/html/page.h"
#include "exporters/lib/html_pack.h"
#include "exporters/lib/initial_view.h"
#include "exporters/lib/sort_rows.h"
#include "io/gzip.h"
#include "io/json.h"

#define DEFAULT_FPS 30
#define NEAR_W 0.2 /* where the training cut splats off */

static const struct spin_plugin_option options[] = {
    {"sh", "DEGREE", "highest SH degree to write, 0 to 3; keep: as it is", "1"},
    {"min-opacity", "V", "leave out splats whose opacity is below V, 0 to 1", "0"},
    {"max-splats", "N", "of each frame only the N most visible splats", NULL},
    {"every", "N", "write every Nth frame; the clip lasts as long", "1"},
    {"fps", "F", "frames a second; otherwise the bundle's, else 30", NULL},
    {"only", "after|before", "leave the other version out, where there are two", NULL},
    {0},
};

/* One of at most two ways the clip looks. */
struct version {
    const char *name, *label;
    int sh_degree; /* written */
    int n_sh;      /* bytes a splat above degree 0 */
    bool antialias;
    struct spin_html_frame now, key;
    int key_frame;          /* of `key`, or -1 */
    size_t *n_rows;         /* [frames of the job] written */
    int *key_of;            /* [frames of the job] */
    unsigned char *visible; /* [n_visible] 1: one of --max-splats, as the first frame has it */
    size_t n_visible;
};

struct export
{
    const struct spin_export_job *job;
    struct spin_out out;
    struct spin_splat_filter rows;
    struct spin_sort_rows order;
    struct spin_gzip *gzip;
    struct spin_html_space space;
    struct spin_initial_view view;
    struct version version[2];
    int n_versions;
    struct spin_splats source;
    uint8_t *packed;
    size_t room;
    size_t max_splats; /* 0: all */
    int every;
    double fps;
    int *number; /* [frames written] */
    int n_written;
};

/* ---- Which splats ------------------------------------------------------------------------------ */

/* Mark the most visible of the kept rows. While the clip has the same splats in every frame the first
 * frame decides for all, so that none comes and goes. */
static spin_status rank(struct export *x, struct version *v, const struct spin_splats *s)
{
    if (v->visible && v->n_visible == s->n)
        return SPIN_OK;
    SPIN_TRY(spin_grow(s->n, 1, (void **)&v->visible));
    v->n_visible = s->n;
    memset(v->visible, 0, s->n);
    SPIN_TRY(spin_sort_rows_fill(&x->order, &x->rows));
    spin_sort_rows_by_size(&x->order, s);
    for (size_t i = 0; i < x->order.n && i < x->max_splats; i++)
        v->visible[x->order.item[i].row] = 1;
    return SPIN_OK;
}

static spin_status choose(struct export *x, struct version *v, const struct spin_splats *s,
                          int number, size_t *n)
{
    SPIN_TRY(spin_splat_filter_choose(&x->rows, s, number));
    *n = x->rows.n_kept;
    if (x->max_splats == 0)
        return SPIN_OK;
    SPIN_TRY(rank(x, v, s));
    *n = 0;
    for (size_t i = 0; i < s->n; i++) {
        x->rows.keep[i] &= v->visible[i];
        *n += x->rows.keep[i];
    }
    return SPIN_OK;
}

/* ---- A block ------------------------------------------------------------------------------------- */

static spin_status write_text(struct export *x, const char *text)
{
    return spin_out_write(&x->out, text, strlen(text));
}

static spin_status take_rows(struct export *x, struct version *v, const struct spin_splats *s,
                             size_t n)
{
    size_t width = 3 * (size_t)spin_sh_count(s->sh_degree), row = 0;
    float none[45] = {0};

    SPIN_TRY(spin_html_reserve(&v->now, n, v->n_sh));
    for (size_t i = 0; i < s->n; i++) {
        const float *sh = s->sh + i * width + 3;
        struct spin_gaussian is;

        if (!x->rows.keep[i])
            continue;
        if (s->sh_degree < v->sh_degree) {
            memcpy(none, sh, (width - 3) * sizeof *sh);
            sh = none;
        }
        spin_splat_filter_take(&x->rows, i, &is);
        spin_html_take(&x->space, &is, sh, v->n_sh, &v->now, row++);
    }
    return SPIN_OK;
}

/* Gzip into memory, base64 into the page. */
static spin_status write_packed(struct export *x, size_t n)
{
    char *bytes = NULL;
    size_t n_bytes = 0;
    struct spin_out memory = {.path = x->out.path, .file = open_memstream(&bytes, &n_bytes)};
    spin_status status;

    if (!memory.file)
        return spin_fail(SPIN_E_MEMORY, "cannot pack a frame of '%s': not enough memory",
                         x->job->output);
    status = spin_gzip_begin(x->gzip, &memory);
    if (status == SPIN_OK)
        status = spin_gzip_write(x->gzip, x->packed, n);
    if (status == SPIN_OK)
        status = spin_gzip_end(x->gzip);
    if (fclose(memory.file) != 0 && status == SPIN_OK)
        status = spin_fail(SPIN_E_MEMORY, "cannot pack a frame of '%s': not enough memory",
                           x->job->output);
    if (status == SPIN_OK)
        spin_text_base64(x->out.file, (unsigned char *)bytes, n_bytes);
    free(bytes);
    return status;
}

static spin_status write_block(struct export *x, int which, const struct spin_splats *s, int number)
{
    struct version *v = &x->version[which];
    const struct spin_html_frame *key = NULL;
    int frame = x->n_written;
    char tag[64];
    size_t n, size;

    SPIN_TRY(choose(x, v, s, number, &n));
    SPIN_TRY(take_rows(x, v, s, n));
    if (v->key_frame >= 0 && v->key.n == n)
        key = &v->key;
    size = spin_html_packed_size(n, v->n_sh);
    if (size > x->room) {
        SPIN_TRY(spin_grow(size, 1, (void **)&x->packed));
        x->room = size;
    }
    spin_html_pack(&v->now, key, v->n_sh, x->packed);
    snprintf(tag, sizeof tag, "<script type=\"text/plain\" id=\"v%df%d\">", which, frame);
    SPIN_TRY(write_text(x, tag));
    SPIN_TRY(write_packed(x, size));
    SPIN_TRY(write_text(x, "</script>\n"));
    v->n_rows[frame] = n;
    v->key_of[frame] = key ? v->key_frame : frame;
    if (!key) {
        struct spin_html_frame spare = v->key;

        v->key = v->now;
        v->now = spare;
        v->key_frame = frame;
    }
    return SPIN_OK;
}

/* ---- What the page must know ------------------------------------------------------------------------ */

static spin_json *list_of(const double *value, int n)
{
    spin_json *list = spin_json_array();

    for (int i = 0; i < n; i++)
        spin_json_push_number(list, value[i]);
    return list;
}

static spin_json *list_of_ints(const int *value, int n)
{
    spin_json *list = spin_json_array();

    for (int i = 0; i < n; i++)
        spin_json_push(list, spin_json_integer_value(value[i]));
    return list;
}

static spin_json *version_json(const struct version *v, int n)
{
    spin_json *j = spin_json_object(), *splats = spin_json_array();

    spin_json_set_string(j, "name", v->name);
    spin_json_set_string(j, "label", v->label);
    spin_json_set_integer(j, "degree", v->sh_degree);
    spin_json_set_integer(j, "sh", v->n_sh);
    spin_json_set_bool(j, "antialias", v->antialias);
    for (int i = 0; i < n; i++)
        spin_json_push(splats, spin_json_integer_value((int64_t)v->n_rows[i]));
    spin_json_set(j, "splats", splats);
    spin_json_set(j, "key", list_of_ints(v->key_of, n));
    return j;
}

/* The method's name comes from the bundle: letters, digits and a few marks only, as they stand in a page. */
static void set_source(spin_json *j, const char *name)
{
    char text[128];
    size_t n = 0;

    for (; name && *name && n < sizeof text - 1; name++)
        text[n++] = isalnum((unsigned char)*name) || strchr(" ._-", *name) ? *name : '_';
    text[n] = '\0';
    spin_json_set_string(j, "source", text);
}

static spin_status write_clip(struct export *x)
{
    static const float black[3] = {0};
    const float *b = x->job->background ? x->job->background : black;
    spin_json *j = spin_json_object(), *versions = spin_json_array();
    char *text;
    spin_status status;

    set_source(j, x->job->source);
    spin_json_set_number(j, "fps", x->fps);
    spin_json_set_number(j, "size", x->space.size);
    spin_json_set_number(j, "fovy", x->view.fovy_deg);
    spin_json_set_number(j, "aspect", x->view.aspect);
    spin_json_set_number(j, "near", NEAR_W);
    spin_json_set(j, "background",
                  list_of((const double[3]){(double)b[0], (double)b[1], (double)b[2]}, 3));
    spin_json_set(j, "centre", list_of(x->space.centre, 3));
    spin_json_set(j, "eye", list_of(x->view.eye, 3));
    spin_json_set(j, "target", list_of(x->view.target, 3));
    spin_json_set(j, "up", list_of(x->view.up, 3));
    spin_json_set(j, "numbers", list_of_ints(x->number, x->n_written));
    for (int i = 0; i < x->n_versions; i++)
        spin_json_push(versions, version_json(&x->version[i], x->n_written));
    spin_json_set(j, "versions", versions);
    text = spin_json_text(j, false);
    spin_json_free(j);
    status = text ? write_text(x, "<script type=\"application/json\" id=\"clip\">")
                  : spin_fail(SPIN_E_MEMORY, "no memory for the page");
    if (status == SPIN_OK)
        status = write_text(x, text);
    free(text);
    return status == SPIN_OK ? write_text(x, "</script>\n") : status;
}

static spin_status write_script(struct export *x, const char *how, const char *text)
{
    SPIN_TRY(write_text(x, "<script"));
    SPIN_TRY(write_text(x, how));
    SPIN_TRY(write_text(x, ">\n"));
    SPIN_TRY(write_text(x, text));
    return write_text(x, "</script>\n");
}

/* ---- The plug-in ------------------------------------------------------------------------------------ */

static void finish(struct export *x)
{
    for (int i = 0; i < 2; i++) {
        spin_html_free(&x->version[i].now);
        spin_html_free(&x->version[i].key);
        free(x->version[i].n_rows);
        free(x->version[i].key_of);
        free(x->version[i].visible);
    }
    spin_splat_filter_end(&x->rows);
    spin_sort_rows_free(&x->order);
    spin_gzip_free(x->gzip);
    spin_splats_free(&x->source);
    free(x->packed);
    free(x->number);
    free(x);
}

static spin_status parse_options(struct export *x)
{
    const struct spin_plugin_values *v = x->job->values;
    int n = 0;

    SPIN_TRY(spin_splat_filter_begin(&x->rows, x->job, NULL));
    SPIN_TRY(spin_option_count(v, "max-splats", 1, 1000000000, &n));
    x->max_splats = (size_t)n;
    x->every = 1;
    SPIN_TRY(spin_option_count(v, "every", 1, 1000000000, &x->every));
    x->fps = x->job->fps > 0 ? x->job->fps : DEFAULT_FPS;
    SPIN_TRY(spin_option_number(v, "fps", 0.001, 1000, &x->fps));
    x->fps /= x->every;
    return SPIN_OK;
}

static spin_status add_version(struct export *x, const char *name, const char *label, int degree,
                               bool antialias)
{
    struct version *v = &x->version[x->n_versions++];
    const char *sh = spin_plugin_value(x->job->values, "sh", "1");
    size_t n = (size_t)x->job->n_frames;

    v->name = name;
    v->label = label;
    v->key_frame = -1;
    v->antialias = antialias;
    SPIN_TRY(spin_splat_filter_parse_sh(sh, degree, &v->sh_degree));
    if (v->sh_degree > degree)
        v->sh_degree = degree < 0 ? 0 : degree;
    v->n_sh = 3 * (spin_sh_count(v->sh_degree) - 1);
    SPIN_TRY(spin_alloc(n, sizeof *v->n_rows, (void **)&v->n_rows));
    return spin_alloc(n, sizeof *v->key_of, (void **)&v->key_of);
}

static spin_status add_versions(struct export *x)
{
    const struct spin_export_job *job = x->job;
    bool only = spin_plugin_value(job->values, "only", NULL) != NULL;
    int before;

    SPIN_TRY(spin_option_word(job->values, "only", "after|before", &before));
    if (!job->source_frame)
        return add_version(x, "clip", "As it is", job->sh_degree, job->antialias);
    if (!before)
        SPIN_TRY(add_version(x, "after", "After", job->sh_degree, job->antialias));
    if (!only || before)
        SPIN_TRY(add_version(x, "before", "Before", job->source_sh_degree, job->source_antialias));
    return SPIN_OK;
}

static spin_status html_begin(const struct spin_export_job *job, void **self)
{
    struct export *x = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->job = job;
    SPIN_TRY_OUT(parse_options(x));
    SPIN_TRY_OUT(add_versions(x));
    SPIN_TRY_OUT(spin_alloc((size_t)job->n_frames, sizeof *x->number, (void **)&x->number));
    SPIN_TRY_OUT(spin_gzip_create(6, job->n_threads, &x->gzip));
    SPIN_TRY_OUT(spin_out_open(job->output, job->force, &x->out));
    x->out.sync = job->sync;
    status = write_text(x, spin_html_head);
    if (status == SPIN_OK)
        status = write_text(x, spin_html_css);
    if (status == SPIN_OK)
        status = write_text(x, spin_html_body);
    if (status != SPIN_OK) {
        spin_out_abandon(&x->out);
        goto out;
    }
    *self = x;
    return SPIN_OK;
out:
    finish(x);
    return status;
}

/* What the page will weigh at most, from the first frame: gzip only makes it less. */
static void say_size(const struct export *x, size_t n_splats)
{
    size_t n = x->max_splats && x->max_splats < n_splats ? x->max_splats : n_splats, frame = 0;
    int n_frames = (x->job->n_frames + x->every - 1) / x->every;

    for (int i = 0; i < x->n_versions; i++)
        frame += spin_html_packed_size(n, x->version[i].n_sh);
    spin_log(0, "html: %d frames of about %zu splats, %d version%s: at most %.2f MB", n_frames, n,
             x->n_versions, x->n_versions > 1 ? "s" : "", (double)frame * n_frames * 4 / 3 / 1e6);
}

/* Where the scene lies and whence it is looked at, from the first frame and the data set. */
static spin_status set_space(struct export *x, const struct spin_splats *s, int frame)
{
    int row = x->job->dataset_frame_of ? x->job->dataset_frame_of[frame] : -1;

    SPIN_TRY(spin_initial_view_middle(s, x->space.centre, &x->space.size));
    spin_initial_view_first(x->job->views, row, x->space.centre, x->space.size, &x->view);
    say_size(x, s->n);
    return SPIN_OK;
}

static spin_status html_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats)
{
    struct export *x = self;

    if (frame % x->every != 0)
        return SPIN_OK;
    if (x->n_written == 0)
        SPIN_TRY(set_space(x, splats, frame));
    for (int i = 0; i < x->n_versions; i++) {
        const struct spin_splats *s = splats;

        if (strcmp(x->version[i].name, "before") == 0) {
            SPIN_TRY(x->job->source_frame(x->job->source_of, frame, &x->source));
            s = &x->source;
        }
        SPIN_TRY(write_block(x, i, s, info->number));
    }
    x->number[x->n_written++] = info->number;
    return SPIN_OK;
}

/* Of the frames in the page, not of those it was asked for. */
static spin_status fill_report(struct export *x)
{
    struct spin_export_report *report = x->job->report;
    double sum = 0;

    if (!report)
        return SPIN_OK;
    for (int i = 0; i < x->n_written; i++)
        sum += (double)x->version[0].n_rows[i];
    report->frames = x->n_written;
    report->splats_mean = sum / x->n_written;
    return spin_out_length(&x->out, &report->bytes);
}

static spin_status html_end(void *self)
{
    struct export *x = self;
    spin_status status;

    SPIN_TRY_OUT(write_clip(x));
    SPIN_TRY_OUT(write_script(x, " type=\"text/plain\" id=\"worker\"", spin_html_worker));
    SPIN_TRY_OUT(write_script(x, " type=\"text/plain\" id=\"vertex\"", spin_html_vertex));
    SPIN_TRY_OUT(write_script(x, " type=\"text/plain\" id=\"fragment\"", spin_html_fragment));
    SPIN_TRY_OUT(write_script(x, "", spin_html_script));
    SPIN_TRY_OUT(write_text(x, "</body>\n</html>\n"));
    SPIN_TRY_OUT(fill_report(x));
    status = spin_out_commit(&x->out);
    finish(x);
    return status;
out:
    spin_out_abandon(&x->out);
    finish(x);
    return status;
}

static void html_abort(void *self)
{
    struct export *x = self;

    spin_out_abandon(&x->out);
    finish(x);
}

extern const struct spin_exporter spin_exporter_html;
const struct spin_exporter spin_exporter_html = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "html",
    .summary = "one page that plays the clip in a browser, before and after, with no server",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .antialias = true,
    .begin = html_begin,
    .frame = html_frame,
    .end = html_end,
    .abort = html_abort,
};
