/* Loading and evaluating HexPlane networks. */
#include "importers/lib/hexplane.h"

#include "math/plane.h"
#include "math/rounded.h"

/* For each plane, the axis of its columns and the axis of its rows: 0 to 2 are x, y, z; 3 is time.
 */
static const int hex_axes[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

/* ---- Loading --------------------------------------------------------------------------------- */

bool spin_hex_find(struct spin_model *m)
{
    static const char *const known[] = {"deformation_net.", "module.deformation_net.",
                                        "_deformation.deformation_net.",
                                        "_deformation.module.deformation_net."};

    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        m->prefix = known[i];
        if (spin_model_get(m, "grid.grids.0.0"))
            return true;
    }
    return false;
}

/* Transposes [channels][n] to [n][channels] in place. */
static spin_status channel_last(size_t channels, size_t n, float *values)
{
    SPIN_FREED float *copy = NULL;

    SPIN_TRY(spin_alloc(channels * n, sizeof *copy, (void **)&copy));
    memcpy(copy, values, channels * n * sizeof *copy);
    for (size_t c = 0; c < channels; c++)
        for (size_t i = 0; i < n; i++)
            values[i * channels + c] = copy[c * n + i];
    return SPIN_OK;
}

static spin_status load_plane(struct spin_model *m, int scale, int p, struct hexplane *hex)
{
    int64_t shape[4] = {1, hex->channels > 0 ? hex->channels : -1, -1, -1};
    struct spin_array info;
    char key[80];

    snprintf(key, sizeof key, "grid.grids.%d.%d", scale, p);
    SPIN_TRY(spin_model_floats(m, key, 4, shape, &info, &hex->plane[scale][p]));
    if (info.shape[1] == 0 || info.shape[1] > HEX_MAX_CHANNELS)
        return spin_malformed("tensor '%s%s' has %llu channels, expected 1 to %d", m->prefix, key,
                              (unsigned long long)info.shape[1], HEX_MAX_CHANNELS);
    hex->channels = (int)info.shape[1];
    for (int i = 0; i < 2; i++) {
        uint64_t n = info.shape[3 - i];
        int *size = &hex->size[scale][hex_axes[p][i]];

        if (n == 0 || n > HEX_MAX_SIZE || (*size && (uint64_t)*size != n))
            return spin_malformed("tensor '%s%s' has %llu samples along %c, expected %s%d%s",
                                  m->prefix, key, (unsigned long long)n, "xyzt"[hex_axes[p][i]],
                                  *size ? "" : "1 to ", *size ? *size : HEX_MAX_SIZE,
                                  *size ? " as in previous planes" : "");
        *size = (int)n;
    }
    return channel_last((size_t)hex->channels, (size_t)(info.shape[2] * info.shape[3]),
                        hex->plane[scale][p]);
}

static spin_status load_planes(struct spin_model *m, struct hexplane *hex)
{
    for (;; hex->n_scales++) {
        int n = 0;

        for (int p = 0; p < 6; p++)
            n += spin_model_get(m, "grid.grids.%d.%d", hex->n_scales, p) != NULL;
        if (n == 0)
            return SPIN_OK;
        if (hex->n_scales == HEX_MAX_SCALES)
            return spin_unsupported("the network has more than %d scales of planes",
                                    HEX_MAX_SCALES);
        if (n != 6)
            return spin_malformed("'%sgrid.grids.%d' has %d planes, expected 6", m->prefix,
                                  hex->n_scales, n);
        for (int p = 0; p < 6; p++)
            SPIN_TRY(load_plane(m, hex->n_scales, p, hex));
    }
}

/* Checks that a bounding box, given by two opposite corners, has an extent along every axis. `key`
 * is the tensor that the error message names. */
static spin_status check_box(const struct spin_model *m, const char *key, const float *low,
                             const float *high)
{
    for (int d = 0; d < 3; d++) {
        if (low[d] == high[d])
            return spin_malformed("tensor '%s%s' is a bounding box without extent along %c",
                                  m->prefix, key, "xyz"[d]);
    }
    return SPIN_OK;
}

/* Loads the network feature_out. The planes yield F = channels x scales features. If the network
 * has F inputs, these are the features. If it has 3 F inputs, these are the features, their sines
 * and their cosines, and grid_pe must be known and above 1. */
static spin_status load_feature(struct spin_model *m, double grid_pe, struct hexplane *hex)
{
    int n_features = hex->channels * hex->n_scales;
    const struct mlp_layer *first = &hex->feature.layer[0];

    SPIN_TRY(spin_model_layer(m, "feature_out.0", -1, -1, MLP_RELU, &hex->feature));
    SPIN_TRY(spin_model_trunk(m, "feature_out", 2, first->n_out, &hex->feature));
    hex->width = first->n_out;
    if (first->n_in == n_features)
        return SPIN_OK;
    if (first->n_in != 3 * n_features)
        return spin_malformed(
            "tensor '%sfeature_out.0.weight' has %d inputs, but the planes have %d features",
            m->prefix, first->n_in, n_features);
    if (!(grid_pe > 1))
        return spin_unsupported("tensor '%sfeature_out.0.weight' has encoded features as its "
                                "input, but no cfg_args contains grid_pe: use --grid-pe",
                                m->prefix);
    hex->grid_pe = grid_pe;
    return SPIN_OK;
}

spin_status spin_hex_load(struct spin_model *m, double grid_pe, struct hexplane *hex)
{
    static const int64_t box[2] = {2, 3}, three[1] = {3};
    static const int64_t voxels[5] = {1, 1, HEX_VOXELS, HEX_VOXELS, HEX_VOXELS};
    static const char *const low = "empty_voxel.xyz_min", *const high = "empty_voxel.xyz_max";

    SPIN_TRY(load_planes(m, hex));
    SPIN_TRY(spin_model_floats(m, "grid.aabb", 2, box, NULL, &hex->corner));
    SPIN_TRY(check_box(m, "grid.aabb", hex->corner, hex->corner + 3));
    SPIN_TRY(load_feature(m, grid_pe, hex));
    if (spin_model_get(m, "static_mlp.1.weight"))
        return spin_model_head(m, "static_mlp", hex->width, 1, &hex->still);
    if (!spin_model_get(m, "empty_voxel.grid"))
        return SPIN_OK;
    SPIN_TRY(spin_model_floats(m, "empty_voxel.grid", 5, voxels, NULL, &hex->voxels));
    SPIN_TRY(spin_model_floats(m, low, 1, three, NULL, &hex->voxel_min));
    SPIN_TRY(spin_model_floats(m, high, 1, three, NULL, &hex->voxel_max));
    return check_box(m, high, hex->voxel_min, hex->voxel_max);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

size_t spin_hex_scratch(const struct hexplane *hex) { return 2 * spin_mlp_widest(&hex->feature); }

/* Computes the features of one point into column `p` of a block. As in the method, the bounding box
 * is mapped to [-1, 1] in x, y and z, whereas the time is used unchanged. */
static void hex_sample(const struct hexplane *hex, const float xyz[3], float time, int p,
                       float *out)
{
    float product[HEX_MAX_CHANNELS], u[4];

    for (int d = 0; d < 3; d++)
        u[d] = (xyz[d] - hex->corner[d]) * (2.0f / (hex->corner[3 + d] - hex->corner[d])) - 1;
    u[3] = time;
    for (int l = 0; l < hex->n_scales; l++) {
        struct spin_plane_axis axis[4];

        for (int d = 0; d < 4; d++)
            axis[d] = spin_plane_axis(u[d], hex->size[l][d]);
        for (int k = 0; k < 6; k++)
            spin_plane_lookup(hex->plane[l][k], hex->size[l][hex_axes[k][0]], hex->channels,
                              axis[hex_axes[k][0]], axis[hex_axes[k][1]], k > 0, product);
        for (int c = 0; c < hex->channels; c++)
            out[(l * hex->channels + c) * MLP_BLOCK + p] = product[c];
    }
}

float *spin_hex_hidden(const struct hexplane *hex, const float *xyz, int n, float time,
                       float *scratch, float **spare, float mask[MLP_BLOCK])
{
    float *now = scratch, *next = scratch + spin_mlp_widest(&hex->feature), *hidden;
    int n_features = hex->channels * hex->n_scales * MLP_BLOCK;

    for (int p = 0; p < MLP_BLOCK; p++) {
        hex_sample(hex, xyz + 3 * (p < n ? p : n - 1), time, p, now);
        mask[p] = 1;
    }
    for (int i = 0; hex->grid_pe > 0 && i < n_features; i++) {
        float f = now[i] * (float)hex->grid_pe;

        now[n_features + i] = spin_rounded_sin(f);
        now[2 * n_features + i] = spin_rounded_cos(f);
    }
    hidden = spin_mlp_run(&hex->feature, now, next, now);
    *spare = hidden == now ? next : now;
    if (hex->still.n > 0)
        spin_mlp_run(&hex->still, hidden, *spare, mask);
    for (int p = 0; hex->voxels && p < n; p++) {
        float u[3];

        for (int d = 0; d < 3; d++)
            u[d] = (xyz[3 * p + d] - hex->voxel_min[d]) / (hex->voxel_max[d] - hex->voxel_min[d]) *
                   (HEX_VOXELS - 1);
        mask[p] = spin_voxel_lookup(hex->voxels, HEX_VOXELS, u);
    }
    return hidden;
}
