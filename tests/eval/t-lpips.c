/* LPIPS compared with an independent implementation (tests/tools/lpips-reference.py) with random
 * weights, which this test writes as torch checkpoints; finding the files; errors.
 * K: eval lpips */
#include "eval/lpips.h"

#include "spin_run.h"
#include "tests/importers/models.h"

/* The same function as in the script. */
static void noise(uint32_t stream, size_t n, float *out)
{
    for (size_t i = 0; i < n; i++) {
        uint32_t h = (uint32_t)i * 2654435761u + stream * 40503u;

        h ^= h >> 15;
        h *= 2246822519u;
        h ^= h >> 13;
        h *= 3266489917u;
        h ^= h >> 16;
        out[i] = (float)(h >> 8) / 16777216.0f;
    }
}

static const int vgg[13][3] = {{0, 3, 64},     {2, 64, 64},    {5, 64, 128},   {7, 128, 128},
                               {10, 128, 256}, {12, 256, 256}, {14, 256, 256}, {17, 256, 512},
                               {19, 512, 512}, {21, 512, 512}, {24, 512, 512}, {26, 512, 512},
                               {28, 512, 512}};
static const int alex[5][3] = {
    {0, 3, 64}, {3, 64, 192}, {6, 192, 384}, {8, 384, 256}, {10, 256, 256}};
static const int vgg_stage[5] = {64, 128, 256, 512, 512}, alex_stage[5] = {64, 192, 384, 256, 256};

static struct pth pth;

static void make_backbone(uint32_t net, int n, const int (*layer)[3], const char *path)
{
    for (int i = 0; i < n; i++) {
        uint64_t side = net == 0 ? 3 : i == 0 ? 11 : i == 1 ? 5 : 3;
        uint64_t shape[4] = {(uint64_t)layer[i][2], (uint64_t)layer[i][1], side, side};
        float size = (float)(2 * sqrt(6.0 / (double)(shape[1] * side * side)));
        uint32_t stream = 1000 * net + 2 * (uint32_t)layer[i][0];
        struct pth_tensor *t;
        char name[64];

        snprintf(name, sizeof name, "features.%d.weight", layer[i][0]);
        t = pth_put(&pth, name, 4, shape);
        noise(stream, t->count, t->values);
        for (uint64_t k = 0; k < t->count; k++)
            t->values[k] = (t->values[k] - 0.5f) * size;
        snprintf(name, sizeof name, "features.%d.bias", layer[i][0]);
        t = pth_put(&pth, name, 1, shape);
        noise(stream + 1, t->count, t->values);
        for (uint64_t k = 0; k < t->count; k++)
            t->values[k] = (t->values[k] - 0.5f) * 0.2f;
    }
    pth_save(&pth, path);
    pth_free(&pth);
}

static void make_lin(uint32_t net, const int *channels, int n, const char *path)
{
    for (int s = 0; s < n; s++) {
        uint64_t shape[4] = {1, (uint64_t)channels[s], 1, 1};
        struct pth_tensor *t;
        char name[64];

        snprintf(name, sizeof name, "lin%d.model.1.weight", s);
        t = pth_put(&pth, name, 4, shape);
        noise(1000 * net + 900 + (uint32_t)s, t->count, t->values);
    }
    pth_save(&pth, path);
    pth_free(&pth);
}

static double number(const spin_json *j, const char *key)
{
    double v = NAN;

    spin_json_number(spin_json_get(j, key), &v);
    return v;
}

static void check_network(struct spin_lpips *l, const spin_json *want, const char *name, int width,
                          int height)
{
    size_t n = 3 * (size_t)width * (size_t)height;
    float *first = malloc(n * sizeof *first), *second = malloc(n * sizeof *second);
    const spin_json *expected = spin_json_get(want, name);
    double distance, stages[SPIN_LPIPS_STAGES], same, back;
    char text[80];

    noise(5000, n, first);
    noise(5001, n, second);
    for (size_t i = 0; i < n; i++)
        second[i] = 0.75f * first[i] + 0.25f * second[i];
    ok(spin_lpips_compare(l, width, height, first, second, &distance, stages) == SPIN_OK,
       "%s: compares", name);
    /* Single precision through 13 layers: errors of 2e-5 were observed on AVX-512. */
    near(distance, number(expected, "distance"), 1e-4 * number(expected, "distance"),
         "the distance of the reference");
    for (int s = 0; s < SPIN_LPIPS_STAGES; s++) {
        double v = NAN;

        spin_json_number(spin_json_at(spin_json_get(expected, "stages"), (size_t)s), &v);
        snprintf(text, sizeof text, "%s: stage %d of it", name, s);
        near(stages[s], v, 2e-4 * v, text);
    }
    ok(spin_lpips_compare(l, width, height, first, first, &same, NULL) == SPIN_OK && same == 0,
       "%s: a picture is at no distance from itself", name);
    ok(spin_lpips_compare(l, width - 9, height - 5, first, second, &same, NULL) == SPIN_OK &&
           spin_lpips_compare(l, width, height, second, first, &back, NULL) == SPIN_OK &&
           fabs(back - distance) < 1e-9,
       "%s: another size between, and the order does not matter", name);
    ok(spin_lpips_compare(l, 31, 200, first, second, &same, NULL) == SPIN_E_UNSUPPORTED,
       "%s: too small: %s", name, spin_last_error());
    free(first);
    free(second);
}

/* l has two threads. */
static void check_threads(struct spin_lpips *l, const char *backbone, const char *lin)
{
    static float first[3 * 70 * 50], second[3 * 70 * 50];
    struct spin_lpips *one = NULL;
    double a, b;

    noise(5000, 3 * 70 * 50, first);
    noise(5001, 3 * 70 * 50, second);
    ok(spin_lpips_open(backbone, lin, 1, &one) == SPIN_OK &&
           spin_lpips_compare(one, 70, 50, first, second, &a, NULL) == SPIN_OK &&
           spin_lpips_compare(l, 70, 50, first, second, &b, NULL) == SPIN_OK && a == b,
       "the same distance with any number of threads");
    spin_lpips_close(one);
}

static void check_refusals(const char *vgg_path, const char *vgg_lin, const char *alex_lin)
{
    struct spin_lpips *l = NULL, *both[SPIN_N_LPIPS];
    const char *folder = path_in(check_folder(), "other"), *path = path_in(folder, "lin.pth");

    spin_folder_make(folder);
    ok(spin_lpips_open(vgg_path, alex_lin, 1, &l) == SPIN_E_USAGE, "heads of the other network: %s",
       spin_last_error());
    ok(spin_lpips_open(vgg_lin, vgg_lin, 1, &l) == SPIN_E_NOT_RECOGNISED,
       "heads as the network: %s", spin_last_error());
    ok(spin_lpips_open(vgg_path, vgg_path, 1, &l) == SPIN_E_NOT_RECOGNISED,
       "the network as heads: %s", spin_last_error());
    ok(spin_lpips_open("no/such.pth", vgg_lin, 1, &l) != SPIN_OK && !l, "not there: %s",
       spin_last_error());
    ok(spin_lpips_open(check_truncated(vgg_path, 100000), vgg_lin, 1, &l) != SPIN_OK && !l,
       "cut short: %s", spin_last_error());
    make_lin(0, vgg_stage, 5, path);
    ok(spin_lpips_find(folder, 1, both) == SPIN_E_NOT_FOUND && !both[0] && !both[1],
       "half of it in a folder: %s", spin_last_error());
    make_lin(0, alex_stage, 2, path); /* lin4 is missing */
    ok(spin_lpips_open(vgg_path, path, 1, &l) != SPIN_OK && !l, "heads missing: %s",
       spin_last_error());
}

TAP_MAIN
{
    const char *fixture = check_fixture("lpips/expected.json");
    const char *folder = check_folder(), *below = path_in(folder, "v0.1");
    const char *vgg_path = path_in(folder, "vgg16-1.pth"), *vgg_lin = path_in(below, "vgg.pth");
    const char *alex_path = path_in(folder, "alexnet-1.pth"),
               *alex_lin = path_in(below, "alex.pth");
    struct spin_lpips *both[SPIN_N_LPIPS];
    spin_json *want = NULL;

    if (!fixture || spin_json_load(fixture, &want) != SPIN_OK) {
        skip("LPIPS", "no fixture lpips/expected.json");
        return;
    }
    spin_folder_make(below);
    make_backbone(0, 13, vgg, vgg_path);
    make_backbone(1, 5, alex, alex_path);
    make_lin(0, vgg_stage, 5, vgg_lin);
    make_lin(1, alex_stage, 5, alex_lin);
    ok(spin_lpips_find(folder, 2, both) == SPIN_OK && both[0] && both[1] &&
           spin_lpips_network(both[0]) == SPIN_LPIPS_VGG &&
           spin_lpips_network(both[1]) == SPIN_LPIPS_ALEX,
       "finds both networks in a folder");
    check_network(both[0], want, "vgg", (int)number(want, "width"), (int)number(want, "height"));
    check_network(both[1], want, "alex", (int)number(want, "width"), (int)number(want, "height"));
    check_threads(both[1], alex_path, alex_lin);
    spin_lpips_close(both[0]);
    spin_lpips_close(both[1]);
    check_refusals(vgg_path, vgg_lin, alex_lin);
    spin_json_free(want);
}
