/* Reads and writes *.spin bundles. man/spin-bundle.5 describes the format.
 *
 * The file is not trusted: spin_bundle_open() checks the headers of all arrays against meta.json,
 * which defines which arrays must exist and what shapes they have. It does not read the values of
 * the arrays, so that a clip of many gigabytes opens in moments. Values are read later from the
 * memory map, frame by frame. */
#include "scene/bundle.h"

#include "base/base.h"
#include "io/sound.h"

#define META "meta.json"
#define META_LIMIT (64u << 20) /* bytes */
#define SOUND "sound"

/* Sets `name` to "GROUP/COLUMN", such as "source/means". */
static void series_name(const char *group, unsigned column, char name[64])
{
    snprintf(name, 64, "%s/%s", group, spin_column_name(column));
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* One of the two groups of splats that are stored in columns: "source" or "refined". */
struct group {
    const char *name;
    unsigned columns, static_columns;
    int sh_degree;
    bool antialias;
    /* [n_frames] number of splats of each frame; NULL: see meta.frame[].n */
    const size_t *n;
};

static struct group group_of(const struct spin_bundle *b, enum spin_splat_source from)
{
    const struct spin_bundle_meta *m = &b->meta;
    const struct spin_bundle_refined *r = &b->refined;

    if (from == SPIN_FROM_REFINED)
        return (struct group){"refined", r->columns, 0, r->sh_degree, r->antialias, r->n};
    return (struct group){"source",     m->columns,   m->static_columns,
                          m->sh_degree, m->antialias, NULL};
}

static size_t count_of(const struct spin_bundle *b, const struct group *group, int frame)
{
    return group->n ? group->n[frame] : b->meta.frame[frame].n;
}

/* Opens a column of a frame as *out. If out is NULL, only checks the header of the array. */
static spin_status find_column(struct spin_bundle *b, const struct group *group, unsigned column,
                               int frame, struct spin_bundle_values *out)
{
    uint64_t shape[3];
    int64_t wanted[3];
    char name[64];
    int n_dims = spin_column_shape(column, count_of(b, group, frame), group->sh_degree, shape);

    for (int d = 0; d < n_dims; d++)
        wanted[d] = (int64_t)shape[d];
    if (group->static_columns & column)
        frame = -1;
    series_name(group->name, column, name);
    return out ? spin_bundle_values_open(b, name, frame, 'f', n_dims, wanted, out)
               : spin_bundle_values_check(b, name, frame, 'f', n_dims, wanted);
}

/* Called once per header: every 16th call releases all mapped pages of the file, since the kernel
 * reads up to a megabyte of the file around each header, which would add up to much memory. */
static void drop_pages(const struct spin_bundle *b, int n_looked_at)
{
    const struct spin_map *map = &b->npz.zip.map;

    if (n_looked_at % 16 == 0)
        spin_map_forget(map, map->data, map->size);
}

/* Opens array k of the source's 4D splats as *out. If out is NULL, only checks the header of the
 * array. */
static spin_status find_4d(struct spin_bundle *b, int k, struct spin_bundle_values *out)
{
    const struct spin_splats_4d *s = &b->meta.four_d;
    int64_t shape[2] = {(int64_t)s->n, (int64_t)spin_array_4d_width(s, k)};
    char name[64];

    snprintf(name, sizeof name, "source/4d/%s", spin_array_4d_name(k));
    return out ? spin_bundle_values_open(b, name, -1, 'f', 2, shape, out)
               : spin_bundle_values_check(b, name, -1, 'f', 2, shape);
}

static spin_status check_source(struct spin_bundle *b)
{
    struct group source = group_of(b, SPIN_FROM_SOURCE);
    int n_looked_at = 0;

    for (int k = 0; b->meta.four_d.n && k < SPIN_N_ARRAYS_4D; k++)
        if (spin_array_4d_in(&b->meta.four_d, k, b->meta.parts))
            SPIN_TRY(find_4d(b, k, NULL));
    if (b->meta.four_d.n)
        return SPIN_OK;
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        bool still = (b->meta.static_columns & column) != 0;

        if (!(b->meta.columns & column))
            continue;
        for (int f = 0; f < b->meta.n_frames; f++) {
            drop_pages(b, n_looked_at++);
            if (f == 0 || !still)
                SPIN_TRY(find_column(b, &source, column, f, NULL));
            else if (b->meta.frame[f].n != b->meta.frame[0].n)
                return spin_malformed("meta.json: frame %d has %zu splats and frame 0 has %zu, but "
                                      "'static_columns' lists '%s'",
                                      f, b->meta.frame[f].n, b->meta.frame[0].n,
                                      spin_column_name(column));
        }
    }
    return SPIN_OK;
}

static spin_status check_refined(struct spin_bundle *b)
{
    const spin_json *refined = spin_json_get(b->json, "refined"), *list;
    struct group group;

    if (!refined)
        return SPIN_OK;
    if (!spin_json_is_object(refined))
        return spin_meta_fail("refined", "an object");
    SPIN_TRY(spin_meta_columns(refined, &b->refined.columns, &b->refined.sh_degree,
                               &b->refined.antialias));
    list = spin_json_get(refined, "frames");
    if (!list || spin_json_length(list) != (size_t)b->meta.n_frames)
        return spin_meta_fail("frames", "a list with one entry per frame of the clip");
    SPIN_TRY(spin_alloc((size_t)b->meta.n_frames, sizeof *b->refined.n, (void **)&b->refined.n));
    group = group_of(b, SPIN_FROM_REFINED);
    for (int f = 0; f < b->meta.n_frames; f++) {
        int64_t n;

        SPIN_TRY(spin_meta_integer(spin_json_at(list, (size_t)f), "n", 0, UINT32_MAX, &n));
        b->refined.n[f] = (size_t)n;
        for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1)
            if (group.columns & column)
                SPIN_TRY(find_column(b, &group, column, f, NULL));
    }
    return SPIN_OK;
}

/* Reads "splats", a list with the number of splats of each frame. If the training used neither
 * tracks nor densification, there is no such list, and the numbers are those of the refined frames
 * or, without refined frames, of the source. */
static spin_status read_trained_counts(struct spin_bundle *b, const spin_json *trained)
{
    const spin_json *list = spin_json_get(trained, "splats");

    if (!list)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)b->meta.n_frames, sizeof *b->trained_n, (void **)&b->trained_n));
    for (int f = 0; f < b->meta.n_frames; f++) {
        int64_t n;

        if (!spin_json_integer(spin_json_at(list, (size_t)f), &n) || n < 0 || n > INT32_MAX)
            return spin_meta_fail("trained.splats", "a number of splats for every frame");
        b->trained_n[f] = (size_t)n;
    }
    return SPIN_OK;
}

/* Checks that the trained arrays exist and have the right shapes. The values are checked when they
 * are read. */
static spin_status check_trained(struct spin_bundle *b)
{
    const spin_json *trained = spin_json_get(b->json, "trained"), *field;
    int64_t shape[2] = {-1, -1};
    bool own;

    if (!trained)
        return SPIN_OK;
    if (!spin_json_is_object(trained))
        return spin_meta_fail("trained", "an object");
    field = spin_json_get(trained, "field");
    if (!spin_json_is_object(field) && !spin_json_is_null(field))
        return spin_meta_fail("trained.field", "an object or null");
    if (spin_json_is_object(field)) {
        SPIN_TRY(spin_meta_integer(field, "features", 1, 8, &shape[1]));
        SPIN_TRY(spin_bundle_values_check(b, "trained/table", -1, 'f', 2, shape));
        shape[1] = -1;
        SPIN_TRY(spin_bundle_values_check(b, "trained/heads", -1, 'f', 1, shape));
    }
    SPIN_TRY(read_trained_counts(b, trained));
    /* the arrays of tracks are checked later, by spin_bundle_tracks_frame() */
    if (spin_json_get(trained, "tracks"))
        return SPIN_OK;
    own = spin_npz_has(&b->npz, "trained/residual/00000");
    for (int f = 0; f < b->meta.n_frames; f++) {
        shape[0] = (int64_t)spin_bundle_count(b, f, SPIN_FROM_TRAINED);
        shape[1] = 3;
        SPIN_TRY(spin_bundle_values_check(b, "trained/means", f, 'f', 2, shape));
        shape[1] = 11;
        if (own)
            SPIN_TRY(spin_bundle_values_check(b, "trained/residual", f, 'f', 2, shape));
    }
    return SPIN_OK;
}

/* Reads the sound track. If meta.json describes one, the zip member must exist. */
static spin_status read_sound(struct spin_bundle *b)
{
    const spin_json *json = spin_json_get(b->json, SOUND);
    const char *name = spin_json_string(spin_json_get(json, "name"));
    const struct spin_zip_member *m = spin_zip_find(&b->npz.zip, SOUND);
    struct spin_sound *sound = &b->meta.sound;
    const unsigned char *data;
    double start, gain;

    if (!json)
        return SPIN_OK;
    if (!m)
        return spin_malformed("the member '" SOUND "' is missing");
    if (!spin_json_number(spin_json_get(json, "start"), &start) || !isfinite(start) ||
        !spin_json_number(spin_json_get(json, "gain"), &gain) || !(gain >= 0) || !isfinite(gain))
        return spin_meta_fail(SOUND, "an object with a finite start and gain");
    SPIN_TRY(spin_zip_read(&b->npz.zip, m, true, SPIN_SOUND_LIMIT, &data, &b->sound));
    SPIN_TRY(spin_sound_set(sound, "", data, (size_t)m->size));
    snprintf(sound->name, sizeof sound->name, "%s", name ? name : "");
    spin_text_tidy(sound->name, false);
    sound->start = start;
    sound->gain = gain;
    return SPIN_OK;
}

/* Converts the meta.json of a bundle older than version 4 to version 4: renames "network" to
 * "trained", and adds "field" with the keys of the network, which older versions store in "network"
 * itself. If "explicit" is true, there is no network, and "field" becomes null. */
static void upgrade_meta(struct spin_bundle *b)
{
    static const char *const series[] = {"per_unit", "xor_rows"};
    spin_json *json = b->json, *trained;
    bool explicit = false;

    if (!spin_json_get(json, "network"))
        return;
    b->npz.prefix = "trained/";
    b->npz.prefix_there = "network/";
    spin_json_rename(json, "network", "trained");
    for (int i = 0; i < 2; i++)
        spin_json_rename((spin_json *)spin_json_get(json, series[i]), "network/", "trained/");
    trained = (spin_json *)spin_json_get(json, "trained");
    spin_json_bool(spin_json_get(trained, "explicit"), &explicit);
    if (explicit) {
        spin_json_set_null(trained, "field");
    } else if (spin_json_is_object(trained)) {
        spin_json *field = spin_json_object();

        spin_json_share(field, trained);
        spin_json_set(trained, "field", field);
    }
}

static spin_status load_meta(struct spin_bundle *b)
{
    const struct spin_zip_member *m = spin_zip_find(&b->npz.zip, META);
    const unsigned char *text = NULL;
    SPIN_FREED void *owned = NULL;

    if (!m)
        return spin_malformed("no member 'meta.json': this is not a bundle");
    SPIN_TRY(spin_zip_read(&b->npz.zip, m, true, META_LIMIT, &text, &owned));
    SPIN_TRY(spin_json_parse(META, (const char *)text, (size_t)m->size, &b->json));
    upgrade_meta(b);
    return spin_bundle_meta_read(&b->meta, b->json);
}

/* Replaces the open checkpoint b->path by the clip that was saved beside it. Fails with
 * SPIN_E_UNSUPPORTED if no clip was saved. */
static spin_status open_clip_of_state(struct spin_bundle *b)
{
    size_t n = strlen(b->path) + sizeof SPIN_CLIP_OF_STATE;
    SPIN_FREED char *clip = NULL;

    SPIN_TRY(spin_alloc(n, 1, (void **)&clip));
    snprintf(clip, n, "%s" SPIN_CLIP_OF_STATE, b->path);
    if (!spin_path_exists(clip))
        return spin_unsupported(
            "it is the checkpoint of an unfinished training: continue it with spin-retrain "
            "--resume; if the training uses --watch DIR, DIR/state.spin is the clip so far");
    spin_npz_close(&b->npz);
    spin_log(0,
             "'%s' is the checkpoint of an unfinished training: reading the clip that was saved "
             "with it, '%s'",
             b->path, clip);
    return spin_npz_open(clip, &b->npz);
}

spin_status spin_bundle_open(const char *path, struct spin_bundle *out)
{
    spin_status status;

    memset(out, 0, sizeof *out);
    SPIN_TRY_OUT(spin_strdup(path, &out->path));
    SPIN_TRY_OUT(spin_npz_open(path, &out->npz));
    if (spin_zip_find(&out->npz.zip, "state.json"))
        SPIN_TRY_OUT(open_clip_of_state(out));
    SPIN_TRY_OUT(load_meta(out));
    SPIN_TRY_OUT(read_sound(out));
    SPIN_TRY_OUT(check_source(out));
    status = check_refined(out);
    if (status != SPIN_OK) {
        status = spin_fail_context(status, "refined");
        goto out;
    }
    SPIN_TRY_OUT(check_trained(out));
    return SPIN_OK;
out:
    spin_bundle_close(out);
    return spin_fail_reading(status, path);
}

void spin_bundle_close(struct spin_bundle *bundle)
{
    spin_npz_close(&bundle->npz);
    spin_json_free(bundle->json);
    spin_bundle_meta_free(&bundle->meta);
    free(bundle->refined.n);
    free(bundle->trained_n);
    free(bundle->sound);
    spin_splats_4d_free(&bundle->four_d);
    spin_bundle_keys_free(&bundle->keys);
    free(bundle->path);
    memset(bundle, 0, sizeof *bundle);
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Sets *out to the group of splats that `from` selects. Fails with SPIN_E_NOT_FOUND if the clip
 * does not contain the frame or the group lacks one of the columns. */
static spin_status find_group(const struct spin_bundle *b, int frame, enum spin_splat_source from,
                              unsigned columns, struct group *out)
{
    unsigned missing;

    *out = group_of(b, from);
    missing = columns & ~out->columns;
    if (frame < 0 || frame >= b->meta.n_frames)
        return spin_not_found("'%s' has no frame %d, only frames 0 to %d", b->path, frame,
                              b->meta.n_frames - 1);
    if (missing && from == SPIN_FROM_REFINED)
        return spin_not_found("'%s' has no refined splats with column '%s'", b->path,
                              spin_column_name(missing));
    if (missing)
        return spin_not_found("'%s': the source has no column '%s'%s", b->path,
                              spin_column_name(missing),
                              (b->meta.columns & SPIN_COL_ATTRIBUTES) == 0
                                  ? "; it has only positions: run spin-retrain first"
                                  : "");
    return spin_map_check(&b->npz.zip.map);
}

static spin_status read_group(struct spin_bundle *bundle, const struct group *group, int frame,
                              unsigned columns, struct spin_splats *out)
{
    size_t n = count_of(bundle, group, frame);

    SPIN_TRY(spin_splats_reserve(out, n, columns, group->sh_degree < 0 ? 0 : group->sh_degree));
    out->antialias = group->antialias;
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        struct spin_bundle_values v;

        if (!(columns & column))
            continue;
        SPIN_TRY(find_column(bundle, group, column, frame, &v));
        spin_bundle_values_get(&v, 0, (size_t)v.count, *spin_column_of(out, column));
        /* Release the mapped pages, since frames are usually read in order and only once. */
        if (v.floats && !(group->static_columns & column))
            spin_map_forget(&bundle->npz.zip.map, v.bytes, (size_t)v.count * sizeof *v.floats);
        spin_bundle_values_close(&v);
    }
    return SPIN_OK;
}

static spin_status load_4d(struct spin_bundle *b, struct spin_splats_4d *s)
{
    const struct spin_splats_4d *meta = &b->meta.four_d;
    size_t n_dropped;

    SPIN_TRY(spin_splats_4d_reserve(s, meta->n, meta->degree, meta->sh_degree, b->meta.parts));
    s->antialias = meta->antialias;
    s->least_weight = meta->least_weight;
    s->least_opacity = meta->least_opacity;
    s->period = meta->period;
    memcpy(s->cov2d, meta->cov2d, sizeof s->cov2d);
    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++) {
        struct spin_bundle_values v;

        if (!*spin_array_4d_of(s, k))
            continue;
        SPIN_TRY(find_4d(b, k, &v));
        spin_bundle_values_get(&v, 0, (size_t)v.count, *spin_array_4d_of(s, k));
        spin_bundle_values_close(&v);
    }
    SPIN_TRY(spin_splats_4d_finish(s, &n_dropped, NULL));
    return n_dropped ? spin_malformed(
                           "source/4d: %s values that are not finite or out of range, "
                           "or rotations of length zero",
                           spin_text_share(n_dropped, meta->n, "row", "has", "have", (char[96]){0}))
                     : SPIN_OK;
}

spin_status spin_bundle_splats_4d(struct spin_bundle *bundle, const struct spin_splats_4d **out)
{
    *out = bundle->meta.four_d.n ? &bundle->four_d : NULL;
    if (!*out || bundle->four_d.n)
        return SPIN_OK;
    SPIN_TRY(spin_map_check(&bundle->npz.zip.map));
    return spin_fail_reading(load_4d(bundle, &bundle->four_d), bundle->path);
}

/* Slices the 4D splats at the time of a frame, and checks that the slice has as many splats as
 * meta.json states for the frame. */
static spin_status slice_frame(struct spin_bundle *b, int frame, unsigned columns,
                               struct spin_splats *out)
{
    const struct spin_frame_info *info = &b->meta.frame[frame];
    const struct spin_splats_4d *s;

    SPIN_TRY(spin_bundle_splats_4d(b, &s));
    SPIN_TRY(spin_splats_4d_slice(s, info->time, columns, out));
    return out->n == info->n ? SPIN_OK
                             : spin_malformed("'%s': meta.json lists %zu splats for frame %d, but "
                                              "%zu are visible at its time %g",
                                              b->path, info->n, frame, out->n, info->time);
}

static spin_status read_frame(struct spin_bundle *bundle, int frame, enum spin_splat_source from,
                              unsigned columns, struct spin_splats *out)
{
    struct group group;

    SPIN_TRY(find_group(bundle, frame, from, columns, &group));
    if (from == SPIN_FROM_SOURCE && bundle->meta.four_d.n)
        return slice_frame(bundle, frame, columns, out);
    return read_group(bundle, &group, frame, columns, out);
}

spin_status spin_bundle_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                              struct spin_splats *out)
{
    return read_frame(bundle, frame, SPIN_FROM_SOURCE, columns, out);
}

spin_status spin_bundle_refined_frame(struct spin_bundle *bundle, int frame, unsigned columns,
                                      struct spin_splats *out)
{
    return read_frame(bundle, frame, SPIN_FROM_REFINED, columns, out);
}

spin_status spin_bundle_view(struct spin_bundle *bundle, int frame, enum spin_splat_source from,
                             unsigned columns, struct spin_splats *out)
{
    struct spin_splats view = {.mapped = true};
    struct group group;

    SPIN_TRY(find_group(bundle, frame, from, columns, &group));
    if (from == SPIN_FROM_SOURCE && bundle->meta.four_d.n)
        return slice_frame(bundle, frame, columns, out);
    view.n = view.capacity = count_of(bundle, &group, frame);
    view.sh_degree = group.sh_degree < 0 ? 0 : group.sh_degree;
    view.antialias = group.antialias;
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        struct spin_bundle_values v;
        const float *floats;

        if (!(columns & column))
            continue;
        SPIN_TRY(find_column(bundle, &group, column, frame, &v));
        floats = v.floats;
        spin_bundle_values_close(&v);
        if (view.n == 0 || !floats) /* a packed or unaligned array must be copied */
            return read_group(bundle, &group, frame, columns, out);
        *spin_column_of(&view, column) = (float *)(uintptr_t)floats;
    }
    spin_splats_free(out);
    *out = view;
    return SPIN_OK;
}

void spin_bundle_release(const struct spin_splats *view)
{
    struct spin_splats s = *view;

    for (unsigned column = 1; column < SPIN_COLUMNS_END && s.mapped; column <<= 1) {
        const float *values = *spin_column_of(&s, column);

        if (values)
            spin_map_release(values, s.n * spin_column_width(column, s.sh_degree) * sizeof *values);
    }
}

void spin_bundle_release_rows(const struct spin_splats *view, size_t first, size_t n,
                              unsigned columns)
{
    struct spin_splats s = *view;
    size_t row = 11 + spin_column_width(SPIN_COL_SH, s.sh_degree);

    /* madvise() briefly stalls all threads, which is not worth it for small frames. */
    if (!s.mapped || row * sizeof(float) * s.n < (size_t)64 << 20)
        return;
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        const float *values = *spin_column_of(&s, column);
        size_t width = spin_column_width(column, s.sh_degree);

        if (values && (columns & column))
            spin_map_release(values + width * first, width * n * sizeof *values);
    }
}

size_t spin_bundle_count(const struct spin_bundle *bundle, int frame, enum spin_splat_source from)
{
    if (from == SPIN_FROM_TRAINED && bundle->trained_n)
        return bundle->trained_n[frame];
    if (from != SPIN_FROM_SOURCE && bundle->refined.columns)
        return bundle->refined.n[frame];
    return bundle->meta.frame[frame].n;
}

static spin_status checksum_slice(struct spin_bundle *b, int frame, unsigned columns, uint32_t *out)
{
    SPIN_LEAVES(spin_splats_free) struct spin_splats splats = {0};
    uint64_t hash = SPIN_HASH_BEGIN;

    SPIN_TRY(slice_frame(b, frame, columns, &splats));
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1)
        if (columns & column)
            spin_hash(&hash, *spin_column_of(&splats, column),
                      splats.n * spin_column_width(column, splats.sh_degree) * sizeof(float));
    *out = (uint32_t)(hash ^ hash >> 32);
    return SPIN_OK;
}

spin_status spin_bundle_checksum(struct spin_bundle *bundle, int frame, unsigned columns,
                                 uint32_t *out)
{
    struct group source = group_of(bundle, SPIN_FROM_SOURCE);

    *out = 0;
    if (bundle->meta.four_d.n)
        return checksum_slice(bundle, frame, columns & bundle->meta.columns, out);
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        struct spin_bundle_values v;
        uint32_t crc;

        if (!(columns & bundle->meta.columns & column))
            continue;
        SPIN_TRY(find_column(bundle, &source, column, frame, &v));
        crc = spin_bundle_values_crc(&v);
        spin_bundle_values_close(&v);
        /* like FNV-1a, but over words instead of bytes */
        *out = (*out ^ crc) * 0x01000193u + column;
    }
    return SPIN_OK;
}

/* ---- Member names and sizes ------------------------------------------------------------------ */

static bool begins_with(const char *text, const char *with)
{
    return strncmp(text, with, strlen(with)) == 0;
}

/* A zip with a meta.json may also be SOG, so a bundle must have members in source/ too. */
bool spin_bundle_detect(const char *path)
{
    struct spin_zip zip;
    bool meta, source = false;

    if (spin_zip_open(path, &zip) != SPIN_OK)
        return false;
    meta = spin_zip_find(&zip, "meta.json") != NULL;
    for (size_t i = 0; i < zip.n; i++)
        source = source || begins_with(zip.member[i].name, "source/");
    spin_zip_close(&zip);
    return meta && source;
}

/* Returns the member of *bytes to which the size of zip member `name` is added; NULL if the member
 * counts only towards the size of the whole file. */
static uint64_t *part_of(struct spin_bundle_bytes *bytes, const char *name)
{
    if (begins_with(name, "source/"))
        return &bytes->source;
    if (begins_with(name, "refined/"))
        return &bytes->refined;
    /* Below version 4, trained/ was called network/. */
    if (!begins_with(name, "trained/") && !begins_with(name, "network/"))
        return NULL;
    name = strchr(name, '/') + 1;
    if (begins_with(name, "means/") || begins_with(name, "residual/"))
        return &bytes->positions;
    if (begins_with(name, "track"))
        return &bytes->tracks;
    return begins_with(name, "table") ? &bytes->table : &bytes->heads;
}

/* Returns the size of a zip member before packing, including the byte planes that the file omits
 * because all their bytes are 0. */
static uint64_t unpacked_size(const struct spin_bundle *bundle,
                              const struct spin_zip_member *member)
{
    char name[80];
    struct spin_array a;
    size_t length = strlen(member->name);

    if (length < 5 || length - 4 >= sizeof name || strcmp(member->name + length - 4, ".npy") != 0)
        return member->size;
    memcpy(name, member->name, length - 4);
    name[length - 4] = '\0';
    if (spin_npz_head(&bundle->npz, name, &a) != SPIN_OK || a.kind != 'i' || a.item_size != 1 ||
        a.n_dims < 2 || a.shape[0] < 1 || a.shape[0] > 4)
        return member->size;
    return member->size + a.count / a.shape[0] * (4 - a.shape[0]);
}

void spin_bundle_sizes(const struct spin_bundle *bundle, struct spin_bundle_bytes *packed,
                       struct spin_bundle_bytes *unpacked)
{
    const struct spin_zip *zip = &bundle->npz.zip;

    memset(packed, 0, sizeof *packed);
    packed->file = zip->map.size;
    *unpacked = *packed;
    for (size_t i = 0; i < zip->n; i++) {
        const struct spin_zip_member *member = &zip->member[i];
        uint64_t size = unpacked_size(bundle, member);

        unpacked->file += size - member->packed_size;
        if (part_of(packed, member->name)) {
            *part_of(packed, member->name) += member->packed_size;
            *part_of(unpacked, member->name) += size;
        }
    }
}

spin_json *spin_bundle_bytes_json(const struct spin_bundle_bytes *bytes)
{
    return json_pack("{s:I, s:I, s:I, s:I, s:I, s:I, s:I}", "file", (json_int_t)bytes->file,
                     "source", (json_int_t)bytes->source, "refined", (json_int_t)bytes->refined,
                     "positions", (json_int_t)bytes->positions, "tracks", (json_int_t)bytes->tracks,
                     "table", (json_int_t)bytes->table, "heads", (json_int_t)bytes->heads);
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

spin_status spin_bundle_write_array(struct spin_bundle_writer *w, const char *series, int frame,
                                    const char *descr, int n_dims, const uint64_t *shape,
                                    const void *values)
{
    char name[80];

    if (!values) /* an array without rows may be NULL, which the functions below do not accept */
        values = "";
    if (w->packs)
        return spin_packer_put(&w->packer, &w->zip, series, frame, n_dims, shape, values);
    if (frame < 0)
        return spin_npz_write(&w->zip, series, descr, n_dims, shape, values);
    snprintf(name, sizeof name, "%s/%05d", series, frame);
    return spin_npz_write(&w->zip, name, descr, n_dims, shape, values);
}

static spin_status write_group(struct spin_bundle_writer *w, const char *group, int index,
                               unsigned columns, unsigned static_columns,
                               const struct spin_splats *splats)
{
    static const float bytes[3] = {255, 255, 255};
    struct spin_splats view = *splats;

    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        bool still = (static_columns & column) != 0;
        uint64_t shape[3];
        char name[64];
        int n_dims;

        if (!(columns & column) || (still && index != 0))
            continue;
        n_dims = spin_column_shape(column, splats->n, splats->sh_degree, shape);
        series_name(group, column, name);
        /* The values of column rgb probably come from 8-bit images, so the packer tries to store
         * them as multiples of 1/255. */
        if (column == SPIN_COL_RGB && w->packs && index == 0)
            SPIN_TRY(spin_packer_units(&w->packer, name, 3, bytes));
        SPIN_TRY(spin_bundle_write_array(w, name, still ? -1 : index, "<f4", n_dims, shape,
                                         *spin_column_of(&view, column)));
    }
    return SPIN_OK;
}

spin_status spin_bundle_write_frame(struct spin_bundle_writer *w, int index, unsigned columns,
                                    unsigned static_columns, const struct spin_splats *splats)
{
    return write_group(w, "source", index, columns, static_columns, splats);
}

static spin_status write_array_4d(struct spin_bundle_writer *w, const struct spin_splats_4d *s,
                                  int k, const float *values, float per_unit)
{
    uint64_t shape[2] = {s->n, spin_array_4d_width(s, k)};
    float unit[SPIN_UNITS];
    char name[64];

    snprintf(name, sizeof name, "source/4d/%s", spin_array_4d_name(k));
    for (uint64_t c = 0; c < shape[1] && per_unit > 0; c++)
        unit[c] = per_unit;
    if (per_unit > 0)
        SPIN_TRY(spin_packer_units(&w->packer, name, shape[1], unit));
    /* An array with SPIN_WIDE columns or more contains SH, whose low bits are noise, so packing
     * would save at most a fifth of the array's size. */
    else if (w->packer.quick && shape[1] >= SPIN_WIDE)
        return spin_npz_write(&w->zip, name, "<f4", 2, shape, values);
    return spin_bundle_write_array(w, name, -1, "<f4", 2, shape, values);
}

spin_status spin_bundle_write_4d(struct spin_bundle_writer *w, const struct spin_splats_4d *s,
                                 enum spin_round_4d round, struct spin_bundle_meta *meta)
{
    struct spin_splats_4d of = *s;

    for (int k = 0; k < SPIN_N_ARRAYS_4D; k++)
        if (*spin_array_4d_of(&of, k))
            SPIN_TRY(write_array_4d(w, s, k, *spin_array_4d_of(&of, k),
                                    spin_array_4d_per_unit(k, round)));
    meta->four_d = (struct spin_splats_4d){.n = s->n,
                                           .degree = s->degree,
                                           .least_weight = s->least_weight,
                                           .least_opacity = s->least_opacity,
                                           .period = s->period,
                                           .cov2d = {s->cov2d[0], s->cov2d[1]}};
    meta->parts = spin_splats_4d_parts(s);
    meta->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    meta->static_columns = 0;
    meta->sh_degree = s->sh_degree;
    meta->antialias = s->antialias;
    return SPIN_OK;
}

spin_status spin_bundle_write_refined(struct spin_bundle_writer *w, int index, unsigned columns,
                                      const struct spin_splats *splats)
{
    return write_group(w, "refined", index, columns, 0, splats);
}

static spin_status write_sound(struct spin_bundle_writer *w, const struct spin_sound *sound)
{
    return sound->data ? spin_zip_member_whole(&w->zip, SOUND, "", 0, sound->data, sound->size)
                       : SPIN_OK;
}

spin_status spin_bundle_writer_finish(struct spin_bundle_writer *w,
                                      const struct spin_bundle_meta *meta, spin_json *extra)
{
    spin_json *root = spin_bundle_meta_json(meta, extra);
    char *text;
    spin_status status;

    if (w->packs)
        spin_bundle_meta_packed(root, &w->packer);
    text = spin_json_text(root, true);
    spin_json_free(root);
    if (!text) {
        status = spin_fail(SPIN_E_MEMORY, "not enough memory to write meta.json");
        goto out;
    }
    SPIN_TRY_OUT(write_sound(w, &meta->sound));
    SPIN_TRY_OUT(spin_zip_member_begin(&w->zip, META, strlen(text)));
    SPIN_TRY_OUT(spin_zip_member_write(&w->zip, text, strlen(text)));
    SPIN_TRY_OUT(spin_zip_member_end(&w->zip));
    free(text);
    spin_packer_free(&w->packer);
    return spin_zip_writer_commit(&w->zip);
out:
    free(text);
    spin_bundle_writer_abandon(w);
    return status;
}

void spin_bundle_writer_abandon(struct spin_bundle_writer *w)
{
    spin_packer_free(&w->packer);
    spin_zip_writer_abandon(&w->zip);
}
