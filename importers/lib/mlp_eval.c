/* Layers for blocks of points, and threads over blocks. */
#include "importers/lib/mlp_eval.h"

#include <stdlib.h>
#include <string.h>

#include "base/pool.h"
#include "base/product.h"

void spin_mlp_linear(const struct mlp_linear *l, const float *in, float *out, bool relu)
{
    spin_multiply_add(l->n_out, MLP_BLOCK, l->n_in, l->weight, (size_t)l->n_in, in, l->bias, relu,
                      out);
}

void spin_mlp_free(struct mlp_linear *l)
{
    free(l->weight);
    free(l->bias);
    memset(l, 0, sizeof *l);
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

/* ---- From a state dict ----------------------------------------------------------------------- */

const struct spin_value *spin_mlp_get(const struct spin_value *dict, const char *prefix,
                                      const char *key)
{
    char name[200];

    snprintf(name, sizeof name, "%s%s", prefix, key);
    return spin_value_get(dict, name);
}

spin_status spin_mlp_floats(struct spin_torch *torch, const struct spin_value *dict,
                            const char *prefix, const char *key, int n_dims, const int64_t *shape,
                            struct spin_array *info, float **out)
{
    const struct spin_value *v = spin_mlp_get(dict, prefix, key);
    struct spin_array unused;
    char name[200];

    snprintf(name, sizeof name, "%s%s", prefix, key);
    if (!v)
        return spin_fail(SPIN_E_MALFORMED, "no tensor '%s'", name);
    return spin_torch_floats(torch, v, name, n_dims, shape, info ? info : &unused, out);
}

bool spin_mlp_has(const struct spin_value *dict, const char *prefix, const char *key)
{
    char name[200];

    snprintf(name, sizeof name, "%s.weight", key);
    return spin_mlp_get(dict, prefix, name) != NULL;
}

spin_status spin_mlp_load(struct spin_torch *torch, const struct spin_value *dict,
                          const char *prefix, const char *key, int n_in, int n_out,
                          struct mlp_linear *out)
{
    int64_t shape[2] = {n_out, n_in};
    struct spin_array info;
    char name[200];

    snprintf(name, sizeof name, "%s.weight", key);
    SPIN_TRY(spin_mlp_floats(torch, dict, prefix, name, 2, shape, &info, &out->weight));
    if (info.shape[0] == 0 || info.shape[1] == 0 || info.shape[0] > MLP_MAX_WIDTH ||
        info.shape[1] > MLP_MAX_WIDTH)
        return spin_fail(SPIN_E_MALFORMED,
                         "tensor '%s%s' has shape [%llu, %llu], expected sizes 1 to %d", prefix,
                         name, (unsigned long long)info.shape[0], (unsigned long long)info.shape[1],
                         MLP_MAX_WIDTH);
    out->n_out = (int)info.shape[0];
    out->n_in = (int)info.shape[1];
    shape[0] = out->n_out;
    snprintf(name, sizeof name, "%s.bias", key);
    return spin_mlp_floats(torch, dict, prefix, name, 1, shape, NULL, &out->bias);
}
