/* The interface between device.c and spin-cuda.so. */
#pragma once

#include "spin.h"

struct spin_device_ops;

/* A number that depends on the sizes of the shared structs, so that a spin-cuda.so whose structs
 * differ in size is rejected. A file that uses this macro must include device/device.h. */
#define SPIN_CUDA_SHIM_ABI                                                                         \
    (int)(1 + 16 * (sizeof(struct spin_device_ops) + sizeof(struct spin_frame_batch) +             \
                    sizeof(struct spin_view_batch) + sizeof(struct spin_images) +                  \
                    sizeof(struct spin_device)))
#define SPIN_CUDA_SHIM_SYMBOL "spin_cuda_shim_table"

typedef spin_status spin_fail_fn(spin_status status, const char *format, ...);

struct spin_cuda_shim {
    int abi; /* the first member in every version of this struct */
    const struct spin_device_ops *op;
    /* is called first, and sets the function that reports failures */
    void (*use)(spin_fail_fn *fail);
};
