/* The CPU device: its memory and its table of verbs. A verb is complete when its function returns.
 * Batches have one frame and one view, which makes the best use of the caches. */
#include "device/cpu/cpu.h"

#include "base/base.h"

static spin_status open_cpu(struct spin_device *d, int n_threads)
{
    spin_status status;
    size_t used = strlen(d->description);

    SPIN_TRY(spin_alloc(1, sizeof(struct spin_cpu), &d->state));
    d->frames_at_once = d->views_at_once = 1;
    d->is_host = true;
    status = spin_pool_create(n_threads, &((struct spin_cpu *)d->state)->pool);
    if (status != SPIN_OK) {
        free(d->state);
        d->state = NULL;
        return status;
    }
    n_threads = spin_pool_n_threads(spin_cpu_pool(d));
    snprintf(d->description + used, sizeof d->description - used, ", %d thread%s)", n_threads,
             n_threads == 1 ? "" : "s");
    return SPIN_OK;
}

static void close_cpu(struct spin_device *d)
{
    struct spin_cpu *cpu = d->state;

    if (!cpu)
        return;
    spin_pool_free(cpu->pool);
    for (int i = 0; i < SPIN_SCRATCHES; i++)
        spin_scratch_free(&cpu->scratch[i]);
    free(cpu);
    d->state = NULL;
}

/* ---- Memory ---------------------------------------------------------------------------------- */

static spin_status reserve(struct spin_device *d, size_t bytes, void **out)
{
    (void)d;
    return spin_pages_reserve(bytes, out);
}

static void release(struct spin_device *d, void *block)
{
    (void)d;
    spin_pages_release(block);
}

static void zero(struct spin_device *d, void *block, size_t bytes)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_CLEAR);

    memset(block, 0, bytes);
}

static void upload(struct spin_device *d, void *to, const void *host, size_t bytes)
{
    (void)d;
    if (bytes)
        memcpy(to, host, bytes);
}

static spin_status wait(struct spin_device *d)
{
    struct spin_cpu *cpu = d->state;

    spin_status status = cpu->failed;

    if (status == SPIN_OK)
        return SPIN_OK;
    cpu->failed = SPIN_OK;
    spin_fail(status, "%s", cpu->why);
    return spin_fail_context(status, "cannot reserve the scratch memory of an operation");
}

static spin_status download(struct spin_device *d, void *host, const void *from, size_t bytes)
{
    if (bytes)
        memcpy(host, from, bytes);
    return wait(d);
}

static spin_status host_reserve(struct spin_device *d, size_t bytes, struct spin_host_memory *out)
{
    (void)d;
    *out = (struct spin_host_memory){.bytes = bytes};
    return spin_pages_reserve(bytes, &out->at);
}

static void host_release(struct spin_device *d, struct spin_host_memory *memory)
{
    (void)d;
    spin_pages_release(memory->at);
    *memory = (struct spin_host_memory){0};
}

static void *host_view(struct spin_device *d, void *at)
{
    (void)d;
    return at;
}

static void copy_rows(struct spin_device *d, size_t n, size_t width, const float *from,
                      size_t from_stride, float *to, size_t to_stride)
{
    bool whole = width == from_stride && width == to_stride;

    (void)d;
    if (whole && n > 0)
        memcpy(to, from, n * width * sizeof *to);
    for (size_t i = 0; i < n && !whole; i++)
        memcpy(to + i * to_stride, from + i * from_stride, width * sizeof *to);
}

static size_t memory_available(struct spin_device *d)
{
    (void)d;
    return spin_memory_available();
}

static double clock_of(struct spin_device *d, int op)
{
    double *seconds = &((struct spin_cpu *)d->state)->seconds[op], spent = *seconds;

    *seconds = 0;
    return spent;
}

#define LISTED(verb) .verb = SPIN_CPU(verb),
extern const struct spin_device_ops SPIN_CPU(ops);
const struct spin_device_ops SPIN_CPU(ops) = {
    .name = "cpu",
    .open = open_cpu,
    .close = close_cpu,
    .reserve = reserve,
    .release = release,
    .zero = zero,
    .upload = upload,
    .download = download,
    .wait = wait,
    .host_reserve = host_reserve,
    .host_release = host_release,
    .host_view = host_view,
    .copy_rows = copy_rows,
    .memory_available = memory_available,
    .clock = clock_of,
    SPIN_DEVICE_VERBS(LISTED) /* LISTED appends the comma */
};
