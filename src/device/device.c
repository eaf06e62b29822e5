/* Opens a device by name, and provides a device that only counts the memory that a plan needs. No
 * other file lists the devices. */
#include "device/device.h"

#include "base/base.h"
#include "base/shim.h"
#include "device/cuda/shim.h"

extern const struct spin_device_ops spin_cpu_base_ops;
extern const struct spin_device_ops spin_cpu_v3_ops;
extern const struct spin_device_ops spin_cpu_v4_ops;

struct path {
    const char *name, *title;
    const struct spin_device_ops *op;
    int (*here)(void); /* returns whether this machine supports the path */
};

static int always(void) { return 1; }

#if defined(SPIN_CPU_v3) || defined(SPIN_CPU_v4)
static int has_v3(void)
{
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
           __builtin_cpu_supports("bmi2");
}
#endif

#ifdef SPIN_CPU_v4
static int has_v4(void)
{
    return has_v3() && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
           __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
           __builtin_cpu_supports("avx512cd");
}
#endif

/* The SIMD paths, from the fastest to the slowest. */
static const struct path paths[] = {
#ifdef SPIN_CPU_v4
    {"v4", "avx-512", &spin_cpu_v4_ops, has_v4},
#endif
#ifdef SPIN_CPU_v3
    {"v3", "avx2", &spin_cpu_v3_ops, has_v3},
#endif
    {"base", "portable", &spin_cpu_base_ops, always},
};

static spin_status open_cpu(int n_threads, struct spin_device *out)
{
    const char *wanted = getenv("SPIN_CPU");

    if (wanted && !*wanted)
        wanted = NULL;
    for (size_t i = 0; i < sizeof paths / sizeof paths[0]; i++) {
        if (wanted && strcmp(wanted, paths[i].name) != 0)
            continue;
        if (!paths[i].here()) {
            if (wanted)
                return spin_fail(SPIN_E_DEVICE, "cannot use SPIN_CPU=%s: this processor has no %s",
                                 wanted, paths[i].title);
            continue;
        }
        out->op = paths[i].op;
        out->path = paths[i].name;
        snprintf(out->description, sizeof out->description, "cpu (%s", paths[i].title);
        return out->op->open(out, n_threads);
    }
    return spin_misuse("unknown SPIN_CPU '%s': use base, v3 or v4", wanted ? wanted : "");
}

/* Opens the CUDA device. It is a shared object that is loaded at run time, so that one build serves
 * machines with and without a GPU. */
static spin_status open_cuda(int n_threads, struct spin_device *out)
{
    static const struct spin_cuda_shim *shim;
    static struct spin_shim where = {
        .file = "spin-cuda.so",
        .override = "SPIN_CUDA_SHIM",
        .symbol = SPIN_CUDA_SHIM_SYMBOL,
        .lacking = "no CUDA device: the kernel library",
        .debian = "nvidia-cuda-toolkit of non-free, or NVIDIA's own",
    };

    where.abi = SPIN_CUDA_SHIM_ABI;
    SPIN_TRY(spin_shim_load(&where, (const void **)&shim));
    shim->use(spin_fail);
    out->op = shim->op;
    return out->op->open(out, n_threads);
}

/* Opens the GPU if it works, otherwise the CPU. If SPIN_CPU is set, the GPU is not tried. Logs the
 * choice and its reason once: at level 0 if a GPU is present but unusable, otherwise at level 1. */
static spin_status open_auto(int n_threads, struct spin_device *out)
{
    static bool said;
    const char *path = getenv("SPIN_CPU");
    char why[300] = "SPIN_CPU is set";
    bool idle = false;

    if (!path || !*path) {
        if (open_cuda(n_threads, out) == SPIN_OK) {
            if (!said)
                spin_log(1, "device auto: %s", out->description);
            said = true;
            return SPIN_OK;
        }
        snprintf(why, sizeof why, "%s", spin_last_error());
        idle = out->description[0] != '\0';
        memset(out, 0, sizeof *out);
    }
    if (!said)
        spin_log(idle ? 0 : 1, "device auto: using the CPU: %s", why);
    said = true;
    return open_cpu(n_threads, out);
}

spin_status spin_device_open(const char *name, int n_threads, struct spin_device *out)
{
    spin_status status = SPIN_E_USAGE;

    memset(out, 0, sizeof *out);
    if (!name || strcmp(name, "auto") == 0)
        return open_auto(n_threads, out);
    if (strcmp(name, "cpu") == 0)
        return open_cpu(n_threads, out);
    if (strcmp(name, "cuda") != 0)
        return spin_fail(status, "unknown device '%s': use auto, cpu or cuda", name);
    status = open_cuda(n_threads, out);
    if (status != SPIN_OK)
        memset(out, 0, sizeof *out);
    return status;
}

void spin_device_close(struct spin_device *d)
{
    if (d && d->op)
        d->op->close(d);
    if (d)
        memset(d, 0, sizeof *d);
}

/* ---- A device that only counts --------------------------------------------------------------- */

static spin_status count_reserve(struct spin_device *d, size_t bytes, void SPIN_DEV **out)
{
    struct spin_counting_device *c = d->state;

    c->bytes += bytes;
    *out = (void SPIN_DEV *)c; /* callers only compare it with NULL */
    return SPIN_OK;
}

static void count_release(struct spin_device *d, void SPIN_DEV *block) { (void)d, (void)block; }

static void count_zero(struct spin_device *d, void SPIN_DEV *block, size_t bytes)
{
    (void)d, (void)block, (void)bytes;
}

static void count_upload(struct spin_device *d, void SPIN_DEV *to, const void *host, size_t bytes)
{
    (void)d, (void)to, (void)host, (void)bytes;
}

void spin_device_count(struct spin_counting_device *c, const struct spin_device *as)
{
    *c = (struct spin_counting_device){
        .device = *as,
        .op = {.name = as->op->name,
               .reserve = count_reserve,
               .release = count_release,
               .zero = count_zero,
               .upload = count_upload,
               .lazy_adam_enable = as->op->lazy_adam_enable,
               .lazy_adam_close = as->op->lazy_adam_close},
    };
    c->device.op = &c->op;
    c->device.state = c;
}

struct spin_camera_f32 spin_camera_f32_from(const struct spin_camera *camera)
{
    struct spin_camera_f32 cam;

    memset(&cam, 0, sizeof cam);
    cam.width = camera->width;
    cam.height = camera->height;
    cam.tiles_x = (camera->width + SPIN_TILE - 1) / SPIN_TILE;
    cam.tiles_y = (camera->height + SPIN_TILE - 1) / SPIN_TILE;
    cam.fx = (float)camera->fx;
    cam.fy = (float)camera->fy;
    cam.cx = (float)camera->cx;
    cam.cy = (float)camera->cy;
    for (int i = 0; i < 3; i++) {
        double centre = 0;

        for (int j = 0; j < 3; j++) {
            cam.r[i * 3 + j] = (float)camera->w2c[i * 4 + j];
            centre -= camera->w2c[j * 4 + i] * camera->w2c[j * 4 + 3];
        }
        cam.t[i] = (float)camera->w2c[i * 4 + 3];
        cam.centre[i] = (float)centre;
    }
    cam.limit_x = (float)(1.3 * camera->width / (2 * camera->fx));
    cam.limit_y = (float)(1.3 * camera->height / (2 * camera->fy));
    cam.z_near = (float)spin_camera_near(camera);
    return cam;
}
