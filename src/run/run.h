/* Calls whose findings are structs, for who needs them to the bit. */
#ifndef SPIN_RUN_RUN_H
#define SPIN_RUN_RUN_H

#include "spin_run.h"

/* spin_eval() with the findings as they are. Free the report. */
spin_status spin_evaluate(const struct spin_eval_options *o, struct spin_eval_report *report);

#endif
