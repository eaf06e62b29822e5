/* *.spin: what is in it is written in man/spin-bundle.5.
 *
 * Reading trusts nothing: meta.json says which arrays there must be and of which shape, and every
 * one of them is looked at before spin_bundle_open() returns - its header only, so that a clip of
 * many gigabytes opens at once. The values stay in the map until a frame is asked for. */
#include "scene/bundle.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"

#define FORMAT "spin bundle"
#define VERSION 1
#define META "meta.json"
#define META_LIMIT (64u << 20) /* bytes */
/* Checking a CRC reads every byte; larger members are only checked for being there. */
#define CRC_LIMIT (64u << 20)

enum { N_COLUMNS = 6 };

static const struct {
    unsigned column;
    const char *name;
    size_t width; /* 0: depends on the SH degree */
} columns_table[N_COLUMNS] = {
    {SPIN_COL_MEANS, "means", 3},
    {SPIN_COL_QUATS, "quats", 4},
    {SPIN_COL_LOG_SCALES, "log_scales", 3},
    {SPIN_COL_LOGIT_OPACITIES, "logit_opacities", 1},
    {SPIN_COL_SH, "sh", 0},
    {SPIN_COL_RGB, "rgb", 3},
};

/* ---- Columns --------------------------------------------------------------------------------- */

static int column_index(unsigned column)
{
    for (int i = 0; i < N_COLUMNS; i++) {
        if (columns_table[i].column == column)
            return i;
    }
    return 0;
}

const char *spin_column_name(enum spin_column column)
{
    return columns_table[column_index(column)].name;
}

size_t spin_column_width(enum spin_column column, int sh_degree)
{
    size_t width = columns_table[column_index(column)].width;

    return width ? width : 3 * (size_t)((sh_degree + 1) * (sh_degree + 1));
}

float **spin_column_of(struct spin_splats *s, enum spin_column column)
{
    float **const of[N_COLUMNS] = {&s->means,           &s->quats, &s->log_scales,
                                   &s->logit_opacities, &s->sh,    &s->rgb};

    return of[column_index(column)];
}

/* Dimensions of n rows of a column. */
static int column_shape(int i, size_t n, int sh_degree, uint64_t shape[3])
{
    shape[0] = n;
    if (columns_table[i].column == SPIN_COL_LOGIT_OPACITIES)
        return 1;
    if (columns_table[i].column == SPIN_COL_SH) {
        shape[1] = (uint64_t)((sh_degree + 1) * (sh_degree + 1));
        shape[2] = 3;
        return 3;
    }
    shape[1] = columns_table[i].width;
    return 2;
}

/* "source/means/00012", or "source/means" for a still column. */
static void member_key(const char *group, int i, bool still, int frame, char key[64])
{
    if (still)
        snprintf(key, 64, "%s/%s", group, columns_table[i].name);
    else
        snprintf(key, 64, "%s/%s/%05d", group, columns_table[i].name, frame);
}

/* ---- Meta ------------------------------------------------------------------------------------ */

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
    memset(meta, 0, sizeof *meta);
}

static spin_status fail_key(const char *key, const char *expected)
{
    return spin_fail(SPIN_E_MALFORMED, "meta.json: '%s' is missing or is not %s", key, expected);
}

static spin_status read_integer(const spin_json *object, const char *key, int64_t least,
                                int64_t most, int64_t *out)
{
    if (!spin_json_integer(spin_json_get(object, key), out))
        return fail_key(key, "a whole number");
    if (*out < least || *out > most)
        return spin_fail(SPIN_E_MALFORMED, "meta.json: '%s' is %lld, expected %lld to %lld", key,
                         (long long)*out, (long long)least, (long long)most);
    return SPIN_OK;
}

/* A string, cut to fit. Absent or null: "". */
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
        return fail_key(key, "a list of names");
    for (size_t k = 0; k < spin_json_length(list); k++) {
        const char *name = spin_json_string(spin_json_at(list, k));
        int i = 0;

        if (!name)
            return fail_key(key, "a list of names");
        while (i < N_COLUMNS && strcmp(columns_table[i].name, name) != 0)
            i++;
        if (i == N_COLUMNS)
            return spin_fail(SPIN_E_UNSUPPORTED,
                             "meta.json: '%s' names a column '%.40s' that this "
                             "version does not know",
                             key, name);
        *out |= columns_table[i].column;
    }
    return SPIN_OK;
}

/* The columns that splats have, means at least, the degree of their colours, how to draw them. */
static spin_status read_splat_columns(const spin_json *object, unsigned *columns, int *sh_degree,
                                      bool *antialias)
{
    int64_t degree;

    SPIN_TRY(read_columns(object, "columns", columns));
    if (!(*columns & SPIN_COL_MEANS))
        return spin_fail(SPIN_E_MALFORMED, "meta.json: 'columns' lacks 'means'");
    SPIN_TRY(read_integer(object, "sh_degree", -1, 3, &degree));
    if ((*columns & SPIN_COL_SH) && degree < 0)
        return spin_fail(SPIN_E_MALFORMED, "meta.json: column 'sh' with an 'sh_degree' of -1");
    *sh_degree = (int)degree;
    spin_json_bool(spin_json_get(object, "antialias"), antialias);
    return SPIN_OK;
}

static spin_status read_frame_entry(struct spin_bundle_meta *meta, int i, const spin_json *entry)
{
    struct spin_frame_info *f = &meta->frame[i];
    int64_t number, n, index;

    SPIN_TRY(read_integer(entry, "number", INT_MIN, INT_MAX, &number));
    SPIN_TRY(read_integer(entry, "n", 0, UINT32_MAX, &n));
    SPIN_TRY(read_integer(entry, "source_index", 0, meta->n_source_frames - 1, &index));
    if (!spin_json_number(spin_json_get(entry, "time"), &f->time) || !isfinite(f->time))
        return fail_key("time", "a number");
    f->number = (int)number;
    f->n = (size_t)n;
    meta->source_index[i] = (int)index;
    return SPIN_OK;
}

static spin_status read_frames(struct spin_bundle_meta *meta, const spin_json *root)
{
    const spin_json *list = spin_json_get(root, "frames");
    size_t n = spin_json_length(list);
    int64_t n_source;

    if (!list || !spin_json_is_array(list) || n == 0 || n > INT_MAX)
        return fail_key("frames", "a list with at least one frame");
    SPIN_TRY(read_integer(root, "source_frames", 1, INT_MAX, &n_source));
    meta->n_source_frames = (int)n_source;
    SPIN_TRY(spin_bundle_meta_reserve(meta, (int)n));
    for (size_t i = 0; i < n; i++) {
        spin_status status = read_frame_entry(meta, (int)i, spin_json_at(list, i));

        if (status != SPIN_OK)
            return spin_fail_context(status, "frame %zu", i);
    }
    return SPIN_OK;
}

static spin_status read_data(struct spin_bundle_meta *meta, const spin_json *root)
{
    const spin_json *data = spin_json_get(root, "data");
    const char *path;

    if (!data || !spin_json_is_object(data))
        return SPIN_OK;
    path = spin_json_string(spin_json_get(data, "path"));
    if (!path || path[0] == '\0')
        return fail_key("data.path", "a path");
    read_text(data, "from", meta->data_from, sizeof meta->data_from);
    return spin_strdup(path, &meta->data_path);
}

static spin_status read_meta(struct spin_bundle_meta *meta, const spin_json *root)
{
    const char *format = spin_json_string(spin_json_get(root, "format"));
    int64_t version;

    if (!format || strcmp(format, FORMAT) != 0)
        return fail_key("format", "'" FORMAT "'");
    SPIN_TRY(read_integer(root, "version", 1, INT_MAX, &version));
    if (version != VERSION)
        return spin_fail(SPIN_E_UNSUPPORTED, "it is of version %lld, this program reads version %d",
                         (long long)version, VERSION);
    read_text(root, "from", meta->from, sizeof meta->from);
    read_text(root, "upstream", meta->upstream, sizeof meta->upstream);
    read_text(root, "variant", meta->variant, sizeof meta->variant);
    if (!spin_json_bool(spin_json_get(root, "numbered"), &meta->numbered))
        return fail_key("numbered", "true or false");
    SPIN_TRY(read_splat_columns(root, &meta->columns, &meta->sh_degree, &meta->antialias));
    SPIN_TRY(read_columns(root, "static_columns", &meta->static_columns));
    if (meta->static_columns & ~meta->columns)
        return spin_fail(SPIN_E_MALFORMED,
                         "meta.json: 'static_columns' names columns that 'columns' does not");
    SPIN_TRY(read_data(meta, root));
    return read_frames(meta, root);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static const struct spin_zip_member *find_member(const struct spin_bundle *b, const char *key)
{
    char name[80];

    snprintf(name, sizeof name, "%s.npy", key);
    return spin_zip_find(&b->npz.zip, name);
}

/* Look at one array; -1 in shape matches anything. Stored members only: they are used in place. */
static spin_status find_array(struct spin_bundle *b, const char *key, bool check_crc, int n_dims,
                              const int64_t *shape, struct spin_array *out)
{
    const struct spin_zip_member *m = find_member(b, key);

    if (m && m->method != 0)
        return spin_fail(SPIN_E_UNSUPPORTED, "member '%s.npy' is compressed; bundles are not", key);
    SPIN_TRY(
        spin_npz_array_of(&b->npz, key, check_crc && m && m->size < CRC_LIMIT, n_dims, shape, out));
    if (out->kind != 'f' || out->item_size != 4 || out->big_endian ||
        !spin_array_is_contiguous(out))
        return spin_fail(SPIN_E_MALFORMED,
                         "array '%s' is not of little-endian float32 in row-major order", key);
    return SPIN_OK;
}

/* Where columns of a frame are found: the source's, or the refined ones. */
struct group {
    const char *name;
    unsigned columns, static_columns;
    int sh_degree;
    bool antialias;
};

static struct group source_of(const struct spin_bundle *b)
{
    return (struct group){"source", b->meta.columns, b->meta.static_columns, b->meta.sh_degree,
                          b->meta.antialias};
}

static struct group refined_of(const struct spin_bundle *b)
{
    return (struct group){"refined", b->refined.columns, 0, b->refined.sh_degree,
                          b->refined.antialias};
}

static spin_status find_column(struct spin_bundle *b, const struct group *group, int i, int frame,
                               size_t n, bool check_crc, struct spin_array *out)
{
    bool still = (group->static_columns & columns_table[i].column) != 0;
    uint64_t shape[3];
    int64_t wanted[3];
    char key[64];
    int n_dims = column_shape(i, n, group->sh_degree, shape);

    for (int d = 0; d < n_dims; d++)
        wanted[d] = (int64_t)shape[d];
    member_key(group->name, i, still, frame, key);
    return find_array(b, key, check_crc, n_dims, wanted, out);
}

/* Looking at a header brings in what lies around it, up to a megabyte: let go of it now and then. */
static void forget_all(const struct spin_bundle *b, int n_looked_at)
{
    const struct spin_map *map = &b->npz.zip.map;

    if (n_looked_at % 16 == 0)
        spin_map_forget(map, map->data, map->size);
}

static spin_status check_source(struct spin_bundle *b)
{
    struct group source = source_of(b);
    struct spin_array array;
    int n_looked_at = 0;

    for (int i = 0; i < N_COLUMNS; i++) {
        unsigned column = columns_table[i].column;
        bool still = (b->meta.static_columns & column) != 0;

        if (!(b->meta.columns & column))
            continue;
        for (int f = 0; f < b->meta.n_frames; f++) {
            forget_all(b, n_looked_at++);
            if (f == 0 || !still)
                SPIN_TRY(find_column(b, &source, i, f, b->meta.frame[f].n, false, &array));
            else if (b->meta.frame[f].n != b->meta.frame[0].n)
                return spin_fail(SPIN_E_MALFORMED,
                                 "meta.json: frame %d has %zu splats and frame 0 %zu, but column "
                                 "'%s' is the same in both",
                                 f, b->meta.frame[f].n, b->meta.frame[0].n, columns_table[i].name);
        }
    }
    return SPIN_OK;
}

static spin_status check_refined(struct spin_bundle *b)
{
    const spin_json *refined = spin_json_get(b->json, "refined"), *list;
    struct group group;
    struct spin_array array;
    void *block = NULL;

    if (!refined)
        return SPIN_OK;
    if (!spin_json_is_object(refined))
        return fail_key("refined", "an object");
    SPIN_TRY(read_splat_columns(refined, &b->refined.columns, &b->refined.sh_degree,
                                &b->refined.antialias));
    list = spin_json_get(refined, "frames");
    if (!list || spin_json_length(list) != (size_t)b->meta.n_frames)
        return fail_key("frames", "a list as long as the clip's");
    SPIN_TRY(spin_alloc((size_t)b->meta.n_frames, sizeof *b->refined.n, &block));
    b->refined.n = block;
    group = refined_of(b);
    for (int f = 0; f < b->meta.n_frames; f++) {
        int64_t n;

        SPIN_TRY(read_integer(spin_json_at(list, (size_t)f), "n", 0, UINT32_MAX, &n));
        b->refined.n[f] = (size_t)n;
        for (int i = 0; i < N_COLUMNS; i++)
            if (group.columns & columns_table[i].column)
                SPIN_TRY(find_column(b, &group, i, f, (size_t)n, false, &array));
    }
    return SPIN_OK;
}

/* The network's arrays are there; what they mean is the core's business. */
static spin_status check_network(struct spin_bundle *b)
{
    const spin_json *network = spin_json_get(b->json, "network");
    int64_t features, shape[2] = {-1, -1};
    struct spin_array array;
    char key[64];
    bool own;

    if (!network)
        return SPIN_OK;
    if (!spin_json_is_object(network))
        return fail_key("network", "an object");
    SPIN_TRY(read_integer(network, "features", 1, 8, &features));
    shape[1] = features;
    SPIN_TRY(find_array(b, "network/table", false, 2, shape, &array));
    SPIN_TRY(find_array(b, "network/heads", false, 1, shape, &array));
    own = spin_npz_has(&b->npz, "network/residual/00000");
    for (int f = 0; f < b->meta.n_frames; f++) {
        shape[0] = (int64_t)spin_bundle_count(b, f, SPIN_FROM_NETWORK);
        shape[1] = 3;
        snprintf(key, sizeof key, "network/means/%05d", f);
        SPIN_TRY(find_array(b, key, false, 2, shape, &array));
        shape[1] = 11;
        snprintf(key, sizeof key, "network/residual/%05d", f);
        if (own)
            SPIN_TRY(find_array(b, key, false, 2, shape, &array));
    }
    return SPIN_OK;
}

static spin_status load_meta(struct spin_bundle *b)
{
    const struct spin_zip_member *m = spin_zip_find(&b->npz.zip, META);
    const unsigned char *text = NULL;
    void *owned = NULL;
    spin_status status;

    if (!m)
        return spin_fail(SPIN_E_MALFORMED, "no member 'meta.json': this is not a bundle");
    SPIN_TRY(spin_zip_read(&b->npz.zip, m, true, META_LIMIT, &text, &owned));
    status = spin_json_parse(META, (const char *)text, (size_t)m->size, &b->json);
    free(owned);
    SPIN_TRY(status);
    return read_meta(&b->meta, b->json);
}

spin_status spin_bundle_open(const char *path, struct spin_bundle *out)
{
    spin_status status;

    memset(out, 0, sizeof *out);
    SPIN_TRY_OUT(spin_strdup(path, &out->path));
    SPIN_TRY_OUT(spin_npz_open(path, &out->npz));
    SPIN_TRY_OUT(load_meta(out));
    SPIN_TRY_OUT(check_source(out));
    status = check_refined(out);
    if (status != SPIN_OK) {
        status = spin_fail_context(status, "refined");
        goto out;
    }
    SPIN_TRY_OUT(check_network(out));
    return SPIN_OK;
out:
    spin_bundle_close(out);
    if (!strstr(spin_last_error(), path))
        status = spin_fail_context(status, "cannot read '%s'", path);
    return status;
}

void spin_bundle_close(struct spin_bundle *bundle)
{
    spin_npz_close(&bundle->npz);
    spin_json_free(bundle->json);
    spin_bundle_meta_free(&bundle->meta);
    free(bundle->refined.n);
    free(bundle->path);
    memset(bundle, 0, sizeof *bundle);
}

spin_status spin_bundle_data_path(const struct spin_bundle *bundle, char **out)
{
    const char *path = bundle->meta.data_path;
    char *folder = NULL, *joined = NULL;
    spin_status status;

    *out = NULL;
    if (!path)
        return SPIN_OK;
    if (path[0] == '/')
        return spin_strdup(path, out);
    SPIN_TRY(spin_path_folder(bundle->path, &folder));
    SPIN_TRY_OUT(spin_path_join(folder, path, &joined));
    if (spin_path_exists(joined)) {
        SPIN_TRY_OUT(spin_path_absolute(joined, out));
    } else { /* the caller says that it is missing, by this name */
        *out = joined;
        joined = NULL;
    }
out:
    free(joined);
    free(folder);
    return status;
}

/* ---- Reading --------------------------------------------------------------------------------- */

static spin_status fail_no_column(const struct spin_bundle *b, unsigned columns)
{
    for (int i = 0; i < N_COLUMNS; i++) {
        if (columns & columns_table[i].column & ~b->meta.columns)
            return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no '%s' of its source%s", b->path,
                             columns_table[i].name,
                             (b->meta.columns & SPIN_COL_ATTRIBUTES) == 0
                                 ? ", only positions: run spin-retrain"
                                 : "");
    }
    return SPIN_OK;
}

static spin_status check_index(const struct spin_bundle *bundle, int frame)
{
    if (frame < 0 || frame >= bundle->meta.n_frames)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no frame %d, only 0 to %d", bundle->path,
                         frame, bundle->meta.n_frames - 1);
    return SPIN_OK;
}

static spin_status read_column(struct spin_bundle *b, const struct group *group, int i, int frame,
                               size_t n, struct spin_array *array)
{
    spin_status status = find_column(b, group, i, frame, n, true, array);

    if (status != SPIN_OK && !strstr(spin_last_error(), b->path))
        return spin_fail_context(status, "cannot read '%s'", b->path);
    return status;
}

static spin_status read_group(struct spin_bundle *bundle, const struct group *group, int frame,
                              size_t n, unsigned columns, struct spin_splats *out)
{
    SPIN_TRY(spin_map_check(&bundle->npz.zip.map));
    SPIN_TRY(spin_splats_reserve(out, n, columns, group->sh_degree < 0 ? 0 : group->sh_degree));
    out->antialias = group->antialias;
    for (int i = 0; i < N_COLUMNS; i++) {
        unsigned column = columns_table[i].column;
        struct spin_array array;

        if (!(columns & column))
            continue;
        SPIN_TRY(read_column(bundle, group, i, frame, n, &array));
        if (n > 0)
            memcpy(*spin_column_of(out, column), array.data, (size_t)array.n_bytes);
        if (!(bundle->meta.static_columns & column)) /* a clip goes by, frame after frame */
            spin_npz_forget(&bundle->npz, &array, 0, array.count);
    }
    return SPIN_OK;
}

/* The columns as they lie in the map; copied when one is not aligned. */
static spin_status view_group(struct spin_bundle *bundle, const struct group *group, int frame,
                              size_t n, unsigned columns, struct spin_splats *out)
{
    struct spin_splats view = {.n = n, .capacity = n, .mapped = true};

    SPIN_TRY(spin_map_check(&bundle->npz.zip.map));
    view.sh_degree = group->sh_degree < 0 ? 0 : group->sh_degree;
    view.antialias = group->antialias;
    for (int i = 0; i < N_COLUMNS; i++) {
        unsigned column = columns_table[i].column;
        struct spin_array array;

        if (!(columns & column))
            continue;
        SPIN_TRY(read_column(bundle, group, i, frame, n, &array));
        if (n == 0 || !spin_array_f32(&array))
            return read_group(bundle, group, frame, n, columns, out);
        *spin_column_of(&view, column) = (float *)(uintptr_t)array.data;
    }
    spin_splats_free(out);
    *out = view;
    return SPIN_OK;
}

spin_status spin_bundle_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                              struct spin_splats *out)
{
    struct group source = source_of(bundle);

    SPIN_TRY(check_index(bundle, frame));
    SPIN_TRY(fail_no_column(bundle, columns));
    return read_group(bundle, &source, frame, bundle->meta.frame[frame].n, columns, out);
}

static spin_status check_refined_frame(const struct spin_bundle *bundle, int frame,
                                       unsigned columns)
{
    SPIN_TRY(check_index(bundle, frame));
    if (columns & ~bundle->refined.columns)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no refined splats with these columns",
                         bundle->path);
    return SPIN_OK;
}

spin_status spin_bundle_refined_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                                      struct spin_splats *out)
{
    struct group refined = refined_of(bundle);

    SPIN_TRY(check_refined_frame(bundle, frame, columns));
    return read_group(bundle, &refined, frame, bundle->refined.n[frame], columns, out);
}

spin_status spin_bundle_view(struct spin_bundle *bundle, int frame, enum spin_splat_source from,
                             unsigned columns, struct spin_splats *out)
{
    struct group group = from == SPIN_FROM_REFINED ? refined_of(bundle) : source_of(bundle);

    if (from == SPIN_FROM_REFINED) {
        SPIN_TRY(check_refined_frame(bundle, frame, columns));
        return view_group(bundle, &group, frame, bundle->refined.n[frame], columns, out);
    }
    SPIN_TRY(check_index(bundle, frame));
    SPIN_TRY(fail_no_column(bundle, columns));
    return view_group(bundle, &group, frame, bundle->meta.frame[frame].n, columns, out);
}

void spin_bundle_rest(const struct spin_splats *view)
{
    struct spin_splats s = *view;

    for (int i = 0; i < N_COLUMNS && s.mapped; i++) {
        enum spin_column column = (enum spin_column)columns_table[i].column;
        const float *values = *spin_column_of(&s, column);

        if (values)
            spin_map_rest(values, s.n * spin_column_width(column, s.sh_degree) * sizeof *values);
    }
}

size_t spin_bundle_count(const struct spin_bundle *bundle, int frame, enum spin_splat_source from)
{
    if (from != SPIN_FROM_SOURCE && bundle->refined.columns)
        return bundle->refined.n[frame];
    return bundle->meta.frame[frame].n;
}

uint32_t spin_bundle_checksum(const struct spin_bundle *bundle, int frame, unsigned columns)
{
    uint32_t sum = 0;

    for (int i = 0; i < N_COLUMNS; i++) {
        unsigned column = columns_table[i].column;
        const struct spin_zip_member *m;
        char key[64];

        if (!(columns & bundle->meta.columns & column))
            continue;
        member_key("source", i, (bundle->meta.static_columns & column) != 0, frame, key);
        m = find_member(bundle, key);
        sum =
            (sum ^ (m ? m->crc : 0)) * 0x01000193u + column; /* as FNV-1a does, a word at a time */
    }
    return sum;
}

/* ---- Writing --------------------------------------------------------------------------------- */

spin_status spin_bundle_writer_open(const char *path, bool force, bool sync,
                                    struct spin_bundle_writer *w)
{
    memset(w, 0, sizeof *w);
    SPIN_TRY(spin_zip_writer_open(path, force, &w->zip));
    w->zip.out.sync = sync;
    return SPIN_OK;
}

static spin_status write_group(struct spin_bundle_writer *w, const char *group, int index,
                               unsigned columns, unsigned static_columns,
                               const struct spin_splats *splats)
{
    struct spin_splats view = *splats;

    for (int i = 0; i < N_COLUMNS; i++) {
        unsigned column = columns_table[i].column;
        bool still = (static_columns & column) != 0;
        uint64_t shape[3];
        char key[64];
        const float *data;
        int n_dims;

        if (!(columns & column) || (still && index != 0))
            continue;
        n_dims = column_shape(i, splats->n, splats->sh_degree, shape);
        data = *spin_column_of(&view, column);
        member_key(group, i, still, index, key);
        SPIN_TRY(
            spin_npz_write(&w->zip, key, "<f4", n_dims, shape, data ? (const void *)data : ""));
        if (still)
            w->still_written |= column;
    }
    return SPIN_OK;
}

spin_status spin_bundle_write_frame(struct spin_bundle_writer *w, int index, unsigned columns,
                                    unsigned static_columns, const struct spin_splats *splats)
{
    return write_group(w, "source", index, columns, static_columns, splats);
}

spin_status spin_bundle_write_refined(struct spin_bundle_writer *w, int index, unsigned columns,
                                      const struct spin_splats *splats)
{
    return write_group(w, "refined", index, columns, 0, splats);
}

static spin_status copy_member(struct spin_bundle_writer *w, const struct spin_zip *zip,
                               const struct spin_zip_member *m)
{
    const unsigned char *data = NULL;
    void *owned = NULL;
    spin_status status;

    SPIN_TRY(spin_zip_read(zip, m, true, m->size, &data, &owned));
    SPIN_TRY_OUT(spin_zip_member_begin(&w->zip, m->name, m->size));
    SPIN_TRY_OUT(spin_zip_member_write(&w->zip, data, (size_t)m->size));
    SPIN_TRY_OUT(spin_zip_member_end(&w->zip));
out:
    free(owned);
    return status;
}

spin_status spin_bundle_copy_source(struct spin_bundle_writer *w, const struct spin_bundle *from)
{
    const struct spin_zip *zip = &from->npz.zip;

    for (size_t i = 0; i < zip->n; i++) {
        const struct spin_zip_member *m = &zip->member[i];

        if (strncmp(m->name, "source/", 7) == 0 && spin_zip_find(zip, m->name) == m)
            SPIN_TRY(copy_member(w, zip, m));
    }
    w->still_written = from->meta.static_columns;
    return SPIN_OK;
}

spin_json *spin_column_names(unsigned columns)
{
    spin_json *list = spin_json_array();

    for (int i = 0; i < N_COLUMNS; i++) {
        if (columns & columns_table[i].column)
            spin_json_push_string(list, columns_table[i].name);
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

/* Our keys go into extra, so a caller's key of the same name does not survive. */
static spin_json *meta_json(const struct spin_bundle_meta *meta, spin_json *extra)
{
    spin_json *root = extra ? extra : spin_json_object();

    spin_json_set_string(root, "format", FORMAT);
    spin_json_set_integer(root, "version", VERSION);
    spin_json_set_string(root, "generator", "spin4d " SPIN_VERSION);
    spin_json_set_string(root, "from", meta->from);
    spin_json_set_string(root, "upstream", meta->upstream);
    spin_json_set_string(root, "variant", meta->variant);
    spin_json_set_integer(root, "source_frames", meta->n_source_frames);
    spin_json_set_bool(root, "numbered", meta->numbered);
    spin_json_set(root, "columns", spin_column_names(meta->columns));
    spin_json_set(root, "static_columns", spin_column_names(meta->static_columns));
    spin_json_set_integer(root, "sh_degree", meta->sh_degree);
    if (meta->antialias)
        spin_json_set_bool(root, "antialias", true);
    if (meta->data_path) {
        spin_json *data = spin_json_object();

        spin_json_set_string(data, "path", meta->data_path);
        spin_json_set_string(data, "from", meta->data_from);
        spin_json_set(root, "data", data);
    } else {
        spin_json_set_null(root, "data");
    }
    spin_json_set(root, "frames", frames_json(meta));
    return root;
}

spin_status spin_bundle_writer_finish(struct spin_bundle_writer *w,
                                      const struct spin_bundle_meta *meta, spin_json *extra)
{
    spin_json *root = meta_json(meta, extra);
    char *text = spin_json_text(root, true);
    spin_status status;

    spin_json_free(root);
    if (!text) {
        status = spin_fail(SPIN_E_MEMORY, "no memory for meta.json");
        goto out;
    }
    SPIN_TRY_OUT(spin_zip_member_begin(&w->zip, META, strlen(text)));
    SPIN_TRY_OUT(spin_zip_member_write(&w->zip, text, strlen(text)));
    SPIN_TRY_OUT(spin_zip_member_end(&w->zip));
    free(text);
    return spin_zip_writer_commit(&w->zip);
out:
    free(text);
    spin_bundle_writer_abandon(w);
    return status;
}

void spin_bundle_writer_abandon(struct spin_bundle_writer *w) { spin_zip_writer_abandon(&w->zip); }
