/* Defaults, presets, limits and JSON of the training options, by the table in options.def. */
#include "train/options.h"

#include "base/base.h"
#include "io/ranks.h"

enum type { BOOL, INT, ENUM, UINT64, FLOAT, DOUBLE };
enum preset { QUICK, BEST, OF_PAPER, OF_SHORT, PRESETS }; /* in the order of SPIN_PRESETS */

struct row {
    enum type type;
    const char *field, *argument;
    size_t offset, n; /* offset of the field in the options, and number of its values */
    double min, max;  /* range of each value; 0, 0: no limit */
    struct {
        double value[PRESETS][4]; /* [preset][number] */
        const char *name[PRESETS];
    } fallback;
    struct {
        /* When the JSON contains the option. 0: never; 1: always; any other value is the offset of
         * a field: only if that field differs from its value in the preset "paper". */
        size_t when;
        const char *key; /* key in the JSON; NULL: the name of the field */
    } in_json[2];        /* [spin_options_of] */
};

/* Kinds of options.def that differ only on the command line have the same type here. */
#define FLAG BOOL
#define SWITCH BOOL
#define GRID INT
#define COLOUR FLOAT

#define C_BOOL bool
#define C_INT int
#define C_ENUM unsigned
#define C_UINT64 uint64_t
#define C_FLOAT float
#define C_DOUBLE double
#define C(type) C_##type
#define FIELD(field) (((struct spin_retrain_options *)NULL)->field)
/* Number of values of a field. Compiles only if the field has the type c, or is an array of this
 * type. */
#define COUNT(c, field) sizeof FIELD(field) / sizeof(_Generic(FIELD(field), c : (c)0, c * : (c)0))

#define NEVER .when = 0
#define ALWAYS .when = 1
#define AS(name) .when = 1, .key = name
#define WHERE(field) .when = offsetof(struct spin_retrain_options, field)

#define UNSET ALL(0)
#define ALL(...) .value = {{__VA_ARGS__}, {__VA_ARGS__}, {__VA_ARGS__}, {__VA_ARGS__}}
#define ALL_SHOWN(text, ...) ALL(__VA_ARGS__)
#define ALL_NAMED(word) .name = {#word, #word, #word, #word}
#define EACH(text, quick, best, paper, shorter) .value = {{quick}, {best}, {paper}, {shorter}}
#define PAPER(paper, rest) EACH("", rest, rest, paper, rest)
#define PAPER_NAMED(paper, rest) .name = {#rest, #rest, #paper, #rest}
#define SHORT(shorter, rest) EACH("", rest, rest, rest, shorter)
#define NETWORK(network, rest) EACH("", rest, rest, network, network)
#define NETWORK_NAMED(network, rest) .name = {#rest, #rest, #network, #network}
#define THREE(paper, shorter, rest) EACH("", rest, rest, paper, shorter)
#define HEADING(text)
#define OPTION(kind, field, name, argument, min, max, fallback, network, refinement, help)         \
    {kind,                                                                                         \
     #field,                                                                                       \
     argument,                                                                                     \
     offsetof(struct spin_retrain_options, field),                                                 \
     COUNT(C(kind), field),                                                                        \
     min,                                                                                          \
     max,                                                                                          \
     {fallback},                                                                                   \
     {{network}, {refinement}}},

static const struct row rows[] = {
#include "train/options.def"
};
static const struct row *const end = rows + sizeof rows / sizeof *rows;

/* ---- Values ---------------------------------------------------------------------------------- */

/* Returns the i-th name in a list like "a|b|c" and sets *length to its length; NULL if the list is
 * shorter. */
static const char *name_at(const char *names, size_t i, size_t *length)
{
    for (;; names++) {
        *length = strcspn(names, "|");
        if (i-- == 0)
            return names;
        names += *length;
        if (!*names)
            return NULL;
    }
}

/* Returns the index of a name in a list like "a|b|c"; SIZE_MAX if the list does not contain the
 * name. */
static size_t index_of_name(const char *name, const char *names)
{
    const char *found;
    size_t length;

    for (size_t i = 0; (found = name_at(names, i, &length)); i++)
        if (length == strlen(name) && memcmp(found, name, length) == 0)
            return i;
    return SIZE_MAX;
}

static double fallback_of(const struct row *row, enum preset preset, size_t i)
{
    const char *name = row->fallback.name[preset];

    return name ? (double)index_of_name(name, row->argument) : row->fallback.value[preset][i];
}

static double get_value(const struct row *row, const struct spin_retrain_options *o, size_t i)
{
    const void *field = (const char *)o + row->offset;

    switch (row->type) {
    case BOOL:
        return *(const bool *)field;
    case INT:
        return ((const int *)field)[i];
    case ENUM:
        return *(const unsigned *)field;
    case UINT64:
        return (double)*(const uint64_t *)field;
    case FLOAT:
        return (double)((const float *)field)[i];
    case DOUBLE:
        return *(const double *)field;
    }
    return NAN;
}

static void set_value(const struct row *row, struct spin_retrain_options *o, size_t i, double value)
{
    void *field = (char *)o + row->offset;

    switch (row->type) {
    case BOOL:
        *(bool *)field = value != 0;
        break;
    case INT:
        ((int *)field)[i] = (int)value;
        break;
    case ENUM:
        *(unsigned *)field = (unsigned)value;
        break;
    case UINT64:
        *(uint64_t *)field = (uint64_t)value;
        break;
    case FLOAT:
        ((float *)field)[i] = (float)value;
        break;
    case DOUBLE:
        *(double *)field = value;
        break;
    }
}

/* ---- Presets --------------------------------------------------------------------------------- */

static const char *const preset_names[] = {"quick", "best", "paper", "short"};

static void apply_preset(enum preset preset, struct spin_retrain_options *o)
{
    memset(o, 0, sizeof *o);
    o->device = "auto";
    o->preset = preset_names[preset];
    for (const struct row *row = rows; row < end; row++)
        for (size_t i = 0; i < row->n; i++)
            set_value(row, o, i, fallback_of(row, preset, i));
}

void spin_retrain_defaults(struct spin_retrain_options *o) { apply_preset(QUICK, o); }

spin_status spin_retrain_preset(const char *name, struct spin_retrain_options *o)
{
    size_t preset = index_of_name(name, SPIN_PRESETS);

    apply_preset(preset < PRESETS ? (enum preset)preset : QUICK, o);
    if (preset == SIZE_MAX)
        return spin_misuse("unknown preset '%s': use one of " SPIN_PRESETS, name);
    return SPIN_OK;
}

/* Constants of the default numbers of iterations, tuned on several clips. A clip has
 * CLIP_ITERATIONS plus FRAME_ITERATIONS for each frame. */
enum {
    CLIP_ITERATIONS = 1500,
    FRAME_ITERATIONS = 100,
    FEWEST_ITERATIONS = 1000,
    MOST_TRACK_ITERATIONS = 5000,
    DENSIFICATIONS = 20
};

/* Multiplies learning rates by sqrt(share). One iteration over `share` images replaces `share`
 * iterations over one image; its mean gradient is less noisy, which allows larger rates. */
static void scale_rates(struct spin_retrain_options *o, int share)
{
    double *rate[] = {&o->lr_table,    &o->lr_head_factor,  &o->lr_position, &o->lr_exposure,
                      &o->lr_residual, &o->lr_displacement, &o->lr_track};

    for (size_t i = 0; i < sizeof rate / sizeof *rate; i++)
        *rate[i] *= sqrt(share);
}

/* Returns the number of images per iteration; the default is one for each rank. */
static int batch_of(const struct spin_retrain_options *o)
{
    return o->batch > 0 ? o->batch : spin_n_ranks();
}

int spin_options_most_iterations(size_t n_images, size_t n_positions)
{
    double positions = (double)n_positions;

    return (int)fmin(fmax(FEWEST_ITERATIONS, positions * positions / 12 * (double)n_images), 1e9);
}

double spin_options_clip_iterations(int n_frames)
{
    return CLIP_ITERATIONS + (double)FRAME_ITERATIONS * n_frames;
}

void spin_options_resolve(struct spin_retrain_options *o, int n_frames, int most_iterations)
{
    /* One iteration of all ranks replaces this number of iterations of a single rank. */
    int share = o->batch > 0 ? 1 : spin_n_ranks();

    o->batch = batch_of(o);
    scale_rates(o, share);
    if (o->iterations < 0)
        o->iterations =
            (int)ceil(fmin(-o->iterations * spin_options_clip_iterations(n_frames),
                           most_iterations) /
                      share);
    if (o->track_iterations < 0)
        o->track_iterations = (MOST_TRACK_ITERATIONS + share - 1) / share;
    if (o->track_iterations > o->iterations)
        o->track_iterations = o->iterations;
    if (o->densify_every < 0)
        o->densify_every = o->track_iterations / DENSIFICATIONS;
    /* 4D splats are not densified, and are trained in all iterations. */
    if (o->method == SPIN_METHOD_4D) {
        o->tracks = false;
        o->track_iterations = o->iterations;
        o->densify_every = 0;
    }
}

/* ---- Limits ---------------------------------------------------------------------------------- */

/* True if `value` is the default of any preset. */
static bool is_fallback(const struct row *row, size_t i, double value)
{
    for (int preset = 0; preset < PRESETS; preset++)
        if (value == fallback_of(row, (enum preset)preset, i))
            return true;
    return false;
}

static spin_status check_number(const struct row *row, size_t i, double value)
{
    int digits = row->type == UINT64 ? 16 : 10;
    size_t length;

    if (row->type == ENUM && !name_at(row->argument, (size_t)value, &length))
        return spin_misuse("%s %g is not one of %s", row->field, value, row->argument);
    if (row->min >= row->max || (value >= row->min && value <= row->max) ||
        is_fallback(row, i, value))
        return SPIN_OK;
    return spin_misuse("%s %.*g is not in the range %.*g to %.*g", row->field, digits, value,
                       digits, row->min, digits, row->max);
}

spin_status spin_options_check(const struct spin_retrain_options *o)
{
    for (const struct row *row = rows; row < end; row++)
        for (size_t i = 0; i < row->n; i++)
            SPIN_TRY(check_number(row, i, get_value(row, o, i)));
    if (o->views_per_frame > batch_of(o))
        return spin_misuse(
            "views_per_frame %d is larger than batch %d: lower views_per_frame, or raise batch",
            o->views_per_frame, batch_of(o));
    return SPIN_OK;
}

/* ---- JSON ------------------------------------------------------------------------------------ */

static bool differs_at(size_t offset, const struct spin_retrain_options *o)
{
    for (const struct row *row = rows; row < end; row++)
        for (size_t i = 0; i < row->n && row->offset == offset; i++)
            if (get_value(row, o, i) != fallback_of(row, OF_PAPER, i))
                return true;
    return false;
}

static void add_to_json(const struct row *row, const struct spin_retrain_options *o,
                        const char *key, spin_json *j)
{
    double value = get_value(row, o, 0);
    spin_json *array;
    size_t length;
    char text[32];

    if (row->n > 1) {
        array = spin_json_array();
        for (size_t i = 0; i < row->n; i++)
            spin_json_push_number(array, get_value(row, o, i));
        spin_json_set(j, key, array);
    } else if (row->type == BOOL) {
        spin_json_set_bool(j, key, value != 0);
        /* UINT64 options are limited to less than 2^53, so a double holds their values exactly. */
    } else if (row->type == INT || row->type == UINT64) {
        spin_json_set_integer(j, key, (int64_t)value);
    } else if (row->type == ENUM) {
        const char *name = name_at(row->argument, (size_t)value, &length);

        snprintf(text, sizeof text, "%.*s", (int)length, name);
        spin_json_set_string(j, key, text);
    } else {
        spin_json_set_number(j, key, value);
    }
}

const char *spin_options_continue(const struct spin_retrain_options *o)
{
    return o->resume || o->auto_resume ? "run the same command to continue"
                                       : "continue with --resume";
}

const char *spin_options_restart(const struct spin_retrain_options *o)
{
    return o->auto_resume ? "--force" : "--force without --resume";
}

spin_json *spin_options_to_json(const struct spin_retrain_options *o, enum spin_options_of of)
{
    spin_json *j = spin_json_object();

    for (const struct row *row = rows; row < end; row++) {
        size_t when = row->in_json[of].when;

        if (when == 1 || (when > 1 && differs_at(when, o)))
            add_to_json(row, o, row->in_json[of].key ? row->in_json[of].key : row->field, j);
    }
    return j;
}
