/* Reads and writes meta.json of a bundle. */
#include "scene/bundle_meta.h"

#include "base/base.h"
#include "scene/columns.h"
#include "scene/kept_cameras.h"
#include "scene/splats_4d.h"

#define FORMAT "spin bundle"
/* Format versions. VERSION: all arrays are plain. VERSION_PACKED: arrays may be packed. VERSION_4D:
 * the source consists of 4D splats. A bundle gets the lowest version that describes its contents,
 * so that older readers can read as many bundles as possible. */
enum { VERSION = 1, VERSION_PACKED = 4, VERSION_4D = 5 };

spin_status spin_bundle_meta_reserve(struct spin_bundle_meta *meta, int n_frames)
{
    void *frame = NULL, *index = NULL;
    spin_status status;

    SPIN_TRY_OUT(spin_alloc((size_t)n_frames, sizeof *meta->frame, &frame));
    SPIN_TRY_OUT(spin_alloc((size_t)n_frames, sizeof *meta->source_index, &index));
    free(meta->frame);
    free(meta->source_index);
    meta->frame = frame;
    meta->source_index = index;
    meta->n_frames = n_frames;
    return SPIN_OK;
out:
    free(frame);
    return status;
}

void spin_bundle_meta_free(struct spin_bundle_meta *meta)
{
    free(meta->frame);
    free(meta->source_index);
    free(meta->data_path);
    free(meta->data_absolute);
    spin_views_free(&meta->cameras);
    memset(meta, 0, sizeof *meta);
}

spin_status spin_meta_fail(const char *key, const char *expected)
{
    return spin_malformed("meta.json: '%s' is missing or is not %s", key, expected);
}

spin_status spin_meta_integer(const spin_json *object, const char *key, int64_t least, int64_t most,
                              int64_t *out)
{
    if (!spin_json_integer(spin_json_get(object, key), out))
        return spin_meta_fail(key, "a whole number");
    if (*out < least || *out > most)
        return spin_malformed("meta.json: '%s' is %lld, expected %lld to %lld", key,
                              (long long)*out, (long long)least, (long long)most);
    return SPIN_OK;
}

/* Copies the string of a key to `out`, truncated to n_out - 1 bytes. Copies "" if the key is
 * missing or null. */
static void read_text(const spin_json *object, const char *key, char *out, size_t n_out)
{
    const char *text = spin_json_string(spin_json_get(object, key));

    snprintf(out, n_out, "%s", text ? text : "");
}

static spin_status read_columns(const spin_json *root, const char *key, unsigned *out)
{
    const spin_json *list = spin_json_get(root, key);

    *out = 0;
    if (!list || !spin_json_is_array(list))
        return spin_meta_fail(key, "a list of names");
    for (size_t k = 0; k < spin_json_length(list); k++) {
        const char *name = spin_json_string(spin_json_at(list, k));

        if (!name)
            return spin_meta_fail(key, "a list of names");
        if (!spin_column_named(name))
            return spin_unsupported("meta.json: '%s' lists the unknown column '%.40s'", key, name);
        *out |= spin_column_named(name);
    }
    return SPIN_OK;
}

spin_status spin_meta_columns(const spin_json *object, unsigned *columns, int *sh_degree,
                              bool *antialias)
{
    int64_t degree;

    SPIN_TRY(read_columns(object, "columns", columns));
    if (!(*columns & SPIN_COL_MEANS))
        return spin_malformed("meta.json: 'columns' does not list 'means'");
    SPIN_TRY(spin_meta_integer(object, "sh_degree", -1, 3, &degree));
    if ((*columns & SPIN_COL_SH) && degree < 0)
        return spin_malformed("meta.json: 'columns' lists 'sh', but 'sh_degree' is -1");
    *sh_degree = (int)degree;
    spin_json_bool(spin_json_get(object, "antialias"), antialias);
    return SPIN_OK;
}

static spin_status read_frame_entry(struct spin_bundle_meta *meta, int i, const spin_json *entry)
{
    struct spin_frame_info *f = &meta->frame[i];
    int64_t number, n, index;

    SPIN_TRY(spin_meta_integer(entry, "number", INT_MIN, INT_MAX, &number));
    SPIN_TRY(spin_meta_integer(entry, "n", 0, UINT32_MAX, &n));
    SPIN_TRY(spin_meta_integer(entry, "source_index", 0, meta->n_source_frames - 1, &index));
    if (!spin_json_number(spin_json_get(entry, "time"), &f->time) || !isfinite(f->time))
        return spin_meta_fail("time", "a number");
    f->number = (int)number;
    f->n = (size_t)n;
    meta->source_index[i] = (int)index;
    return SPIN_OK;
}

spin_status spin_frame_numbers_check(const struct spin_frame_info *frame, int n)
{
    SPIN_FREED int *number = NULL;

    SPIN_TRY(spin_alloc((size_t)n, sizeof *number, (void **)&number));
    for (int i = 0; i < n; i++)
        number[i] = frame[i].number;
    qsort(number, (size_t)n, sizeof *number, spin_by_int);
    for (int i = 1; i < n; i++)
        if (number[i] == number[i - 1])
            return spin_malformed("two frames have the number %d", number[i]);
    return SPIN_OK;
}

static spin_status read_frames(struct spin_bundle_meta *meta, const spin_json *root)
{
    const spin_json *list = spin_json_get(root, "frames");
    size_t n = spin_json_length(list);
    int64_t n_source;

    if (!list || !spin_json_is_array(list) || n == 0 || n > INT_MAX)
        return spin_meta_fail("frames", "a list with at least one frame");
    SPIN_TRY(spin_meta_integer(root, "source_frames", 1, INT_MAX, &n_source));
    meta->n_source_frames = (int)n_source;
    SPIN_TRY(spin_bundle_meta_reserve(meta, (int)n));
    for (size_t i = 0; i < n; i++)
        SPIN_TRY_IN(read_frame_entry(meta, (int)i, spin_json_at(list, i)), "frame %zu", i);
    return spin_frame_numbers_check(meta->frame, meta->n_frames);
}

static spin_status read_data(struct spin_bundle_meta *meta, const spin_json *root)
{
    const spin_json *data = spin_json_get(root, "data");
    const char *path, *absolute;

    read_text(root, "pair", meta->pair, sizeof meta->pair);
    if (!data || !spin_json_is_object(data))
        return SPIN_OK;
    path = spin_json_string(spin_json_get(data, "path"));
    if (!path || path[0] == '\0')
        return spin_meta_fail("data.path", "a path");
    read_text(data, "from", meta->data_from, sizeof meta->data_from);
    absolute = spin_json_string(spin_json_get(data, "absolute"));
    if (absolute && *absolute)
        SPIN_TRY(spin_strdup(absolute, &meta->data_absolute));
    return spin_strdup(path, &meta->data_path);
}

static spin_status read_number(const spin_json *object, const char *key, double *out)
{
    const spin_json *value = spin_json_get(object, key);

    return !value || (spin_json_number(value, out) && isfinite(*out))
               ? SPIN_OK
               : spin_meta_fail(key, "a number");
}

/* Reads "splats_4d": the number of 4D splats, the list of optional arrays, and the values that all
 * splats share. */
static spin_status read_4d(struct spin_bundle_meta *meta, const spin_json *root)
{
    const spin_json *json = spin_json_get(root, "splats_4d"), *list;
    struct spin_splats_4d *s = &meta->four_d;
    int64_t n, degree;

    if (!json)
        return SPIN_OK;
    if (!spin_json_is_object(json))
        return spin_meta_fail("splats_4d", "an object");
    SPIN_TRY(spin_meta_integer(json, "n", 1, UINT32_MAX, &n));
    SPIN_TRY(spin_meta_integer(json, "degree", 0, 3, &degree));
    if (meta->columns != (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES) || meta->static_columns)
        return spin_malformed("meta.json: if there are 4D splats, 'columns' must list the means "
                              "and all attributes, and 'static_columns' must be empty");
    *s = (struct spin_splats_4d){.n = (size_t)n,
                                 .degree = (int)degree,
                                 .sh_degree = meta->sh_degree,
                                 .antialias = meta->antialias};
    SPIN_TRY(read_number(json, "least_weight", &s->least_weight));
    SPIN_TRY(read_number(json, "least_opacity", &s->least_opacity));
    SPIN_TRY(read_number(json, "period", &s->period));
    list = spin_json_get(json, "cov2d");
    for (size_t c = 0; list && c < 2; c++)
        if (!spin_json_number(spin_json_at(list, c), &s->cov2d[c]) || !(s->cov2d[c] > 0) ||
            !isfinite(s->cov2d[c]))
            return spin_meta_fail("cov2d", "two numbers above 0");
    list = spin_json_get(json, "arrays");
    for (size_t i = 0; i < spin_json_length(list); i++) {
        const char *name = spin_json_string(spin_json_at(list, i));
        unsigned part = name ? spin_array_4d_part(name) : 0;

        if (!part)
            return spin_unsupported("meta.json: 'arrays' lists the unknown array '%.40s'",
                                    name ? name : "");
        meta->parts |= part;
    }
    return SPIN_OK;
}

/* Reads a list of three numbers; if the key is missing, `out` keeps its values. */
static spin_status read_vector(const spin_json *root, const char *key, double out[3])
{
    const spin_json *list = spin_json_get(root, key);

    for (size_t c = 0; list && c < 3; c++)
        if (spin_json_length(list) != 3 || !spin_json_number(spin_json_at(list, c), &out[c]) ||
            !isfinite(out[c]))
            return spin_meta_fail(key, "three numbers");
    return SPIN_OK;
}

static bool is_zero(const double v[3]) { return v[0] == 0 && v[1] == 0 && v[2] == 0; }

static spin_status read_up(const spin_json *root, double up[3])
{
    SPIN_TRY(read_vector(root, "up", up));
    if (!is_zero(up) && fabs(up[0] * up[0] + up[1] * up[1] + up[2] * up[2] - 1) > 1e-6)
        return spin_meta_fail("up", "a unit vector");
    return SPIN_OK;
}

spin_status spin_bundle_meta_read(struct spin_bundle_meta *meta, const spin_json *root)
{
    const char *format = spin_json_string(spin_json_get(root, "format"));
    int64_t version;

    if (!format || strcmp(format, FORMAT) != 0)
        return spin_meta_fail("format", "'" FORMAT "'");
    SPIN_TRY(spin_meta_integer(root, "version", 1, INT_MAX, &version));
    if (version > VERSION_4D)
        return spin_unsupported(
            "bundle version %lld, expected %d to %d: a newer spin4d may read it",
            (long long)version, VERSION, VERSION_4D);
    read_text(root, "from", meta->from, sizeof meta->from);
    read_text(root, "upstream", meta->upstream, sizeof meta->upstream);
    read_text(root, "variant", meta->variant, sizeof meta->variant);
    if (!spin_json_bool(spin_json_get(root, "numbered"), &meta->numbered))
        return spin_meta_fail("numbered", "true or false");
    SPIN_TRY(spin_meta_columns(root, &meta->columns, &meta->sh_degree, &meta->antialias));
    SPIN_TRY(read_columns(root, "static_columns", &meta->static_columns));
    spin_json_bool(spin_json_get(root, "identity"), &meta->identity);
    if (meta->static_columns & ~meta->columns)
        return spin_malformed("meta.json: 'static_columns' lists a column that 'columns' does not");
    SPIN_TRY(read_4d(meta, root));
    SPIN_TRY(read_number(root, "fps", &meta->fps));
    SPIN_TRY(read_vector(root, "shift", meta->shift));
    SPIN_TRY(read_up(root, meta->up));
    if (meta->fps < 0)
        return spin_meta_fail("fps", "a number of at least 0");
    SPIN_TRY(read_data(meta, root));
    SPIN_TRY(spin_kept_cameras_read(spin_json_get(root, "cameras"), &meta->cameras));
    return read_frames(meta, root);
}

/* ---- Writing --------------------------------------------------------------------------------- */

spin_json *spin_column_names(unsigned columns)
{
    spin_json *list = spin_json_array();

    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        if (columns & column)
            spin_json_push_string(list, spin_column_name(column));
    }
    return list;
}

static spin_json *frames_json(const struct spin_bundle_meta *meta)
{
    spin_json *list = spin_json_array();

    for (int i = 0; i < meta->n_frames; i++) {
        spin_json *entry = spin_json_object();

        spin_json_set_integer(entry, "number", meta->frame[i].number);
        spin_json_set_number(entry, "time", meta->frame[i].time);
        spin_json_set_integer(entry, "n", (int64_t)meta->frame[i].n);
        spin_json_set_integer(entry, "source_index", meta->source_index[i]);
        spin_json_push(list, entry);
    }
    return list;
}

spin_json *spin_bundle_4d_json(const struct spin_splats_4d *s, unsigned parts)
{
    spin_json *json = spin_json_object(), *list = spin_json_array();

    spin_json_set_integer(json, "n", (int64_t)s->n);
    spin_json_set_integer(json, "degree", s->degree);
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
        if (spin_array_4d_part(spin_array_4d_name(k)) & parts)
            spin_json_push_string(list, spin_array_4d_name(k));
    spin_json_set(json, "arrays", list);
    spin_json_set_number(json, "least_weight", s->least_weight);
    spin_json_set_number(json, "least_opacity", s->least_opacity);
    if (parts & SPIN_4D_SH_COS)
        spin_json_set_number(json, "period", s->period);
    if (s->cov2d[0] > 0)
        spin_json_set(json, "cov2d", spin_json_numbers(s->cov2d, 2));
    return json;
}

spin_json *spin_sound_json(const struct spin_sound *sound)
{
    spin_json *json = spin_json_object();

    if (!sound->data) {
        spin_json_free(json);
        return json_null();
    }
    spin_json_set_string(json, "name", sound->name);
    spin_json_set_string(json, "type", sound->type);
    spin_json_set_integer(json, "bytes", (int64_t)sound->size);
    spin_json_set_number(json, "start", sound->start);
    spin_json_set_number(json, "gain", sound->gain);
    return json;
}

spin_json *spin_bundle_meta_json(const struct spin_bundle_meta *meta, spin_json *extra)
{
    spin_json *root = extra ? extra : spin_json_object();

    spin_json_set_string(root, "format", FORMAT);
    spin_json_set_integer(root, "version", meta->four_d.n ? VERSION_4D : VERSION);
    spin_json_set_string(root, "generator", "spin4d " SPIN_VERSION);
    spin_json_set_string(root, "from", meta->from);
    spin_json_set_string(root, "upstream", meta->upstream);
    spin_json_set_string(root, "variant", meta->variant);
    spin_json_set_integer(root, "source_frames", meta->n_source_frames);
    spin_json_set_bool(root, "numbered", meta->numbered);
    spin_json_set(root, "columns", spin_column_names(meta->columns));
    spin_json_set(root, "static_columns", spin_column_names(meta->static_columns));
    if (!is_zero(meta->shift))
        spin_json_set(root, "shift", spin_json_numbers(meta->shift, 3));
    if (!is_zero(meta->up))
        spin_json_set(root, "up", spin_json_numbers(meta->up, 3));
    if (meta->fps > 0)
        spin_json_set_number(root, "fps", meta->fps);
    if (meta->identity)
        spin_json_set_bool(root, "identity", true);
    if (meta->pair[0])
        spin_json_set_string(root, "pair", meta->pair);
    spin_json_set_integer(root, "sh_degree", meta->sh_degree);
    if (meta->antialias)
        spin_json_set_bool(root, "antialias", true);
    if (meta->data_path) {
        spin_json *data = spin_json_object();

        spin_json_set_string(data, "path", meta->data_path);
        if (meta->data_absolute && strcmp(meta->data_absolute, meta->data_path) != 0)
            spin_json_set_string(data, "absolute", meta->data_absolute);
        spin_json_set_string(data, "from", meta->data_from);
        spin_json_set(root, "data", data);
    } else {
        spin_json_set_null(root, "data");
    }
    if (meta->cameras.n > 0)
        spin_json_set(root, "cameras", spin_kept_cameras_json(&meta->cameras));
    if (meta->four_d.n)
        spin_json_set(root, "splats_4d", spin_bundle_4d_json(&meta->four_d, meta->parts));
    if (meta->sound.data)
        spin_json_set(root, "sound", spin_sound_json(&meta->sound));
    spin_json_set(root, "frames", frames_json(meta));
    return root;
}

void spin_bundle_meta_packed(spin_json *root, const struct spin_packer *packer)
{
    if (!spin_json_get(root, "splats_4d"))
        spin_json_set_integer(root, "version", VERSION_PACKED);
    spin_packer_json(packer, root);
}

spin_json *spin_trained_options(const spin_json *trained)
{
    static const char *const of_network[] = {
        "levels",       "features",       "hash_log2",  "hidden",           "base_resolution",
        "lr_table",     "lr_sh",          "lr_scale",   "lr_rotation",      "finest_resolution",
        "residual",     "init_log_scale", "lr_opacity", "hash_init_range",  "lr_head_factor",
        "relu",         "activation",     "normalise",  "normalise_centre", "normalise_radius",
        "network_start"};
    spin_json *copy = json_copy((json_t *)(uintptr_t)spin_json_get(trained, "options"));

    for (size_t i = 0; i < sizeof of_network / sizeof *of_network && copy; i++)
        if (!spin_json_is_object(spin_json_get(trained, "field")))
            json_object_del(copy, of_network[i]);
    return copy;
}
