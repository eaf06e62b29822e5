/* Frames and checkpoints of methods with deformed clouds. */
#include "importers/lib/deform.h"

#include "math/covariance.h"
#include "math/quat.h"
#include "math/rounded.h"

spin_status spin_deform_frame(struct spin_model *m, double time, unsigned columns, unsigned moved,
                              mlp_block_fn fn, struct spin_splats *out)
{
    const struct spin_splats *from = &m->canonical;
    struct deform_job job = {m, from, out, columns, (float)time};

    if (!isfinite(time))
        return spin_misuse("'%s': time %g is not finite", m->path, time);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, from->n, columns, from->sh_degree));
    for (int c = 0; c < SPIN_MODEL_COLUMNS; c++) {
        size_t width;
        const float *values = spin_model_values(from, c, &width);

        if (columns & ~moved & 1u << c)
            memcpy(spin_model_values(out, c, &width), values, from->n * width * sizeof *values);
    }
    for (size_t i = 0; columns & ~moved & SPIN_COL_QUATS && i < from->n; i++)
        spin_quat_normalise(out->quats + 4 * i);
    if (columns & moved)
        spin_mlp_team_run(&m->team, from->n, fn, &job);
    return spin_model_check(m->path, time, columns, out);
}

void spin_deform_shape(const struct deform_job *job, size_t first, int n, const float *d_scale,
                       const float *d_quat)
{
    for (size_t p = 0, row = first; p < (size_t)n; p++, row++) {
        const float *quat = job->from->quats + 4 * row;
        double norm = spin_quat_norm(quat), scale[3], q[4], cov6[6];
        double log_scales[3] = {NAN, NAN, NAN}, unit[4] = {NAN, NAN, NAN, NAN};

        for (size_t i = 0; i < 4; i++)
            q[i] = (norm > 0 ? quat[i] / norm : 0) + d_quat[i * MLP_BLOCK + p];
        for (size_t i = 0; i < 3; i++)
            scale[i] = exp(job->from->log_scales[3 * row + i]) + d_scale[i * MLP_BLOCK + p];
        spin_covariance_unnormalised(scale, q, cov6);
        spin_covariance_split(cov6, log_scales, unit);
        for (size_t i = 0; job->columns & SPIN_COL_LOG_SCALES && i < 3; i++)
            job->out->log_scales[3 * row + i] = (float)log_scales[i];
        for (size_t i = 0; job->columns & SPIN_COL_QUATS && i < 4; i++)
            job->out->quats[4 * row + i] = (float)unit[i];
    }
}

/* ---- Checkpoints ----------------------------------------------------------------------------- */

/* Refuses a model whose last cloud and last network belong to different checkpoints: the user must
 * choose a checkpoint. */
static spin_status check_newest(struct spin_model *m, const char *path, const char *clouds,
                                const char *deforms, const char *found)
{
    const char *cloud, *deform;

    SPIN_TRY(spin_model_choose(m, NULL, clouds, "point_cloud.ply", NULL, NULL, &cloud));
    SPIN_TRY(spin_model_choose(m, NULL, deforms, "deform.pth", NULL, NULL, &deform));
    if (!cloud)
        return spin_not_found("'%s' has no iteration_<N> with point_cloud.ply", clouds);
    if (!deform)
        return spin_not_found("'%s' has no iteration_<N> with deform.pth", deforms);
    if (strcmp(cloud, deform) == 0)
        return SPIN_OK;
    return spin_malformed("'%s': the last cloud is from %s, but the last network is from %s: %s%s",
                          path, cloud, deform,
                          found ? "choose a checkpoint with --iteration; the last complete one is "
                                : "no iteration has both; the folders may come from two runs, or "
                                  "may not be copied completely",
                          found ? found : "");
}

spin_status spin_deform_find(struct spin_model *m, const char *path, bool together,
                             struct deform_save *out)
{
    const char *wanted = spin_model_option(m, "iteration"), *clouds, *deforms;

    out->model = path;
    if (!spin_path_is_folder(path)) {
        const char *whole, *folder;

        SPIN_TRY(spin_model_absolute(m, &whole, path));
        SPIN_TRY(spin_model_folder(m, &folder, whole));
        SPIN_TRY(spin_model_folder(m, &deforms, folder));
        SPIN_TRY(spin_model_folder(m, &out->model, deforms));
        if (strcmp(spin_path_name(whole), "deform.pth") != 0 ||
            strncmp(spin_path_name(folder), "iteration_", 10) != 0)
            return spin_misuse(
                "'%s' is neither the model's folder nor its deform/iteration_<N>/deform.pth", path);
        wanted = spin_path_name(folder) + 10;
    }
    SPIN_TRY(spin_model_join(m, &clouds, out->model, "point_cloud"));
    SPIN_TRY(spin_model_join(m, &deforms, out->model, "deform"));
    if (!spin_path_is_folder(clouds) || !spin_path_is_folder(deforms))
        return spin_not_found("'%s' has no folder '%s'", out->model,
                              spin_path_is_folder(clouds) ? "deform" : "point_cloud");
    SPIN_TRY(
        spin_model_choose(m, wanted, clouds, "point_cloud.ply", deforms, "deform.pth", &out->name));
    if (!wanted && together)
        SPIN_TRY(check_newest(m, out->model, clouds, deforms, out->name));
    if (!out->name)
        return spin_not_found("'%s' has no iteration_%s with both a cloud and a network",
                              out->model, wanted ? wanted : "<N>");
    SPIN_TRY(spin_model_join(m, &out->cloud, clouds, "%s/point_cloud.ply", out->name));
    return spin_model_join(m, &out->network, deforms, "%s/deform.pth", out->name);
}

/* ---- The network ----------------------------------------------------------------------------- */

enum { MAX_LAYERS = 32, MAX_FREQUENCIES = 64 };
/* Number of frequencies in the encoding of positions if there is no time network. The tensors do
 * not determine this number then, so it is the default of Deformable 3D Gaussians. */
enum { OWN_FREQUENCIES = 10 };

/* Loads linear.0, whose weights [W, I] define the width W and the number of inputs I, and the
 * layers after it. The weights of these layers are [W, W], except for one layer with a skip
 * connection from the input, whose weights are [W, I + W]. */
static spin_status load_layers(struct spin_model *m, struct deform_net *d)
{
    const struct spin_value *root = m->tensors;
    struct mlp_net *net = &d->linear;
    size_t n = strlen(m->prefix);

    for (int i = 0; i == 0 || spin_model_get(m, "linear.%d.weight", i); i++) {
        const struct mlp_layer *l = &net->layer[i];
        char name[32];

        if (i == MAX_LAYERS)
            return spin_unsupported("the network has more than %d layers 'linear.*'", MAX_LAYERS);
        snprintf(name, sizeof name, "linear.%d", i);
        SPIN_TRY(spin_model_layer(m, name, -1, i ? d->width : -1, MLP_RELU, net));
        if (i == 0) {
            d->n_in = l->n_in;
            d->width = l->n_out;
        } else if (l->n_in == d->n_in + d->width && net->again == 0) {
            net->again = i;
        } else if (l->n_in != d->width) {
            return spin_malformed("tensor '%s.weight' has shape [%d, %d], expected [%d, %d]%s",
                                  name, l->n_out, l->n_in, d->width, d->width,
                                  net->again ? ", since an earlier layer has the skip connection"
                                             : "");
        }
    }
    for (size_t i = 0; i < root->n; i++) {
        const char *key = spin_value_text(root->item[2 * i]);

        if (key && strncmp(key, m->prefix, n) == 0 && strncmp(key + n, "linear.", 7) == 0 &&
            strtol(key + n + 7, NULL, 10) >= net->n)
            return spin_malformed("there is a tensor '%.80s', but no 'linear.%d.weight'", key,
                                  net->n);
    }
    if (net->again == 0)
        return spin_malformed(
            "no layer 'linear.*' has a skip connection from the input: layers are missing");
    return SPIN_OK;
}

/* Counts the inputs of the first layer that encode the position, and the inputs that depend on
 * time. The outputs of a time network are the inputs that depend on time. Without a time network,
 * the position is assumed to be encoded with OWN_FREQUENCIES frequencies. */
static spin_status count_inputs(struct deform_net *d)
{
    d->n_time = d->time.n ? spin_mlp_n_out(&d->time) : d->n_in - 3 - 6 * OWN_FREQUENCIES;
    d->n_position = d->n_in - d->n_time;
    if (d->n_time < 1)
        return spin_malformed("tensor 'linear.0.weight' has %d inputs, expected more than %d, the "
                              "inputs for the position",
                              d->n_in, d->n_position);
    if (d->n_position < 3 || d->n_position % 6 != 3 || d->n_position > 3 + 6 * MAX_FREQUENCIES)
        return spin_malformed("tensor 'linear.0.weight' has %d inputs, and the time network %d "
                              "outputs, which leaves %d inputs for the position, expected 3 + "
                              "6 per frequency, for at most %d frequencies",
                              d->n_in, d->n_time, d->n_position, MAX_FREQUENCIES);
    return SPIN_OK;
}

/* Loads the time network, if there is one. Without a time network, the first layer receives the
 * encoding of the time itself. */
static spin_status load_time(struct spin_model *m, struct deform_net *d)
{
    bool has = spin_model_get(m, "timenet.0.weight") || spin_model_get(m, "timenet.2.weight");
    int inputs;

    if (has) {
        SPIN_TRY(spin_model_layer(m, "timenet.0", -1, -1, MLP_RELU, &d->time));
        SPIN_TRY(
            spin_model_layer(m, "timenet.2", spin_mlp_n_out(&d->time), -1, MLP_PLAIN, &d->time));
    }
    SPIN_TRY(count_inputs(d));
    inputs = has ? d->time.layer[0].n_in : d->n_time;
    d->frequencies = (inputs - 1) / 2;
    if (inputs % 2 == 0 || d->frequencies > MAX_FREQUENCIES)
        return spin_malformed(
            "the encoding of the time has %d values, expected 1 + 2 per frequency, for "
            "at most %d frequencies",
            inputs, MAX_FREQUENCIES);
    return SPIN_OK;
}

spin_status spin_deform_net_load(struct spin_model *m, struct deform_net *net)
{
    SPIN_TRY(load_layers(m, net));
    SPIN_TRY(load_time(m, net));
    return spin_model_alloc(m,
                            (size_t)net->n_time + (size_t)(1 + 2 * net->frequencies) * MLP_BLOCK +
                                2 * spin_mlp_widest(&net->time),
                            sizeof *net->inputs, (void **)&net->inputs);
}

/* Writes the encoding of v: the channel v, then the channels sin(2^k v) and cos(2^k v) for k = 0,
 * 1, ..., `frequencies` - 1. The encodings of `width` values are interleaved, so the channels of
 * one value are `width` * `step` floats apart. */
static void encode(float v, int frequencies, int width, size_t step, float *out)
{
    out[0] = v;
    for (int k = 0; k < frequencies; k++) {
        float angle = ldexpf(v, k);

        out[(size_t)(width * (2 * k + 1)) * step] = spin_rounded_sin(angle);
        out[(size_t)(width * (2 * k + 2)) * step] = spin_rounded_cos(angle);
    }
}

/* A time network evaluates a whole block of points, but only the result of the first point is used,
 * since all points have the same time. */
void spin_deform_net_time(struct deform_net *d, float time)
{
    float *in = d->inputs + d->n_time, *middle = in + (1 + 2 * d->frequencies) * MLP_BLOCK;
    const float *last;

    if (d->time.n == 0) {
        encode(time, d->frequencies, 1, 1, d->inputs);
        return;
    }
    encode(time, d->frequencies, 1, MLP_BLOCK, in);
    last = spin_mlp_run(&d->time, in, middle, middle + spin_mlp_widest(&d->time));
    for (int i = 0; i < d->n_time; i++)
        d->inputs[i] = last[i * MLP_BLOCK];
}

void spin_deform_net_encode(const struct deform_net *net, const float *const at[MLP_BLOCK],
                            float *in)
{
    for (int p = 0; p < MLP_BLOCK; p++) {
        for (int c = 0; c < 3; c++)
            encode(at[p][c], (net->n_position - 3) / 6, 3, MLP_BLOCK, in + c * MLP_BLOCK + p);
        for (int i = 0; i < net->n_time; i++)
            in[(net->n_position + i) * MLP_BLOCK + p] = net->inputs[i];
    }
}
