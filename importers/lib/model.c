/* Models of importers: memory, files, clouds, tensors. */
#include "importers/lib/model.h"

#include <float.h>
#include <stdarg.h>

struct spin_model_block {
    struct spin_model_block *next;
    void *block;
};

/* ---- Opening and closing --------------------------------------------------------------------- */

spin_status spin_model_open(const char *path, const struct spin_plugin_values *values, void **self,
                            struct spin_sequence_info *sequence, size_t bytes,
                            spin_status (*fn)(void *self, const char *path))
{
    struct spin_model *m;
    spin_status status;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, bytes, self));
    m = *self;
    m->values = values;
    m->sequence = sequence;
    m->prefix = "";
    m->path = path;
    status = fn(m, path);
    if (spin_run_config_is_blender(&m->settings))
        sequence->up[2] = 1;
    spin_ply_close(&m->ply);
    spin_arena_free(&m->scratch);
    return status;
}

void spin_model_clear(struct spin_model *m)
{
    spin_ply_close(&m->ply);
    spin_torch_close(&m->torch);
    spin_run_config_close(&m->settings);
    spin_splats_free(&m->canonical);
    spin_splats_4d_free(&m->splats_4d);
    spin_mlp_team_free(&m->team);
    for (struct spin_model_block *b = m->blocks; b; b = b->next)
        free(b->block);
    spin_arena_free(&m->arena);
}

void spin_model_close(void *self)
{
    if (self)
        spin_model_clear(self);
    free(self);
}

const char *spin_model_option(const struct spin_model *m, const char *key)
{
    return spin_plugin_value(m->values, key, NULL);
}

struct cfg_span spin_model_option_span(const struct spin_model *m, const char *key)
{
    const char *text = spin_model_option(m, key);

    return (struct cfg_span){text, text ? text + strlen(text) : NULL};
}

spin_status spin_model_bool(const struct spin_model *m, const char *option, const char *key,
                            bool *out)
{
    struct cfg_span given = spin_model_option_span(m, option);

    if (!given.at)
        return spin_cfg_read_bool(&m->settings.cfg, key, out);
    return spin_cfg_bool(given, out)
               ? SPIN_OK
               : spin_misuse("--%s '%s': expected true or false", option, given.at);
}

spin_status spin_model_number(const struct spin_model *m, const char *option, const char *key,
                              double *out)
{
    struct cfg_span given = spin_model_option_span(m, option);

    if (!given.at)
        return spin_cfg_read_number(&m->settings.cfg, key, out);
    return spin_cfg_number(given, out)
               ? SPIN_OK
               : spin_misuse("--%s '%s': expected a number", option, given.at);
}

spin_status spin_model_word(const struct spin_model *m, const char *option, const char *key,
                            const char *words, int *out)
{
    struct cfg_span s = spin_cfg_get(&m->settings.cfg, key);
    char text[64] = "";
    const char *const pairs[] = {key, text, NULL};
    const struct spin_plugin_values said = {pairs};

    if (option && spin_model_option(m, option))
        return spin_option_word(m->values, option, words, out);
    if (s.at && s.end - s.at > 2)
        snprintf(text, sizeof text, "%.*s", (int)(s.end - s.at - 2), s.at + 1);
    if (spin_option_word(&said, key, words, out) != SPIN_OK)
        *out = -1;
    return SPIN_OK;
}

spin_status spin_model_join(struct spin_model *m, const char **out, const char *folder,
                            const char *fmt, ...)
{
    size_t n_folder = strlen(folder), n;
    const char *between = n_folder > 0 && folder[n_folder - 1] != '/' ? "/" : "";
    va_list args, again;
    spin_status status;
    char *text;

    va_start(args, fmt);
    va_copy(again, args);
    n = n_folder + 2 + (size_t)vsnprintf(NULL, 0, fmt, again);
    va_end(again);
    status = spin_model_alloc(m, n, 1, (void **)&text);
    if (status == SPIN_OK) {
        n_folder = (size_t)snprintf(text, n, "%s%s", folder, between);
        vsnprintf(text + n_folder, n - n_folder, fmt, args);
        *out = text;
    }
    va_end(args);
    return status;
}

spin_status spin_model_if_exists(spin_status status, const char **out)
{
    if (status == SPIN_OK && !spin_path_exists(*out))
        *out = NULL;
    return status;
}

/* Takes ownership of a malloc() block: the block is freed with the model or, if this function
 * fails, immediately. */
static spin_status keep_block(struct spin_model *m, void *block)
{
    struct spin_model_block *b;
    spin_status status = spin_model_alloc(m, 1, sizeof *b, (void **)&b);

    if (status != SPIN_OK) {
        free(block);
        return status;
    }
    *b = (struct spin_model_block){m->blocks, block};
    m->blocks = b;
    return SPIN_OK;
}

spin_status spin_model_folder(struct spin_model *m, const char **out, const char *path)
{
    char *folder;

    SPIN_TRY(spin_path_folder(path, &folder));
    *out = folder;
    return keep_block(m, folder);
}

spin_status spin_model_absolute(struct spin_model *m, const char **out, const char *path)
{
    char *whole;

    SPIN_TRY(spin_path_absolute(path, &whole));
    *out = whole;
    return keep_block(m, whole);
}

spin_status spin_model_name(struct spin_model *m, const char *folder, const char *name,
                            const char **out)
{
    size_t n = strlen(name);
    char *copy;

    while (n > 0 && strchr(" \t\r\n", name[n - 1]))
        n--;
    SPIN_TRY(spin_model_text(m, out, "%.*s", (int)n, name));
    if (!strchr(*out, '\\') || spin_model_holds(folder, *out))
        return SPIN_OK;
    copy = (char *)(uintptr_t)*out;
    for (char *at = copy; (at = strchr(at, '\\'));)
        *at = '/';
    return SPIN_OK;
}

spin_status spin_model_names(struct spin_model *m, const char *folder, char ***names, size_t *n)
{
    char **list;
    spin_status status;

    SPIN_TRY(spin_folder_list(folder, &list, n));
    status = spin_model_alloc(m, *n + 1, sizeof *list, (void **)names);
    for (size_t i = 0; i < *n && status == SPIN_OK; i++) {
        const char *name = NULL;

        status = spin_model_text(m, &name, "%s", list[i]);
        (*names)[i] = (char *)name;
    }
    spin_folder_list_free(list);
    return status;
}

void spin_model_describe(const struct spin_model *m, const size_t *counts, int sh_degree,
                         unsigned moved)
{
    struct spin_sequence_info *s = m->sequence;

    s->n_frames = 1;
    s->identity = true;
    s->counts = counts;
    s->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    s->static_columns = s->columns & ~moved;
    s->sh_degree = sh_degree;
    s->continuous = true;
    s->time_last = 1;
}

spin_status spin_model_finish_4d(struct spin_model *m)
{
    size_t n = m->splats_4d.n, n_dropped;

    SPIN_TRY(spin_splats_4d_finish(&m->splats_4d, &n_dropped, NULL));
    if (n_dropped == n)
        return spin_malformed("none of the %zu Gaussians has finite values", n);
    if (n_dropped > 0)
        spin_note(m->sequence, "%s dropped because of values that are not finite",
                  spin_text_share(n_dropped, n, "Gaussian", "is", "are", (char[96]){0}));
    spin_model_describe(m, NULL, m->splats_4d.sh_degree, ~0u);
    m->sequence->antialias = m->splats_4d.antialias;
    m->sequence->identity = false;
    return SPIN_OK;
}

spin_status spin_model_sound(struct spin_model *m, const struct spin_sound *sound)
{
    unsigned char *data;

    if (!sound->data)
        return SPIN_OK;
    SPIN_TRY(spin_model_alloc(m, sound->size, 1, (void **)&data));
    memcpy(data, sound->data, sound->size);
    m->sound = *sound;
    m->sound.data = data;
    m->sequence->sound = &m->sound;
    return SPIN_OK;
}

spin_status spin_model_slice(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out)
{
    struct spin_model *m = self;

    if (frame < 0)
        return spin_not_found("'%s' has no frame %d", m->path, frame);
    return spin_splats_4d_slice(&m->splats_4d, time, columns, out);
}

spin_status spin_model_splats_4d(void *self, const struct spin_splats_4d **out)
{
    *out = &((struct spin_model *)self)->splats_4d;
    return SPIN_OK;
}

/* ---- Recognising ----------------------------------------------------------------------------- */

bool spin_peek_has(const struct spin_peek *peek, const char *name)
{
    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        if (strcmp(peek->names[i], name) == 0)
            return true;
    }
    return false;
}

bool spin_peek_contains(const struct spin_peek *peek, const char *word)
{
    return peek->n_head > 0 && memmem(peek->head, peek->n_head, word, strlen(word)) != NULL;
}

/* ---- Columns --------------------------------------------------------------------------------- */

float *spin_model_values(const struct spin_splats *s, int column, size_t *width)
{
    const size_t n_sh = (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    const size_t widths[SPIN_MODEL_COLUMNS] = {3, 4, 3, 1, 3 * n_sh};
    float *const values[] = {s->means, s->quats, s->log_scales, s->logit_opacities, s->sh};

    *width = widths[column];
    return values[column];
}

spin_status spin_model_check(const char *path, double time, unsigned columns,
                             const struct spin_splats *s)
{
    static const char *const names[] = {"positions", "rotations", "scales", "opacities", "colours"};

    for (int c = 0; c < SPIN_MODEL_COLUMNS; c++) {
        size_t width, bad = 0;
        const float *values = spin_model_values(s, c, &width);

        if (columns & 1u << c)
            bad = spin_finite_missing(values, s->n * width);
        if (bad > 0)
            return spin_malformed("'%s': %zu values of the %s at time %g are not finite", path, bad,
                                  names[c], time);
    }
    return SPIN_OK;
}

/* ---- The folder of a training ---------------------------------------------------------------- */

long long spin_model_iteration(const char *name)
{
    const char *digits = name + 10;

    if (strncmp(name, "iteration_", 10) != 0 || !*digits || strlen(digits) > 15 ||
        strspn(digits, "0123456789") != strlen(digits))
        return -1;
    return atoll(digits);
}

bool spin_model_holds(const char *folder, const char *file)
{
    SPIN_FREED char *path = NULL;
    bool found = spin_path_join(folder, file, &path) == SPIN_OK && spin_path_exists(path);

    return found;
}

spin_status spin_model_choose(struct spin_model *m, const char *wanted, const char *folder,
                              const char *file, const char *folder2, const char *file2,
                              const char **out)
{
    char **names = NULL;
    size_t n = 0;
    long long best = -2;

    *out = NULL;
    SPIN_TRY(spin_model_names(m, folder, &names, &n));
    for (size_t i = 0; i < n; i++) {
        long long number = spin_model_iteration(names[i]);
        const char *found, *found2 = "";

        if (number < 0 && strcmp(names[i], "iteration_best") != 0)
            continue;
        if (wanted ? strcmp(names[i] + 10, wanted) != 0 : number <= best)
            continue;
        SPIN_TRY(spin_model_find(m, &found, folder, "%s/%s", names[i], file));
        if (folder2)
            SPIN_TRY(spin_model_find(m, &found2, folder2, "%s/%s", names[i], file2));
        if (!found || !found2)
            continue;
        best = number;
        *out = names[i];
    }
    return SPIN_OK;
}

spin_status spin_model_newest(struct spin_model *m, const char *path, const char *inner,
                              long long (*step_of)(const char *name), const char *called)
{
    const char *folder, *best = NULL;
    char **names;
    size_t n;

    if (!spin_path_is_folder(path))
        return spin_model_text(m, &m->path, "%s", path);
    SPIN_TRY(spin_model_join(m, &folder, path, "%s", inner));
    if (!spin_path_is_folder(folder))
        folder = path;
    SPIN_TRY(spin_model_names(m, folder, &names, &n));
    for (size_t i = 0; i < n; i++)
        if (step_of(names[i]) > (best ? step_of(best) : -1))
            best = names[i];
    return best ? spin_model_join(m, &m->path, folder, "%s", best)
                : spin_not_found("'%s' contains no %s", folder, called);
}

spin_status spin_model_checkpoint(struct spin_model *m, const char *path, const char *network,
                                  const char **out)
{
    const char *clouds, *name, *file = spin_path_name(path);

    *out = NULL;
    if (!spin_path_is_folder(path)) {
        if (strcmp(file, network) != 0 && strcmp(file, "point_cloud.ply") != 0)
            return spin_misuse(
                "'%s' is neither the model's folder nor its point_cloud/iteration_<N>", path);
        return spin_model_folder(m, out, path);
    }
    if (spin_model_holds(path, network))
        return spin_model_text(m, out, "%s", path);
    SPIN_TRY(spin_model_join(m, &clouds, path, "point_cloud"));
    if (!spin_path_is_folder(clouds))
        clouds = path;
    SPIN_TRY(spin_model_choose(m, spin_model_option(m, "iteration"), clouds, "point_cloud.ply",
                               clouds, network, &name));
    return name ? spin_model_join(m, out, clouds, "%s", name) : SPIN_OK;
}

bool spin_model_search(const char *path, const char *file, bool *coarse)
{
    struct spin_model m = {0};
    bool found = spin_model_holds(path, file);
    const char *folder;
    char **names;
    size_t n = 0;

    *coarse = false;
    if (spin_model_join(&m, &folder, path, "point_cloud") != SPIN_OK ||
        !spin_path_is_folder(folder))
        folder = path;
    if (spin_model_names(&m, folder, &names, &n) != SPIN_OK)
        n = 0;
    for (size_t i = 0; i < n; i++) {
        const char *save = NULL;

        *coarse = *coarse || strncmp(names[i], "coarse_iteration_", 17) == 0;
        if (spin_model_join(&m, &save, folder, "%s", names[i]) == SPIN_OK)
            found = found || spin_model_holds(save, file);
    }
    spin_model_clear(&m);
    return found;
}

spin_status spin_model_find_upwards(struct spin_model *m, const char *path, const char *save,
                                    const char *name, const char **out)
{
    static const char *const above[] = {"", "../", "../../"};

    SPIN_TRY(spin_model_find(m, out, path, "%s", name));
    for (int i = 0; i < 3 && save && !*out; i++)
        SPIN_TRY(spin_model_find(m, out, save, "%s%s", above[i], name));
    return SPIN_OK;
}

spin_status spin_model_cfg(struct spin_model *m, const char *path, const char *save)
{
    const char *file;

    SPIN_TRY(spin_model_find_upwards(m, path, save, "cfg_args", &file));
    return file ? spin_cfg_open(file, &m->settings.cfg) : SPIN_OK;
}

/* Opens the YAML file of option `config`. Refuses a file that contains none of the settings that
 * importers use, since it would have no effect. */
static spin_status open_config(struct spin_model *m, const char *path)
{
    static const char *const keys[] = {"time_duration", "frame_ratio", "compute_cov3D_python"};
    const char *next;

    SPIN_TRY_IN(spin_yaml_open(path, &m->settings), "--config");
    for (int i = 0; i < 3; i++)
        if (spin_yaml_find(&m->settings, keys[i], &next).at)
            return SPIN_OK;
    return spin_malformed("--config: '%s' has none of %s, %s and %s: give the YAML of the training",
                          path, keys[0], keys[1], keys[2]);
}

spin_status spin_model_config(struct spin_model *m)
{
    const char *config = spin_model_option(m, "config"), *folder, *next, *path;
    char **names;
    size_t n;

    SPIN_TRY(spin_model_folder(m, &folder, m->path));
    SPIN_TRY(spin_model_cfg(m, folder, NULL));
    if (config)
        return open_config(m, config);
    SPIN_TRY(spin_model_names(m, folder, &names, &n));
    /* Training stores no YAML file in this folder, but users may copy one there. */
    for (size_t i = 0; i < n; i++) {
        const char *dot = strrchr(names[i], '.');

        if (!dot || (strcmp(dot, ".yaml") != 0 && strcmp(dot, ".yml") != 0))
            continue;
        SPIN_TRY(spin_model_join(m, &path, folder, "%s", names[i]));
        if (spin_path_is_folder(path))
            continue;
        SPIN_TRY(spin_yaml_open(path, &m->settings));
        if (spin_yaml_find(&m->settings, "time_duration", &next).at)
            return SPIN_OK;
        spin_yaml_close(&m->settings);
    }
    return SPIN_OK;
}

/* ---- The cloud ------------------------------------------------------------------------------- */

spin_status spin_model_column(const struct spin_ply *ply, const struct spin_ply_element *e,
                              const char *name, float *out, size_t step)
{
    int p = spin_ply_find(e, name);
    uint64_t bad = 0;

    if (p < 0)
        return spin_malformed("'%s': element 'vertex' has no property '%s'", ply->path, name);
    spin_ply_column(ply, e, p, out, step);
    for (uint64_t i = 0; i < e->count; i++)
        bad += !isfinite(out[i * step]);
    if (bad > 0)
        return spin_malformed("'%s': %llu values of '%s' are not finite", ply->path,
                              (unsigned long long)bad, name);
    return SPIN_OK;
}

spin_status spin_model_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                               const char *prefix, int n, float *out, size_t step)
{
    for (int i = 0; i < n; i++) {
        char name[64];

        snprintf(name, sizeof name, "%s%d", prefix, i);
        SPIN_TRY(spin_model_column(ply, e, name, out + i, step));
    }
    return SPIN_OK;
}

int spin_model_count(const struct spin_ply_element *e, const char *prefix)
{
    int n = 0;

    for (size_t i = 0; i < e->n_properties; i++)
        n += strncmp(e->property[i].name, prefix, strlen(prefix)) == 0;
    return n;
}

spin_status spin_model_ply(struct spin_model *m, const char *path)
{
    spin_ply_close(&m->ply);
    return spin_ply_open(path, &m->ply);
}

spin_status spin_model_vertices(struct spin_model *m, const char *path,
                                const struct spin_ply_element **vertex)
{
    SPIN_TRY(spin_model_ply(m, path));
    SPIN_TRY(spin_ply_vertices(&m->ply, vertex));
    if ((*vertex)->count == 0)
        return spin_malformed("'%s' contains 0 vertices", path);
    if ((*vertex)->count > INT_MAX)
        return spin_unsupported("'%s' has 2^31 or more vertices", path);
    return SPIN_OK;
}

spin_status spin_model_cloud(struct spin_model *m, const char *path, struct spin_gs_ply *cloud)
{
    SPIN_TRY(spin_model_ply(m, path));
    SPIN_TRY(spin_gs_ply_find(&m->ply, cloud));
    if (cloud->vertex->count > INT_MAX)
        return spin_unsupported("'%s' has 2^31 or more vertices", path);
    if (cloud->n_rest > (int)spin_n_rest(3))
        return spin_malformed(
            "'%s' has %d properties f_rest_*, expected 0, 9, 24 or 45 (SH degree 0 to 3)", path,
            cloud->n_rest);
    return SPIN_OK;
}

spin_status spin_model_read(struct spin_model *m, const char *path, const char *extra, int n_extra,
                            float **values)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_splats *out = &m->canonical;
    size_t width = n_extra > 0 ? (size_t)n_extra : 1;
    struct spin_gs_ply cloud;

    SPIN_TRY(spin_model_cloud(m, path, &cloud));
    if (cloud.vertex->count == 0)
        return spin_malformed("'%s' contains 0 vertices", path);
    SPIN_TRY(spin_splats_reserve(out, (size_t)cloud.vertex->count, columns, cloud.sh_degree));
    SPIN_TRY(spin_gs_ply_read(&cloud, columns, 0, out));
    if (!extra)
        return SPIN_OK;
    SPIN_TRY(spin_model_alloc(m, out->n, width * sizeof **values, (void **)values));
    return n_extra > 0 ? spin_model_columns(&m->ply, cloud.vertex, extra, n_extra, *values, width)
                       : spin_model_column(&m->ply, cloud.vertex, extra, *values, 1);
}

/* The median of a coordinate, and the extent of the central 90 % of its values. */
struct spread {
    double middle, range;
};

static spin_status find_spread(const float *means, size_t n, int c, struct spread *out)
{
    SPIN_FREED float *value = NULL;
    size_t n_finite = 0;

    SPIN_TRY(spin_alloc(n, sizeof *value, (void **)&value));
    for (size_t i = 0; i < n; i++)
        if (isfinite(means[3 * i + (size_t)c]))
            value[n_finite++] = means[3 * i + (size_t)c];
    if (n_finite == 0)
        return SPIN_OK;
    qsort(value, n_finite, sizeof *value, spin_by_float);
    out->middle = (double)value[n_finite / 2];
    out->range = (double)(value[n_finite - 1 - n_finite / 20] - value[n_finite / 20]);
    return SPIN_OK;
}

spin_status spin_model_choose_shift(struct spin_model *m, const char *path, const float *means,
                                    size_t n, bool wide, double shift[3])
{
    double extent = 0, farthest = 0;
    struct spread s[3] = {0};

    for (int c = 0; c < 3; c++) {
        SPIN_TRY(find_spread(means, n, c, &s[c]));
        extent = fmax(extent, s[c].range);
        farthest = fmax(farthest, fabs(s[c].middle));
    }
    if (farthest < (extent > 0 ? 1 : 1024) ||
        FLT_EPSILON * farthest <= (wide ? 2e-6 : 1e-5) * extent)
        return SPIN_OK;
    if (!wide) {
        spin_warn("'%s': positions are up to %g from 0, where floats have steps of %.2g: store "
                  "them as doubles, or closer to 0",
                  path, farthest,
                  (double)(nextafterf((float)farthest, INFINITY) - (float)farthest));
        return SPIN_OK;
    }
    for (int c = 0; c < 3; c++)
        m->sequence->shift[c] = shift[c] = round(s[c].middle);
    spin_note(m->sequence,
              "positions are stored relative to %.15g, %.15g, %.15g, since floats have steps of "
              "%.2g there; spin-export adds these coordinates again, unless --relative is given",
              shift[0], shift[1], shift[2],
              (double)(nextafterf((float)farthest, INFINITY) - (float)farthest));
    return SPIN_OK;
}

/* ---- Tensors --------------------------------------------------------------------------------- */

spin_status spin_model_torch(struct spin_model *m, const char *path,
                             spin_status (*fn)(struct spin_model *m))
{
    spin_status status = spin_torch_open(path, &m->torch);

    if (status == SPIN_OK)
        status = fn(m);
    spin_torch_close(&m->torch);
    return spin_fail_reading(status, path);
}

spin_status spin_model_dict(struct spin_model *m)
{
    m->tensors = m->torch.root;
    if (!m->tensors || m->tensors->kind != SPIN_VALUE_DICT)
        return spin_malformed("the file does not contain a state dict");
    return SPIN_OK;
}

spin_status spin_model_keys(const struct spin_model *m, const char *const *stems)
{
    size_t n = strlen(m->prefix);

    for (size_t i = 0; i < m->tensors->n; i++) {
        const char *key = spin_value_text(m->tensors->item[2 * i]), *const *stem = stems;

        while (*stem && !(key && strncmp(key, m->prefix, n) == 0 &&
                          strncmp(key + n, *stem, strlen(*stem)) == 0))
            stem++;
        if (!*stem)
            return spin_unsupported(
                "tensor '%.80s' does not belong to this method: the run may be of a derived method",
                key ? key : "");
    }
    return SPIN_OK;
}

const struct spin_value *spin_model_get(const struct spin_model *m, const char *fmt, ...)
{
    size_t n = strlen(m->prefix);
    char name[300];
    va_list args;

    snprintf(name, sizeof name, "%s", m->prefix);
    n = n < sizeof name ? n : sizeof name - 1;
    va_start(args, fmt);
    vsnprintf(name + n, sizeof name - n, fmt, args);
    va_end(args);
    return spin_value_get(m->tensors, name);
}

spin_status spin_model_floats(struct spin_model *m, const char *key, int n_dims,
                              const int64_t *shape, struct spin_array *info, float **out)
{
    const struct spin_value *v = spin_model_get(m, "%s", key);
    struct spin_array unused;
    char name[300];

    snprintf(name, sizeof name, "%s%s", m->prefix, key);
    if (!v)
        return spin_malformed("there is no tensor '%s'", name);
    SPIN_TRY(spin_torch_floats(&m->torch, v, name, n_dims, shape, info ? info : &unused, out));
    return keep_block(m, *out);
}

spin_status spin_model_layer(struct spin_model *m, const char *key, int n_in, int n_out,
                             enum mlp_ending ending, struct mlp_net *net)
{
    struct mlp_layer *l = &net->layer[net->n];
    int64_t shape[2] = {n_out, n_in};
    struct spin_array info;
    float *weight, *bias;
    char name[200];

    if (net->n == MLP_MAX_LAYERS)
        return spin_unsupported("the network has more than %d layers", MLP_MAX_LAYERS);
    snprintf(name, sizeof name, "%s.weight", key);
    SPIN_TRY(spin_model_floats(m, name, 2, shape, &info, &weight));
    if (info.shape[0] == 0 || info.shape[1] == 0 || info.shape[0] > MLP_MAX_WIDTH ||
        info.shape[1] > MLP_MAX_WIDTH)
        return spin_malformed("tensor '%s%s' has shape [%llu, %llu], expected sizes 1 to %d",
                              m->prefix, name, (unsigned long long)info.shape[0],
                              (unsigned long long)info.shape[1], MLP_MAX_WIDTH);
    *l = (struct mlp_layer){(int)info.shape[1], (int)info.shape[0], ending, weight, NULL};
    shape[0] = l->n_out;
    snprintf(name, sizeof name, "%s.bias", key);
    SPIN_TRY(spin_model_floats(m, name, 1, shape, NULL, &bias));
    l->bias = bias;
    net->n++;
    return SPIN_OK;
}

spin_status spin_model_trunk(struct spin_model *m, const char *stem, int from, int width,
                             struct mlp_net *net)
{
    for (int i = from; spin_model_get(m, "%s.%d.weight", stem, i); i += 2) {
        char key[80];

        snprintf(key, sizeof key, "%s.%d", stem, i);
        SPIN_TRY(spin_model_layer(m, key, width, width, MLP_RELU, net));
    }
    return SPIN_OK;
}

spin_status spin_model_head(struct spin_model *m, const char *name, int width, int n_out,
                            struct mlp_net *net)
{
    char key[100];

    snprintf(key, sizeof key, "%s.1", name);
    SPIN_TRY(spin_model_layer(m, key, width, width, MLP_RELU, net));
    snprintf(key, sizeof key, "%s.3", name);
    return spin_model_layer(m, key, width, n_out, MLP_PLAIN, net);
}
