/* The interface between device.c and spin-cuda.so. */
#pragma once

#include "spin.h"

struct spin_device_ops;

/* Depends on the sizes of the shared structs, so that a spin-cuda.so with other structs is
 * rejected. Requires device/device.h. */
#define SPIN_CUDA_SHIM_ABI                                                                         \
    (int)(1 + 16 * (sizeof(struct spin_device_ops) + sizeof(struct spin_frame_batch) +             \
                    sizeof(struct spin_view_batch) + sizeof(struct spin_images) +                  \
                    sizeof(struct spin_device)))
#define SPIN_CUDA_SHIM_SYMBOL "spin_cuda_shim_table"

typedef spin_status spin_fail_fn(spin_status status, const char *format, ...);

struct spin_cuda_shim {
    int abi; /* first member in every version */
    const struct spin_device_ops *op;
    void (*use)(spin_fail_fn *fail); /* called first; sets the function that reports failures */
};
