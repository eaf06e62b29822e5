/* The opcodes of pickles. */
#ifndef SPIN_IO_PICKLE_RUN_H
#define SPIN_IO_PICKLE_RUN_H

#include "io/pickle_machine.h"

/* One pickle from m->p on, to STOP. */
spin_status spin_pickle_run(struct spin_pickle_machine *m, const struct spin_value **root);

#endif
