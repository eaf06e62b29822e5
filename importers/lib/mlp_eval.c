/* Layers for blocks of points, and threads over blocks. */
#include "importers/lib/mlp_eval.h"

#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "base/pool.h"
#include "math/ntc.h"

typedef float mlp_vec __attribute__((vector_size(4 * MLP_LANES), aligned(4), may_alias));

/* `rows` is a constant where it is inlined, so the sums live in registers. */
MLP_INLINE void mlp_tile(const struct mlp_layer *l, int rows, int row, const float *in, float *out,
                         bool relu)
{
    const float *w = l->weight + (size_t)row * (size_t)l->n_in;
    mlp_vec sum[4][MLP_TILE_VECS];
    size_t n_in = (size_t)l->n_in;

    for (int r = 0; r < rows; r++)
        for (int v = 0; v < MLP_TILE_VECS; v++)
            sum[r][v] = (mlp_vec){0} + (l->bias ? l->bias[row + r] : 0.0f);
    for (size_t i = 0; i < n_in; i++) {
        mlp_vec x[MLP_TILE_VECS];

        for (int v = 0; v < MLP_TILE_VECS; v++)
            x[v] = *(const mlp_vec *)(in + i * MLP_BLOCK + v * MLP_LANES);
        for (int r = 0; r < rows; r++)
            for (int v = 0; v < MLP_TILE_VECS; v++)
                sum[r][v] += w[(size_t)r * n_in + i] * x[v];
    }
    for (int r = 0; r < rows; r++) {
        float *to = out + (size_t)(row + r) * MLP_BLOCK;

        for (int v = 0; v < MLP_TILE_VECS; v++)
            *(mlp_vec *)(to + v * MLP_LANES) = sum[r][v];
        for (int p = 0; relu && p < MLP_TILE_VECS * MLP_LANES; p++)
            to[p] = to[p] < 0 ? 0 : to[p];
    }
}

MLP_INLINE void mlp_layer(const struct mlp_layer *l, const float *in, float *out, bool relu)
{
    for (int p = 0; p < MLP_BLOCK; p += MLP_TILE_VECS * MLP_LANES) {
        int row = 0;

        for (; row + 4 <= l->n_out; row += 4)
            mlp_tile(l, 4, row, in + p, out + p, relu);
        for (; row < l->n_out; row++)
            mlp_tile(l, 1, row, in + p, out + p, relu);
    }
}

__attribute__((noinline, unused)) static void
mlp_layer_plain(const struct mlp_layer *l, const float *in, float *out, bool relu)
{
    mlp_layer(l, in, out, relu);
}

#if defined(__x86_64__) && !defined(__AVX2__)

__attribute__((target("avx2,fma"), noinline, unused)) static void
mlp_layer_avx2(const struct mlp_layer *l, const float *in, float *out, bool relu)
{
    mlp_layer(l, in, out, relu);
}

#endif

/* out [n_out][MLP_BLOCK] = W in + b, negative values to 0 when `relu`. in and out differ. */
static void mlp_linear(const struct mlp_layer *l, const float *in, float *out, bool relu)
{
#if defined(__x86_64__) && !defined(__AVX2__)
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        mlp_layer_avx2(l, in, out, relu);
        return;
    }
#endif
    mlp_layer_plain(l, in, out, relu);
}

int spin_mlp_n_out(const struct mlp_net *net) { return net->layer[net->n - 1].n_out; }

size_t spin_mlp_widest(const struct mlp_net *net)
{
    int widest = 0;

    for (int i = 0; i < net->n; i++) {
        widest = net->layer[i].n_in > widest ? net->layer[i].n_in : widest;
        widest = net->layer[i].n_out > widest ? net->layer[i].n_out : widest;
    }
    return (size_t)widest * MLP_BLOCK;
}

float *spin_mlp_run(const struct mlp_net *net, float *in, float *a, float *b)
{
    float *now = in;

    for (int i = 0; i < net->n; i++) {
        const struct mlp_layer *l = &net->layer[i];
        bool before = net->again > 0 && i + 1 == net->again;
        float *to = before ? in + (size_t)net->layer[0].n_in * MLP_BLOCK : now == a ? b : a;

        mlp_linear(l, net->again > 0 && i == net->again ? in : now, to, l->ending == MLP_RELU);
        for (int k = 0; l->ending == MLP_LEAKY && k < l->n_out * MLP_BLOCK; k++)
            to[k] = to[k] < 0 ? 0.01f * to[k] : to[k];
        for (int k = 0; net->half && k < l->n_out * MLP_BLOCK; k++)
            to[k] = spin_half(to[k]);
        now = to;
    }
    return now;
}

/* ---- Blocks over threads --------------------------------------------------------------------- */

void spin_mlp_team_free(struct mlp_team *team)
{
    spin_pool_free(team->pool);
    free(team->scratch);
    memset(team, 0, sizeof *team);
}

spin_status spin_mlp_team_create(size_t n_scratch, struct mlp_team *team)
{
    SPIN_TRY(spin_pool_create(0, &team->pool));
    team->each = n_scratch;
    return spin_alloc((size_t)spin_pool_n_threads(team->pool), n_scratch * sizeof(float),
                      (void **)&team->scratch);
}

enum { MLP_BLOCKS_A_TASK = 8 };

static void mlp_team_task(void *context, int task, int worker)
{
    const struct mlp_team *team = context;
    float *scratch = team->scratch + (size_t)worker * team->each;
    size_t first = (size_t)task * MLP_BLOCKS_A_TASK * MLP_BLOCK;

    for (int i = 0; i < MLP_BLOCKS_A_TASK && first < team->n_points; i++, first += MLP_BLOCK) {
        size_t left = team->n_points - first;

        team->fn(team->context, first, left < MLP_BLOCK ? (int)left : MLP_BLOCK, scratch);
    }
}

void spin_mlp_team_run(struct mlp_team *team, size_t n_points, mlp_block_fn fn, void *context)
{
    size_t a_task = (size_t)MLP_BLOCKS_A_TASK * MLP_BLOCK;

    team->fn = fn;
    team->context = context;
    team->n_points = n_points;
    spin_pool_run(team->pool, (int)((n_points + a_task - 1) / a_task), mlp_team_task, team);
}
