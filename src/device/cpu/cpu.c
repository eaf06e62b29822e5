/* The CPU device: memory, and the struct that says which function does which op. */
#include "device/cpu/cpu.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"

static spin_status open_cpu(struct spin_device *d, int n_threads)
{
    spin_status status;
    void *block = NULL;
    size_t used = strlen(d->description);

    SPIN_TRY(spin_alloc(1, sizeof(struct spin_cpu), &block));
    d->state = block;
    status = spin_pool_create(n_threads, &((struct spin_cpu *)block)->pool);
    if (status != SPIN_OK) {
        free(block);
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

void *SPIN_CPU(scratch_need)(struct spin_device *d, enum spin_cpu_scratch which, size_t bytes)
{
    struct spin_cpu *cpu = d->state;

    if (spin_scratch_need(&cpu->scratch[which], bytes) == SPIN_OK)
        return cpu->scratch[which].block;
    if (!cpu->no_memory[0])
        snprintf(cpu->no_memory, sizeof cpu->no_memory, "%s", spin_last_error());
    return NULL;
}

static spin_status reserve(struct spin_device *d, size_t bytes, void **out)
{
    (void)d;
    return spin_pages_reserve(bytes, out);
}

static void release(struct spin_device *d, void *block, size_t bytes)
{
    (void)d;
    if (block)
        spin_pages_release(block, bytes);
}

static void copy(struct spin_device *d, void *to, const void *from, size_t bytes)
{
    (void)d;
    if (bytes)
        memcpy(to, from, bytes);
}

static void zero(struct spin_device *d, void *block, size_t bytes)
{
    (void)d;
    memset(block, 0, bytes);
}

spin_status SPIN_CPU(wait)(struct spin_device *d)
{
    struct spin_cpu *cpu = d->state;

    if (!cpu->no_memory[0])
        return SPIN_OK;
    spin_fail(SPIN_E_MEMORY, "%s", cpu->no_memory);
    cpu->no_memory[0] = '\0';
    return spin_fail_context(SPIN_E_MEMORY, "scratch of an operation");
}

static size_t memory(struct spin_device *d)
{
    (void)d;
    return spin_memory_available();
}

extern const struct spin_device_ops SPIN_CPU(ops);
const struct spin_device_ops SPIN_CPU(ops) = {
    .name = "cpu",
    .open = open_cpu,
    .close = close_cpu,
    .reserve = reserve,
    .release = release,
    .upload = copy,
    .download = copy,
    .zero = zero,
    .wait = SPIN_CPU(wait),
    .memory = memory,
    .contract = SPIN_CPU(contract),
    .contract_back = SPIN_CPU(contract_back),
    .grid = SPIN_CPU(grid),
    .grid_back = SPIN_CPU(grid_back),
    .mlp = SPIN_CPU(mlp),
    .mlp_back = SPIN_CPU(mlp_back),
    .attr = SPIN_CPU(attr),
    .activate_back = SPIN_CPU(activate_back),
    .regularise_back = SPIN_CPU(regularise_back),
    .project = SPIN_CPU(project),
    .project_back = SPIN_CPU(project_back),
    .tile_count = SPIN_CPU(tile_count),
    .tile_fill = SPIN_CPU(tile_fill),
    .blend = SPIN_CPU(blend),
    .blend_back = SPIN_CPU(blend_back),
    .loss = SPIN_CPU(loss),
    .residual = SPIN_CPU(residual),
    .residual_back = SPIN_CPU(residual_back),
    .exposure = SPIN_CPU(exposure),
    .exposure_back = SPIN_CPU(exposure_back),
    .active = SPIN_CPU(active),
    .adam = SPIN_CPU(adam),
    .lazy_grid = SPIN_CPU(lazy_grid),
    .lazy_adam = SPIN_CPU(lazy_adam),
    .lazy_flush = SPIN_CPU(lazy_flush),
};
