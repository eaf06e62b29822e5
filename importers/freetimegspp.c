/* FreeTimeGS++: separated.pt if it exists, otherwise gaussians.pt, with config.toml beside this
 * file.
 *
 * The file contains the model as a Python object, whose state is read as data without running code.
 * Splats move on straight lines; the gate of a splat is the share of its opacity that its Gaussian
 * window in time does not affect. 4D splats represent lines and gates exactly. Times are seconds
 * from the first frame of the video.
 *
 * In runs with velocity_model = "field", a network computes the velocity of a splat from its
 * position and the time: a hash grid, followed by layers whose biases are functions of the time.
 * Such a model has no 4D splats and can only be sampled. */
#include "importers/lib/chkpnt.h"
#include "math/activate.h"

#define LEAST_OPACITY (1 / 255.0) /* rasterisers do not draw splats with a lower opacity */
#define MOST_FRAMES 1000000
#define CLASS "ftgspp.models.gaussians.Gaussians"

enum { MOST_LEVELS = 32, MOST_FEATURES = 8 };

struct level {
    float scale;
    uint32_t resolution, n_entries;
    const float *entry; /* [n_entries][n_features] */
};

struct velocity_net {
    float place[2][3], time[2]; /* lower and upper bounds, which are mapped to 0 and to 1 */
    struct level level[MOST_LEVELS];
    int n_levels, n_features;
    struct mlp_net layers;               /* layers whose biases are computed for each time */
    struct mlp_net bias[MLP_MAX_LAYERS]; /* for each layer, the network that computes its bias */
    float *biases[MLP_MAX_LAYERS];       /* for each layer, its bias at the current time */
};

struct model {
    struct spin_model base;
    double max_duration;
    /* From config.toml: the frame rate, and the range of frames, which excludes `stop`. Without
     * that file, fps is 0. */
    double fps, first, stop;
    bool has_network;
    struct velocity_net net;
    size_t *rows;      /* rows that are visible at the current time */
    float *velocities; /* [n][3] velocities of the visible rows at the current time */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    if (!peek->is_folder)
        return spin_peek_contains(peek, "ftgspp.models.gaussians") ? 100 : 0;
    if (!spin_peek_has(peek, "config.toml"))
        return spin_peek_has(peek, "gaussians.pt") || spin_peek_has(peek, "separated.pt") ? 60 : 0;
    return spin_peek_has(peek, "gaussians.pt") || spin_peek_has(peek, "separated.pt") ? 90 : 0;
}

/* ---- Objects --------------------------------------------------------------------------------- */

/* Returns the state of an object, which is a dict; NULL if the object has no state. */
static const struct spin_value *state_of(const struct spin_value *object)
{
    return object && object->kind == SPIN_VALUE_OBJECT && object->n == 1 ? object->item[0] : NULL;
}

/* Returns a submodule (`kind` is "_modules") or a parameter ("_parameters") of a module of PyTorch.
 */
static const struct spin_value *part_of(const struct spin_value *module, const char *kind,
                                        const char *name)
{
    return spin_value_get(spin_value_get(state_of(module), kind), name);
}

static spin_status bind_tensor(struct model *m, const char *name, int n_dims, const int64_t *shape,
                               struct spin_array *out)
{
    const struct spin_value *v = part_of(m->base.torch.root, "_parameters", name);

    if (!v || v->kind != SPIN_VALUE_TENSOR)
        return spin_malformed("the model has no parameter '%s'", name);
    return spin_chkpnt_bind(&m->base.torch, v, name, n_dims, shape, out);
}

/* ---- config.toml ----------------------------------------------------------------------------- */

/* Returns the text after "key =" in a section, or NULL if the section lacks the key. Keys may be
 * indented. */
static const char *find_setting(const char *text, const char *section, const char *key)
{
    size_t n = strlen(key), n_section = strlen(section);
    bool within = false;

    for (const char *line = text; line; line = strchr(line, '\n')) {
        line += strspn(line, " \t\r\n");
        if (*line == '[')
            within = strncmp(line + 1, section, n_section) == 0 && line[1 + n_section] == ']';
        else if (within && strncmp(line, key, n) == 0 && strchr(" \t=", line[n]))
            return line + n + strspn(line + n, " \t=");
        if (!*line)
            break;
    }
    return NULL;
}

/* Reads a number from the first line of `text`: if `key` is NULL, the number at the start of the
 * line, otherwise the number after "key =", as in an inline table. */
static bool read_number(const char *text, const char *key, double *out)
{
    const char *end = text ? strchr(text, '\n') : NULL;
    const char *at = text && key ? strstr(text, key) : text;
    char *after;

    if (!at || (end && at > end))
        return false;
    at += key ? strlen(key) + strspn(at + strlen(key), " \t=") : 0;
    *out = strtod(at, &after);
    return after != at;
}

static spin_status read_config(struct model *m, const char *path)
{
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    SPIN_FREED char *text = NULL;
    const char *frames;

    SPIN_TRY(spin_map_open(path, &map));
    if (map.size > CFG_MAX_BYTES)
        return spin_malformed("cannot read '%s': it is too large for a configuration file", path);
    SPIN_TRY(spin_alloc(map.size + 1, 1, (void **)&text));
    memcpy(text, map.data, map.size);
    frames = find_setting(text, "data", "frames");
    if (!read_number(find_setting(text, "data", "fps"), NULL, &m->fps) ||
        !(m->fps > 0 && m->fps <= 1e6))
        return spin_malformed("'%s': data.fps is %g, expected a number above 0", path, m->fps);
    if (!read_number(frames, "start", &m->first) || !read_number(frames, "stop", &m->stop) ||
        !(m->first >= 0 && m->stop > m->first && m->stop <= MOST_FRAMES))
        return spin_malformed("'%s': data.frames has start %g and stop %g, expected a stop above "
                              "the start",
                              path, m->first, m->stop);
    return SPIN_OK;
}

/* ---- The network ----------------------------------------------------------------------------- */

/* Appends the layer of a Linear module. `bias` states whether the module has a bias. */
static spin_status add_layer(struct model *m, const struct spin_value *linear, bool bias, int n_in,
                             struct mlp_net *net)
{
    struct mlp_layer *l = &net->layer[net->n];
    int64_t shape[2] = {-1, n_in};
    struct spin_array info;
    float *weight, *values = NULL;

    if (net->n == MLP_MAX_LAYERS)
        return spin_unsupported("the velocity network has more than %d layers", MLP_MAX_LAYERS);
    m->base.tensors = spin_value_get(state_of(linear), "_parameters");
    SPIN_TRY(spin_model_floats(&m->base, "weight", 2, shape, &info, &weight));
    if (info.shape[0] < 1 || info.shape[0] > MLP_MAX_WIDTH || info.shape[1] < 1 ||
        info.shape[1] > MLP_MAX_WIDTH)
        return spin_malformed("a layer of the velocity network has %llu x %llu weights, expected 1 "
                              "to %d in each dimension",
                              (unsigned long long)info.shape[0], (unsigned long long)info.shape[1],
                              MLP_MAX_WIDTH);
    shape[0] = (int64_t)info.shape[0];
    if (bias)
        SPIN_TRY(spin_model_floats(&m->base, "bias", 1, shape, NULL, &values));
    *l = (struct mlp_layer){(int)info.shape[1], (int)info.shape[0], MLP_RELU, weight, values};
    net->n++;
    return SPIN_OK;
}

/* Loads the Linear modules "0", "1", ... of a ModuleList; the last has no ReLU. */
static spin_status add_layers(struct model *m, const struct spin_value *list, bool bias, int n_in,
                              struct mlp_net *net)
{
    char name[16];

    for (int i = 0;; i++) {
        const struct spin_value *linear;

        snprintf(name, sizeof name, "%d", i);
        linear = part_of(list, "_modules", name);
        if (!linear)
            break;
        SPIN_TRY(add_layer(m, linear, bias, n_in, net));
        n_in = spin_mlp_n_out(net);
    }
    if (net->n == 0)
        return spin_malformed("the velocity network has no layers");
    net->layer[net->n - 1].ending = MLP_PLAIN;
    return SPIN_OK;
}

static spin_status load_layers(struct model *m, const struct spin_value *mlp, int n_in)
{
    struct velocity_net *net = &m->net;
    const struct spin_value *nets = part_of(mlp, "_modules", "bias_nets");
    char name[16];

    SPIN_TRY(add_layers(m, part_of(mlp, "_modules", "layers"), false, n_in, &net->layers));
    if (spin_mlp_n_out(&net->layers) != 3)
        return spin_malformed("the velocity network has %d outputs, expected 3",
                              spin_mlp_n_out(&net->layers));
    for (int i = 0; i < net->layers.n; i++) {
        struct mlp_layer *l = &net->layers.layer[i];

        snprintf(name, sizeof name, "%d", i);
        SPIN_TRY(add_layers(m, part_of(part_of(nets, "_modules", name), "_modules", "layers"), true,
                            1, &net->bias[i]));
        if (spin_mlp_n_out(&net->bias[i]) != l->n_out)
            return spin_malformed("bias network %d has %d outputs, but layer %d has %d", i,
                                  spin_mlp_n_out(&net->bias[i]), i, l->n_out);
        SPIN_TRY(
            spin_model_alloc(&m->base, (size_t)l->n_out, sizeof(float), (void **)&net->biases[i]));
        l->bias = net->biases[i];
    }
    return SPIN_OK;
}

static spin_status read_setting(const struct spin_value *config, const char *key, double least,
                                double most, double *out)
{
    if (spin_value_number(spin_value_get(config, key), out) && *out >= least && *out <= most)
        return SPIN_OK;
    return spin_unsupported(
        "setting '%s' of the hash grid is missing, or is not a number from %g to %g", key, least,
        most);
}

/* Sets the sizes of all levels, as in tiny-cuda-nn, and returns the number of parameters of the
 * hash grid. */
static uint64_t set_levels(struct velocity_net *net, double base, double per_level, double log2)
{
    uint64_t n = 0;

    for (int l = 0; l < net->n_levels; l++) {
        struct level *level = &net->level[l];
        double cells;

        level->scale = exp2f((float)l * log2f((float)per_level)) * (float)base - 1.0f;
        level->resolution = (uint32_t)ceilf(level->scale) + 1;
        cells = pow(level->resolution, 3);
        cells = fmin(8 * ceil(cells / 8), exp2(log2));
        level->n_entries = (uint32_t)cells;
        n += (uint64_t)level->n_entries * (uint64_t)net->n_features;
    }
    return n;
}

static spin_status load_grid(struct model *m, const struct spin_value *encoding)
{
    struct velocity_net *net = &m->net;
    const struct spin_value *config = spin_value_get(state_of(encoding), "encoding_config");
    const char *otype = spin_value_text(spin_value_get(config, "otype"));
    const char *type = spin_value_text(spin_value_get(config, "type"));
    const char *how = spin_value_text(spin_value_get(config, "interpolation"));
    double levels, features, log2, base, scale;
    float *values;
    int64_t shape[1];

    if (!otype || !type || (strcmp(otype, "Grid") != 0 && strcmp(otype, "HashGrid") != 0) ||
        strcmp(type, "Hash") != 0 || (how && strcmp(how, "Linear") != 0))
        return spin_unsupported("the encoding of the velocity network is '%.40s' of type '%.40s', "
                                "expected a linear hash grid",
                                otype ? otype : "unknown", type ? type : "unknown");
    SPIN_TRY(read_setting(config, "n_levels", 1, MOST_LEVELS, &levels));
    SPIN_TRY(read_setting(config, "n_features_per_level", 1, MOST_FEATURES, &features));
    SPIN_TRY(read_setting(config, "log2_hashmap_size", 3, 28, &log2));
    SPIN_TRY(read_setting(config, "base_resolution", 1, 65536, &base));
    SPIN_TRY(read_setting(config, "per_level_scale", 1, 16, &scale));
    net->n_levels = (int)levels;
    net->n_features = (int)features;
    if (!(base * pow(scale, levels - 1) < 1e9))
        return spin_unsupported("the finest level of the hash grid has too many cells");
    shape[0] = (int64_t)set_levels(net, base, scale, log2);
    m->base.tensors = spin_value_get(state_of(encoding), "_parameters");
    SPIN_TRY(spin_model_floats(&m->base, "params", 1, shape, NULL, &values));
    for (int l = 0; l < net->n_levels; l++) {
        net->level[l].entry = values;
        values += (size_t)net->level[l].n_entries * (size_t)net->n_features;
    }
    return SPIN_OK;
}

/* Reads the bounds of the positions or of the times. */
static spin_status load_bounds(struct model *m, const struct spin_value *bounds, size_t width,
                               float *least, float *most)
{
    const int64_t shape[2] = {(int64_t)width, 2};
    float *values;

    m->base.tensors = spin_value_get(state_of(bounds), "_buffers");
    if (!spin_value_get(m->base.tensors, "_bounds"))
        m->base.tensors = spin_value_get(state_of(bounds), "_parameters");
    SPIN_TRY(spin_model_floats(&m->base, "_bounds", 2, shape, NULL, &values));
    for (size_t i = 0; i < width; i++) {
        least[i] = values[2 * i];
        most[i] = values[2 * i + 1];
        if (!(most[i] > least[i]))
            return spin_malformed(
                "the bounds of the velocity network are %g to %g, expected the second to be larger",
                (double)least[i], (double)most[i]);
    }
    return SPIN_OK;
}

static spin_status load_network(struct model *m, const struct spin_value *net)
{
    SPIN_TRY(load_bounds(m, part_of(net, "_modules", "bounds_xyz"), 3, m->net.place[0],
                         m->net.place[1]));
    SPIN_TRY(
        load_bounds(m, part_of(net, "_modules", "bounds_t"), 1, &m->net.time[0], &m->net.time[1]));
    SPIN_TRY(load_grid(m, part_of(net, "_modules", "enc_xyz")));
    SPIN_TRY(
        load_layers(m, part_of(net, "_modules", "hyper_mlp"), m->net.n_levels * m->net.n_features));
    m->has_network = true;
    return SPIN_OK;
}

/* ---- Velocities ------------------------------------------------------------------------------ */

/* Writes the features of a point of the unit cube, `step` floats apart. Points outside the cube are
 * not clamped: negative cell indices wrap around, as in tiny-cuda-nn. */
static void encode_point(const struct velocity_net *net, const float unit[3], float *out,
                         size_t step)
{
    for (int l = 0; l < net->n_levels; l++) {
        const struct level *level = &net->level[l];
        uint32_t cell[3], r = level->resolution;
        float part[3];

        for (int c = 0; c < 3; c++) {
            float at = fmaf(level->scale, unit[c], 0.5f), whole = floorf(at);

            part[c] = at - whole;
            cell[c] = fabsf(whole) < 0x1p62f ? (uint32_t)(int64_t)whole : 0;
        }
        for (int f = 0; f < net->n_features; f++)
            out[(size_t)(l * net->n_features + f) * step] = 0;
        for (uint32_t k = 0; k < 8; k++) {
            uint32_t p[3], index;
            float weight = 1;

            for (uint32_t c = 0; c < 3; c++) {
                p[c] = cell[c] + (k >> c & 1);
                weight *= k >> c & 1 ? part[c] : 1 - part[c];
            }
            index = r <= 1625 && (uint64_t)r * r * r <= level->n_entries
                        ? p[0] + p[1] * r + p[2] * r * r
                        : p[0] ^ p[1] * 2654435761u ^ p[2] * 805459861u;
            index %= level->n_entries;
            for (int f = 0; f < net->n_features; f++)
                out[(size_t)(l * net->n_features + f) * step] +=
                    weight * level->entry[index * (uint32_t)net->n_features + (uint32_t)f];
        }
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct model *m = context;
    const struct velocity_net *net = &m->net;
    size_t widest = spin_mlp_widest(&net->layers);
    const float *out;

    for (int p = 0; p < MLP_BLOCK; p++) { /* pad the last block with its last point */
        size_t row = m->rows[first + (size_t)(p < n ? p : n - 1)];
        float unit[3];

        for (int c = 0; c < 3; c++)
            unit[c] = (m->base.splats_4d.centres[3 * row + (size_t)c] - net->place[0][c]) /
                      (net->place[1][c] - net->place[0][c]);
        encode_point(net, unit, scratch + p, MLP_BLOCK);
    }
    out = spin_mlp_run(&net->layers, scratch, scratch + widest, scratch + 2 * widest);
    for (int p = 0; p < n; p++)
        for (int c = 0; c < 3; c++)
            m->velocities[3 * (first + (size_t)p) + (size_t)c] = out[c * MLP_BLOCK + p];
}

/* Computes the biases of all layers for one time, in the first thread's scratch memory. */
static void set_biases(struct model *m, double time)
{
    struct velocity_net *net = &m->net;
    float unit = ((float)time - net->time[0]) / (net->time[1] - net->time[0]);

    for (int i = 0; i < net->layers.n; i++) {
        float *in = m->base.team.scratch;
        float *a = in + MLP_BLOCK, *b = a + spin_mlp_widest(&net->bias[i]);
        const float *out;

        for (int p = 0; p < MLP_BLOCK; p++)
            in[p] = unit;
        out = spin_mlp_run(&net->bias[i], in, a, b);
        for (int k = 0; k < net->layers.layer[i].n_out; k++)
            net->biases[i][k] = out[k * MLP_BLOCK];
    }
}

/* Starts the threads, each with scratch memory for three blocks of activations of the widest layer
 * of all networks. */
static spin_status start_team(struct model *m)
{
    size_t widest = spin_mlp_widest(&m->net.layers);

    for (int i = 0; i < m->net.layers.n; i++) {
        size_t other = spin_mlp_widest(&m->net.bias[i]);

        widest = other > widest ? other : widest;
    }
    return spin_mlp_team_create(3 * widest, &m->base.team);
}

static spin_status frame(void *self, int index, double time, unsigned columns,
                         struct spin_splats *out)
{
    struct model *m = self;
    const struct spin_splats_4d *s = &m->base.splats_4d;
    size_t n = 0;

    if (!isfinite(time))
        return spin_misuse("'%s': time %g is not finite", m->base.path, time);
    SPIN_TRY(spin_model_slice(self, index, time, columns, out));
    if (!m->has_network || !(columns & SPIN_COL_MEANS))
        return SPIN_OK;
    for (size_t i = 0; i < s->n; i++)
        if (spin_splats_4d_is_visible(s, i, time))
            m->rows[n++] = i;
    set_biases(m, time);
    spin_mlp_team_run(&m->base.team, n, evaluate, m);
    for (size_t k = 0; k < n; k++)
        for (size_t c = 0; c < 3; c++)
            out->means[3 * k + c] =
                (float)((double)out->means[3 * k + c] +
                        (time - (double)s->times[m->rows[k]]) * (double)m->velocities[3 * k + c]);
    return spin_model_check(m->base.path, time, SPIN_COL_MEANS, out);
}

static spin_status frame_splats_4d(void *self, const struct spin_splats_4d **out)
{
    const struct model *m = self;

    *out = m->has_network ? NULL : &m->base.splats_4d;
    return SPIN_OK;
}

/* ---- The splats ------------------------------------------------------------------------------ */

/* Converts the values of the file. Widths of windows become standard deviations in seconds: the
 * file contains their logarithms or, if max_duration is finite, the logits of their ratios to
 * max_duration / 6. Gates become shares of the opacity: the file contains their logits, divided
 * by 20. */
static void convert_rows(struct model *m)
{
    struct spin_splats_4d *s = &m->base.splats_4d;

    for (size_t i = 0; i < s->n; i++) {
        double raw = (double)s->sigmas[i];
        double sigma =
            isinf(m->max_duration) ? exp(raw) : m->max_duration / 6 * spin_sigmoid_of(raw);

        s->sigmas[i] = sigma > (double)SPIN_FOREVER ? SPIN_FOREVER : (float)sigma;
        s->gates[i] = (float)spin_sigmoid_of(20 * (double)s->gates[i]);
        s->logit_opacities[i] = spin_finite_logit(s->logit_opacities[i]);
    }
}

static spin_status load_sh(struct model *m, size_t n, int *degree, struct spin_array sh[2])
{
    const int64_t dc[3] = {(int64_t)n, 1, 3}, rest[3] = {(int64_t)n, -1, 3};

    SPIN_TRY(bind_tensor(m, "sh_0", 3, dc, &sh[0]));
    SPIN_TRY(bind_tensor(m, "sh_n", 3, rest, &sh[1]));
    *degree = 0;
    while (*degree < 3 && (uint64_t)((*degree + 1) * (*degree + 1)) < sh[1].shape[1] + 1)
        ++*degree;
    if ((uint64_t)((*degree + 1) * (*degree + 1)) != sh[1].shape[1] + 1)
        return spin_malformed("parameter 'sh_n' has %llu rows, expected 0, 3, 8 or 15",
                              (unsigned long long)sh[1].shape[1]);
    return SPIN_OK;
}

static spin_status load_columns(struct model *m, size_t n, bool moves)
{
    struct spin_splats_4d *s = &m->base.splats_4d;
    const struct {
        const char *name;
        int width;
        float *out;
    } columns[] = {{"means", 3, s->centres},        {"scales", 3, s->log_scales},
                   {"quats", 4, s->quats},          {"opacities", 1, s->logit_opacities},
                   {"times", 1, s->times},          {"durations", 1, s->sigmas},
                   {"marginal_gates", 1, s->gates}, {"velocity_model", 3, s->paths}};

    for (size_t i = 0; i < sizeof columns / sizeof *columns - !moves; i++) {
        const int64_t shape[2] = {(int64_t)n, columns[i].width};
        struct spin_array t;

        SPIN_TRY(bind_tensor(m, columns[i].name, 2, shape, &t));
        spin_array_to_f32(&t, 0, t.count, columns[i].out);
    }
    return SPIN_OK;
}

static spin_status check_object(struct model *m)
{
    const struct spin_value *root = m->base.torch.root;
    const struct spin_value *duration = spin_value_get(state_of(root), "max_duration");

    if (!root || root->kind != SPIN_VALUE_OBJECT || strcmp(root->text, CLASS) != 0 ||
        !state_of(root))
        return spin_unsupported("the file contains %s, expected an object of the class %s",
                                spin_chkpnt_kind(root), CLASS);
    if (!duration || (duration->kind != SPIN_VALUE_FLOAT && duration->kind != SPIN_VALUE_INT))
        return spin_malformed("'max_duration' is %s, expected a number",
                              spin_chkpnt_kind(duration));
    m->max_duration = duration->number;
    if (!(m->max_duration > 0))
        return spin_malformed("'max_duration' is %g, expected a number above 0", m->max_duration);
    return SPIN_OK;
}

static spin_status read_checkpoint(struct spin_model *base)
{
    struct model *m = (struct model *)base;
    const struct spin_value *net = part_of(base->torch.root, "_modules", "velocity_model");
    const int64_t shape[2] = {-1, 3};
    struct spin_array means, sh[2];
    struct spin_splats_4d *s = &base->splats_4d;
    size_t n, width;
    int degree;

    SPIN_TRY(check_object(m));
    SPIN_TRY(bind_tensor(m, "means", 2, shape, &means));
    n = (size_t)means.shape[0];
    if (n == 0 || n > INT_MAX)
        return spin_malformed("parameter 'means' has %zu Gaussians, expected 1 to %d", n, INT_MAX);
    SPIN_TRY(load_sh(m, n, &degree, sh));
    SPIN_TRY(spin_splats_4d_reserve(s, n, net ? 0 : 1, degree, SPIN_4D_GATES));
    s->least_opacity = LEAST_OPACITY;
    SPIN_TRY(load_columns(m, n, !net));
    width = 3 * (size_t)((degree + 1) * (degree + 1));
    for (size_t i = 0; i < n; i++) {
        spin_array_to_f32(&sh[0], 3 * i, 3, s->sh + width * i);
        if (width > 3)
            spin_array_to_f32(&sh[1], (width - 3) * i, width - 3, s->sh + width * i + 3);
    }
    convert_rows(m);
    return net ? load_network(m, net) : SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status find_file(struct spin_model *m, const char *path, const char **config)
{
    const char *folder = path;

    if (!spin_path_is_folder(path)) {
        SPIN_TRY(spin_model_text(m, &m->path, "%s", path));
        SPIN_TRY(spin_model_folder(m, &folder, path));
    } else {
        SPIN_TRY(spin_model_find(m, &m->path, path, "separated.pt"));
        if (!m->path)
            SPIN_TRY(spin_model_find(m, &m->path, path, "gaussians.pt"));
        if (!m->path)
            return spin_not_found("'%s' contains neither separated.pt nor gaussians.pt", path);
    }
    if (strcmp(spin_path_name(m->path), "init.pt") == 0)
        spin_note(m->sequence, "init.pt contains the Gaussians before training");
    return spin_model_find(m, config, folder, "config.toml");
}

static spin_status describe(struct model *m, const char *asked)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    const struct spin_splats_4d *s = &m->base.splats_4d;
    struct clip_times times;

    if (asked || m->fps == 0) {
        SPIN_TRY(spin_run_config_times(NULL, asked, s->times, s->n, 1, 1, &times));
        sequence->time_first = times.first;
        sequence->time_last = times.last;
        if (!asked)
            spin_note(sequence,
                      "there is no config.toml beside the file: the clip is guessed to last from "
                      "%g to %g seconds; set this range with --time-range",
                      times.first, times.last);
    } else {
        sequence->fps = m->fps;
        sequence->n_clip_frames = (int)(m->stop - m->first);
        sequence->time_first = m->first / m->fps;
        sequence->time_last = (m->stop - 1) / m->fps;
    }
    snprintf(sequence->variant, sizeof sequence->variant,
             "FreeTimeGS++, %zu Gaussians, SH degree %d, %s", s->n, s->sh_degree,
             m->has_network ? "velocity network" : "explicit velocities");
    if (m->has_network)
        spin_note(sequence, "the hash grid is evaluated in single precision, whereas the method "
                            "rounds its values to half precision");
    return SPIN_OK;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    const char *config;

    SPIN_TRY(find_file(&m->base, path, &config));
    if (config)
        SPIN_TRY(read_config(m, config));
    SPIN_TRY(spin_model_torch(&m->base, m->base.path, read_checkpoint));
    SPIN_TRY(spin_fail_reading(spin_model_finish_4d(&m->base), m->base.path));
    SPIN_TRY(describe(m, spin_model_option(&m->base, "time-range")));
    if (!m->has_network)
        return SPIN_OK;
    SPIN_TRY(spin_model_alloc(&m->base, m->base.splats_4d.n, sizeof *m->rows, (void **)&m->rows));
    SPIN_TRY(spin_model_alloc(&m->base, m->base.splats_4d.n, 3 * sizeof *m->velocities,
                              (void **)&m->velocities));
    return start_team(m);
}

static const struct spin_plugin_option options[] = {
    {"time-range", "A,B", "the clip's first and last time (default: as in config.toml)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(freetimegspp, struct model, open_model, spin_model_close,
                    .summary = "FreeTimeGS++: gaussians.pt or separated.pt, or the run's folder",
                    .upstream = "suNoeul/FreeTimeGSPlusPlus 8005d2f", .options = options,
                    .probe = probe, .frame = frame, .splats_4d = frame_splats_4d)
