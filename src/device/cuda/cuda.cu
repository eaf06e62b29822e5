/* The CUDA device: its memory, errors and clocks, and its table of verbs. */
#include "device/cuda/cuda.h"

#include <stdio.h>
#include <stdlib.h>

#include "device/cuda/shim.h"

static spin_fail_fn *fail;

static void set_fail(spin_fail_fn *how) { fail = how; }

spin_status cuda_fail(spin_status status, const char *what, const char *why)
{
    return fail(status, "%s: %s", what, why);
}

spin_status cuda_no_memory(void) { return fail(SPIN_E_MEMORY, "out of memory"); }

/* Records an error, which the next wait() returns, unless `why` is NULL. Only the first error is
 * kept, since later errors follow from it. */
static void note_error(struct spin_device *d, spin_status status, const char *why)
{
    struct cuda *cuda = cuda_of(d);

    if (!why || cuda->failed != SPIN_OK)
        return;
    cuda->failed = status;
    snprintf(cuda->why, sizeof cuda->why, "%s: %s", cuda->gpu.name, why);
}

/* Returns the number of the GPU to try first. Each rank on a machine has its own GPU, whose number
 * is the local rank. Open MPI, MPICH and Slurm provide the local rank in the environment. */
static int gpu_number(void)
{
    static const char *const name[] = {"OMPI_COMM_WORLD_LOCAL_RANK", "MPI_LOCALRANKID",
                                       "SLURM_LOCALID"};

    for (int i = 0; i < 3; i++) {
        const char *value = getenv(name[i]);

        if (value && *value)
            return abs(atoi(value));
    }
    return 0;
}

/* Returns whether the GPU computes three tf32 products faster than one fp32 product. Consumer GPUs
 * (compute capability 8.6, 8.9 and 12) do not, since their tf32 and fp32 rates are equal. For
 * comparisons, SPIN_CUDA_MLP=fp32 or SPIN_CUDA_MLP=tf32 overrides the choice. */
static bool prefers_tensor(const struct gpu *gpu)
{
    const char *wanted = getenv("SPIN_CUDA_MLP");
    bool games = (gpu->major == 8 && (gpu->minor == 6 || gpu->minor == 9)) || gpu->major == 12;

    if (wanted && *wanted)
        return strcmp(wanted, "fp32") != 0;
    return gpu->major >= 8 && !games;
}

static spin_status open_cuda(struct spin_device *d, int n_threads)
{
    struct cuda *cuda = (struct cuda *)calloc(1, sizeof *cuda);
    char why[200] = "";
    int n, first = gpu_number(), at = 0;
    const char *sync = getenv("SPIN_CUDA_SYNC");

    (void)n_threads;
    if (!cuda)
        return cuda_no_memory();
    n = gpu_count(why, sizeof why);
    while (at < n && !gpu_open(&cuda->gpu, (first + at) % n, why, sizeof why))
        at++;
    if (at >= n) {
        free(cuda);
        snprintf(d->description, sizeof d->description, "%s", n ? "cuda" : "");
        return fail(SPIN_E_DEVICE, "no CUDA device: %s", why);
    }
    cuda->sync = sync && strcmp(sync, "1") == 0;
    cuda->tensor = prefers_tensor(&cuda->gpu);
    d->state = cuda;
    d->path = "cuda";
    d->frames_at_once = SPIN_MAX_FRAMES;
    d->views_at_once = SPIN_MAX_VIEWS;
    snprintf(d->description, sizeof d->description, "cuda (%s)", cuda->gpu.name);
    return SPIN_OK;
}

static void close_cuda(struct spin_device *d)
{
    struct cuda *cuda = cuda_of(d);

    if (!cuda)
        return;
    gpu_wait(&cuda->gpu);
    for (int i = 0; i < CUDA_SCRATCHES; i++)
        if (cuda->scratch[i].block)
            gpu_free(&cuda->gpu, cuda->scratch[i].block);
    for (int op = 0; op < SPIN_N_OPS; op++)
        for (int i = 0; i < CUDA_MARKS; i++) {
            gpu_mark_free(cuda->clock[op].mark[i][0]);
            gpu_mark_free(cuda->clock[op].mark[i][1]);
        }
    gpu_close(&cuda->gpu);
    free(cuda);
    d->state = NULL;
}

/* ---- Memory ---------------------------------------------------------------------------------- */

static spin_status wait(struct spin_device *d)
{
    struct cuda *cuda = cuda_of(d);
    spin_status status;

    note_error(d, SPIN_E_DEVICE, gpu_wait(&cuda->gpu));
    status = cuda->failed;
    cuda->failed = SPIN_OK;
    return status == SPIN_OK ? SPIN_OK : fail(status, "the CUDA device failed: %s", cuda->why);
}

static spin_status reserve(struct spin_device *d, size_t bytes, void SPIN_DEV **out)
{
    const char *why = NULL;
    void *block = gpu_alloc(gpu_of(d), bytes, &why);

    *out = block;
    note_error(d, SPIN_E_DEVICE, why);
    if (why)
        return wait(d);
    if (!block)
        return fail(SPIN_E_MEMORY,
                    "out of memory on the CUDA device (%s): %zu bytes requested, %zu free",
                    gpu_of(d)->name, bytes, gpu_memory_free(gpu_of(d)));
    gpu_zero(gpu_of(d), block, bytes);
    return SPIN_OK;
}

static void release(struct spin_device *d, void SPIN_DEV *block)
{
    if (block)
        gpu_free(gpu_of(d), block);
}

static void zero(struct spin_device *d, void SPIN_DEV *block, size_t bytes)
{
    cuda_clocked clocked(d, SPIN_OP_CLEAR);
    if (bytes)
        gpu_zero(gpu_of(d), block, bytes);
}

static void upload(struct spin_device *d, void SPIN_DEV *to, const void *host, size_t bytes)
{
    if (bytes)
        gpu_copy_in(gpu_of(d), to, host, bytes);
}

static spin_status download(struct spin_device *d, void *host, const void SPIN_DEV *from,
                            size_t bytes)
{
    if (bytes)
        gpu_copy_out(gpu_of(d), host, from, bytes);
    return wait(d);
}

/* Reserves page-locked memory, or ordinary memory if page-locked memory is not available. */
static spin_status host_reserve(struct spin_device *d, size_t bytes, struct spin_host_memory *out)
{
    size_t room = (bytes + 63) / 64 * 64 + 64;

    *out = spin_host_memory{gpu_host_alloc(gpu_of(d), room), bytes, true};
    if (out->at)
        return SPIN_OK;
    *out = spin_host_memory{aligned_alloc(64, room), bytes, false};
    return out->at ? SPIN_OK : cuda_no_memory();
}

static void host_release(struct spin_device *d, struct spin_host_memory *memory)
{
    if (memory->pinned)
        gpu_host_free(gpu_of(d), memory->at);
    else
        free(memory->at);
    *memory = spin_host_memory{};
}

static void *host_view(struct spin_device *, void SPIN_DEV *) { return NULL; }

/* Returns 15/16 of the free memory. The rest is kept for the scratch memory of the verbs. */
static size_t memory_available(struct spin_device *d)
{
    size_t left = gpu_memory_free(gpu_of(d));

    return left - left / 16;
}

void *cuda_scratch(struct spin_device *d, enum cuda_scratch_of which, size_t bytes)
{
    struct cuda *cuda = cuda_of(d);
    auto *s = &cuda->scratch[which];
    const char *failed = NULL;
    char why[96];

    if (s->block && bytes <= s->bytes)
        return s->block;
    if (s->block)
        gpu_free(&cuda->gpu, s->block);
    /* with an eighth to spare, so that the buffer is not enlarged in every iteration */
    s->bytes = bytes + bytes / 8;
    s->block = gpu_alloc(&cuda->gpu, s->bytes, &failed);
    if (!s->block && !failed) {
        s->bytes = bytes;
        s->block = gpu_alloc(&cuda->gpu, s->bytes, &failed);
    }
    note_error(d, SPIN_E_DEVICE, failed);
    if (!s->block) {
        snprintf(why, sizeof why, "out of memory: an operation needs %zu bytes of scratch memory",
                 s->bytes);
        note_error(d, SPIN_E_MEMORY, why);
    }
    return s->block;
}

/* ---- Clocks ---------------------------------------------------------------------------------- */

/* Adds the time between the two events of each pair to the clock. Called only when the time is
 * requested or all pairs are in use, since it waits for the events. */
static void add_marks(struct cuda_clock *clock)
{
    for (int i = 0; i < clock->n; i++)
        clock->seconds += gpu_seconds(clock->mark[i][0], clock->mark[i][1]);
    clock->n = 0;
}

static void record_mark(struct spin_device *d, int op, int end)
{
    struct cuda_clock *clock = &cuda_of(d)->clock[op];
    void **at = &clock->mark[clock->n][end];

    if (!*at)
        *at = gpu_mark_new(gpu_of(d));
    gpu_mark(gpu_of(d), *at);
}

cuda_clocked::cuda_clocked(struct spin_device *device, int number) : d(device), op(number)
{
    if (cuda_of(d)->clock[op].n == CUDA_MARKS)
        add_marks(&cuda_of(d)->clock[op]);
    record_mark(d, op, 0);
}

cuda_clocked::~cuda_clocked()
{
    static const char *const name[] = SPIN_OP_NAMES;
    const char *failed;
    char why[160];

    record_mark(d, op, 1);
    cuda_of(d)->clock[op].n++;
    failed = cuda_of(d)->sync ? gpu_wait(gpu_of(d)) : gpu_error(gpu_of(d));
    if (failed && cuda_of(d)->sync) {
        snprintf(why, sizeof why, "%s (in %s)", failed, name[op]);
        failed = why;
    }
    note_error(d, SPIN_E_DEVICE, failed);
}

static double clock_of(struct spin_device *d, int op)
{
    struct cuda_clock *clock = &cuda_of(d)->clock[op];
    double seconds;

    add_marks(clock);
    seconds = clock->seconds;
    clock->seconds = 0;
    return seconds;
}

spin_status cuda_pairs_fit(uint64_t pairs, uint64_t before)
{
    if (pairs > SPIN_MAX_PAIRS)
        return fail(
            SPIN_E_MEMORY,
            "cannot render a view: %llu pairs of splats and tiles exceed the limit of %llu: "
            "render a smaller image, or remove splats that are very large",
            (unsigned long long)pairs, (unsigned long long)SPIN_MAX_PAIRS);
    if (before + pairs > UINT32_MAX)
        return fail(SPIN_E_MEMORY,
                    "cannot render this many views at once: %llu pairs of splats and tiles exceed "
                    "2^32: render fewer views at once",
                    (unsigned long long)(before + pairs));
    return SPIN_OK;
}

/* ---- Sort and scan --------------------------------------------------------------------------- */

bool cuda_scan(struct spin_device *d, const uint64_t *in, uint64_t *out, size_t n)
{
    size_t bytes = gpu_scan_bytes(n);
    void *temp = cuda_scratch(d, CUDA_SCRATCH_SORT, bytes);

    if (temp)
        gpu_scan(gpu_of(d), temp, bytes, in, out, n);
    return temp != NULL;
}

bool cuda_sort(struct spin_device *d, const uint32_t *key, uint32_t *key_out, const uint32_t *value,
               uint32_t *value_out, size_t n, int bits)
{
    size_t bytes = gpu_sort_bytes(n);
    void *temp = cuda_scratch(d, CUDA_SCRATCH_SORT, bytes);

    if (temp)
        gpu_sort(gpu_of(d), temp, bytes, key, key_out, value, value_out, n, bits);
    return temp != NULL;
}

/* ---- The table of verbs ---------------------------------------------------------------------- */

#define LISTED(verb) .verb = cuda_##verb,
static const struct spin_device_ops ops = {
    .name = "cuda",
    .open = open_cuda,
    .close = close_cuda,
    .reserve = reserve,
    .release = release,
    .zero = zero,
    .upload = upload,
    .download = download,
    .wait = wait,
    .host_reserve = host_reserve,
    .host_release = host_release,
    .host_view = host_view,
    .copy_rows = cuda_copy_rows,
    .memory_available = memory_available,
    .clock = clock_of,
    SPIN_DEVICE_VERBS(LISTED) /* LISTED appends the comma */
};

extern "C" {
extern SPIN_VISIBLE const struct spin_cuda_shim spin_cuda_shim_table;
const struct spin_cuda_shim spin_cuda_shim_table = {SPIN_CUDA_SHIM_ABI, &ops, set_fail};
}
