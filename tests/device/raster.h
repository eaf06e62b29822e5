/* Shared by the tests of project, tile and blend: a view with all its arrays, loaded from a fixture
 * or random, and iteration over the SIMD paths of the CPU. */
#ifndef SPIN_TESTS_DEVICE_RASTER_H
#define SPIN_TESTS_DEVICE_RASTER_H

#include "tests/device/verbs.h"

struct view {
    char name[32];
    struct spin_camera_f32 cam;
    float background[3];
    int n, degree;
    float *pos_w, *attr;
    struct spin_splat2d *splat2d;
    struct spin_splat2d_grad *d_splat2d;
    struct host_tiles tiles;
    float *image, *final_transmittance, *d_image; /* [3][h][w], [h][w], [3][h][w] */
    int32_t *last_contributor;
    float *d_attr, *d_pos_w;
};

static inline size_t view_pixels(const struct view *v)
{
    return (size_t)v->cam.width * (size_t)v->cam.height;
}

static inline void *allocate(size_t n, size_t size)
{
    void *block = calloc(n ? n : 1, size);
    if (!block) {
        printf("Bail out! out of memory\n");
        exit(1);
    }
    return block;
}

static inline void view_reserve(struct view *v, const struct spin_camera *camera, int n)
{
    size_t pixels;

    v->cam = spin_camera_f32_from(camera);
    v->n = n;
    pixels = view_pixels(v);
    v->pos_w = allocate((size_t)n * 3, sizeof(float));
    v->attr = allocate((size_t)n * SPIN_ATTR, sizeof(float));
    v->splat2d = allocate((size_t)n, sizeof *v->splat2d);
    v->d_splat2d = allocate((size_t)n, sizeof *v->d_splat2d);
    v->tiles.start = allocate((size_t)(v->cam.tiles_x * v->cam.tiles_y) + 1, sizeof(uint32_t));
    v->image = allocate(pixels * 3, sizeof(float));
    v->d_image = allocate(pixels * 3, sizeof(float));
    v->final_transmittance = allocate(pixels, sizeof(float));
    v->last_contributor = allocate(pixels, sizeof(int32_t));
    v->d_attr = allocate((size_t)n * SPIN_ATTR, sizeof(float));
    v->d_pos_w = allocate((size_t)n * 3, sizeof(float));
}

static inline void view_free(struct view *v)
{
    free(v->pos_w);
    free(v->attr);
    free(v->splat2d);
    free(v->d_splat2d);
    free(v->tiles.start);
    free(v->tiles.intersections);
    free(v->image);
    free(v->d_image);
    free(v->final_transmittance);
    free(v->last_contributor);
    free(v->d_attr);
    free(v->d_pos_w);
    memset(v, 0, sizeof *v);
}

static inline void view_tiles(struct spin_device *d, struct view *v)
{
    on_tiles(d, &v->cam, (size_t)v->n, v->splat2d, &v->tiles);
}

static inline void view_forward(struct spin_device *d, struct view *v)
{
    on_project(d, &v->cam, (size_t)v->n, v->pos_w, v->attr, v->degree, v->splat2d);
    view_tiles(d, v);
    on_blend(d, &v->cam, (size_t)v->n, v->splat2d, &v->tiles, v->background, v->image,
             v->final_transmittance, v->last_contributor);
}

/* Backward pass from d_image, after view_forward. */
static inline void view_backward(struct spin_device *d, struct view *v)
{
    memset(v->d_attr, 0, (size_t)v->n * SPIN_ATTR * sizeof(float));
    memset(v->d_pos_w, 0, (size_t)v->n * 3 * sizeof(float));
    on_blend_back(d, &v->cam, (size_t)v->n, v->splat2d, &v->tiles, v->background,
                  v->final_transmittance, v->last_contributor, v->d_image, v->d_splat2d);
    on_project_back(d, &v->cam, (size_t)v->n, v->pos_w, v->attr, v->degree, v->splat2d,
                    v->d_splat2d, v->d_attr, v->d_pos_w);
}

/* Copies n rows of `columns` floats into rows of `stride` floats, starting at column `at`. */
static inline void put_columns(float *to, int stride, int at, const float *from, int n, int columns)
{
    for (int i = 0; i < n; i++)
        memcpy(to + (size_t)i * (size_t)stride + at, from + (size_t)i * (size_t)columns,
               (size_t)columns * sizeof(float));
}

static inline float *columns_of(const float *from, int stride, int at, int n, int columns)
{
    float *out = allocate((size_t)n * (size_t)columns, sizeof(float));

    for (int i = 0; i < n; i++)
        memcpy(out + (size_t)i * (size_t)columns, from + (size_t)i * (size_t)stride + at,
               (size_t)columns * sizeof(float));
    return out;
}

static inline void view_load_column(struct view *v, struct spin_npz *npz, const char *key, int at,
                                    int columns)
{
    struct spin_array info;
    float *values = check_load_f32(npz, key, &info);

    if (values && info.count == (uint64_t)v->n * (uint64_t)columns)
        put_columns(v->attr, SPIN_ATTR, at, values, v->n, columns);
    else
        ok(0, "%s: %s has %d values a splat", v->name, key, columns);
    free(values);
}

/* Loads a render_*.npz with its upstream gradient. Returns false and prints a skipped test if it is
 * missing. */
static inline int view_load(struct view *v, struct spin_npz *npz, const char *name)
{
    char path[64];
    const char *file;
    struct spin_camera camera = {0};
    struct spin_array info;
    double *size, *intr, *r, *t;
    float *values;

    memset(v, 0, sizeof *v);
    snprintf(v->name, sizeof v->name, "%s", name);
    snprintf(path, sizeof path, "core/%s.npz", name);
    file = check_fixture(path);
    if (!file) {
        skip(name, "the fixture is not here");
        return 0;
    }
    if (spin_npz_open(file, npz) != SPIN_OK) {
        ok(0, "%s opens: %s", path, spin_last_error());
        return 0;
    }
    size = check_load(npz, "cam_size", NULL);
    intr = check_load(npz, "cam_intr", NULL);
    r = check_load(npz, "cam_R", NULL);
    t = check_load(npz, "cam_t", NULL);
    camera.width = (int)size[0];
    camera.height = (int)size[1];
    camera.fx = intr[0];
    camera.fy = intr[1];
    camera.cx = intr[2];
    camera.cy = intr[3];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            camera.w2c[4 * i + j] = r[3 * i + j];
        camera.w2c[4 * i + 3] = t[i];
    }
    free(size);
    free(intr);
    free(r);
    free(t);
    values = check_load_f32(npz, "means", &info);
    view_reserve(v, &camera, (int)info.shape[0]);
    v->degree = (int)check_setting(path + 5, "sh_degree");
    memcpy(v->pos_w, values, (size_t)info.count * sizeof(float));
    free(values);
    view_load_column(v, npz, "scales", SPIN_ATTR_SCALE, 3);
    view_load_column(v, npz, "quats", SPIN_ATTR_ROTATION, 4);
    view_load_column(v, npz, "sh", SPIN_ATTR_SH, 48);
    view_load_column(v, npz, "opacity", SPIN_ATTR_OPACITY, 1);
    values = check_load_f32(npz, "bg", &info);
    memcpy(v->background, values, sizeof v->background);
    free(values);
    values = check_load_f32(npz, "v_image", &info);
    memcpy(v->d_image, values, 3 * view_pixels(v) * sizeof(float));
    free(values);
    return 1;
}

/* A small random generator with the same results on every platform. */
static inline float random_f(uint64_t *state)
{
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return (float)(*state >> 40) / 16777216.0f;
}

static inline float random_between(uint64_t *state, float low, float high)
{
    return low + (high - low) * random_f(state);
}

static inline void random_quaternion(uint64_t *state, float *q)
{
    float sum = 0;

    for (int k = 0; k < 4; k++) {
        q[k] = random_between(state, -1, 1);
        sum += q[k] * q[k];
    }
    for (int k = 0; k < 4; k++)
        q[k] /= sqrtf(sum);
}

static inline struct spin_camera camera_of(int width, int height, double focal)
{
    struct spin_camera camera = {0};

    camera.width = width;
    camera.height = height;
    camera.fx = camera.fy = focal;
    camera.cx = width / 2.0;
    camera.cy = height / 2.0;
    camera.w2c[0] = camera.w2c[5] = camera.w2c[10] = 1;
    return camera;
}

/* n splats of about `size_px` pixels that fill the image, at depths 2 to 6. */
static inline void view_random(struct view *v, const struct spin_camera *camera, int n,
                               float size_px, uint64_t seed)
{
    uint64_t state = seed * 2654435761u + 1;

    memset(v, 0, sizeof *v);
    snprintf(v->name, sizeof v->name, "random");
    view_reserve(v, camera, n);
    v->degree = 3;
    for (int i = 0; i < n; i++) {
        float *p = v->pos_w + 3 * i, *a = v->attr + (size_t)SPIN_ATTR * (size_t)i;
        float z = random_between(&state, 2, 6), unit = z / v->cam.fx;
        p[0] = random_between(&state, -0.55f, 0.55f) * (float)v->cam.width * unit;
        p[1] = random_between(&state, -0.55f, 0.55f) * (float)v->cam.height * unit;
        p[2] = z;
        for (int k = 0; k < 3; k++)
            a[SPIN_ATTR_SCALE + k] = size_px * unit * random_between(&state, 0.3f, 1.7f);
        random_quaternion(&state, a + SPIN_ATTR_ROTATION);
        for (int k = 0; k < 48; k++)
            a[SPIN_ATTR_SH + k] = random_between(&state, -1, 1) / (k < 3 ? 1.0f : 8.0f);
        a[SPIN_ATTR_OPACITY] = random_between(&state, 0.05f, 0.95f);
    }
    for (size_t i = 0; i < 3 * view_pixels(v); i++)
        v->d_image[i] = random_between(&state, -1, 1);
    for (int c = 0; c < 3; c++)
        v->background[c] = random_f(&state);
}

/* Opens the CPU with this SIMD path ("base", "v3", "v4"); returns NULL and prints a skipped test if
 * it is not supported. */
static inline struct spin_device *device_of_path(const char *path, int n_threads)
{
    struct spin_device d;

    if (!check_device_is_cpu()) /* other devices have a single path */
        return strcmp(path, "base") == 0 ? check_device(n_threads) : NULL;
    setenv("SPIN_CPU", path, 1);
    if (spin_device_open("cpu", n_threads, &d) != SPIN_OK) {
        skip(path, spin_last_error());
        return NULL;
    }
    spin_device_close(&d);
    return check_device(n_threads);
}

static const char *const cpu_paths[] = {"base", "v3", "v4"};
enum { CPU_PATHS = 3 };

#endif
