/* spin_bundle_describe() and spin_bundle_views() report the contents of a bundle, from meta.json
 * and the headers of its arrays. */
#include "base/base.h"
#include "spin_run.h"
#include "scene/bundle_meta.h"
#include "scene/clip.h"
#include "scene/dataset.h"

static int64_t integer_of(const spin_json *object, const char *key)
{
    int64_t value = 0;

    spin_json_integer(spin_json_get(object, key), &value);
    return value;
}

static spin_json *text_of(const spin_json *object, const char *key)
{
    const char *text = spin_json_string(spin_json_get(object, key));

    return spin_json_text_value(text ? text : "");
}

/* Adds the members "splats", "sh_degree", "antialias" and "attributes" to the JSON object `to`,
 * which describes the source, a refinement or a training. */
static void add_splats(spin_json *to, const struct spin_bundle *b, enum spin_splat_source from,
                       unsigned columns, int64_t sh_degree, bool antialias)
{
    size_t least = SIZE_MAX, most = 0;
    double sum = 0;

    for (int f = 0; f < b->meta.n_frames; f++) {
        size_t n = spin_bundle_count(b, f, from);

        least = n < least ? n : least;
        most = n > most ? n : most;
        sum += (double)n;
    }
    spin_json_set(to, "splats",
                  json_pack("{s:I, s:f, s:I}", "min", (json_int_t)least, "mean",
                            sum / b->meta.n_frames, "max", (json_int_t)most));
    spin_json_set(to, "sh_degree",
                  columns & SPIN_COL_SH && sh_degree >= 0 ? json_integer(sh_degree) : json_null());
    spin_json_set_bool(to, "antialias", antialias);
    spin_json_set(to, "attributes", spin_column_names(columns));
}

/* Returns the description of the network; null if there is none. */
static spin_json *field_json(const spin_json *field)
{
    int64_t rows = 0, levels = integer_of(field, "levels");

    if (!spin_json_is_object(field))
        return json_null();
    spin_json_integer(spin_json_at(spin_json_get(field, "offset"), levels > 0 ? (size_t)levels : 0),
                      &rows);
    return json_pack("{s:I, s:I, s:I, s:I}", "levels", (json_int_t)levels, "features",
                     (json_int_t)integer_of(field, "features"), "hidden",
                     (json_int_t)integer_of(field, "hidden"), "rows", (json_int_t)rows);
}

/* Adds a refinement or a training to the report, as recorded in meta.json under `name`. */
static void add_stage(spin_json *root, const struct spin_bundle *b, const char *name,
                      enum spin_splat_source from, unsigned columns, int64_t sh_degree)
{
    static const char *const copied[] = {"before", "test", "options"};
    const spin_json *json = spin_json_get(b->json, name);
    spin_json *to = spin_json_object();
    bool antialias = false;

    spin_json_bool(spin_json_get(json, "antialias"), &antialias);
    add_splats(to, b, from, columns, sh_degree, antialias);
    if (from != SPIN_FROM_REFINED) {
        spin_json_set(to, "field", field_json(spin_json_get(json, "field")));
        spin_json_set(to, "device", text_of(json, "device"));
    }
    for (int i = 0; i < 3; i++) {
        spin_json *value = spin_json_get(json, copied[i]);

        spin_json_set(to, copied[i], value ? json_incref(value) : json_null());
    }
    if (from != SPIN_FROM_REFINED && spin_json_get(json, "options"))
        spin_json_set(to, "options", spin_trained_options(json));
    spin_json_set(root, name, to);
}

spin_status spin_bundle_describe(const char *path, char **report)
{
    SPIN_LEAVES(spin_bundle_close) struct spin_bundle bundle = {0};
    struct spin_bundle_bytes bytes, unpacked;
    const struct spin_bundle_meta *meta = &bundle.meta;
    const struct spin_frame_info *first, *last;
    const spin_json *trained;
    SPIN_LEAVES(spin_json_freed) spin_json *root = spin_json_object();
    SPIN_FREED char *data = NULL;

    *report = NULL;
    if (!spin_bundle_detect(path))
        return spin_fail(SPIN_E_NOT_RECOGNISED, "'%s' is not a bundle", path);
    SPIN_TRY(spin_bundle_open(path, &bundle));
    SPIN_TRY(spin_bundle_data_path(&bundle, &data));
    spin_bundle_sizes(&bundle, &bytes, &unpacked);
    first = meta->frame;
    last = first + meta->n_frames - 1;
    trained = spin_json_get(bundle.json, "trained");
    spin_json_set_string(root, "bundle", bundle.path);
    spin_json_set(root, "generator", text_of(bundle.json, "generator"));
    spin_json_set_string(root, "from", meta->from);
    spin_json_set_string(root, "variant", meta->variant);
    spin_json_set_string(root, "upstream", meta->upstream);
    spin_json_set_string(root, "data", data);
    spin_json_set_string(root, "data_from", data ? meta->data_from : NULL);
    spin_json_set_bool(root, "data_there", data && spin_path_exists(data));
    spin_json_set_integer(root, "frames", meta->n_frames);
    spin_json_set_integer(root, "source_frames", meta->n_source_frames);
    spin_json_set_bool(root, "numbered", meta->numbered);
    spin_json_set(root, "numbers", json_pack("[i, i]", first->number, last->number));
    spin_json_set(root, "times", spin_json_numbers((double[]){first->time, last->time}, 2));
    add_splats(root, &bundle, SPIN_FROM_SOURCE, meta->columns, meta->sh_degree, meta->antialias);
    spin_json_set(root, "static", spin_column_names(meta->static_columns));
    spin_json_set(root, "splats_4d",
                  meta->four_d.n ? json_incref(spin_json_get(bundle.json, "splats_4d"))
                                 : json_null());
    spin_json_set(root, "sound", spin_sound_json(&meta->sound));
    if (bundle.refined.columns)
        add_stage(root, &bundle, "refined", SPIN_FROM_REFINED, bundle.refined.columns,
                  bundle.refined.sh_degree);
    if (trained)
        add_stage(root, &bundle, "trained", SPIN_FROM_TRAINED, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                  integer_of(trained, "sh_degree"));
    /* Retrained 4D splats replace the source in the bundle. */
    if (spin_json_get(bundle.json, "trained_4d"))
        add_stage(root, &bundle, "trained_4d", SPIN_FROM_SOURCE, meta->columns, meta->sh_degree);
    spin_json_set(root, "bytes", spin_bundle_bytes_json(&bytes));
    spin_json_set(root, "bytes_unpacked", spin_bundle_bytes_json(&unpacked));
    return spin_json_finish(json_incref(root), report);
}

static spin_json *view_json(const struct spin_clip *clip, const struct spin_pair *pair)
{
    const struct spin_view *v = &clip->views.view[pair->view];
    const struct spin_camera *c = &v->camera;
    spin_json *j = spin_json_object();

    spin_json_set_integer(j, "frame", pair->frame);
    spin_json_set_integer(j, "number", clip->bundle.meta.frame[clip->frame[pair->frame]].number);
    spin_json_set_integer(j, "camera", v->camera_id);
    spin_json_set_bool(j, "test", v->test);
    spin_json_set_integer(j, "width", c->width);
    spin_json_set_integer(j, "height", c->height);
    spin_json_set_number(j, "fx", c->fx);
    spin_json_set_number(j, "fy", c->fy);
    spin_json_set_number(j, "cx", c->cx);
    spin_json_set_number(j, "cy", c->cy);
    spin_json_set(j, "w2c", spin_json_numbers(c->w2c, 12));
    spin_json_set_string(j, "image", v->path);
    spin_json_set_string(j, "mask", v->mask);
    return j;
}

spin_status spin_bundle_views(const char *path, const char *data, const char *data_from,
                              char **report)
{
    struct spin_clip_options o = {.input = path,
                                  .data = data,
                                  .data_from = data_from,
                                  .needs_views = true,
                                  .as_trained = true};
    SPIN_LEAVES(spin_clip_close) struct spin_clip clip = {0};
    SPIN_FREED struct spin_pair *pairs = NULL;
    SPIN_LEAVES(spin_json_freed) spin_json *list = spin_json_array();
    size_t n = 0;

    *report = NULL;
    SPIN_TRY(spin_clip_open(&o, &clip));
    SPIN_TRY(spin_clip_pairs(&clip, SPIN_SPLIT_ALL, &pairs, &n));
    for (size_t i = 0; i < n; i++)
        spin_json_push(list, view_json(&clip, &pairs[i]));
    return spin_json_finish(json_incref(list), report);
}
