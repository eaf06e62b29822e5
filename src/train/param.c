/* Manages the device memory of parameters: four arrays of the same length. */
#include "train/param.h"

#include <string.h>

spin_status spin_param_open(struct spin_param *param, struct spin_device *d, size_t n, size_t pad)
{
    float SPIN_DEV **at[4] = {&param->p, &param->g, &param->m, &param->v};

    memset(param, 0, sizeof *param);
    param->n = n;
    param->pad = pad;
    for (int i = 0; i < 4; i++) {
        SPIN_TRY(d->op->reserve(d, (n + pad) * sizeof(float), (void SPIN_DEV **)at[i]));
        *at[i] += pad;
    }
    return SPIN_OK;
}

void spin_param_close(struct spin_param *param, struct spin_device *d)
{
    float SPIN_DEV *at[4] = {param->p, param->g, param->m, param->v};

    for (int i = 0; i < 4; i++)
        if (at[i])
            d->op->release(d, at[i] - param->pad);
    memset(param, 0, sizeof *param);
}

struct spin_param_group spin_param_group(const struct spin_param *param, size_t first, size_t last,
                                         double lr, int64_t step)
{
    return (struct spin_param_group){.p = param->p + first,
                                     .g = param->g + first,
                                     .m = param->m + first,
                                     .v = param->v + first,
                                     .n = last - first,
                                     .lr = lr,
                                     .step = step};
}
