/* Implements emu.h: fibers, the order in which they run, and the operations at which they meet. */
#include "tests/emu/emu.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>

#include "tests/emu/race.h"

#if !defined(__x86_64__) && !defined(__aarch64__)
#include <ucontext.h>
#endif

enum { WARP = 32, MOST_THREADS = 1024, CANARY = 64, POISON = 0xff };
static const size_t stack_bytes = (size_t)256 << 10, page = 4096;

enum state { READY, WAITS, DONE };
struct fiber {
#if defined(__x86_64__) || defined(__aarch64__)
    void *sp;
#else
    ucontext_t context;
#endif
    char *stack;
    enum state state;
    dim3 index;
    /* What the fiber waits for, and the result. */
    enum emu_op op;
    const char *file;
    int line, arg;
    uint32_t mask;
    uint64_t value, result;
};

dim3 emu_thread_index, emu_block_index, emu_block_size, emu_grid_size;

static struct fiber fibers[MOST_THREADS], host;
static int now = -1, n_threads;
static const char *kernel_name;
static void (*kernel_call)(void *);
static void *kernel_of;
static char *dynamic;
static size_t dynamic_size;
static struct emu_shared shared;
static struct emu_epoch epoch;

/* ---- Reporting a faulty kernel --------------------------------------------------------------- */

static const char *const op_names[] = {
    "__syncthreads",    "__syncthreads_and", "__syncthreads_or", "__syncthreads_count",
    "__syncwarp",       "__shfl_sync",       "__shfl_up_sync",   "__shfl_down_sync",
    "__shfl_xor_sync",  "__ballot_sync",     "__any_sync",       "__all_sync",
    "__match_any_sync", "__reduce_add_sync", "mma.sync"};

void emu_die(const char *what)
{
    fprintf(stderr, "emu: %s, block (%u, %u, %u), thread %d: %s\n",
            kernel_name ? kernel_name : "host", emu_block_index.x, emu_block_index.y,
            emu_block_index.z, now, what);
    for (int i = 0, shown = 0; i < n_threads && shown < 3; i++)
        if (fibers[i].state == WAITS && i != now && ++shown)
            fprintf(stderr, "emu:   thread %d waits in %s, %s:%d, mask %08x\n", i,
                    op_names[fibers[i].op], fibers[i].file, fibers[i].line, fibers[i].mask);
    fflush(NULL);
    abort();
}

/* GCC calls this when -fsanitize=bounds finds an index outside an array. */
struct where {
    const char *file;
    uint32_t line, column;
};
extern "C" __attribute__((visibility("hidden"))) void
__ubsan_handle_out_of_bounds_abort(struct where *where, uintptr_t index)
{
    char what[300];

    snprintf(what, sizeof what, "index %lld is outside of its array, %s:%u", (long long)index,
             where->file, where->line);
    emu_die(what);
}
extern "C" __attribute__((visibility("hidden"))) void
__ubsan_handle_out_of_bounds(struct where *where, uintptr_t index)
{
    __ubsan_handle_out_of_bounds_abort(where, index);
}

/* ---- Fibers ---------------------------------------------------------------------------------- */

/* Stacks are multiples of a page apart. Without an offset the frames of all fibers would compete
 * for the same few sets of the processor's cache. */
static size_t stagger(const struct fiber *f) { return (size_t)(f - fibers) * 448 % page; }

extern "C" __attribute__((visibility("hidden"))) void emu_fiber_main(void)
{
    kernel_call(kernel_of);
    fibers[now].state = DONE;
    for (;;)
        emu_meet(EMU_SYNC, NULL, 0, 0, 0, 0); /* returns to the host, for good */
}

#if defined(__x86_64__)
extern "C" void emu_switch(void **from, void *to);
__asm__(".text\n.hidden emu_switch\n.globl emu_switch\n.type emu_switch, @function\nemu_switch:\n"
        "push %rbp\npush %rbx\npush %r12\npush %r13\npush %r14\npush %r15\n"
        "mov %rsp, (%rdi)\nmov %rsi, %rsp\n"
        "pop %r15\npop %r14\npop %r13\npop %r12\npop %rbx\npop %rbp\nret\n"
        ".size emu_switch, .-emu_switch\n");

static void fiber_start(struct fiber *f)
{
    void **top = (void **)(f->stack + stack_bytes - stagger(f));

    *--top = NULL; /* return address, never used; aligns the stack as after a call */
    *--top = (void *)emu_fiber_main;
    for (int i = 0; i < 6; i++)
        *--top = NULL;
    f->sp = top;
}
static void fiber_switch(struct fiber *from, struct fiber *to) { emu_switch(&from->sp, to->sp); }
#elif defined(__aarch64__)
extern "C" void emu_switch(void **from, void *to);
__asm__(".text\n.hidden emu_switch\n.globl emu_switch\n.type emu_switch, %function\nemu_switch:\n"
        "sub sp, sp, #160\n"
        "stp x19, x20, [sp]\nstp x21, x22, [sp, #16]\nstp x23, x24, [sp, #32]\n"
        "stp x25, x26, [sp, #48]\nstp x27, x28, [sp, #64]\nstp x29, x30, [sp, #80]\n"
        "stp d8, d9, [sp, #96]\nstp d10, d11, [sp, #112]\nstp d12, d13, [sp, #128]\n"
        "stp d14, d15, [sp, #144]\nmov x9, sp\nstr x9, [x0]\nmov sp, x1\n"
        "ldp x19, x20, [sp]\nldp x21, x22, [sp, #16]\nldp x23, x24, [sp, #32]\n"
        "ldp x25, x26, [sp, #48]\nldp x27, x28, [sp, #64]\nldp x29, x30, [sp, #80]\n"
        "ldp d8, d9, [sp, #96]\nldp d10, d11, [sp, #112]\nldp d12, d13, [sp, #128]\n"
        "ldp d14, d15, [sp, #144]\nadd sp, sp, #160\nret\n"
        ".size emu_switch, .-emu_switch\n");

static void fiber_start(struct fiber *f)
{
    void **top = (void **)(f->stack + stack_bytes - stagger(f)) - 20;

    memset(top, 0, 160);
    top[11] = (void *)emu_fiber_main; /* x30 */
    f->sp = top;
}
static void fiber_switch(struct fiber *from, struct fiber *to) { emu_switch(&from->sp, to->sp); }
#else
static void fiber_start(struct fiber *f)
{
    getcontext(&f->context);
    f->context.uc_stack.ss_sp = f->stack;
    f->context.uc_stack.ss_size = stack_bytes;
    f->context.uc_link = NULL;
    makecontext(&f->context, emu_fiber_main, 0);
}
static void fiber_switch(struct fiber *from, struct fiber *to)
{
    swapcontext(&from->context, &to->context);
}
#endif

/* Each stack has an inaccessible guard page below it. */
static void need_stacks(int n)
{
    for (int i = 0; i < n; i++) {
        char *block;

        if (fibers[i].stack)
            continue;
        block = (char *)mmap(NULL, stack_bytes + page, PROT_READ | PROT_WRITE,
                             MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        if (block == MAP_FAILED || mprotect(block, page, PROT_NONE) != 0)
            emu_die("no memory for a stack");
        fibers[i].stack = block + page;
    }
}

bool emu_is_shared(const void *at)
{
    return (at >= shared.from && at < shared.to) ||
           (size_t)((const char *)at - dynamic) < dynamic_size;
}

struct emu_epoch *emu_now(const void *at)
{
    if (now < 0 || (size_t)((const char *)at - fibers[now].stack) < stack_bytes)
        return NULL;
    epoch.thread = (uint32_t)now;
    return &epoch;
}

/* ---- Meeting --------------------------------------------------------------------------------- */

static bool of_block(enum emu_op op) { return op <= EMU_SYNC_COUNT; }

/* Keeps in `lost` the bits of a factor that tf32 has not; NaN may have any. */
static float factor_of(uint32_t bits, uint32_t *lost)
{
    float v;

    memcpy(&v, &bits, sizeof v);
    *lost |= bits & (v == v ? 0x1fffu : 0);
    return v;
}

typedef float row __attribute__((vector_size(8 * sizeof(float))));
static void multiply_add(float (*a)[8], const row *b, row *c)
{
    for (int i = 0; i < 16; i++) {
        row sum = c[i];

        for (int k = 0; k < 8; k++)
            sum += a[i][k] * b[k];
        c[i] = sum;
    }
}

/* mma.sync: assembles two matrices from the lanes' registers and adds their product to the
 * third. */
static void multiply(struct fiber *warp)
{
    struct emu_mma_queue *queue[WARP];
    uint32_t lost = 0;
    float a[16][8];
    row b[8], c[16];

    for (int i = 0; i < WARP; i++) {
        queue[i] = (struct emu_mma_queue *)(uintptr_t)warp[i].value;
        if (queue[i]->n != queue[0]->n)
            emu_die("lanes have other numbers of products");
    }
    for (int q = 0; q < queue[0]->n; q++) {
        for (unsigned i = 0; i < WARP; i++) {
            auto *lane = &queue[i]->at[q];
            unsigned g = i / 4, t = i % 4;

            for (unsigned r = 0; r < 4; r++) {
                a[g + r % 2 * 8][t + r / 2 * 4] = factor_of(lane->a[r], &lost);
                c[g + r / 2 * 8][t * 2 + r % 2] = lane->c[r];
            }
            for (unsigned r = 0; r < 2; r++)
                b[t + 4 * r][g] = factor_of(lane->b[r], &lost);
        }
        multiply_add(a, b, c);
        for (unsigned i = 0; i < WARP; i++)
            for (unsigned r = 0; r < 4; r++)
                queue[i]->at[q].c[r] = c[i / 4 + r / 2 * 8][i % 4 * 2 + r % 2];
    }
    if (lost)
        emu_die("a factor of mma.sync is not a number of tf32");
}

/* The result for lane `lane`; the values are those of the mask's lanes. */
static uint64_t give(struct fiber *warp, int lane, int n)
{
    struct fiber *f = &warp[lane];
    int from = lane;
    uint64_t sum = 0;

    switch (f->op) {
    case EMU_MMA:
        return 0; /* done by multiply() */
    case EMU_SHUFFLE:
        from = f->arg & (WARP - 1);
        break;
    case EMU_SHUFFLE_UP:
        from = lane - f->arg < 0 ? lane : lane - f->arg;
        break;
    case EMU_SHUFFLE_DOWN:
        from = lane + f->arg >= WARP ? lane : lane + f->arg;
        break;
    case EMU_SHUFFLE_XOR:
        from = (lane ^ f->arg) & (WARP - 1);
        break;
    default:
        for (int i = 0; i < n; i++)
            if (f->mask >> i & 1)
                sum = f->op == EMU_REDUCE_ADD ? (uint32_t)(sum + warp[i].value)
                      : f->op == EMU_MATCH    ? sum | (uint64_t)(warp[i].value == f->value) << i
                                              : sum | warp[i].value << i;
        return f->op == EMU_ANY ? sum != 0 : f->op == EMU_ALL ? sum == f->mask : sum;
    }
    if (!(f->mask >> from & 1))
        emu_die("a lane reads from a lane that is outside of the mask");
    return warp[from].value;
}

/* Threads that wait at a block barrier, threads that have finished, and lanes that wait for their
 * warp. */
static int n_at_barrier, n_done;
static uint32_t at_warp[MOST_THREADS / WARP];

/* Releases all threads that thread `me` waits for, if all have arrived. To save time they are
 * checked only if enough have arrived, or if the block is `stuck`. */
static void try_meet(int me, bool stuck)
{
    struct fiber *f = &fibers[me];
    int first = of_block(f->op) ? 0 : me / WARP * WARP;
    int n = of_block(f->op) ? n_threads : n_threads - first < WARP ? n_threads - first : WARP;
    struct fiber *group = &fibers[first];
    uint64_t result[MOST_THREADS], sum = 0;

    if (!stuck && (of_block(f->op) ? n_at_barrier + n_done < n_threads
                                   : (f->mask & ~at_warp[me / WARP]) != 0))
        return;
    for (int i = 0; i < n; i++) {
        struct fiber *g = &group[i];

        if (!of_block(f->op) && !(f->mask >> i & 1))
            continue;
        if (g->state == DONE)
            emu_die(of_block(f->op) ? "waits at a barrier, and a thread of its block has left"
                                    : "waits for a lane that has left");
        if (g->state != WAITS)
            return;
        if (g->op != f->op || g->file != f->file || g->line != f->line)
            emu_die("threads meet in different operations");
        if (g->mask != f->mask)
            emu_die("lanes meet with different masks");
        sum += g->value;
    }
    if (f->op == EMU_MMA)
        multiply(group);
    for (int i = 0; i < n; i++)
        if (!of_block(f->op) && f->mask >> i & 1)
            result[i] = give(group, i, n);
        else
            result[i] = f->op == EMU_SYNC_AND  ? sum == (uint64_t)n
                        : f->op == EMU_SYNC_OR ? sum > 0
                                               : sum;
    for (int i = 0; i < n; i++)
        if (of_block(f->op) || f->mask >> i & 1) {
            group[i].result = result[i];
            group[i].state = READY;
        }
    if (of_block(f->op)) {
        epoch.barriers++;
        n_at_barrier = 0;
    } else {
        epoch.warp_barriers[first / WARP]++;
        at_warp[first / WARP] &= ~f->mask;
    }
}

uint64_t emu_meet(enum emu_op op, const char *file, int line, uint32_t mask, uint64_t value,
                  int arg)
{
    int me = now;
    struct fiber *f = &fibers[me];

    if (me < 0)
        emu_die("a host function waits");
    if (f->state != DONE) {
        f->state = WAITS;
        f->op = op;
        f->file = file;
        f->line = line;
        f->mask = mask;
        f->value = value;
        f->arg = arg;
        if (!of_block(op) && !(mask >> me % WARP & 1))
            emu_die("a lane is outside of the mask that it names");
        if (!of_block(op) && n_threads - me / WARP * WARP < WARP &&
            mask >> (n_threads - me / WARP * WARP))
            emu_die("the mask names lanes that the block does not have");
        if (of_block(op))
            n_at_barrier++;
        else
            at_warp[me / WARP] |= 1u << me % WARP;
        try_meet(me, false);
    }
    if (f->state != READY)
        fiber_switch(f, &host);
    f->state = f->state == DONE ? DONE : READY;
    return f->result;
}

/* ---- The order ------------------------------------------------------------------------------- */

static uint64_t seed;
static enum { FORWARD, REVERSE, SHUFFLE } order;

static uint64_t next_random(void)
{
    seed = seed * 6364136223846793005u + 1442695040888963407u;
    return seed >> 33;
}

static void read_order(void)
{
    const char *text = getenv("SPIN_EMU_ORDER");

    if (!text || strcmp(text, "forward") == 0) {
        order = FORWARD;
    } else if (strcmp(text, "reverse") == 0) {
        order = REVERSE;
    } else if (strncmp(text, "shuffle:", 8) == 0) {
        order = SHUFFLE;
        seed = seed ? seed : strtoull(text + 8, NULL, 10) * 2 + 1;
    } else {
        emu_die("SPIN_EMU_ORDER is not forward, reverse or shuffle:SEED");
    }
}

static void permute(uint32_t *place, size_t n)
{
    for (size_t i = 0; i < n; i++)
        place[i] = (uint32_t)(order == REVERSE ? n - 1 - i : i);
    for (size_t i = n; order == SHUFFLE && i > 1; i--) {
        size_t other = next_random() % i;
        uint32_t swap = place[i - 1];

        place[i - 1] = place[other];
        place[other] = swap;
    }
}

/* ---- Launch ---------------------------------------------------------------------------------- */

void *emu_dynamic(void) { return dynamic; }

/* Fills all shared memory of the file, including what AddressSanitizer put between the arrays. */
__attribute__((no_sanitize("address"))) static void poison_shared(void)
{
    volatile uint64_t *at = (volatile uint64_t *)shared.from;

    for (; at < (volatile uint64_t *)shared.to; at++)
        *at = UINT64_MAX;
}

static void run_block(size_t dynamic_bytes)
{
    static uint32_t place[MOST_THREADS];

    n_done = n_at_barrier = 0;
    memset(at_warp, 0, sizeof at_warp);
    poison_shared();
#if defined(__SANITIZE_ADDRESS__)
    dynamic = (char *)malloc(dynamic_bytes ? dynamic_bytes : 1);
#else
    dynamic = (char *)malloc(dynamic_bytes + CANARY);
    memset(dynamic + dynamic_bytes, POISON, CANARY);
#endif
    memset(dynamic, POISON, dynamic_bytes);
    dynamic_size = dynamic_bytes;
    epoch.block++;
    for (int i = 0; i < n_threads; i++) {
        unsigned u = (unsigned)i;

        fibers[i].state = READY;
        fibers[i].index = dim3(u % emu_block_size.x, u / emu_block_size.x % emu_block_size.y,
                               u / emu_block_size.x / emu_block_size.y);
        fiber_start(&fibers[i]);
    }
    permute(place, (size_t)n_threads);
    while (n_done < n_threads) {
        bool moved = false;

        for (int i = 0; i < n_threads; i++) {
            struct fiber *f = &fibers[place[i]];

            if (f->state != READY)
                continue;
            now = (int)place[i];
            emu_thread_index = f->index;
            fiber_switch(&host, f);
            moved = true;
            n_done += f->state == DONE;
        }
        for (now = 0; !moved && now < n_threads; now++)
            if (fibers[now].state == WAITS)
                try_meet(now, true); /* reports which thread has left */
        now = -1;
        if (!moved)
            emu_die("deadlock: every thread waits, and nobody will come");
    }
#if !defined(__SANITIZE_ADDRESS__)
    for (int i = 0; i < CANARY; i++)
        if ((unsigned char)dynamic[dynamic_bytes + (size_t)i] != POISON)
            emu_die("the block wrote behind its dynamic shared memory");
#endif
    free(dynamic);
    dynamic_size = 0;
}

void emu_run(const char *name, dim3 grid, dim3 block, size_t dynamic_bytes,
             struct emu_shared of_file, void (*call)(void *), void *kernel)
{
    static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
    size_t n = (size_t)grid.x * grid.y * grid.z, threads = (size_t)block.x * block.y * block.z;
    uint32_t *place;

    pthread_mutex_lock(&mutex);
    kernel_name = name;
    shared = of_file;
    if (n == 0 || threads == 0 || threads > MOST_THREADS)
        emu_die("a launch without blocks or threads, or with more than 1024 threads a block");
    if (dynamic_bytes > EMU_MOST_SHARED)
        emu_die("a launch with more shared memory than a block may have");
    place = (uint32_t *)malloc(n * sizeof *place);
    n_threads = (int)threads;
    need_stacks(n_threads);
    read_order();
    permute(place, n);
    kernel_call = call;
    kernel_of = kernel;
    emu_grid_size = grid;
    emu_block_size = block;
    epoch.launch++;
    for (size_t i = 0; i < n; i++) {
        emu_block_index =
            dim3(place[i] % grid.x, place[i] / grid.x % grid.y, place[i] / grid.x / grid.y);
        run_block(dynamic_bytes);
    }
    free(place);
    kernel_name = NULL;
    n_threads = 0;
    pthread_mutex_unlock(&mutex);
}
