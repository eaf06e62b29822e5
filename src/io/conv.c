/* Loads the shim and gives its failures our words. */
#include "io/conv.h"

#include <string.h>

#include "base/err.h"
#include "base/shim.h"

static const struct spin_conv_shim *shim;

spin_status spin_conv_start(void)
{
    static struct spin_shim where = {.file = "spin-conv.so",
                                     .override = "SPIN_CONV_SHIM",
                                     .symbol = SPIN_CONV_SHIM_SYMBOL,
                                     .abi = SPIN_CONV_SHIM_ABI,
                                     .lacking = "LPIPS needs convolutions: the oneDNN shim",
                                     .debian = "libdnnl-dev"};

    return spin_shim_need(&where, (const void **)&shim);
}

spin_status spin_conv_open(const struct spin_conv_shape *shape, const float *weights,
                           const float *bias, int n_threads, struct spin_conv *out)
{
    char why[256] = "";

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_conv_start());
    out->shape = *shape;
    out->out_height = (shape->height + 2 * shape->pad - shape->kernel) / shape->stride + 1;
    out->out_width = (shape->width + 2 * shape->pad - shape->kernel) / shape->stride + 1;
    out->plan = shim->plan(shape, weights, bias, n_threads, why, sizeof why);
    if (!out->plan)
        return spin_fail(SPIN_E_UNSUPPORTED, "oneDNN cannot plan a convolution: %s", why);
    return SPIN_OK;
}

spin_status spin_conv_run(const struct spin_conv *conv, const float *in, float *out)
{
    char why[256] = "";

    if (!shim->run(conv->plan, in, out, why, sizeof why))
        return spin_fail(SPIN_E_UNSUPPORTED, "oneDNN cannot run a convolution: %s", why);
    return SPIN_OK;
}

void spin_conv_close(struct spin_conv *conv)
{
    if (conv->plan)
        shim->drop(conv->plan);
    memset(conv, 0, sizeof *conv);
}
