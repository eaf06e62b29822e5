#include "importers/lib/sog_levels.h"

#include "base/option.h"
#include "formats/sog.h"
#include "importers/lib/views_check.h"
#include "io/json.h"

enum { VERSION = 1, MAX_LEVELS = 64 };

/* ---- The tree -------------------------------------------------------------------------------- */

static size_t count_runs(const spin_json *node)
{
    const spin_json *children = spin_json_get(node, "children");
    size_t n = json_object_size(spin_json_get(node, "lods"));

    for (size_t i = 0; i < spin_json_length(children); i++)
        n += count_runs(spin_json_at(children, i));
    return n;
}

static spin_status read_run(const char *key, const spin_json *json, struct sog_levels *l)
{
    struct sog_run *run = &l->run[l->n_runs];
    int64_t chunk, first, n;
    char *end;
    long level = strtol(key, &end, 10);

    if (end == key || *end || level < 0 || level >= MAX_LEVELS)
        return spin_malformed("'%.40s' is not a level of detail from 0 to %d", key, MAX_LEVELS - 1);
    if (!spin_json_integer(spin_json_get(json, "file"), &chunk) ||
        !spin_json_integer(spin_json_get(json, "offset"), &first) ||
        !spin_json_integer(spin_json_get(json, "count"), &n) || first < 0 || n < 0 ||
        first > INT_MAX || n > INT_MAX)
        return spin_malformed("a leaf has no valid 'file', 'offset' and 'count' for level %ld",
                              level);
    if (chunk < 0 || (size_t)chunk >= l->n_chunks)
        return spin_malformed("a leaf refers to file %lld, but 'filenames' has %zu entries",
                              (long long)chunk, l->n_chunks);
    *run = (struct sog_run){(int)level, (int)chunk, (size_t)first, (size_t)n};
    l->n_runs += n > 0;
    l->n_levels = (int)level >= l->n_levels ? (int)level + 1 : l->n_levels;
    return SPIN_OK;
}

static spin_status read_node(const spin_json *node, struct sog_levels *l)
{
    spin_json *lods = spin_json_get(node, "lods"), *children = spin_json_get(node, "children");
    const char *key;
    spin_json *value;

    json_object_foreach(lods, key, value) SPIN_TRY(read_run(key, value, l));
    for (size_t i = 0; i < spin_json_length(children); i++)
        SPIN_TRY(read_node(spin_json_at(children, i), l));
    return SPIN_OK;
}

/* ---- Files ----------------------------------------------------------------------------------- */

static spin_status find_chunk(struct spin_model *m, const char *folder, const spin_json *name,
                              struct sog_chunk *out)
{
    const char *text = spin_json_string(name);

    if (!text || !*text || !spin_views_is_safe_name(text))
        return spin_malformed(
            "a file name is '%.80s', expected a path below the folder of " SPIN_SOG_LEVELS_FILE,
            text ? text : "");
    SPIN_TRY(spin_model_join(m, &out->path, folder, "%s", text));
    if (spin_text_ends_any_case(text, ".json"))
        SPIN_TRY(spin_model_folder(m, &out->folder, out->path));
    out->exists = spin_path_exists(out->path);
    return SPIN_OK;
}

static spin_status find_chunks(struct spin_model *m, const char *folder, const spin_json *meta,
                               struct sog_levels *l)
{
    const spin_json *names = spin_json_get(meta, "filenames");
    const spin_json *sky = spin_json_get(meta, "environment");

    l->n_chunks = spin_json_length(names);
    SPIN_TRY(spin_model_alloc(m, l->n_chunks + 1, sizeof *l->chunk, (void **)&l->chunk));
    for (size_t i = 0; i < l->n_chunks; i++)
        SPIN_TRY(find_chunk(m, folder, spin_json_at(names, i), &l->chunk[i]));
    if (sky && !spin_json_is_null(sky))
        SPIN_TRY(find_chunk(m, folder, sky, &l->chunk[l->n_chunks]));
    l->has_sky = l->chunk[l->n_chunks].exists;
    return SPIN_OK;
}

static spin_status read_meta(struct spin_model *m, const char *folder, const spin_json *meta,
                             struct sog_levels *l)
{
    const spin_json *tree = spin_json_get(meta, "tree"), *version = spin_json_get(meta, "version");
    int64_t number = VERSION;

    if (version && (!spin_json_integer(version, &number) || number != VERSION))
        return spin_unsupported("streamed SOG: the version is %lld, expected %d", (long long)number,
                                VERSION);
    SPIN_TRY(find_chunks(m, folder, meta, l));
    SPIN_TRY(spin_model_alloc(m, count_runs(tree) + 1, sizeof *l->run, (void **)&l->run));
    SPIN_TRY(read_node(tree, l));
    return l->n_runs > 0 ? SPIN_OK : spin_malformed("'tree' contains no splats");
}

/* ---- The level ------------------------------------------------------------------------------- */

/* Sets *missing to the path of a file that the level lacks, or to NULL if it lacks none. Returns
 * whether the level has splats. */
static bool has_level(const struct sog_levels *l, int level, const char **missing)
{
    bool has = false;

    *missing = NULL;
    for (size_t i = 0; i < l->n_runs; i++) {
        if (l->run[i].level != level)
            continue;
        has = true;
        if (!l->chunk[l->run[i].chunk].exists)
            *missing = l->chunk[l->run[i].chunk].path;
    }
    return has;
}

static spin_status choose_level(struct spin_model *m, struct sog_levels *l)
{
    const char *missing = NULL, *first_missing = NULL;
    int wanted = -1;

    SPIN_TRY(spin_option_count(m->values, "lod", 0, MAX_LEVELS - 1, &wanted));
    for (int level = 0; level < l->n_levels; level++) {
        if ((wanted >= 0 && level != wanted) || !has_level(l, level, &missing))
            continue;
        l->level = level;
        if (!missing)
            return SPIN_OK;
        first_missing = first_missing ? first_missing : missing;
    }
    if (first_missing)
        return spin_not_found("'%s' does not exist", first_missing);
    return spin_not_found("--lod is %d, but this level of detail has no splats: levels are 0 to %d",
                          wanted, l->n_levels - 1);
}

static spin_status peek_chunk(const struct sog_chunk *chunk, struct spin_sog *out)
{
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};

    SPIN_TRY(spin_map_open(chunk->path, &map));
    return spin_fail_context(spin_sog_peek(map.data, map.size, chunk->folder, out), "'%s'",
                             chunk->path);
}

/* Reads the header of a chunk, and adds the chunk's splats of the chosen level to the totals of *l.
 */
static spin_status add_chunk(struct sog_chunk *chunk, struct sog_levels *l)
{
    struct spin_sog sog;

    SPIN_TRY(peek_chunk(chunk, &sog));
    chunk->n_rows = sog.n;
    if (chunk->n > sog.n)
        return spin_malformed("'%s' contains %zu splats, but the leaves of the tree list %zu",
                              chunk->path, sog.n, chunk->n);
    l->n += chunk->n;
    l->sh_degree = sog.sh_degree > l->sh_degree ? sog.sh_degree : l->sh_degree;
    l->antialias = l->antialias || sog.antialias;
    return SPIN_OK;
}

static spin_status count_splats(struct sog_levels *l)
{
    struct sog_chunk *sky = &l->chunk[l->n_chunks];
    struct spin_sog sog;

    for (size_t i = 0; i < l->n_runs; i++)
        if (l->run[i].level == l->level)
            l->chunk[l->run[i].chunk].n += l->run[i].n;
    if (l->has_sky) {
        SPIN_TRY(peek_chunk(sky, &sog));
        sky->n = sog.n;
    }
    for (size_t i = 0; i <= l->n_chunks; i++)
        if (l->chunk[i].n > 0)
            SPIN_TRY(add_chunk(&l->chunk[i], l));
    return SPIN_OK;
}

spin_status spin_sog_levels_open(struct spin_model *m, const char *folder, const void *text,
                                 size_t n, struct sog_levels *out)
{
    SPIN_LEAVES(spin_json_freed) spin_json *meta = NULL;

    *out = (struct sog_levels){0};
    SPIN_TRY(spin_json_parse(SPIN_SOG_LEVELS_FILE, text, n, &meta));
    SPIN_TRY(read_meta(m, folder, meta, out));
    SPIN_TRY(choose_level(m, out));
    return count_splats(out);
}

spin_status spin_sog_levels_note(struct spin_model *m, const struct sog_levels *l,
                                 const char **level, const char **sky)
{
    const struct sog_chunk *env = &l->chunk[l->n_chunks];
    const char *missing, *why = "the finest";

    for (int i = 0; i < l->level; i++)
        if (has_level(l, i, &missing) && missing)
            why = "the finest whose files exist";
    SPIN_TRY(spin_model_text(m, level, "streamed SOG: level of detail %d of 0 to %d%s%s%s",
                             l->level, l->n_levels - 1, spin_model_option(m, "lod") ? "" : ", ",
                             spin_model_option(m, "lod") ? "" : why,
                             spin_model_option(m, "lod") ? "" : "; --lod selects another"));
    *sky = NULL;
    if (l->has_sky)
        return spin_model_text(m, sky, "the last %zu splats are the sky ('%s')", env->n, env->path);
    return env->path
               ? spin_model_text(m, sky, "the sky is not imported: '%s' does not exist", env->path)
               : SPIN_OK;
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Drops the rows that do not belong to the level from the splats of a chunk. */
static spin_status select_rows(const struct sog_levels *l, size_t chunk, struct spin_splats *raw,
                               struct spin_splats *selected)
{
    SPIN_FREED unsigned char *mark = NULL;

    SPIN_TRY(spin_alloc(raw->n + 1, 1, (void **)&mark));
    for (size_t i = 0; i < l->n_runs; i++) {
        const struct sog_run *run = &l->run[i];

        if (run->level == l->level && (size_t)run->chunk == chunk && run->first <= raw->n &&
            run->n <= raw->n - run->first)
            memset(mark + run->first, 1, run->n);
    }
    return spin_splats_select(raw, mark, selected);
}

static spin_status read_chunk(const struct sog_levels *l, size_t i, unsigned columns,
                              struct spin_splats *raw, struct spin_splats *selected,
                              const struct spin_splats **out)
{
    const struct sog_chunk *chunk = &l->chunk[i];
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};

    if (chunk->n < chunk->n_rows) /* spin_splats_select() copies all columns, so all must be read */
        columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_map_open(chunk->path, &map));
    SPIN_TRY_IN(spin_sog_read(map.data, map.size, chunk->folder, columns, raw), "'%s'",
                chunk->path);
    *out = raw;
    if (chunk->n < chunk->n_rows) {
        SPIN_TRY(select_rows(l, i, raw, selected));
        *out = selected;
    }
    if ((*out)->n != chunk->n)
        return spin_malformed("the leaves of the tree list overlapping splats of '%s', or splats "
                              "that it does not contain",
                              chunk->path);
    return SPIN_OK;
}

spin_status spin_sog_levels_read(const struct sog_levels *l, unsigned columns,
                                 struct spin_splats *out)
{
    static const struct spin_placement in_place = {.q = {1}, .scale = 1};
    SPIN_LEAVES(spin_splats_free) struct spin_splats raw = {0}, selected = {0};
    const struct spin_splats *from = NULL;
    size_t first = 0;

    SPIN_TRY(spin_splats_reserve(out, l->n, columns, l->sh_degree));
    for (size_t i = 0; i <= l->n_chunks; i++) {
        if (l->chunk[i].n == 0)
            continue;
        SPIN_TRY(read_chunk(l, i, columns, &raw, &selected, &from));
        spin_splats_place(from, columns, &in_place, first, out);
        first += from->n;
    }
    out->antialias = l->antialias;
    return SPIN_OK;
}
