/* Loading and evaluating HexPlane networks. */
#include "importers/lib/hexplane.h"

#include <stdlib.h>
#include <string.h>

#include "math/plane.h"

/* Which axes a plane spans, 3 being time: its columns, its rows. */
static const int hex_axes[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

void spin_hex_head_free(struct hex_head *head)
{
    spin_mlp_free(&head->first);
    spin_mlp_free(&head->last);
}

void spin_hex_free(struct hexplane *hex)
{
    for (int l = 0; l < HEX_MAX_SCALES; l++)
        for (int p = 0; p < 6; p++)
            free(hex->plane[l][p]);
    for (int i = 0; i < HEX_MAX_DEPTH; i++)
        spin_mlp_free(&hex->feature[i]);
    spin_mlp_free(&hex->still[0]);
    spin_mlp_free(&hex->still[1]);
    free(hex->voxels);
    memset(hex, 0, sizeof *hex);
}

/* ---- Loading --------------------------------------------------------------------------------- */

const char *spin_hex_prefix(const struct spin_value *dict)
{
    static const char *const known[] = {"", "module.", "_deformation.", "_deformation.module."};

    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        if (spin_mlp_get(dict, known[i], "deformation_net.grid.grids.0.0"))
            return known[i];
    }
    return NULL;
}

/* [channels][n] to [n][channels]. */
static spin_status hex_channel_last(size_t channels, size_t n, float **values)
{
    float *out = NULL;

    SPIN_TRY(spin_alloc(channels * n, sizeof *out, (void **)&out));
    for (size_t c = 0; c < channels; c++)
        for (size_t i = 0; i < n; i++)
            out[i * channels + c] = (*values)[c * n + i];
    free(*values);
    *values = out;
    return SPIN_OK;
}

static spin_status hex_load_plane(struct spin_torch *torch, const struct spin_value *dict,
                                  const char *prefix, int scale, int p, struct hexplane *hex)
{
    int64_t shape[4] = {1, hex->channels > 0 ? hex->channels : -1, -1, -1};
    struct spin_array info;
    char key[80];

    snprintf(key, sizeof key, "deformation_net.grid.grids.%d.%d", scale, p);
    SPIN_TRY(spin_mlp_floats(torch, dict, prefix, key, 4, shape, &info, &hex->plane[scale][p]));
    if (info.shape[1] == 0 || info.shape[1] > HEX_MAX_CHANNELS)
        return spin_fail(SPIN_E_MALFORMED, "tensor '%s%s' has %llu channels, expected 1 to %d",
                         prefix, key, (unsigned long long)info.shape[1], HEX_MAX_CHANNELS);
    hex->channels = (int)info.shape[1];
    for (int i = 0; i < 2; i++) {
        uint64_t n = info.shape[3 - i];
        int *size = &hex->size[scale][hex_axes[p][i]];

        if (n == 0 || n > HEX_MAX_SIZE || (*size && (uint64_t)*size != n))
            return spin_fail(
                SPIN_E_MALFORMED, "tensor '%s%s' has %llu samples along %c, expected %s%d", prefix,
                key, (unsigned long long)n, "xyzt"[hex_axes[p][i]],
                *size ? "as the planes before it " : "1 to ", *size ? *size : HEX_MAX_SIZE);
        *size = (int)n;
    }
    return hex_channel_last((size_t)hex->channels, (size_t)(info.shape[2] * info.shape[3]),
                            &hex->plane[scale][p]);
}

static spin_status hex_load_planes(struct spin_torch *torch, const struct spin_value *dict,
                                   const char *prefix, struct hexplane *hex)
{
    for (;; hex->n_scales++) {
        char key[80];
        int n = 0;

        for (int p = 0; p < 6; p++) {
            snprintf(key, sizeof key, "deformation_net.grid.grids.%d.%d", hex->n_scales, p);
            n += spin_mlp_get(dict, prefix, key) != NULL;
        }
        if (n == 0)
            return SPIN_OK;
        if (hex->n_scales == HEX_MAX_SCALES)
            return spin_fail(SPIN_E_UNSUPPORTED, "more than %d scales of planes", HEX_MAX_SCALES);
        if (n != 6)
            return spin_fail(SPIN_E_MALFORMED,
                             "'%sdeformation_net.grid.grids.%d' has %d planes, expected 6", prefix,
                             hex->n_scales, n);
        for (int p = 0; p < 6; p++)
            SPIN_TRY(hex_load_plane(torch, dict, prefix, hex->n_scales, p, hex));
    }
}

static spin_status hex_load_box(struct spin_torch *torch, const struct spin_value *dict,
                                const char *prefix, struct hexplane *hex)
{
    int64_t shape[2] = {2, 3};
    float *box = NULL;

    SPIN_TRY(
        spin_mlp_floats(torch, dict, prefix, "deformation_net.grid.aabb", 2, shape, NULL, &box));
    memcpy(hex->corner, box, sizeof hex->corner);
    free(box);
    for (int d = 0; d < 3; d++) {
        if (hex->corner[0][d] == hex->corner[1][d])
            return spin_fail(SPIN_E_MALFORMED,
                             "tensor '%sdeformation_net.grid.aabb' is a box without extent along "
                             "%c",
                             prefix, "xyz"[d]);
    }
    return SPIN_OK;
}

/* The input is F = channels x scales wide, or 3 F when it is encoded: grid_pe > 1. */
static spin_status hex_load_feature(struct spin_torch *torch, const struct spin_value *dict,
                                    const char *prefix, double grid_pe, struct hexplane *hex)
{
    int n_features = hex->channels * hex->n_scales, width = -1;

    for (hex->depth = 0; hex->depth < HEX_MAX_DEPTH; hex->depth++) {
        char key[80];

        snprintf(key, sizeof key, "deformation_net.feature_out.%d", 2 * hex->depth);
        if (hex->depth > 0 && !spin_mlp_has(dict, prefix, key))
            break;
        SPIN_TRY(spin_mlp_load(torch, dict, prefix, key, width, width, &hex->feature[hex->depth]));
        width = hex->feature[0].n_out;
    }
    hex->width = width;
    if (hex->feature[0].n_in == n_features)
        return SPIN_OK;
    if (hex->feature[0].n_in != 3 * n_features)
        return spin_fail(SPIN_E_MALFORMED,
                         "tensor '%sdeformation_net.feature_out.0.weight' takes %d features, but "
                         "the planes give %d",
                         prefix, hex->feature[0].n_in, n_features);
    if (!(grid_pe > 1))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "tensor '%sdeformation_net.feature_out.0.weight' takes encoded features, "
                         "and no cfg_args says how: give grid_pe with --grid-pe",
                         prefix);
    hex->grid_pe = grid_pe;
    return SPIN_OK;
}

bool spin_hex_has_head(const struct spin_value *dict, const char *prefix, const char *name)
{
    char key[100];

    snprintf(key, sizeof key, "deformation_net.%s.1", name);
    return spin_mlp_has(dict, prefix, key);
}

spin_status spin_hex_load_head(struct spin_torch *torch, const struct spin_value *dict,
                               const char *prefix, const char *name, int width, int n_out,
                               struct hex_head *out)
{
    char key[100];

    snprintf(key, sizeof key, "deformation_net.%s.1", name);
    SPIN_TRY(spin_mlp_load(torch, dict, prefix, key, width, width, &out->first));
    snprintf(key, sizeof key, "deformation_net.%s.3", name);
    return spin_mlp_load(torch, dict, prefix, key, width, n_out, &out->last);
}

static spin_status hex_load_voxels(struct spin_torch *torch, const struct spin_value *dict,
                                   const char *prefix, struct hexplane *hex)
{
    static const int64_t shape[5] = {1, 1, HEX_VOXELS, HEX_VOXELS, HEX_VOXELS}, three[1] = {3};
    static const char *const key[2] = {"deformation_net.empty_voxel.xyz_min",
                                       "deformation_net.empty_voxel.xyz_max"};

    SPIN_TRY(spin_mlp_floats(torch, dict, prefix, "deformation_net.empty_voxel.grid", 5, shape,
                             NULL, &hex->voxels));
    for (int i = 0; i < 2; i++) {
        float *corner = NULL;

        SPIN_TRY(spin_mlp_floats(torch, dict, prefix, key[i], 1, three, NULL, &corner));
        memcpy(i == 0 ? hex->voxel_min : hex->voxel_max, corner, 3 * sizeof *corner);
        free(corner);
    }
    for (int d = 0; d < 3; d++) {
        if (hex->voxel_min[d] == hex->voxel_max[d])
            return spin_fail(SPIN_E_MALFORMED, "tensor '%s%s' is a box without extent along %c",
                             prefix, key[1], "xyz"[d]);
    }
    return SPIN_OK;
}

spin_status spin_hex_load(struct spin_torch *torch, const struct spin_value *dict,
                          const char *prefix, double grid_pe, struct hexplane *hex)
{
    struct hex_head still = {0};

    SPIN_TRY(hex_load_planes(torch, dict, prefix, hex));
    SPIN_TRY(hex_load_box(torch, dict, prefix, hex));
    SPIN_TRY(hex_load_feature(torch, dict, prefix, grid_pe, hex));
    if (spin_hex_has_head(dict, prefix, "static_mlp")) {
        spin_status status =
            spin_hex_load_head(torch, dict, prefix, "static_mlp", hex->width, 1, &still);

        hex->still[0] = still.first;
        hex->still[1] = still.last;
        return status;
    }
    if (spin_mlp_get(dict, prefix, "deformation_net.empty_voxel.grid"))
        return hex_load_voxels(torch, dict, prefix, hex);
    return SPIN_OK;
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

size_t spin_hex_scratch(const struct hexplane *hex)
{
    int n = hex->width > hex->feature[0].n_in ? hex->width : hex->feature[0].n_in;

    return 2 * (size_t)n * MLP_BLOCK;
}

/* The features of one point, into column `p` of a block. Time goes in as it is, not mapped to
 * [-1, 1]: Differs from what the planes' other axes do, as the method does. */
static void hex_sample(const struct hexplane *hex, const float xyz[3], float time, int p,
                       float *out)
{
    float product[HEX_MAX_CHANNELS], u[4];

    for (int d = 0; d < 3; d++)
        u[d] = (xyz[d] - hex->corner[0][d]) * (2.0f / (hex->corner[1][d] - hex->corner[0][d])) - 1;
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

const float *spin_hex_hidden(const struct hexplane *hex, const float *xyz, int n, float time,
                             float *scratch)
{
    float *now = scratch, *next = scratch + spin_hex_scratch(hex) / 2;
    int n_features = hex->channels * hex->n_scales * MLP_BLOCK;

    for (int p = 0; p < MLP_BLOCK; p++)
        hex_sample(hex, xyz + 3 * (p < n ? p : n - 1), time, p, now);
    for (int i = 0; hex->grid_pe > 0 && i < n_features; i++) {
        float f = now[i] * (float)hex->grid_pe;

        now[n_features + i] = sinf(f);
        now[2 * n_features + i] = cosf(f);
    }
    for (int i = 0; i < hex->depth; i++) {
        float *t = now;

        spin_mlp_linear(&hex->feature[i], now, next, true);
        now = next;
        next = t;
    }
    return now;
}

float *spin_hex_spare(const struct hexplane *hex, const float *hidden, float *scratch)
{
    return hidden == scratch ? scratch + spin_hex_scratch(hex) / 2 : scratch;
}

void spin_hex_head(const struct hex_head *head, const float *hidden, float *spare, float *out)
{
    spin_mlp_linear(&head->first, hidden, spare, true);
    spin_mlp_linear(&head->last, spare, out, false);
}

void spin_hex_mask(const struct hexplane *hex, const float *xyz, int n, const float *hidden,
                   float *spare, float mask[MLP_BLOCK])
{
    for (int p = 0; p < MLP_BLOCK; p++)
        mask[p] = 1;
    if (hex->still[0].n_in > 0) {
        spin_mlp_linear(&hex->still[0], hidden, spare, true);
        spin_mlp_linear(&hex->still[1], spare, mask, false);
    }
    for (int p = 0; hex->voxels && p < n; p++) {
        float u[3];

        for (int d = 0; d < 3; d++)
            u[d] = (xyz[3 * p + d] - hex->voxel_min[d]) / (hex->voxel_max[d] - hex->voxel_min[d]) *
                   (HEX_VOXELS - 1);
        mask[p] = spin_voxel_lookup(hex->voxels, HEX_VOXELS, u);
    }
}
