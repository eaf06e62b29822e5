/* Variants of spin_retrain(), spin_eval() and spin_export() that report in C structs instead of
 * JSON. */
#pragma once

#include "spin_run.h"
#include "eval/report/compare.h"
#include "render/player.h"
#include "train/plan.h"

spin_status spin_train(const struct spin_retrain_options *o, struct spin_retrain_report *report);
spin_status spin_export_clip(const struct spin_export_options *o,
                             struct spin_export_report *report);
/* Measures the clip like spin_eval(). The caller frees the report with spin_eval_report_free(). */
spin_status spin_evaluate(const struct spin_eval_options *o, struct spin_eval_report *report);
/* Like spin_evaluate(), except that rank 0 also adds images of the measured views to *compare. */
spin_status spin_evaluate_for(const struct spin_eval_options *o, struct spin_compare *compare,
                              struct spin_eval_report *report);

/* The renderer of spin.h that exporters receive. */
struct spin_renderer {
    struct spin_player player;
};
