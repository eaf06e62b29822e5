/* The stream that torch.save wrote before 1.6: five pickles, then the storages. */
#ifndef SPIN_IO_PICKLE_LEGACY_H
#define SPIN_IO_PICKLE_LEGACY_H

#include "io/pickle_machine.h"

bool spin_pickle_is_legacy(const unsigned char *bytes, size_t n);
/* A whole stream from m->p on. */
spin_status spin_pickle_run_legacy(struct spin_pickle_machine *m, struct spin_pickle *out);
/* What the machine's load_from_bytes does. */
spin_status spin_pickle_load_from_bytes(struct spin_pickle_machine *m,
                                        const struct spin_value *args);

#endif
