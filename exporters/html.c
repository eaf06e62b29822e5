/* Writes a web page that plays the clip: a single .html file with splats and player, which needs
 * neither a server nor the internet. With --split, the splats are in a second file, which consists
 * of blocks, and the page loads a block when it is about to show it. If the bundle has both
 * imported and retrained attributes, the page can switch between them.
 *
 * The player in exporters/html/ uses WebGL 2 and no library. exporters/html/format.md describes the
 * format of blocks, and lib/page_*.c encodes them. The JSON that describes the clip is written
 * after the blocks, because it contains their sizes. */
#include <ctype.h>
#include <strings.h>
#include <time.h>
#include <unistd.h>

#include "base/base.h"
#include "exporters/html/page.h"
#include "exporters/lib/initial_view.h"
#include "exporters/lib/page_draft.h"
#include "exporters/lib/page_group.h"
#include "exporters/lib/page_rows.h"
#include "exporters/lib/splat_rows.h"
#include "io/file.h"
#include "io/json.h"
#include "io/sound.h"

#define DEGREES 57.29577951308232 /* per radian */
#define DEFAULT_FPS 30
/* Shorter clips are slowed down to this duration, unless --fps is given. */
#define LEAST_SECONDS 2.0
#define DEFAULT_KEY_EVERY 30

static const struct spin_plugin_option options[] = {
    {"sh", "DEGREE", "highest SH degree to write, 0 to 3; keep: that of the bundle", "1"},
    {"level", "fine|normal|coarse",
     "error bounds of all values; each --bound-* changes one of them", "normal"},
    {"bound-place", "X", "bound of coordinates, world units (0.001, or 0.0005 of the scene)", NULL},
    {"bound-colour", "X", "bound of colours and opacities, in 255ths (3)", NULL},
    {"bound-scale", "X", "bound of scales, percent (2)", NULL},
    {"bound-rotation", "X", "bound of rotations, degrees (1)", NULL},
    {"bound-sh", "X", "bound of SH coefficients above degree 0 (0.02)", NULL},
    {"key-every", "N", "largest number of frames from one key frame to the next, up to 256", "30"},
    {"split", NULL, "write the frames to a .bin file beside the page, for a server", NULL},
    {"max-splats", "N", "write only the N largest and most opaque splats of each frame", NULL},
    {"every", "N", "write every Nth frame; the duration stays the same", "1"},
    {"fps", "F",
     "frames per second; default: the bundle's, else 30, or fewer if the clip would take less than "
     "two seconds",
     NULL},
    {"title", "TEXT", "title above the clip; default: the name of the file; empty: none", NULL},
    {"only", "after|before", "write only this version, if there are two", NULL},
    {"camera", "N|FILE", "first view: camera N of the data set, or the first camera in a file",
     NULL},
    {"up", "AXIS", "axis of the source that points up in the page: x, y, z, -x, -y or -z", NULL},
    {"poster", NULL, "write an image of the first view beside the page, for previews of links",
     NULL},
    {"rotate", "X,Y,Z", "show the scene rotated about x, then y, then z, in degrees", NULL},
    {0},
};

/* Largest size of the draft (a coarse version of the first frame), as a fraction of the size of all
 * blocks and, for long clips, in bytes. With these limits, the first image appears before a tenth
 * of the file of --split is loaded. Also, it appears before 1 MB is loaded, including the page, for
 * clips of up to 10,000 frames. */
#define DRAFT_SHARE 0.05
#define DRAFT_BYTES 600000.0

/* If the page has more bytes, a log line recommends --split. */
#define SPLIT_BYTES 3000000

/* A block that has been written: a frame of a version of the clip, or some rows of 4D splats. */
struct page_frame {
    int first; /* index of the key frame on which a frame depends; not used for rows of 4D splats */
    size_t shared, still, own, referred;
    /* Rows of 4D splats: they are visible in ticks `from` to `end` - 1 only. */
    int from, end;
    uint64_t at, bytes; /* offset of the block in the file of --split, and size of the block */
};

/* One of at most two versions of the clip: with the imported or with the retrained attributes. */
struct version {
    const char *name, *label;
    int sh_degree; /* SH degree in the page */
    int n_sh;      /* number of SH values per splat above degree 0 */
    bool antialias;
    struct spin_page_group group;
    struct page_frame *frame; /* [n_written] */
    int n_written;
    double n_kept;
    size_t n_empty; /* number of frames without splats */
    bool rows;      /* true: blocks contain rows of 4D splats; false: each contains a frame */
};

struct export
{
    const struct spin_export_job *job;
    struct spin_out out, data, poster, sound; /* sound: with --split only */
    bool split, has_poster;
    /* Encoder of the draft, a coarse version of the first frame that the page shows until the
     * complete one is loaded; used only with --split. */
    struct spin_page_draft draft;
    size_t draft_splats; /* number of splats in the draft; 0: no draft */
    uint64_t draft_bytes;
    struct spin_splat_rows rows;
    struct spin_sort_rows order;
    struct spin_page_space space;
    double size; /* size of the scene, see spin_initial_view_middle(); 0: not yet known */
    struct spin_initial_view view;
    bool faces_subject; /* true: the clip has no cameras, and `view` faces the subject */
    struct version version[2];
    int n_versions;
    struct spin_splats source;
    struct spin_page_rows four_d; /* encoder of 4D splats, used only for version[0] */
    size_t max_splats;            /* largest number of splats per frame; 0: no limit */
    int every, key_every;
    double fps;
    const char *title; /* title above the clip; NULL: the name of the file */
    int *number;       /* [n_written] number of each written frame */
    int n_written;
    uint64_t data_bytes, n_splats;
};

/* ---- Choice of splats ------------------------------------------------------------------------ */

static spin_status choose_splats(struct export *x, const struct spin_splats *s, size_t *n)
{
    SPIN_TRY(spin_splat_rows_choose(&x->rows, s));
    *n = x->rows.n_kept;
    if (x->max_splats == 0 || *n <= x->max_splats)
        return SPIN_OK;
    SPIN_TRY(spin_sort_rows_fill(&x->order, &x->rows));
    spin_sort_rows_by_size(&x->order, s);
    memset(x->rows.keep, 0, s->n);
    for (size_t i = 0; i < x->max_splats; i++)
        x->rows.keep[x->order.item[i].row] = 1;
    *n = x->max_splats;
    return SPIN_OK;
}

/* ---- A block --------------------------------------------------------------------------------- */

static spin_status write_text(struct export *x, const char *text)
{
    return spin_out_write(&x->out, text, strlen(text));
}

static void write_seven(FILE *to, unsigned seven)
{
    static const char special[] = {0, '\n', '\r', '<', 127};
    const char *at = memchr(special, (int)seven, sizeof special);

    if (at)
        putc(127, to);
    putc(at ? '0' + (int)(at - special) : (int)seven, to);
}

/* Writes bytes as text: each character stores seven bits. Characters that HTML interprets or that
 * an editor may change are written as an escape character and a digit. */
static void write_sevens(FILE *to, const uint8_t *bytes, size_t n)
{
    unsigned held = 0;
    int bits = 0;

    for (size_t i = 0; i < n; i++) {
        held = (held & 127) << 8 | bytes[i];
        for (bits += 8; bits >= 7;)
            write_seven(to, held >> (bits -= 7) & 127);
    }
    if (bits)
        write_seven(to, held << (7 - bits) & 127);
}

struct sink {
    struct export *x;
    struct version *v;
};

static spin_status take_bytes(const struct sink *s, struct page_frame block, const uint8_t *data,
                              size_t n)
{
    struct export *x = s->x;
    char tag[64];

    block.at = x->data_bytes;
    block.bytes = n;
    s->v->frame[s->v->n_written++] = block;
    x->data_bytes += n;
    x->n_splats += block.shared + block.own;
    if (x->split)
        return spin_out_write(&x->data, data, n);
    snprintf(tag, sizeof tag, "<script type=\"text/plain\" id=\"v%df%d\">",
             (int)(s->v - x->version), s->v->n_written - 1);
    SPIN_TRY(write_text(x, tag));
    write_sevens(x->out.file, data, n);
    return write_text(x, "</script>\n");
}

static spin_status take_block(void *context, const struct spin_page_block *block)
{
    const struct sink *s = context;

    return take_bytes(s,
                      (struct page_frame){.first = s->v->n_written - block->frame,
                                          .shared = block->n_shared,
                                          .still = block->n_still,
                                          .referred = block->n_referred,
                                          .own = block->n_own},
                      block->data, block->n_bytes);
}

static spin_status take_rows(void *context, const struct spin_page_rows_block *block)
{
    return take_bytes(context,
                      (struct page_frame){.own = block->n, .from = block->from, .end = block->end},
                      block->data, block->n_bytes);
}

static spin_status take_draft(void *context, const struct spin_page_block *block)
{
    struct export *x = context;

    x->draft_splats = block->n_shared;
    x->draft_bytes = block->n_bytes;
    return spin_out_write(&x->data, block->data, block->n_bytes);
}

/* Returns the size of the blocks that the page needs for the first frame: that of the key frame or,
 * of 4D splats, all blocks with rows that are visible in tick 0. */
static uint64_t bytes_of_first_frame(const struct version *v)
{
    uint64_t sum = v->frame[0].bytes;

    for (int k = 1; v->rows && k < v->n_written; k++)
        if (v->frame[k].from <= 0)
            sum += v->frame[k].bytes;
    return sum;
}

/* With --split, writes the draft after all blocks. No draft is written if the blocks of the first
 * frame are themselves small enough to be loaded first. */
static spin_status write_draft(struct export *x)
{
    double most = fmin(DRAFT_SHARE * (double)x->data_bytes, DRAFT_BYTES);

    if (!x->split || (double)bytes_of_first_frame(&x->version[0]) <= most)
        return SPIN_OK;
    return spin_page_draft_write(&x->draft, (uint64_t)most, take_draft, x);
}

static spin_status write_group(struct export *x, struct version *v)
{
    struct sink sink = {x, v};

    return spin_page_group_write(&v->group, take_block, &sink);
}

static spin_status add_frame(struct export *x, struct version *v, const struct spin_splats *s)
{
    bool full;
    size_t n;

    SPIN_TRY(choose_splats(x, s, &n));
    v->n_kept += (double)n;
    v->n_empty += n == 0;
    SPIN_TRY(spin_page_group_add(&v->group, &x->rows, s, &full));
    if (x->split && v == &x->version[0] && x->n_written == 0)
        SPIN_TRY(spin_page_draft_add_rows(&x->draft, &x->rows, s, &x->view, &x->order));
    if (!full)
        return SPIN_OK;
    SPIN_TRY(write_group(x, v));
    return spin_page_group_add(&v->group, &x->rows, s, &full);
}

/* ---- JSON ------------------------------------------------------------------------------------ */

static spin_json *list_of_ints(const int *value, int n)
{
    spin_json *list = spin_json_array();

    for (int i = 0; i < n; i++)
        spin_json_push(list, spin_json_integer_value(value[i]));
    return list;
}

/* Returns an object with `referred` of the key frames for which it is not 0, by their indices. */
static spin_json *referred_json(const struct version *v)
{
    spin_json *j = spin_json_object();
    char key[16];

    for (int f = 0; f < v->n_written; f++) {
        snprintf(key, sizeof key, "%d", f);
        if (v->frame[f].referred > 0)
            spin_json_set_integer(j, key, (int64_t)v->frame[f].referred);
    }
    return j;
}

static spin_json *version_json(const struct version *v, const struct export *x)
{
    static const char *const frames[] = {"splats", "at",    "bytes", "first",
                                         "shared", "still", "own",   NULL};
    static const char *const rows[] = {"splats", "at", "bytes", "from", "end", NULL};
    const char *const *key = v->rows ? rows : frames;
    spin_json *j = spin_json_object();

    spin_json_set_string(j, "name", v->name);
    spin_json_set_string(j, "label", v->label);
    spin_json_set_integer(j, "degree", v->sh_degree);
    spin_json_set_integer(j, "sh", v->n_sh);
    spin_json_set_bool(j, "antialias", v->antialias);
    for (int k = 0; key[k]; k++) {
        spin_json *list = spin_json_array();

        for (int f = 0; f < v->n_written; f++) {
            const struct page_frame *at = &v->frame[f];
            const uint64_t of_rows[] = {(uint64_t)at->from, (uint64_t)at->end};
            const uint64_t of_frames[] = {(uint64_t)at->first, at->shared, at->still, at->own};
            const uint64_t of_all[] = {at->shared + at->own, at->at, at->bytes};
            uint64_t value = k < 3 ? of_all[k] : v->rows ? of_rows[k - 3] : of_frames[k - 3];

            spin_json_push(list, spin_json_integer_value((int64_t)value));
        }
        spin_json_set(j, key[k], list);
    }
    if (v->rows)
        spin_json_set(j, "rows", spin_page_rows_json(&x->four_d));
    else
        spin_json_set(j, "referred", referred_json(v));
    if (v == &x->version[0] && x->draft_splats > 0) {
        spin_json *draft = spin_json_object();

        spin_json_set_integer(draft, "splats", (int64_t)x->draft_splats);
        spin_json_set_integer(draft, "at", (int64_t)x->data_bytes);
        spin_json_set_integer(draft, "bytes", (int64_t)x->draft_bytes);
        spin_json_set(j, "draft", draft);
    }
    return j;
}

/* Sets a member of the JSON to a name in which all characters except letters, digits and a few
 * punctuation marks are replaced by '_': a file name may be invalid UTF-8 or contain HTML. */
static void set_name(spin_json *j, const char *key, const char *name, size_t n_name)
{
    char text[128];
    size_t n = 0;

    for (; n < n_name && name[n] && n < sizeof text - 1; n++)
        text[n] = isalnum((unsigned char)name[n]) || strchr(" ._-", name[n]) ? name[n] : '_';
    text[n] = '\0';
    spin_json_set_string(j, key, text);
}

/* Returns the length of the path without its extension .html or .htm. */
static size_t stem_of(const char *path)
{
    const char *dot = strrchr(path, '.');

    return dot && (strcasecmp(dot, ".html") == 0 || strcasecmp(dot, ".htm") == 0)
               ? (size_t)(dot - path)
               : strlen(path);
}

static spin_json *steps_json(const struct spin_page_space *space)
{
    static const char *const key[] = {"place", "colour", "opacity", "scale", "rotation", "sh"};
    static const int column[] = {SPIN_PAGE_PLACE, SPIN_PAGE_COLOUR,   SPIN_PAGE_OPACITY,
                                 SPIN_PAGE_SCALE, SPIN_PAGE_ROTATION, SPIN_PAGE_SH};
    spin_json *j = spin_json_object();

    for (int i = 0; i < 6; i++)
        spin_json_set_number(j, key[i], spin_page_step(space, column[i]));
    return j;
}

/* Returns the description of the sound. step: seconds of the sound that play during one frame of
 * the page; start: time of the clip at which the sound begins, in seconds. */
static spin_json *sound_json(const struct export *x)
{
    const struct spin_sound *s = x->job->sound;
    spin_json *j = spin_json_object();

    spin_json_set_number(j, "step", x->every / x->job->fps);
    spin_json_set_number(j, "start", s->start);
    spin_json_set_number(j, "volume", fmin(s->gain, 1));
    return j;
}

static spin_status write_clip(struct export *x)
{
    static const float black[3] = {0};
    const float *b = x->job->background ? x->job->background : black;
    const struct spin_page_space *space = &x->space;
    const char *file = spin_path_name(x->job->output);
    spin_json *j = spin_json_object(), *versions = spin_json_array();
    SPIN_FREED char *text = NULL;

    set_name(j, "name", file, stem_of(file));
    if (x->title)
        spin_json_set_string(j, "title", x->title);
    set_name(j, "source", x->job->source ? x->job->source : "", SIZE_MAX);
    spin_json_set_number(j, "fps", x->fps);
    spin_json_set_number(j, "size", x->size);
    spin_json_set_number(j, "fovy", x->view.fovy_deg);
    spin_json_set_number(j, "aspect", x->view.aspect);
    spin_json_set_number(j, "near", x->view.z_near);
    if (x->view.keep > 0)
        spin_json_set_number(j, "keep", x->view.keep);
    spin_json_set(
        j, "background",
        spin_json_numbers((const double[3]){(double)b[0], (double)b[1], (double)b[2]}, 3));
    spin_json_set(j, "centre", spin_json_numbers(space->centre, 3));
    spin_json_set(j, "eye", spin_json_numbers(x->view.eye, 3));
    spin_json_set(j, "target", spin_json_numbers(x->view.target, 3));
    spin_json_set(j, "up", spin_json_numbers(x->view.up, 3));
    spin_json_set(j, "reach", spin_json_numbers(x->view.reach, 2));
    spin_json_set(j, "numbers", list_of_ints(x->number, x->n_written));
    spin_json_set(j, "steps", steps_json(x->version[0].rows ? &x->four_d.inner : space));
    if (x->split)
        spin_json_set_string(j, "data", spin_path_name(x->data.path));
    if (x->job->sound)
        spin_json_set(j, "sound", sound_json(x));
    for (int i = 0; i < x->n_versions; i++)
        spin_json_push(versions, version_json(&x->version[i], x));
    spin_json_set(j, "versions", versions);
    text = spin_json_text(j, false);
    spin_json_free(j);
    SPIN_TRY(text ? write_text(x, "<script type=\"application/json\" id=\"clip\">")
                  : spin_fail(SPIN_E_MEMORY, "not enough memory for the page"));
    for (const char *c = text; c && *c; c++)
        SPIN_TRY(*c == '<' ? write_text(x, "\\u003c") : spin_out_write(&x->out, c, 1));
    return write_text(x, "</script>\n");
}

static spin_status write_script(struct export *x, const char *how, const char *text)
{
    SPIN_TRY(write_text(x, "<script"));
    SPIN_TRY(write_text(x, how));
    SPIN_TRY(write_text(x, ">\n"));
    SPIN_TRY(write_text(x, text));
    return write_text(x, "</script>\n");
}

/* Writes a file name as a relative URL. */
static spin_status write_address(struct export *x, const char *name)
{
    char text[8];

    for (const char *c = name; *c; c++) {
        bool plain = isalnum((unsigned char)*c) || strchr("._-~", *c);

        snprintf(text, sizeof text, plain ? "%c" : "%%%02X", (unsigned char)*c);
        SPIN_TRY(write_text(x, text));
    }
    return SPIN_OK;
}

/* Writes the element that plays the sound. The sound is embedded in the page or, with --split, in a
 * file beside the page. */
static spin_status write_sound(struct export *x)
{
    const struct spin_sound *s = x->job->sound;

    if (!s)
        return SPIN_OK;
    SPIN_TRY(write_text(x, "<audio id=\"sound\" preload=\"auto\" src=\""));
    if (x->split) {
        SPIN_TRY(spin_out_write(&x->sound, s->data, s->size));
        SPIN_TRY(write_address(x, spin_path_name(x->sound.path)));
    } else {
        SPIN_TRY(write_text(x, "data:"));
        SPIN_TRY(write_text(x, spin_sound_mime(s)));
        SPIN_TRY(write_text(x, ";base64,"));
        spin_text_base64(x->out.file, s->data, s->size);
    }
    return write_text(x, "\"></audio>\n");
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static void free_export(void *self)
{
    struct export *x = self;

    spin_out_abandon(&x->out);
    spin_out_abandon(&x->data);
    spin_out_abandon(&x->poster);
    spin_out_abandon(&x->sound);
    for (int i = 0; i < 2; i++) {
        spin_page_group_free(&x->version[i].group);
        free(x->version[i].frame);
    }
    spin_page_draft_free(&x->draft);
    spin_splat_rows_end(&x->rows);
    spin_sort_rows_free(&x->order);
    spin_splats_free(&x->source);
    free(x->number);
    free(x);
}

static spin_status parse_options(struct export *x)
{
    const struct spin_plugin_values *v = x->job->values;
    struct spin_page_bounds bounds;
    int n = 0;

    x->title = spin_plugin_value(v, "title", NULL);
    SPIN_TRY(spin_splat_rows_begin(&x->rows, x->job, NULL));
    SPIN_TRY(spin_option_count(v, "max-splats", 1, 1000000000, &n));
    x->max_splats = (size_t)n;
    x->every = 1;
    SPIN_TRY(spin_option_count(v, "every", 1, 1000000000, &x->every));
    x->key_every = DEFAULT_KEY_EVERY;
    SPIN_TRY(spin_option_count(v, "key-every", 1, SPIN_PAGE_MOST_FRAMES, &x->key_every));
    /* Only check the values of --bound-* here: set_space() computes the bounds later, when the size
     * of the scene is known. */
    SPIN_TRY(spin_page_bounds_from(v, 1, &bounds));
    x->split = spin_plugin_value(v, "split", NULL) != NULL;
    x->has_poster = spin_plugin_value(v, "poster", NULL) != NULL;
    x->fps = x->job->fps > 0 ? x->job->fps : DEFAULT_FPS;
    if (!x->job->sound && x->job->n_frames > 1 && x->job->n_frames < LEAST_SECONDS * x->fps)
        x->fps = x->job->n_frames / LEAST_SECONDS;
    SPIN_TRY(spin_option_number(v, "fps", 0.001, 1000, &x->fps));
    x->fps /= x->every;
    return SPIN_OK;
}

static spin_status add_version(struct export *x, const char *name, const char *label, int degree,
                               bool antialias)
{
    struct version *v = &x->version[x->n_versions++];
    const char *sh = spin_plugin_value(x->job->values, "sh", "1");

    v->name = name;
    v->label = label;
    v->antialias = antialias;
    SPIN_TRY(spin_splat_rows_parse_sh(sh, degree, &v->sh_degree));
    if (v->sh_degree > degree)
        v->sh_degree = degree < 0 ? 0 : degree;
    v->n_sh = 3 * (spin_sh_count(v->sh_degree) - 1);
    v->group.n_sh = v->n_sh;
    v->group.pool = x->rows.pool;
    v->group.most_frames = x->key_every;
    v->group.refers = true;
    return spin_alloc((size_t)x->job->n_frames, sizeof *v->frame, (void **)&v->frame);
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

/* Opens a file beside the page, with the page's name and another extension. */
static spin_status open_beside(const struct export *x, const char *ending, struct spin_out *out)
{
    const struct spin_export_job *job = x->job;
    char path[4096];

    snprintf(path, sizeof path, "%.*s%s", (int)fmin((double)stem_of(job->output), 4000),
             job->output, ending);
    spin_out_sweep(path);
    SPIN_TRY(spin_out_open(path, job->force, out));
    out->sync = job->sync;
    return SPIN_OK;
}

/* Opens the page and the files beside it: with --split, a file for the blocks and a file for the
 * sound; with --poster, a file for the image. */
static spin_status open_files(struct export *x)
{
    SPIN_TRY(spin_out_open(x->job->output, x->job->force, &x->out));
    x->out.sync = x->job->sync;
    if (x->split)
        SPIN_TRY(open_beside(x, ".bin", &x->data));
    if (x->split && x->job->sound) {
        char ending[32];

        snprintf(ending, sizeof ending, ".sound%s", spin_sound_ending(x->job->sound));
        SPIN_TRY(open_beside(x, ending, &x->sound));
    }
    return x->has_poster ? open_beside(x, ".png", &x->poster) : SPIN_OK;
}

/* Writes the title, or the name of the file if there is no title, as HTML text. */
static spin_status write_title(struct export *x)
{
    const char *file = spin_path_name(x->job->output), *title = x->title;
    size_t n = title && *title ? strlen(title) : stem_of(file);

    for (const char *c = title && *title ? title : file; n > 0; c++, n--)
        SPIN_TRY(*c == '<'   ? write_text(x, "&lt;")
                 : *c == '&' ? write_text(x, "&amp;")
                 : *c == '"' ? write_text(x, "&quot;")
                             : spin_out_write(&x->out, c, 1));
    return SPIN_OK;
}

/* Writes the elements with the URL of the poster, relative to the page, and with the size of its
 * image. */
static spin_status write_poster_tags(struct export *x)
{
    char text[160];

    SPIN_TRY(write_text(x, "<meta property=\"og:image\" content=\""));
    SPIN_TRY(write_address(x, spin_path_name(x->poster.path)));
    snprintf(text, sizeof text,
             "\">\n<meta property=\"og:image:width\" content=\"%d\">\n"
             "<meta property=\"og:image:height\" content=\"%d\">\n",
             SPIN_POSTER_WIDTH, SPIN_POSTER_HEIGHT);
    return write_text(x, text);
}

/* Writes the elements with the title that browsers show in tabs, search engines in results, and
 * other sites in previews of links. The title that the page shows above the clip is in the JSON
 * instead. */
static spin_status write_titles(struct export *x)
{
    SPIN_TRY(write_text(x, "<title>"));
    SPIN_TRY(write_title(x));
    SPIN_TRY(write_text(x, "</title>\n<meta property=\"og:title\" content=\""));
    SPIN_TRY(write_title(x));
    SPIN_TRY(write_text(x, "\">\n"));
    if (x->has_poster)
        SPIN_TRY(write_poster_tags(x));
    return write_text(x, "<style>\n");
}

/* Makes the first view show the subject, unless --camera chooses the view. */
static spin_status find_subject(struct export *x)
{
    static const double origin[3] = {0};

    if (spin_plugin_value(x->job->values, "camera", NULL))
        return SPIN_OK;
    spin_initial_view_first(NULL, x->job->up, 0, false, origin, 1, &x->view);
    return spin_initial_view_subject(x->job, 1280, 720, &x->view, &x->faces_subject);
}

static spin_status begin_export(struct export *x, const struct spin_export_job *job)
{
    x->job = job;
    SPIN_TRY(parse_options(x));
    SPIN_TRY(add_versions(x));
    SPIN_TRY(spin_alloc((size_t)job->n_frames, sizeof *x->number, (void **)&x->number));
    SPIN_TRY(spin_initial_view_middle_after_empty(job, x->space.centre, &x->size));
    SPIN_TRY(find_subject(x));
    SPIN_TRY(open_files(x));
    SPIN_TRY(write_text(x, spin_html_head));
    SPIN_TRY(write_titles(x));
    SPIN_TRY(write_text(x, spin_html_css));
    return write_text(x, spin_html_body);
}

/* Sets the centre, the size and the initial view of the scene from the first frame and the data
 * set, passes centre, size and error bounds to the encoders, and writes the poster. */
static spin_status set_space(struct export *x, const struct spin_splats *s, int frame)
{
    int row = x->job->dataset_frame_of ? x->job->dataset_frame_of[frame] : -1;

    if (x->size == 0)
        SPIN_TRY(spin_initial_view_middle(s, x->space.centre, &x->size));
    if (!x->faces_subject) {
        spin_initial_view_first(x->job->views, x->job->up, row, false, x->space.centre, x->size,
                                &x->view);
        SPIN_TRY(spin_initial_view_chosen(x->job, row, x->space.centre, x->size, &x->view));
    }
    SPIN_TRY(spin_page_bounds_from(x->job->values, x->size, &x->space.bounds));
    for (int i = 0; i < x->n_versions; i++)
        x->version[i].group.space = x->space;
    x->draft.group.space = x->space;
    x->draft.group.n_sh = x->version[0].n_sh;
    x->draft.group.pool = x->rows.pool;
    return x->has_poster ? spin_poster_write(x->job, &x->view, s, &x->poster) : SPIN_OK;
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
        SPIN_TRY(add_frame(x, &x->version[i], s));
    }
    x->number[x->n_written++] = info->number;
    return SPIN_OK;
}

/* ---- 4D splats ------------------------------------------------------------------------------- */

/* Writes each 4D splat once. The first frame is needed only for the view and the draft. */
static spin_status write_rows(struct export *x, const double *times)
{
    struct version *v = &x->version[0];
    const struct spin_splats_4d *s = x->job->splats_4d;
    struct spin_splats view = spin_splats_of_4d(s);
    struct sink sink = {x, v};
    int n_blocks = 2 + x->n_written / x->key_every;

    SPIN_TRY(spin_splats_4d_slice(s, times[0], SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &x->source));
    SPIN_TRY(set_space(x, &x->source, 0));
    v->rows = true;
    x->four_d.space = x->space;
    x->four_d.splats = s;
    x->four_d.pool = x->rows.pool;
    x->four_d.times = times;
    x->four_d.n_sh = v->n_sh;
    x->four_d.n_frames = x->n_written;
    x->four_d.key_every = x->key_every;
    spin_page_rows_begin(&x->four_d);
    if (x->split) {
        x->draft.group.space = x->four_d.inner;
        SPIN_TRY(spin_splat_rows_choose(&x->rows, &x->source));
        SPIN_TRY(spin_page_draft_add_rows(&x->draft, &x->rows, &x->source, &x->view, &x->order));
    }
    SPIN_TRY(spin_grow((size_t)n_blocks, sizeof *v->frame, (void **)&v->frame));
    SPIN_TRY(spin_splat_rows_choose(&x->rows, &view));
    SPIN_TRY(spin_splat_rows_report_4d(&x->rows, x->job, NULL, times, x->n_written));
    return spin_page_rows_write(&x->four_d, &x->rows, take_rows, &sink);
}

/* Writes 4D splats as rows, or as frames if the frames are not evenly spaced in time or if
 * --max-splats is given. */
static spin_status write_4d(struct export *x)
{
    const struct spin_export_job *job = x->job;
    const struct spin_splats *frame;
    SPIN_FREED double *times = NULL;

    SPIN_TRY(spin_alloc((size_t)job->n_frames, sizeof *times, (void **)&times));
    for (int f = 0; f < job->n_frames; f += x->every) {
        times[x->n_written] = job->times[f];
        x->number[x->n_written++] = job->numbers[f];
    }
    if (x->max_splats == 0 && spin_page_rows_can(times, x->n_written, &x->four_d.step))
        return write_rows(x, times);
    x->n_written = 0;
    for (int f = 0; f < job->n_frames; f++) {
        struct spin_frame_info info = {.number = job->numbers[f], .time = job->times[f]};

        if (f % x->every != 0)
            continue;
        SPIN_TRY(job->again(job->context, f, &frame));
        SPIN_TRY(html_frame(x, f, &info, frame));
    }
    return SPIN_OK;
}

/* Reports the contents of the page, which has fewer frames than the job if --every is given. */
static spin_status fill_report(struct export *x)
{
    struct spin_export_report *report = x->job->report;
    uint64_t page = 0;
    char text[3][48];

    SPIN_TRY(spin_out_length(&x->out, &page));
    page += x->split ? x->data_bytes + x->draft_bytes : 0;
    page += x->split && x->job->sound ? x->job->sound->size : 0;
    spin_log(0, "html: %s of %s and %s, %.2f bytes each",
             spin_text_count((long long)x->n_splats, "splat", text[0]),
             spin_text_count(x->n_written, "frame", text[1]),
             spin_text_count(x->n_versions, "version", text[2]),
             (double)x->data_bytes / fmax((double)x->n_splats, 1));
    if (!x->split && page > SPLIT_BYTES)
        spin_log(
            0,
            "html: browsers load all %s before they show the first image: use --split to show it "
            "sooner from a web server",
            spin_text_bytes(page, text[0]));
    spin_splat_rows_warn_empty(x->version[0].n_empty, (size_t)x->n_written);
    if (!report)
        return SPIN_OK;
    report->frames = x->n_written;
    if (!x->version[0].rows)
        report->splats_mean = x->version[0].n_kept / x->n_written;
    report->bytes = page;
    return SPIN_OK;
}

/* Logs the largest error and the bound of each attribute, and fills the report of --check. */
static void say_errors(const struct export *x)
{
    const struct spin_page_bounds *b = &x->space.bounds;
    struct spin_quant_error quant = x->four_d.quant;
    struct spin_export_report *report = x->job->report;
    uint64_t n_values = x->four_d.n_values;
    double most[SPIN_QUANT_PARTS];

    for (int i = 0; i < x->n_versions; i++) {
        n_values += x->version[i].group.n_values;
        spin_quant_error_merge(&quant, &x->version[i].group.quant);
    }
    for (int p = 0; p < SPIN_QUANT_PARTS; p++)
        most[p] = quant.part[p].largest;
    spin_log(0,
             "html: largest errors of %llu values: position %.3g (bound %.3g), scale %.2f %% "
             "(%.2f), rotation %.2f degrees (%.2f), opacity %.2f/255 (%.2f), colour %.2f/255 "
             "(%.2f), SH %.3f (%.3f)",
             (unsigned long long)n_values, most[SPIN_QUANT_PLACE], b->place,
             100 * expm1(most[SPIN_QUANT_SCALE]), 100 * expm1(b->scale),
             most[SPIN_QUANT_ROTATION] * DEGREES, b->rotation * DEGREES,
             255 * most[SPIN_QUANT_OPACITY], 255 * b->opacity, 255 * most[SPIN_QUANT_COLOUR],
             255 * b->colour, most[SPIN_QUANT_SH], b->sh);
    if (!report || !x->job->check)
        return;
    report->check = (struct spin_export_check){.frames = x->n_written,
                                               .splats = quant.part[SPIN_QUANT_OPACITY].n,
                                               .bounds = 2 * most[SPIN_QUANT_PLACE],
                                               .place_sizes = (double)NAN,
                                               .place_pixels = (double)NAN,
                                               .rendered = -1,
                                               .psnr = (double)NAN};
    for (int p = 0; p < SPIN_QUANT_PARTS; p++) {
        double unit = p == SPIN_QUANT_ROTATION ? DEGREES : 1;

        report->check.rms[p] = unit * spin_quant_error_rms(&quant, (enum spin_quant_error_part)p);
        report->check.largest[p] = unit * most[p];
    }
}

/* Commits a file beside the page, if it was opened. *path receives its path, which the caller
 * frees. */
static spin_status commit_beside(struct spin_out *out, char **path)
{
    SPIN_FREED char *own = NULL;

    if (!out->path)
        return SPIN_OK;
    SPIN_TRY(spin_strdup(out->path, &own));
    SPIN_TRY(spin_out_commit(out));
    *path = own;
    own = NULL;
    return SPIN_OK;
}

/* Commits the files beside the page first and the page last, so that a page never exists without
 * its files. After a failure, removes files that were already committed. */
static spin_status commit_files(struct export *x)
{
    struct spin_out *beside[] = {&x->data, &x->poster, &x->sound};
    char *path[] = {NULL, NULL, NULL};
    spin_status status = SPIN_OK;

    for (int i = 0; i < 3 && status == SPIN_OK; i++)
        status = commit_beside(beside[i], &path[i]);
    if (status == SPIN_OK)
        status = spin_out_commit(&x->out);
    for (int i = 0; i < 3; i++) {
        if (status != SPIN_OK && path[i])
            unlink(path[i]);
        free(path[i]);
    }
    return status;
}

static spin_status finish_export(struct export *x)
{
    if (x->job->splats_4d)
        SPIN_TRY(write_4d(x));
    for (int i = 0; i < x->n_versions; i++)
        SPIN_TRY(write_group(x, &x->version[i]));
    SPIN_TRY(write_draft(x));
    SPIN_TRY(write_sound(x));
    SPIN_TRY(write_clip(x));
    SPIN_TRY(write_script(x, " type=\"text/plain\" id=\"worker\"", spin_html_worker));
    SPIN_TRY(write_script(x, " type=\"text/plain\" id=\"project\"", spin_html_project));
    SPIN_TRY(write_script(x, " type=\"text/plain\" id=\"vertex\"", spin_html_vertex));
    SPIN_TRY(write_script(x, " type=\"text/plain\" id=\"fragment\"", spin_html_fragment));
    SPIN_TRY(write_script(x, "", spin_html_script));
    SPIN_TRY(write_text(x, "</body>\n</html>\n"));
    say_errors(x);
    SPIN_TRY(fill_report(x));
    return commit_files(x);
}

SPIN_OWN_EXPORTER(html, "html", begin_export, finish_export, free_export,
                  .summary = "a web page that plays the clip, before and after, without a server",
                  .options = options, .checks = true, .antialias = true, .splats_4d = true,
                  .sound = "all", .looks_at_views = true, .frame = html_frame);
