/* Functions that several verbs use: they provide scratch memory, and find the active rows of a
 * frame. */
#include "device/cpu/cpu.h"

void *SPIN_CPU(scratch_need)(struct spin_device *d, enum spin_cpu_scratch which, size_t bytes)
{
    struct spin_cpu *cpu = d->state;
    spin_status status = spin_scratch_need(&cpu->scratch[which], bytes);

    if (status == SPIN_OK)
        return cpu->scratch[which].block;
    if (cpu->failed == SPIN_OK) {
        cpu->failed = status;
        snprintf(cpu->why, sizeof cpu->why, "%s", spin_last_error());
    }
    return NULL;
}

/* Returns the index in active->row of the first entry that is `row` or greater, by binary
 * search. */
static size_t place_of(const struct spin_active *active, size_t row)
{
    size_t low = 0, high = *active->n;

    while (low < high) {
        size_t middle = (low + high) / 2;

        if (active->row[middle] < row)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

size_t SPIN_CPU(active_of)(const struct spin_active *active,
                           const struct spin_frame_of_batch *frame, size_t *first)
{
    *first = place_of(active, frame->first);
    return place_of(active, frame->first + frame->n) - *first;
}
