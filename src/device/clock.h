/* Names of the ops and their clocks: what a step's seconds went to. */
#ifndef SPIN_DEVICE_CLOCK_H
#define SPIN_DEVICE_CLOCK_H

#include "base/log.h"
#include "device/device.h"

enum {
    SPIN_OP_PIXELS,
    SPIN_OP_CONTRACT,
    SPIN_OP_GRID,
    SPIN_OP_MLP,
    SPIN_OP_ACTIVATE,
    SPIN_OP_PROJECT,
    SPIN_OP_TILE,
    SPIN_OP_BLEND,
    SPIN_OP_LOSS,
    SPIN_OP_BLEND_BACK,
    SPIN_OP_PROJECT_BACK,
    SPIN_OP_ACTIVATE_BACK,
    SPIN_OP_MLP_BACK,
    SPIN_OP_GRID_BACK,
    SPIN_OP_ADAM,
    SPIN_OP_CLEAR,
    SPIN_OP_NONZERO_GRAD,
    SPIN_N_OPS
};
#define SPIN_OP_NAMES                                                                              \
    {                                                                                              \
        "pixels", "contract", "grid", "mlp", "attr", "project", "tile", "blend", "loss",           \
            "blend_back", "project_back", "activate_back", "mlp_back", "grid_back", "adam",        \
            "clear", "active"                                                                      \
    }

/* Run a call and add its wall time to the device's clock of that op. */
#define SPIN_TIMED(device, which, call)                                                            \
    do {                                                                                           \
        double spin_timed_ = spin_now_s();                                                         \
        call;                                                                                      \
        (device)->seconds[which] += spin_now_s() - spin_timed_;                                    \
    } while (0)

#endif
