/* spin_retrain(), spin_eval() and spin_export(), with the findings as they are. */
#pragma once

#include "spin_run.h"
#include "eval/report/compare.h"
#include "train/plan.h"

spin_status spin_train(const struct spin_retrain_options *o, struct spin_retrain_report *report);
spin_status spin_export_clip(const struct spin_export_options *o,
                             struct spin_export_report *report);
/* Free the report. */
spin_status spin_evaluate(const struct spin_eval_options *o, struct spin_eval_report *report);
/* The same; pictures of what was measured are added to compare, by rank 0. */
spin_status spin_evaluate_for(const struct spin_eval_options *o, struct spin_compare *compare,
                              struct spin_eval_report *report);
