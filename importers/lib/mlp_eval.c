/* Evaluates layers for blocks of points, and blocks on several threads. */
#include "importers/lib/mlp_eval.h"

#include "base/base.h"
#include "base/product.h"
#include "math/ntc.h"

/* Sets out [n_out][MLP_BLOCK] to W in + b; if `relu`, negative values become 0. `in` and `out` must
 * be different arrays. */
static void mlp_linear(const struct mlp_layer *l, const float *in, float *out, bool relu)
{
    if (!l->bias)
        memset(out, 0, (size_t)l->n_out * MLP_BLOCK * sizeof *out);
    spin_multiply_add(l->n_out, MLP_BLOCK, l->n_in, l->weight, (size_t)l->n_in, in, l->bias, relu,
                      out);
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

/* ---- Distributing blocks over threads -------------------------------------------------------- */

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

static void mlp_team_task(void *context, int task)
{
    const struct mlp_team *team = context;
    float *scratch = team->scratch + (size_t)spin_pool_worker() * team->each;
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
