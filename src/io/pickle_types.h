/* Globals that a pickle names, and what REDUCE, NEWOBJ and BUILD make of them. Each opcode takes its arguments
 * from the stack or the input. */
#ifndef SPIN_IO_PICKLE_TYPES_H
#define SPIN_IO_PICKLE_TYPES_H

#include "io/pickle_machine.h"

spin_status spin_pickle_op_global(struct spin_pickle_machine *m);
spin_status spin_pickle_op_stack_global(struct spin_pickle_machine *m);
spin_status spin_pickle_op_persistent_id(struct spin_pickle_machine *m);
spin_status spin_pickle_op_reduce(struct spin_pickle_machine *m);
spin_status spin_pickle_op_newobj(struct spin_pickle_machine *m);
spin_status spin_pickle_op_build(struct spin_pickle_machine *m);
/* The key of a storage: up to 20 digits. */
bool spin_pickle_is_key(const struct spin_value *v);

#endif
