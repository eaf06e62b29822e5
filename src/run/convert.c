/* spin_convert(): converts a run to a format for viewers. It calls spin_import(), spin_retrain()
 * and spin_export() in turn.
 *
 * For the output clip.html, these files are written beside it:
 *     clip.import.spin  the imported clip; after the export, it is deleted or, if it was not
 *                       retrained, renamed to clip.spin; after a failure, it is deleted unless an
 *                       unfinished training still needs it
 *     clip.spin.part    the checkpoint, while the training is unfinished
 *     clip.spin         the final clip, which is kept
 *
 * After an interruption, the same call continues from these files. If the format stores 4D splats,
 * two trainings are needed: the first trains frames with tracks, which are kept as
 * clip.tracks.spin; the second trains 4D splats that are made from these frames.
 *
 * A clip of frames with opacities that has no data set is retrained on renders of itself if the
 * format stores 4D splats; --data renders requests this for any format. Before this training, if
 * the frames share no rows, static splats are stored once for all frames, in clip.static.spin.
 * clip.import.spin is kept, since the renders are drawn from it. */
#include <sys/stat.h>

#include "base/base.h"
#include "spin_run.h"
#include "io/numbered.h"
#include "io/output.h"
#include "io/ranks.h"
#include "render/draw_renders.h"
#include "render/player.h"
#include "run/data_hint.h"
#include "run/export_sound.h"
#include "run/settle.h"
#include "run/targets.h"
#include "scene/dataset.h"
#include "scene/probe.h"
#include "train/options.h"

/* Number of frames that are sampled from a continuous run if neither the user nor the run states
 * it: two seconds. */
#define DEFAULT_FRAMES 60

/* The shares of static and of dynamic splats to keep with --splats auto. Dynamic splats are stored
 * for each frame. */
static const double auto_static = 0.6, auto_dynamic = 0.4;

/* Tracks that are trained on renders, and from which 4D splats are trained, need only this share of
 * the usual iterations: the quality of the 4D splats is the same (tests/bench/ablations.md). */
static const double track_share = 0.85;

struct convert {
    const struct spin_convert_options *o;
    const char *to;
    char *output, *bundle; /* paths of the final output and of the final bundle */
    char *tracks;          /* path of the retrained frames if `to` stores 4D splats, else NULL */
    /* Path of the bundle to retrain, or to export if it is not retrained. If the input is a bundle,
     * this is the input itself. */
    char *import;
    char *settled; /* path of the clip with its static rows stored once */
    /* Path of the data set that was found beside the run; NULL if none was found or the user named
     * one. */
    char *beside;
    bool imports;
    /* true: if the call fails, `import` is deleted, since no training needs it */
    bool removes_import;
    /* true: the user named a data set, or the data set that the bundle `import` names exists */
    bool has_data;
    bool is_trained; /* true: `import` was already retrained, with any method */
    /* true: `import` was trained with tracks, so that 4D splats can be made of its frames */
    bool is_tracks;
    bool renders; /* true: the clip is retrained on renders of itself */
    /* true: the frames of the import share no rows. Before the clip is retrained, it is rewritten
     * so that each static row is stored only once. */
    bool settles;
    int n_frames;                        /* of `import` */
    struct spin_settle_options thinning; /* its members keep_static, keep_dynamic and most */
    spin_json *report;
};

/* ---- Names ----------------------------------------------------------------------------------- */

static spin_status append_text(const char *text, size_t n, const char *ending, char **out)
{
    SPIN_TRY(spin_alloc(n + strlen(ending) + 1, 1, (void **)out));
    memcpy(*out, text, n);
    strcpy(*out + n, ending);
    return SPIN_OK;
}

/* Returns the length of a path without trailing slashes and, if has_ending is true, without the
 * extension of its last component, which may have two parts, such as ".tar.gz". */
static size_t stem_length(const char *path, bool has_ending)
{
    size_t n = strlen(path), first;

    while (n > 1 && path[n - 1] == '/')
        n--;
    first = (size_t)(spin_path_name(path) - path);
    if (has_ending && n > first + 3 && spin_text_ends_any_case(path, ".gz"))
        n -= 3;
    for (size_t i = n; has_ending && i-- > first + 1;)
        if (path[i] == '.')
            return i;
    return n;
}

/* Completes the default name of the output for the program of --for. A file gets the extension of
 * the program's format; a folder is called "NAME-PROGRAM", since "NAME" may be the input. */
static spin_status name_for_target(struct convert *c)
{
    SPIN_FREED char *stem = c->output, *named = NULL;
    size_t n = strlen(stem);

    c->output = NULL;
    SPIN_TRY(spin_target_output(c->o->target, c->o->to, stem, &c->output));
    if (spin_exporter_for(c->output))
        return SPIN_OK;
    free(c->output);
    c->output = NULL;
    SPIN_TRY(append_text(stem, n, "-", &named));
    return append_text(named, n + 1, c->o->target, &c->output);
}

static spin_status name_output(struct convert *c)
{
    const struct spin_convert_options *o = c->o;
    SPIN_FREED char *absolute = NULL, *folder = NULL;
    const char *name, *pattern;

    if (o->output && o->target)
        return spin_target_output(o->target, o->to, o->output, &c->output);
    if (o->output)
        return spin_strdup(o->output, &c->output);
    SPIN_TRY(spin_pattern_split(o->input, &folder, &pattern));
    SPIN_TRY(spin_foreign_missing(folder ? folder : o->input));
    SPIN_TRY(spin_path_absolute(folder ? folder : o->input, &absolute));
    name = spin_path_name(absolute);
    SPIN_TRY(append_text(name, stem_length(name, !spin_path_is_folder(absolute)),
                         o->target ? "" : ".html", &c->output));
    return o->target ? name_for_target(c) : SPIN_OK;
}

/* Returns whether an exporter receives 4D splats. An exporter that accepts nothing else receives
 * them, and so do 'tsog' and '4dgs', whose files are far larger if they store frames. */
static bool stores_4d(const char *name)
{
    for (const struct spin_exporter *const *e = spin_exporter_list(); *e; e++)
        if (strcmp((*e)->name, name) == 0)
            return (*e)->splats_4d &&
                   (!(*e)->frame || strcmp(name, "tsog") == 0 || strcmp(name, "4dgs") == 0);
    return false;
}

static spin_status name_all(struct convert *c)
{
    const struct spin_convert_options *o = c->o;
    const struct spin_exporter *named = o->to ? spin_exporter_named(o->to) : NULL;
    const char *ending, *dot, *nearest;
    size_t n;

    SPIN_TRY(name_output(c));
    ending = spin_exporter_for(c->output);
    c->to = named ? named->name : o->to ? o->to : ending;
    if (!c->to && o->target)
        SPIN_TRY(spin_target_exporter(o->target, &c->to));
    if (!c->to) {
        dot = strrchr(spin_path_name(c->output), '.');
        nearest = dot && dot[1] ? spin_exporter_nearest(dot) : NULL;
        return spin_misuse("no exporter for the extension of '%s': %s%s", c->output,
                           nearest ? "the nearest format is " : "choose one with --to",
                           nearest ? nearest : "");
    }
    if (named)
        SPIN_TRY(spin_exporter_check_name(named, c->output));
    n = stem_length(c->output, ending != NULL);
    SPIN_TRY(append_text(c->output, n, ".spin", &c->bundle));
    SPIN_TRY(append_text(c->output, n, ".static.spin", &c->settled));
    if (stores_4d(c->to))
        SPIN_TRY(append_text(c->output, n, ".tracks.spin", &c->tracks));
    c->imports = !spin_bundle_detect(o->input);
    return c->imports ? append_text(c->output, n, ".import.spin", &c->import)
                      : spin_strdup(o->input, &c->import);
}

static bool is_same_folder(const char *a, const char *b)
{
    struct stat one, other;

    return stat(a, &one) == 0 && stat(b, &other) == 0 && S_ISDIR(one.st_mode) &&
           one.st_dev == other.st_dev && one.st_ino == other.st_ino;
}

/* Checks before the training that the output can be written, to fail early. */
static spin_status check_output(const struct convert *c)
{
    const struct spin_convert_options *o = c->o;

    if (is_same_folder(o->input, c->output))
        return spin_fail(SPIN_E_IO, "cannot write into '%s': it is the input; name another folder",
                         c->output);
    if (spin_path_is_folder(c->output))
        return spin_output_check_empty_folder(c->output, o->force);
    if (spin_path_is_taken(c->output) || spin_exporter_for(c->output))
        return spin_output_check_file(c->output, o->force);
    return SPIN_OK;
}

/* Checks before the training that a clip of several frames is not to be written to a single file of
 * a format that stores one frame per file. */
static spin_status check_single_file(const struct convert *c)
{
    static const char *const formats[] = {"compressed-ply", "ply", "sog", "splat", "spz"};
    const char *format = spin_exporter_for(c->output);

    for (size_t i = 0; i < sizeof formats / sizeof *formats && c->n_frames > 1; i++)
        if (format && strcmp(format, formats[i]) == 0 && !spin_path_is_folder(c->output) &&
            !strpbrk(spin_path_name(c->output), "#%"))
            return spin_misuse("cannot write %d frames to the single file '%s': a file of '%s' "
                               "contains one frame; name a folder and give --to %s",
                               c->n_frames, c->output, format, format);
    return SPIN_OK;
}

/* Called if the output cannot be written. If the input is a data set and not a run, replaces the
 * error `status` by the description of the data set, which needs no output. */
static spin_status explain_input(const struct convert *c, spin_status status)
{
    const char *input = c->o->input;
    const struct spin_importer *importer = NULL;
    SPIN_FREED char *error = NULL, *below = NULL;
    spin_status found;

    if (!c->imports || c->o->from || !spin_path_is_folder(input))
        return status;
    SPIN_TRY(spin_strdup(spin_last_error(), &error));
    found = spin_importer_find_run(input, NULL, &importer, &below);
    if (found == SPIN_OK && strcmp(importer->name, "ply") == 0 &&
        spin_run_is_points(input, below ? below : input))
        found = SPIN_E_NOT_RECOGNISED;
    (void)spin_fail(status, "%s", error);
    if (found != SPIN_E_NOT_RECOGNISED)
        return status;
    found = spin_explain_data_set(input, status);
    return found == SPIN_E_NOT_RECOGNISED ? spin_fail_context(found, "cannot import '%s'", input)
                                          : found;
}

/* Checks before the training that the exporter has the options that the user gave. */
static spin_status check_exporter(const struct convert *c)
{
    const struct spin_exporter *e = spin_exporter_named(c->to);

    return e ? spin_plugin_check(c->to, e->options, c->o->export_pairs) : SPIN_OK;
}

/* Fails if the format stores 4D splats but the preset does not train tracks, since 4D splats can
 * only be made of frames trained with tracks. */
static spin_status check_preset(const struct convert *c)
{
    const char *preset = c->o->preset;

    if (!c->tracks || !preset || strcmp(preset, "quick") == 0 || strcmp(preset, "best") == 0)
        return SPIN_OK;
    return spin_misuse(
        "'%s' stores 4D splats, which can be trained with --preset quick or best, not %s", c->to,
        preset);
}

/* Parses --splats. */
static spin_status parse_splats(struct convert *c)
{
    const char *text = c->o->splats;
    struct spin_settle_options *t = &c->thinning;
    char *end;
    double value;

    t->keep_static = t->keep_dynamic = 1;
    if (!text)
        return SPIN_OK;
    if (strcmp(text, "auto") == 0) {
        t->keep_static = auto_static;
        t->keep_dynamic = auto_dynamic;
        return SPIN_OK;
    }
    value = strtod(text, &end);
    if (end > text && strcmp(end, "%") == 0 && value > 0 && value <= 100) {
        t->keep_static = t->keep_dynamic = value / 100;
        return SPIN_OK;
    }
    t->most = value;
    if (end > text && !*end && value >= 1 && value <= 1e9 && value == floor(value))
        return SPIN_OK;
    return spin_misuse("--splats '%s': expected a number of splats per frame (50000), a share of "
                       "the splats (50%%) or auto",
                       text);
}

/* Fails if the retrained clip would overwrite the bundle that it is made from. */
static spin_status check_bundle(const struct convert *c)
{
    const char *written[] = {c->bundle, c->tracks};
    SPIN_FREED char *input = NULL;

    if (c->imports)
        return SPIN_OK;
    SPIN_TRY(spin_path_absolute(c->import, &input));
    for (int i = 0; i < 2; i++) {
        SPIN_FREED char *path = NULL;

        if (!written[i] || !spin_path_is_taken(written[i]))
            continue;
        SPIN_TRY(spin_path_absolute(written[i], &path));
        if (strcmp(input, path) == 0 && (i == 0 || !c->is_trained))
            return spin_misuse("the retrained clip would overwrite the input '%s': choose another "
                               "name with --output",
                               written[i]);
    }
    return SPIN_OK;
}

/* ---- The steps ------------------------------------------------------------------------------- */

/* Adds the report `text`, returned by spin_import(), spin_retrain() or spin_export(), to the report
 * of spin_convert() as a member with this key. Takes ownership of `text`. */
static spin_status add_report(struct convert *c, const char *key, char *text)
{
    spin_json *document = NULL;
    spin_status status = text ? spin_json_parse("report", text, strlen(text), &document) : SPIN_OK;

    free(text);
    spin_json_set(c->report, key, document ? document : json_null());
    return status;
}

static bool asks_renders(const struct spin_convert_options *o)
{
    return o->data && strcmp(o->data, "renders") == 0 && !spin_path_exists(o->data);
}

static spin_status import_from(struct convert *c, const char *data)
{
    const struct spin_convert_options *o = c->o;
    char lod[16];
    const char *const pairs[] = {"lod", lod, NULL};
    struct spin_import_options import = {.input = o->input,
                                         .output = c->import,
                                         .from = o->from,
                                         .data = data,
                                         .data_from = asks_renders(o) ? NULL : o->data_from,
                                         .n_frames = o->n_frames,
                                         .default_frames = DEFAULT_FRAMES,
                                         .plugin_pairs = o->lod >= 0 ? pairs : NULL,
                                         .force = true};
    char *text = NULL;

    snprintf(lod, sizeof lod, "%d", o->lod);
    SPIN_TRY(spin_import(&import, &text));
    return add_report(c, "import", text);
}

/* Imports the run again, without the data set found beside it, after an import with this data set
 * has failed. If this succeeds, the data set was the reason, and a warning is printed. */
static spin_status import_without_data(struct convert *c)
{
    SPIN_FREED char *error = NULL;

    SPIN_TRY(spin_strdup(spin_last_error(), &error));
    SPIN_TRY(import_from(c, NULL));
    spin_warn("not using the data set '%s' found beside the run: %s", c->beside, error);
    free(c->beside);
    c->beside = NULL;
    return SPIN_OK;
}

/* Imports the run, with the data set that the user names or, if there is none, the data set that is
 * found beside the run. If a data set that was found does not fit, warns and imports without it. */
static spin_status import_run(struct convert *c)
{
    const struct spin_convert_options *o = c->o;
    spin_status status;

    if (asks_renders(o))
        return import_from(c, NULL);
    if (!o->data && !o->no_retrain)
        c->beside = spin_data_beside(o->input);
    if (!c->beside)
        return import_from(c, o->data);
    status = import_from(c, c->beside);
    if (status == SPIN_OK)
        spin_log(0, "using the data set '%s' found beside the run; --data chooses another",
                 c->beside);
    if (status == SPIN_OK || status == SPIN_E_CANCELLED || status == SPIN_E_MEMORY ||
        status == SPIN_E_NOT_RECOGNISED) /* the input is no run */
        return status;
    return import_without_data(c);
}

/* Returns whether to retrain. A clip that was already retrained is retrained again only to make 4D
 * splats from its frames, which requires that the frames were trained with tracks. */
static bool retrains(const struct convert *c)
{
    return (c->has_data || c->renders) && !c->o->no_retrain &&
           (!c->is_trained || (c->tracks && c->is_tracks));
}

/* Returns whether to retrain the clip on renders of itself: with --data renders, and by default if
 * there is no data set and either the format stores 4D splats, or a page would store the splats of
 * every frame, since the frames share none. */
static bool retrains_on_renders(const struct convert *c, const struct spin_bundle *b)
{
    bool fits = b->meta.n_frames > 1 && b->meta.four_d.n == 0 && !c->is_trained &&
                !(SPIN_COL_ATTRIBUTES & ~b->meta.columns);
    bool gains = c->tracks || (strcmp(c->to, "html") == 0 && !b->meta.identity);

    return fits && !c->o->no_retrain &&
           (asks_renders(c->o) || (!c->has_data && !c->o->data_from && gains));
}

/* Sets the members of *c that depend on the contents of the bundle `import`, and checks that the
 * bundle can be processed. */
static spin_status inspect_bundle(struct convert *c)
{
    SPIN_LEAVES(spin_bundle_close) struct spin_bundle bundle = {0};
    SPIN_FREED char *data = NULL;
    char frames[48];

    SPIN_TRY(spin_bundle_open(c->import, &bundle));
    SPIN_TRY(spin_bundle_data_path(&bundle, &data));
    c->has_data = (c->o->data && !asks_renders(c->o)) || (data && spin_path_exists(data));
    c->is_tracks = spin_bundle_is_trained_by_tracks(&bundle);
    c->is_trained = spin_bundle_is_trained(&bundle) || spin_bundle_is_trained_4d(&bundle) ||
                    bundle.refined.columns;
    c->renders = retrains_on_renders(c, &bundle);
    c->n_frames = bundle.meta.n_frames;
    SPIN_TRY(check_single_file(c));
    c->settles = c->renders && !bundle.meta.identity;
    if (c->has_data && !c->renders && !c->is_trained && !c->o->no_retrain)
        SPIN_TRY(spin_settle_applies(&bundle, &c->settles));
    if (asks_renders(c->o) && !c->renders && !c->o->no_retrain)
        return spin_unsupported("'%s' cannot be retrained on renders of itself: this needs a clip "
                                "of two or more frames that has opacities and is not yet trained",
                                c->o->input);
    if (c->o->splats && !(c->settles && c->renders))
        return spin_misuse("--splats applies only to a clip of frames that consist of different "
                           "splats and that is retrained on renders of itself; to leave out splats "
                           "of other clips, use spin-export --decimate");
    if (retrains(c)) {
        SPIN_TRY(check_preset(c));
        SPIN_TRY(check_bundle(c));
    }
    spin_log(0, "%s '%s': %s of %s%s%s", c->imports ? "imported" : "opened", c->o->input,
             spin_text_count(bundle.meta.n_frames, "frame", frames), bundle.meta.from,
             *bundle.meta.variant ? ", " : "", bundle.meta.variant);
    return SPIN_OK;
}

/* Sets options for training on renders. Exposures are off, since all renders have the same one. The
 * splats of dynamic and varying tracks learn no residual values per frame, which would only learn
 * the flicker of the source. No splats are split: the halves would grow where no render shows them,
 * in front of walls. Faint splats are pruned, unless the user chose their number (--splats). */
static void set_recipe(const struct convert *c, struct spin_retrain_options *o)
{
    if (o->method != SPIN_METHOD_4D) {
        o->residual = SPIN_RESIDUAL_SOURCE;
        o->dynamic_residual = false;
        if (c->o->splats)
            o->densify_every = 0;
        else
            o->densify_threshold = 1; /* prunes, but splits nothing */
        if (c->tracks && o->iterations < 0)
            o->iterations = (int)(track_share * -o->iterations *
                                  spin_options_clip_iterations(c->n_frames) / spin_n_ranks());
    }
    o->learn_exposure = SPIN_EXPOSURE_OFF;
    o->antialias = false;
}

/* Returns the options of the data set "renders", as in data_from of struct spin_clip_options; NULL
 * if the user gave none. */
static const char *renders_from(const struct spin_convert_options *o)
{
    return asks_renders(o) ? o->data_from : NULL;
}

/* Estimates the size of .tsog and .sogst files, in bytes. The constants are means of the clips in
 * docs/results.md, "Frames without images", of which the sizes differ by up to 13 %: the number of
 * 4D splats per static splat, and per dynamic splat of a frame, with and without pruning, and the
 * bytes of a 4D splat. */
static uint64_t guess_bytes(const struct spin_settled *s, bool prunes)
{
    const double per_static = prunes ? 1.2 : 1.15, per_dynamic = prunes ? 0.47 : 0.72, bytes = 14;

    return (uint64_t)(bytes *
                      (per_static * s->n_static + per_dynamic * s->n_dynamic * s->n_frames));
}

/* Writes c->settled, a copy of the clip whose static rows are stored once. Clears c->settles if the
 * images of the data set do not allow this. */
static spin_status settle_clip(struct convert *c)
{
    struct spin_settle_options o = c->thinning;
    struct spin_settled s;
    char bytes[32], size[64] = "";
    spin_status status;

    o.input = c->import;
    o.output = c->settled;
    o.data = c->renders ? "renders" : c->imports ? NULL : c->o->data;
    o.data_from = c->renders ? renders_from(c->o) : c->imports ? NULL : c->o->data_from;
    o.n_threads = c->o->n_threads;
    o.force = true;
    status = spin_settle(&o, &s);
    if (status == SPIN_E_UNSUPPORTED && !c->renders) {
        spin_log(0, "static splats cannot be found and remain stored in every frame: %s",
                 spin_last_error());
        c->settles = false;
        return SPIN_OK;
    }
    SPIN_TRY(status);
    if (c->renders && (strcmp(c->to, "tsog") == 0 || strcmp(c->to, "sogst") == 0))
        snprintf(size, sizeof size, "; the clip will have about %s",
                 spin_text_bytes(guess_bytes(&s, !c->o->splats), bytes));
    spin_log(0, "of %.0f splats per frame, %.0f are static and stored once, and %.0f are dynamic%s",
             s.n_before, s.n_static, s.n_dynamic, size);
    return SPIN_OK;
}

/* Retrains the bundle `input` and writes the result to `output`. Resumes an unfinished training of
 * this output. If that training had other options, --force starts again from the beginning, and
 * without --force the call fails. If `rows` is true, 4D splats are trained, otherwise frames. */
static spin_status retrain_as(struct convert *c, const char *input, const char *output, bool rows)
{
    const struct spin_convert_options *o = c->o;
    struct spin_retrain_options retrain;
    bool own_data = !c->imports && !c->renders && input == c->import;
    SPIN_FREED char *part = NULL;
    char *text = NULL;
    spin_status status;

    SPIN_TRY(append_text(output, strlen(output), ".part", &part));
    SPIN_TRY(spin_retrain_preset(o->preset ? o->preset : "quick", &retrain));
    retrain.method = rows ? SPIN_METHOD_4D : retrain.method;
    retrain.tracks |= retrain.method == SPIN_METHOD_TRACKS;
    retrain.antialias &= !c->tracks; /* viewers render files of 4D splats without antialiasing */
    retrain.iterations = o->iterations > 0 ? o->iterations : retrain.iterations;
    if (c->renders)
        set_recipe(c, &retrain);
    retrain.input = input;
    retrain.output = output;
    retrain.data = own_data ? o->data : NULL;
    retrain.data_from = own_data ? o->data_from : NULL;
    if (c->renders && input == c->import) {
        retrain.data = "renders";
        retrain.data_from = renders_from(o);
    }
    retrain.device = o->device;
    retrain.n_threads = o->n_threads;
    retrain.force = o->force;
    retrain.auto_resume = true;
    retrain.resume = spin_path_is_taken(part) || (!o->force && spin_path_is_taken(output));
    status = spin_retrain(&retrain, &text);
    if (status == SPIN_E_USAGE && retrain.resume && o->force) {
        retrain.resume = false;
        spin_inputs_own(part); /* allow the checkpoint to be overwritten, though it was an input */
        status = spin_retrain(&retrain, &text);
    }
    return status == SPIN_OK ? add_report(c, rows ? "rows" : "retrain", text) : status;
}

/* Retrains the clip to c->bundle. If the format stores 4D splats, trains frames with tracks first,
 * unless the clip is already trained. */
static spin_status retrain_clip(struct convert *c)
{
    const char *input;
    bool frames = !c->is_trained;

    if (c->settles)
        SPIN_TRY(settle_clip(c));
    input = c->settles ? c->settled : c->import;
    if (!c->tracks)
        return retrain_as(c, input, c->bundle, false);
    if (frames)
        SPIN_TRY(retrain_as(c, input, c->tracks, false));
    spin_log(0, "'%s' stores 4D splats: training 4D splats from the frames", c->to);
    return retrain_as(c, frames ? c->tracks : c->import, c->bundle, true);
}

static spin_status export_bundle(struct convert *c, const char *bundle)
{
    const struct spin_convert_options *o = c->o;
    struct spin_export_options export = {.input = bundle,
                                         .output = c->output,
                                         .to = c->to,
                                         .target = o->target,
                                         .sound = o->sound,
                                         .data = c->imports ? NULL : o->data,
                                         .data_from = c->imports ? NULL : o->data_from,
                                         .device = o->device,
                                         .n_threads = o->n_threads,
                                         .plugin_pairs = o->export_pairs,
                                         .n_crop = o->n_crop,
                                         .floaters = o->floaters,
                                         .force = o->force};
    char *text = NULL;

    memcpy(export.crop, o->crop, sizeof o->crop);
    SPIN_TRY(spin_export(&export, &text));
    return add_report(c, "export", text);
}

/* Measures the clip in held-out views, and compares its flicker with that of the source. */
static spin_status measure_clip(struct convert *c)
{
    struct spin_eval_options eval = {.input = c->bundle,
                                     .temporal = true,
                                     .image_scale = 1,
                                     .device = c->o->device,
                                     .n_threads = c->o->n_threads};
    char *text = NULL;

    SPIN_TRY(spin_eval(&eval, &text));
    return add_report(c, "eval", text);
}

/* Renames the imported clip to the final bundle if it was not retrained. If it was retrained,
 * removes the imported clip, whose contents the retrained clip includes. A clip that was retrained
 * on renders keeps the imported clip, since its data set is rendered from it. */
static spin_status keep_or_remove_import(struct convert *c, bool retrained)
{
    if (spin_rank() > 0)
        return SPIN_OK;
    if (retrained && c->settles)
        remove(c->settled);
    if (!c->imports)
        return SPIN_OK;
    if (!retrained && rename(c->import, c->bundle) != 0)
        return spin_fail(SPIN_E_IO, "cannot rename '%s' to '%s'", c->import, c->bundle);
    if (retrained && !c->renders)
        remove(c->import);
    return SPIN_OK;
}

static spin_status run_convert(struct convert *c)
{
    const struct spin_convert_options *o = c->o;
    bool trains;
    spin_status status;

    SPIN_TRY(name_all(c));
    SPIN_TRY(parse_splats(c));
    SPIN_TRY(spin_inputs_add_path(o->input));
    status = check_output(c);
    if (status != SPIN_OK)
        return explain_input(c, status);
    SPIN_TRY(spin_export_sound_check(o->sound));
    SPIN_TRY(check_exporter(c));
    if (c->imports && !o->no_retrain)
        SPIN_TRY(check_preset(c));
    if (!c->imports && (o->n_frames > 0 || o->from || o->lod >= 0))
        return spin_misuse("%s applies to runs only, but '%s' is a bundle",
                           o->from       ? "--from"
                           : o->lod >= 0 ? "--lod"
                                         : "--frames",
                           o->input);
    if (c->imports) {
        SPIN_TRY(import_run(c));
        spin_json_set_integer(c->report, "input_bytes", (json_int_t)spin_inputs_bytes());
    }
    c->removes_import = c->imports;
    SPIN_TRY(inspect_bundle(c));
    trains = retrains(c);
    c->removes_import &= !trains;
    if (c->renders)
        spin_log(0,
                 "%sretraining on renders of the clip itself, in about ten seconds of processor "
                 "time per frame; --no-retrain skips this",
                 asks_renders(c->o) ? "" : "no data set is known (--data names one): ");
    else if (trains)
        spin_log(0, "retraining on the images of the data set; --no-retrain skips this, and Ctrl-C "
                    "stops with a checkpoint");
    else if (o->preset || o->iterations > 0)
        spin_warn("nothing is retrained, so %s has no effect: %s",
                  o->preset ? "--preset" : "--iterations",
                  o->no_retrain ? "--no-retrain is given"
                  : c->is_trained
                      ? "the clip is already trained; use spin-retrain to train it again"
                      : "no data set is known; give one with --data");
    else if (!o->no_retrain && c->is_trained)
        spin_log(
            0,
            "the clip is already trained and is not retrained; use spin-retrain to train it again");
    else if (!o->no_retrain)
        spin_log(0, "no data set is known, so the clip is not retrained; give one with --data");
    if (trains)
        SPIN_TRY(retrain_clip(c));
    else if (c->imports)
        SPIN_TRY(spin_output_check_file(c->bundle, o->force));
    c->removes_import = c->imports && !c->renders;
    status = export_bundle(c, trains ? c->bundle : c->import);
    if (status != SPIN_OK && status != SPIN_E_CANCELLED && trains)
        return spin_fail_context(status, "the retrained clip is kept in '%s'", c->bundle);
    SPIN_TRY(status);
    if (c->renders)
        SPIN_TRY(measure_clip(c));
    SPIN_TRY(keep_or_remove_import(c, trains));
    spin_json_set_string(c->report, "bundle", c->imports || trains ? c->bundle : c->import);
    spin_json_set_string(c->report, "output", c->output);
    spin_json_set_string(c->report, "to", c->to);
    return SPIN_OK;
}

spin_status spin_convert(const struct spin_convert_options *o, char **report)
{
    SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin();
    SPIN_LEAVES(spin_renders_end) int renders = spin_renders_begin(o->n_threads);
    struct convert c = {.o = o, .report = spin_json_object()};
    spin_status status;

    (void)inputs;
    (void)renders;
    *report = NULL;
    spin_json_set_null(c.report, "input_bytes");
    spin_json_set_null(c.report, "import");
    spin_json_set_null(c.report, "retrain");
    spin_json_set_null(c.report, "rows");
    spin_json_set_null(c.report, "eval");
    status = run_convert(&c);
    if (status == SPIN_OK)
        status = spin_json_finish(json_incref(c.report), report);
    else if (c.removes_import && spin_rank() == 0)
        remove(c.import); /* not needed, since the next call imports the run again */
    spin_json_free(c.report);
    free(c.output);
    free(c.bundle);
    free(c.tracks);
    free(c.import);
    free(c.settled);
    free(c.beside);
    return status;
}
