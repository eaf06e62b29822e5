/* Kernels for t-emu.c: correct ones, and variants with a fault that the emulation must detect. */
#include <stdio.h>
#include <stdlib.h>

#define EXPORT extern "C" __attribute__((visibility("default")))
enum { N = 256, WARPS = N / 32 };

/* The sum of a block's values by halving in shared memory. Fault: no barrier. */
static __global__ void block_sum(const float *in, float *out, bool barrier, int reach)
{
    __shared__ float sum[N];
    int me = (int)threadIdx.x;

    sum[me] = in[blockIdx.x * N + threadIdx.x];
    __syncthreads();
    for (int half = N / 2; half > 0; half /= 2) {
        if (me < half)
            sum[me] += sum[me + half + reach];
        if (barrier)
            __syncthreads();
    }
    if (me == 0)
        out[blockIdx.x] = sum[0];
}

/* Faults: a mask of half the lanes; lanes that leave; a lane whose mask lacks the lanes in
 * `other`. */
static __global__ void warp_sum(const float *in, float *out, unsigned mask, int leave,
                                unsigned other)
{
    float v = in[blockIdx.x * N + threadIdx.x];
    unsigned lane = threadIdx.x % 32;

    if ((int)lane < leave)
        return;
    for (int by = 16; by > 0; by /= 2)
        v += __shfl_down_sync(lane == 5 ? mask & ~other : mask, v, by);
    if (lane == 0)
        atomicAdd(&out[blockIdx.x], v);
}

/* Adds each row once per warp: of the lanes that refer to the same row, the first adds for all.
 * Faults: without `merge` it adds only its own value; without `atomic` two warps may update the
 * same row. */
static __global__ void merged_rows(const int *row, const float *in, float *out, bool merge,
                                   bool atomic)
{
    unsigned at = blockIdx.x * N + threadIdx.x, lane = threadIdx.x % 32;
    unsigned same = __match_any_sync(0xffffffffu, row[at]);
    float sum = 0;

    for (unsigned from = 0; from < 32; from++) {
        float v = __shfl_sync(0xffffffffu, in[at], (int)from);

        if (merge ? same >> from & 1 : from == lane)
            sum += v;
    }
    if ((unsigned)__ffs((int)same) - 1 != lane)
        return;
    if (atomic)
        atomicAdd(&out[row[at]], sum);
    else
        out[row[at]] += sum;
}

static __global__ void two_barriers(float *out)
{
    if (threadIdx.x < 32)
        __syncthreads();
    else
        __syncthreads();
    out[threadIdx.x] = 1;
}

static __global__ void early(float *out)
{
    if (threadIdx.x == 7)
        return;
    __syncthreads();
    out[threadIdx.x] = 1;
}

/* Every block finds its shared memory without a value, also after another has set it. */
static __global__ void poisoned(float *out)
{
    __shared__ float one[N];

    out[blockIdx.x * N + threadIdx.x] = isnan(one[threadIdx.x]);
    one[threadIdx.x] = 2;
}

static __global__ void dynamic_kernel(float *out, int past)
{
    float *room = (float *)emu_dynamic();

    room[threadIdx.x + (threadIdx.x == N - 1 ? past : 0)] = 1;
    __syncthreads();
    out[threadIdx.x] = room[N - 1 - threadIdx.x];
}

/* A warp's product of A [16][8] and B [8][8], added to C = 1. Faults: two registers of A are
 * exchanged; a factor has more bits than tf32; a lane leaves. */
static __global__ void tensor_product(const float *from, float *to, bool exchange, float more,
                                      int leave)
{
    struct emu_mma_queue queue;
    int lane = (int)threadIdx.x, g = lane / 4, t = lane % 4;
    uint32_t a[4], b[2];
    float c[4] = {1, 1, 1, 1};

    if (lane < leave)
        return;
    for (int r = 0; r < 4; r++) {
        int k = exchange && (r == 1 || r == 2) ? 3 - r : r;

        a[r] = (uint32_t)emu_bits(from[(g + k % 2 * 8) * 8 + t + k / 2 * 4] + more);
    }
    for (int r = 0; r < 2; r++)
        b[r] = emu_tf32(from[128 + (t + 4 * r) * 8 + g]);
    queue.add(c, a, b);
    queue.run();
    for (int r = 0; r < 4; r++)
        to[(g + r / 2 * 8) * 8 + 2 * t + r % 2] = c[r];
}

static int run_tensor(const char *what)
{
    static float from[128 + 64], to[128];
    int wrong = 0;

    for (int i = 0; i < 128 + 64; i++)
        from[i] = (float)(i * 7 % 19) - 6;
    emu_launch(what, 1, 32, [=] {
        tensor_product(from, to, strcmp(what, "mma-exchanged") == 0,
                       strcmp(what, "mma-float") == 0 ? 1e-4f : 0,
                       strcmp(what, "mma-left") == 0 ? 1 : 0);
    });
    for (int i = 0; i < 16; i++)
        for (int j = 0; j < 8; j++) {
            float want = 1;

            for (int k = 0; k < 8; k++)
                want += from[i * 8 + k] * from[128 + k * 8 + j];
            wrong += to[i * 8 + j] != want;
        }
    return wrong != 0;
}

static float in[4 * N], out[4 * N];
static int row[4 * N];

/* Runs a kernel; returns 0 if the results are right. */
EXPORT int run(const char *what)
{
    bool is_sum = strncmp(what, "sum", 3) == 0, is_warp = strncmp(what, "warp", 4) == 0;
    bool is_rows = strncmp(what, "rows", 4) == 0;
    float want[4 * N] = {0};
    int wrong = 0, n_out = 4;

    if (strncmp(what, "mma", 3) == 0)
        return run_tensor(what);
    memset(out, 0, sizeof out);
    for (int i = 0; i < 4 * N; i++) {
        in[i] = (float)(i % 11) - 3;
        row[i] = i / 4 % 60;
        want[is_rows ? row[i] : i / N] += in[i];
    }
    if (is_sum)
        emu_launch(what, 4, N, [=] {
            block_sum(in, out, strcmp(what, "sum-barrier") != 0,
                      strcmp(what, "sum-index") == 0 ? N / 2 : 0);
        });
    else if (is_warp)
        emu_launch(what, 4, N, [=] {
            warp_sum(in, out, strcmp(what, "warp-mask") == 0 ? 0x0000ffffu : 0xffffffffu,
                     strcmp(what, "warp-left") == 0 ? 3 : 0,
                     strcmp(what, "warp-outside") == 0 ? 1u << 5
                     : strcmp(what, "warp-masks") == 0 ? 1u << 6
                                                       : 0);
        });
    else if (is_rows)
        emu_launch(what, 4, N, [=] {
            merged_rows(row, in, out, strcmp(what, "rows-unmerged") != 0,
                        strcmp(what, "rows-plain") != 0);
        });
    else if (strcmp(what, "two-barriers") == 0)
        emu_launch(what, 1, N, [=] { two_barriers(out); });
    else if (strcmp(what, "early") == 0)
        emu_launch(what, 1, N, [=] { early(out); });
    else if (strncmp(what, "dynamic", 7) == 0)
        emu_launch_dynamic(what, 1, N,
                           strcmp(what, "dynamic-large") == 0 ? EMU_MOST_SHARED + 1
                                                              : N * sizeof(float),
                           [=] { dynamic_kernel(out, strcmp(what, "dynamic-past") == 0); });
    else if (strcmp(what, "poisoned") == 0)
        emu_launch(what, 4, N, [=] { poisoned(out); });
    else
        return 2;
    if (!is_sum && !is_warp && !is_rows) {
        n_out = strcmp(what, "poisoned") == 0 ? 4 * N : N;
        for (int i = 0; i < n_out; i++)
            want[i] = 1;
    }
    for (int i = 0; i < (is_rows ? 60 : n_out); i++)
        wrong += !(fabsf(out[i] - want[i]) < 1e-3f);
    return wrong != 0;
}
