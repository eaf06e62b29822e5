/* LPIPS: tables of the layers of both networks, reading of weights, convolution, and the distance
 * between two images with the features f and g:
 *
 *     x = (2 image - 1 - shift) / scale
 *     f_s = features after the ReLU of stage s, divided at each pixel by their norm over channels
 *     distance = sum over s of the mean over pixels of  sum_c lin_s[c] (f_s[c] - g_s[c])^2 */
#include "eval/lpips.h"

#include "base/base.h"
#include "base/product.h"
#include "io/file.h"
#include "io/torch.h"

enum { MOST_LAYERS = 13, STAGES = SPIN_LPIPS_STAGES, BLOCK = 64 };

/* Mean and standard deviation of ImageNet for images in -1..1, as in the class ScalingLayer of the
 * package lpips. */
static const float shift[3] = {-0.030f, -0.088f, -0.188f};
static const float scale[3] = {0.458f, 0.448f, 0.450f};
/* Added to the norm of the features of a pixel, as in the package lpips. */
static const double smallest_length = 1e-10;

/* A convolution followed by ReLU. */
struct layer {
    int place; /* N in torchvision's features.N */
    int n_in, n_out, kernel, stride, pad;
    int pool;   /* window size of a max pooling with stride 2 before the convolution; 0: none */
    bool stage; /* true if the output of this layer contributes to the distance */
};

static const struct layer vgg[] = {
    {0, 3, 64, 3, 1, 1, 0, false},     {2, 64, 64, 3, 1, 1, 0, true},
    {5, 64, 128, 3, 1, 1, 2, false},   {7, 128, 128, 3, 1, 1, 0, true},
    {10, 128, 256, 3, 1, 1, 2, false}, {12, 256, 256, 3, 1, 1, 0, false},
    {14, 256, 256, 3, 1, 1, 0, true},  {17, 256, 512, 3, 1, 1, 2, false},
    {19, 512, 512, 3, 1, 1, 0, false}, {21, 512, 512, 3, 1, 1, 0, true},
    {24, 512, 512, 3, 1, 1, 2, false}, {26, 512, 512, 3, 1, 1, 0, false},
    {28, 512, 512, 3, 1, 1, 0, true},
};
static const struct layer alex[] = {
    {0, 3, 64, 11, 4, 2, 0, true},    {3, 64, 192, 5, 1, 2, 3, true},
    {6, 192, 384, 3, 1, 1, 3, true},  {8, 384, 256, 3, 1, 1, 0, true},
    {10, 256, 256, 3, 1, 1, 0, true},
};
static const struct network {
    const char *name;
    const struct layer *layer;
    int n_layers;
} networks[SPIN_N_LPIPS] = {{"VGG", vgg, 13}, {"AlexNet", alex, 5}};

struct spin_lpips {
    int network;
    struct spin_pool *pool;
    float *weights[MOST_LAYERS], *bias[MOST_LAYERS];
    float *lin[STAGES];
    /* Buffers for images of one size. */
    int width, height;
    int out_width[MOST_LAYERS], out_height[MOST_LAYERS];
    float *feature[2][STAGES]; /* features of the two images after each stage */
    float *work[2], *padded;   /* input and output of a layer; input padded with zeros */
    float *scratch;            /* [threads][SCRATCH] */
};

/* ---- Weights --------------------------------------------------------------------------------- */

static bool has_shape(struct spin_torch *t, const char *key, int n_dims, const int64_t *shape)
{
    const struct spin_value *v = spin_value_get(t->root, key);

    return v && v->kind == SPIN_VALUE_TENSOR && spin_array_has_shape(&v->tensor, n_dims, shape);
}

/* Returns the network whose convolutions a file contains; -1: unknown. */
static int backbone_of(struct spin_torch *t)
{
    for (int k = 0; k < SPIN_N_LPIPS; k++) {
        const struct layer *first = &networks[k].layer[0];
        int64_t shape[4] = {first->n_out, first->n_in, first->kernel, first->kernel};

        if (has_shape(t, "features.0.weight", 4, shape) &&
            (k != SPIN_LPIPS_VGG || spin_value_get(t->root, "features.28.weight")))
            return k;
    }
    return -1;
}

/* Returns the number of channels in the output of stage s. */
static int stage_channels(int network, int s)
{
    const struct layer *layer = networks[network].layer;

    for (; s > 0 || !layer->stage; layer++)
        s -= layer->stage;
    return layer->n_out;
}

/* Returns the network whose linear heads a file contains; -1: unknown. */
static int lin_of(struct spin_torch *t)
{
    for (int k = 0; k < SPIN_N_LPIPS; k++) {
        int64_t shape[4] = {1, stage_channels(k, 1), 1, 1};
        int64_t last[4] = {1, stage_channels(k, 4), 1, 1};

        if (has_shape(t, "lin1.model.1.weight", 4, shape) &&
            has_shape(t, "lin4.model.1.weight", 4, last))
            return k;
    }
    return -1;
}

static spin_status read_tensor(struct spin_torch *t, const char *key, int n_dims,
                               const int64_t *shape, float **out)
{
    struct spin_array info;
    const struct spin_value *v = spin_value_get(t->root, key);

    if (!v)
        return spin_malformed("the tensor '%s' is missing", key);
    return spin_torch_floats(t, v, key, n_dims, shape, &info, out);
}

static spin_status read_backbone(struct spin_torch *t, struct spin_lpips *l)
{
    const struct network *net;
    char key[64];

    l->network = backbone_of(t);
    if (l->network < 0)
        return spin_fail(SPIN_E_NOT_RECOGNISED,
                         "the file does not contain the weights of torchvision's vgg16 or alexnet "
                         "(tensors features.N.weight)");
    net = &networks[l->network];
    for (int i = 0; i < net->n_layers; i++) {
        const struct layer *a = &net->layer[i];
        int64_t shape[4] = {a->n_out, a->n_in, a->kernel, a->kernel};

        snprintf(key, sizeof key, "features.%d.weight", a->place);
        SPIN_TRY(read_tensor(t, key, 4, shape, &l->weights[i]));
        snprintf(key, sizeof key, "features.%d.bias", a->place);
        SPIN_TRY(read_tensor(t, key, 1, shape, &l->bias[i]));
    }
    return SPIN_OK;
}

static spin_status read_lin(struct spin_torch *t, struct spin_lpips *l)
{
    int network = lin_of(t);
    char key[64];

    if (network < 0)
        return spin_fail(SPIN_E_NOT_RECOGNISED,
                         "the file does not contain the linear heads of LPIPS for VGG or AlexNet "
                         "(tensors lin0.model.1.weight to lin4.model.1.weight)");
    if (network != l->network)
        return spin_misuse(
            "the linear heads are for %s, but the network is %s; use files of the same network",
            networks[network].name, networks[l->network].name);
    for (int s = 0; s < STAGES; s++) {
        int64_t shape[4] = {1, stage_channels(network, s), 1, 1};

        snprintf(key, sizeof key, "lin%d.model.1.weight", s);
        SPIN_TRY(read_tensor(t, key, 4, shape, &l->lin[s]));
    }
    return SPIN_OK;
}

static spin_status read_file(const char *path, struct spin_lpips *l,
                             spin_status (*read)(struct spin_torch *, struct spin_lpips *))
{
    struct spin_torch t;
    spin_status status = spin_torch_open(path, &t);

    if (status == SPIN_OK) {
        status = read(&t, l);
        spin_torch_close(&t);
        if (status != SPIN_OK)
            status = spin_fail_context(status, "cannot read '%s'", path);
    }
    return status;
}

spin_status spin_lpips_open(const char *backbone, const char *lin, int n_threads,
                            struct spin_lpips **out)
{
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof **out, (void **)out));
    SPIN_TRY_OUT(spin_pool_create(n_threads, &(*out)->pool));
    SPIN_TRY_OUT(read_file(backbone, *out, read_backbone));
    SPIN_TRY_OUT(read_file(lin, *out, read_lin));
    return SPIN_OK;
out:
    spin_lpips_close(*out);
    *out = NULL;
    return status;
}

int spin_lpips_network(const struct spin_lpips *l) { return l->network; }

/* ---- Finding weights in a folder ------------------------------------------------------------- */

struct found {
    char *backbone[SPIN_N_LPIPS], *lin[SPIN_N_LPIPS];
};

/* Stores the path of a file in *found if it contains weights. Ignores files that cannot be read. */
static spin_status detect_weights(const char *path, struct found *found)
{
    struct spin_torch t;
    int backbone, lin;

    if (spin_torch_open(path, &t) != SPIN_OK)
        return SPIN_OK;
    backbone = backbone_of(&t);
    lin = lin_of(&t);
    spin_torch_close(&t);
    if (backbone >= 0 && !found->backbone[backbone])
        return spin_strdup(path, &found->backbone[backbone]);
    if (lin >= 0 && !found->lin[lin])
        return spin_strdup(path, &found->lin[lin]);
    return SPIN_OK;
}

static spin_status search_folder(const char *folder, int depth, struct found *found)
{
    char **names = NULL;
    size_t n = 0;
    spin_status status = spin_folder_list(folder, &names, &n);

    for (size_t i = 0; status == SPIN_OK && i < n; i++) {
        SPIN_FREED char *path = NULL;

        status = spin_path_join(folder, names[i], &path);
        if (status == SPIN_OK && depth > 0 && spin_path_is_folder(path))
            status = search_folder(path, depth - 1, found);
        else if (status == SPIN_OK &&
                 (spin_text_ends(names[i], ".pth") || spin_text_ends(names[i], ".pt")))
            status = detect_weights(path, found);
    }
    spin_folder_list_free(names);
    return status;
}

spin_status spin_lpips_find(const char *folder, int n_threads, struct spin_lpips **out)
{
    struct found found = {{NULL}, {NULL}};
    spin_status status;
    int n = 0;

    for (int k = 0; k < SPIN_N_LPIPS; k++)
        out[k] = NULL;
    status = search_folder(folder, 2, &found);
    for (int k = 0; status == SPIN_OK && k < SPIN_N_LPIPS; k++) {
        if (!found.backbone[k] || !found.lin[k])
            continue;
        status = spin_lpips_open(found.backbone[k], found.lin[k], n_threads, &out[k]);
        n++;
    }
    if (status == SPIN_OK && n == 0)
        status = spin_not_found(
            "'%s' contains no LPIPS weights: put the weights of torchvision's vgg16 or alexnet "
            "there, and the linear heads of the Python package lpips for the same network",
            folder);
    for (int k = 0; k < SPIN_N_LPIPS; k++) {
        free(found.backbone[k]);
        free(found.lin[k]);
        if (status != SPIN_OK) {
            spin_lpips_close(out[k]);
            out[k] = NULL;
        }
    }
    return status;
}

/* ---- Convolution ----------------------------------------------------------------------------- */

/* A convolution is computed as the matrix product out [n_out][pixels] = weights [n_out][terms] x
 * patches [terms][pixels]. A term is a pair of an input channel and a position in the kernel. A
 * task computes COLUMNS output pixels, DEPTH terms at a time, so that the patches of these terms
 * remain in the cache. Each output is summed in the order of the terms, so the result does not
 * depend on the number of threads. */
enum { COLUMNS = 96, DEPTH = 256, MOST_OUT = 512, SCRATCH = (DEPTH + MOST_OUT) * COLUMNS };

struct convolution {
    const struct layer *layer;
    const float *weights, *bias, *in; /* in: [n_in][in_height][in_width], padded with zeros */
    float *out, *scratch;
    size_t in_width, in_height, out_width, plane; /* plane: number of output pixels */
};

/* Gathers the inputs of term k for the output pixels [first, first + n). */
static void gather_patches(const struct convolution *c, size_t k, size_t first, size_t n, float *to)
{
    size_t side = (size_t)c->layer->kernel, stride = (size_t)c->layer->stride;
    const float *corner =
        c->in + (k / (side * side) * c->in_height + k / side % side) * c->in_width + k % side;

    while (n > 0) {
        size_t x = first % c->out_width, run = c->out_width - x < n ? c->out_width - x : n;
        const float *from = corner + stride * (first / c->out_width * c->in_width + x);

        for (size_t i = 0; i < run; i++)
            to[i] = from[i * stride];
        to += run;
        first += run;
        n -= run;
    }
}

static void convolve_block(void *context, size_t first, size_t end)
{
    const struct convolution *c = context;
    float *patches = c->scratch + (size_t)spin_pool_worker() * SCRATCH,
          *sums = patches + DEPTH * COLUMNS;
    size_t terms = (size_t)(c->layer->n_in * c->layer->kernel * c->layer->kernel);
    size_t n = end - first, n_out = (size_t)c->layer->n_out;

    for (size_t k = 0; k < terms; k += DEPTH) {
        size_t depth = terms - k < DEPTH ? terms - k : DEPTH;

        for (size_t i = 0; i < depth; i++)
            gather_patches(c, k + i, first, n, patches + i * COLUMNS);
        spin_multiply_add((int)n_out, COLUMNS, (int)depth, c->weights + k, terms, patches,
                          k == 0 ? c->bias : NULL, k + depth == terms, sums);
    }
    for (size_t row = 0; row < n_out; row++)
        memcpy(c->out + row * c->plane + first, sums + row * COLUMNS, n * sizeof *sums);
}

/* Computes layer i and its ReLU for an input of width x height. */
static void convolve_layer(struct spin_lpips *l, int i, int width, int height, const float *in,
                           float *out)
{
    const struct layer *a = &networks[l->network].layer[i];
    size_t pad = (size_t)a->pad, w = (size_t)width, h = (size_t)height;
    struct convolution c = {.layer = a,
                            .weights = l->weights[i],
                            .bias = l->bias[i],
                            .in = l->padded,
                            .out = out,
                            .scratch = l->scratch,
                            .in_width = w + 2 * pad,
                            .in_height = h + 2 * pad,
                            .out_width = (size_t)l->out_width[i],
                            .plane = (size_t)l->out_width[i] * (size_t)l->out_height[i]};

    memset(l->padded, 0, (size_t)a->n_in * c.in_width * c.in_height * sizeof *l->padded);
    for (size_t row = 0; row < (size_t)a->n_in * h; row++)
        memcpy(l->padded + (row / h * c.in_height + pad + row % h) * c.in_width + pad, in + row * w,
               w * sizeof *in);
    spin_pool_rows(l->pool, c.plane, COLUMNS, convolve_block, &c);
}

/* ---- Buffers for images of one size ---------------------------------------------------------- */

static void drop_plan(struct spin_lpips *l)
{
    for (int k = 0; k < 2; k++) {
        for (int s = 0; s < STAGES; s++) {
            free(l->feature[k][s]);
            l->feature[k][s] = NULL;
        }
        free(l->work[k]);
        l->work[k] = NULL;
    }
    free(l->padded);
    free(l->scratch);
    l->padded = l->scratch = NULL;
    l->width = l->height = 0;
}

static int pooled_size(int n, int window) { return window ? (n - window) / 2 + 1 : n; }

static spin_status plan_layers(struct spin_lpips *l, int width, int height)
{
    const struct network *net = &networks[l->network];
    size_t most = 3 * (size_t)width * (size_t)height, most_padded = 0;
    int stage = 0;

    for (int i = 0; i < net->n_layers; i++) {
        const struct layer *a = &net->layer[i];
        int w = pooled_size(width, a->pool) + 2 * a->pad,
            h = pooled_size(height, a->pool) + 2 * a->pad;
        size_t n = (size_t)a->n_in * (size_t)w * (size_t)h;

        most_padded = n > most_padded ? n : most_padded;
        l->out_width[i] = width = (w - a->kernel) / a->stride + 1;
        l->out_height[i] = height = (h - a->kernel) / a->stride + 1;
        n = (size_t)a->n_out * (size_t)width * (size_t)height;
        most = n > most ? n : most;
        if (!a->stage)
            continue;
        for (int k = 0; k < 2; k++)
            SPIN_TRY(spin_alloc(n, sizeof(float), (void **)&l->feature[k][stage]));
        stage++;
    }
    for (int k = 0; k < 2; k++)
        SPIN_TRY(spin_alloc(most, sizeof(float), (void **)&l->work[k]));
    SPIN_TRY(spin_alloc(most_padded, sizeof(float), (void **)&l->padded));
    return spin_alloc((size_t)spin_pool_n_threads(l->pool), SCRATCH * sizeof(float),
                      (void **)&l->scratch);
}

static spin_status plan_buffers(struct spin_lpips *l, int width, int height)
{
    if (width < SPIN_LPIPS_SMALLEST || height < SPIN_LPIPS_SMALLEST)
        return spin_unsupported("LPIPS needs images of at least %d x %d pixels, but these have %d "
                                "x %d: use a larger --scale, or omit --lpips",
                                SPIN_LPIPS_SMALLEST, SPIN_LPIPS_SMALLEST, width, height);
    if (l->width == width && l->height == height)
        return SPIN_OK;
    drop_plan(l);
    SPIN_TRY(plan_layers(l, width, height));
    l->width = width;
    l->height = height;
    return SPIN_OK;
}

void spin_lpips_close(struct spin_lpips *l)
{
    if (!l)
        return;
    drop_plan(l);
    spin_pool_free(l->pool);
    for (int i = 0; i < MOST_LAYERS; i++) {
        free(l->weights[i]);
        free(l->bias[i]);
    }
    for (int s = 0; s < STAGES; s++)
        free(l->lin[s]);
    free(l);
}

/* ---- Features and their distance ------------------------------------------------------------- */

static void max_pool(int n, int width, int height, int window, const float *in, float *out)
{
    int to_width = pooled_size(width, window), to_height = pooled_size(height, window);

    for (int c = 0; c < n; c++)
        for (int y = 0; y < to_height; y++)
            for (int x = 0; x < to_width; x++) {
                const float *corner = in +
                                      ((size_t)c * (size_t)height + 2 * (size_t)y) * (size_t)width +
                                      2 * (size_t)x;
                float most = corner[0];

                for (int v = 0; v < window; v++)
                    for (int u = 0; u < window; u++)
                        most = fmaxf(most, corner[(size_t)v * (size_t)width + (size_t)u]);
                *out++ = most;
            }
}

static void run_network(struct spin_lpips *l, const float *image, float *const *feature)
{
    const struct network *net = &networks[l->network];
    size_t plane = (size_t)l->width * (size_t)l->height;
    int width = l->width, height = l->height, stage = 0;
    float *now = l->work[0], *next = l->work[1];

    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < plane; i++)
            now[c * plane + i] = (2 * image[c * plane + i] - 1 - shift[c]) / scale[c];
    for (int i = 0; i < net->n_layers; i++) {
        const struct layer *a = &net->layer[i];
        float *keep;

        if (a->pool) {
            max_pool(a->n_in, width, height, a->pool, now, next);
            width = pooled_size(width, a->pool);
            height = pooled_size(height, a->pool);
            keep = now;
            now = next;
            next = keep;
        }
        convolve_layer(l, i, width, height, now, next);
        width = l->out_width[i];
        height = l->out_height[i];
        keep = now;
        now = next;
        next = keep;
        if (a->stage)
            memcpy(feature[stage++], now,
                   (size_t)a->n_out * (size_t)width * (size_t)height * sizeof(float));
    }
}

/* Returns the distance in a stage, summed over a block of n <= BLOCK pixels. Channel c of f and g
 * begins at c * plane. */
static double block_distance(int n_channels, size_t plane, size_t n, const float *f, const float *g,
                             const float *lin)
{
    double f2[BLOCK] = {0}, g2[BLOCK] = {0}, sum = 0;

    for (int c = 0; c < n_channels; c++)
        for (size_t i = 0; i < n; i++) {
            double x = (double)f[(size_t)c * plane + i], y = (double)g[(size_t)c * plane + i];

            f2[i] += x * x;
            g2[i] += y * y;
        }
    for (size_t i = 0; i < n; i++) {
        f2[i] = 1 / (sqrt(f2[i]) + smallest_length);
        g2[i] = 1 / (sqrt(g2[i]) + smallest_length);
    }
    for (int c = 0; c < n_channels; c++) {
        double part = 0;

        for (size_t i = 0; i < n; i++) {
            double d =
                (double)f[(size_t)c * plane + i] * f2[i] - (double)g[(size_t)c * plane + i] * g2[i];

            part += d * d;
        }
        sum += part * (double)lin[c];
    }
    return sum;
}

static double stage_distance(int n_channels, size_t plane, const float *f, const float *g,
                             const float *lin)
{
    double sum = 0;

    for (size_t at = 0; at < plane; at += BLOCK)
        sum += block_distance(n_channels, plane, plane - at < BLOCK ? plane - at : BLOCK, f + at,
                              g + at, lin);
    return sum / (double)plane;
}

spin_status spin_lpips_compare(struct spin_lpips *l, int width, int height, const float *image,
                               const float *truth, double *distance,
                               double stages[SPIN_LPIPS_STAGES])
{
    const struct network *net = &networks[l->network];
    int stage = 0;

    *distance = NAN;
    SPIN_TRY(plan_buffers(l, width, height));
    run_network(l, image, l->feature[0]);
    run_network(l, truth, l->feature[1]);
    *distance = 0;
    for (int i = 0; i < net->n_layers; i++) {
        size_t plane = (size_t)l->out_width[i] * (size_t)l->out_height[i];
        double d;

        if (!net->layer[i].stage)
            continue;
        d = stage_distance(net->layer[i].n_out, plane, l->feature[0][stage], l->feature[1][stage],
                           l->lin[stage]);
        if (stages)
            stages[stage] = d;
        *distance += d;
        stage++;
    }
    return SPIN_OK;
}
