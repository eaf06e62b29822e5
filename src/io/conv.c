/* Loads the shim and gives its failures our words. */
#include "io/conv.h"

#include <pthread.h>
#include <string.h>

#include "base/err.h"
#include "io/shim.h"

static pthread_once_t once = PTHREAD_ONCE_INIT;
static const struct spin_conv_shim *shim; /* NULL after a failed start */
static char failure[512];

static void start(void)
{
    static const struct spin_shim where = {.file = "spin-conv.so",
                                           .override = "SPIN_CONV_SHIM",
                                           .symbol = SPIN_CONV_SHIM_SYMBOL,
                                           .abi = SPIN_CONV_SHIM_ABI};

    shim = spin_shim_load(&where, failure, sizeof failure);
}

spin_status spin_conv_start(void)
{
    pthread_once(&once, start);
    if (shim)
        return SPIN_OK;
    return spin_fail(SPIN_E_UNSUPPORTED,
                     "LPIPS needs convolutions: the oneDNN shim 'spin-conv.so' is missing or does "
                     "not load%s%s (Debian: install libdnnl-dev, then make)",
                     *failure ? ": " : "", failure);
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
