/* The network of Deformable 3D Gaussians: loading, and its inputs. */
#include "importers/lib/deform_net.h"

#include "math/rounded.h"

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
