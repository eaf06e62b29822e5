/* The small networks of anchors, as torch.jit.trace() saves them: a zip whose program is not read, only its
 * storages. */
#ifndef SPIN_IMPORTERS_LIB_TORCHSCRIPT_H
#define SPIN_IMPORTERS_LIB_TORCHSCRIPT_H

#include "importers/lib/mlp_eval.h"

/* Linear(A + 3 or A + 4, A) and Linear(A, n_out) of A features and the view, an opacity_mlp.pt. To be freed
 * with spin_mlp_free(), also after a failure. */
spin_status spin_torchscript_load(const char *path, int n_features, int n_out,
                                  struct mlp_linear layer[2]);

#endif
