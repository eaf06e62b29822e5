/* Small networks of foreign methods, evaluated for blocks of points.
 *
 * The activations of a block are stored by channel, [channel][MLP_BLOCK]: the loops below go over
 * points, so a layer is a broadcast and a multiply-add whatever its width. */
#ifndef SPIN_IMPORTERS_LIB_MLP_EVAL_H
#define SPIN_IMPORTERS_LIB_MLP_EVAL_H

#include "io/torch.h"

enum {
    MLP_BLOCK = 32,    /* points */
    MLP_MAX_WIDTH = 8192
};

#define MLP_INLINE static inline __attribute__((always_inline, unused))

/* y = W x + b; n_in == 0: there is no such layer. */
struct mlp_linear {
    int n_in, n_out;
    float *weight; /* [n_out][n_in] */
    float *bias;   /* [n_out] */
};

/* out [n_out][MLP_BLOCK] = W in + b, negative values to 0 when `relu`. in and out differ. */
void spin_mlp_linear(const struct mlp_linear *l, const float *in, float *out, bool relu);

void spin_mlp_free(struct mlp_linear *l);

/* Evaluates points first .. first + n - 1, n at most MLP_BLOCK, with `scratch` to itself. */
typedef void (*mlp_block_fn)(void *context, size_t first, int n, float *scratch);

struct mlp_team {
    struct spin_pool *pool;
    float *scratch; /* [threads][each] */
    size_t each;
    mlp_block_fn fn; /* of the call that is running */
    void *context;
    size_t n_points;
};

void spin_mlp_team_free(struct mlp_team *team);

spin_status spin_mlp_team_create(size_t n_scratch, struct mlp_team *team);

/* fn for all points, at most 2^31 of them. */
void spin_mlp_team_run(struct mlp_team *team, size_t n_points, mlp_block_fn fn, void *context);

/* The value of prefix + key. */
const struct spin_value *spin_mlp_get(const struct spin_value *dict, const char *prefix,
                                      const char *key);

/* A tensor by name as floats; -1 in `shape` matches anything. */
spin_status spin_mlp_floats(struct spin_torch *torch, const struct spin_value *dict,
                            const char *prefix, const char *key, int n_dims, const int64_t *shape,
                            struct spin_array *info, float **out);

bool spin_mlp_has(const struct spin_value *dict, const char *prefix, const char *key);

/* The layer `key`.weight, `key`.bias; n_in and n_out are -1 where any will do. */
spin_status spin_mlp_load(struct spin_torch *torch, const struct spin_value *dict,
                          const char *prefix, const char *key, int n_in, int n_out,
                          struct mlp_linear *out);

#endif
