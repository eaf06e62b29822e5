/* Settings of exports for the programs that play them, see --for of spin-export(1). */
#pragma once

#include "spin_run.h"

enum { SPIN_TARGET_SET = 4 };

struct spin_target {
    const char *name;
    const char *to;     /* exporter, unless the output or --to determines it */
    const char *ending; /* appended to an output without extension; "/": a folder */
    /* Options of exporters: name of the exporter, option, value. */
    const char *set[SPIN_TARGET_SET][3];
    bool equal_rows; /* the program needs the same splats in the same order in all frames */
    /* How the settings were tested: "measured" in the program itself; "by reader", with code of
     * the same authors; or "untested", taken from the program's documentation. */
    const char *tried;
};

/* Memory that options point to after the settings of a target were applied to them. */
struct spin_targeted {
    const struct spin_target *target;
    char *output;
    const char **pairs; /* options of the exporter: key, value, ..., NULL */
};

/* Sets *out, which the caller frees, to the output with the extension of the target if its name has
 * none. to: the exporter that was given; NULL: none. */
spin_status spin_target_output(const char *name, const char *to, const char *output, char **out);
/* Sets *to to the exporter of a target. */
spin_status spin_target_exporter(const char *name, const char **to);
/* Completes the options for a target, without changing those that were given, and logs the
 * settings. The caller zeroes *out before the call, and frees it afterwards even if the call
 * fails. */
spin_status spin_target_apply(const char *name, struct spin_export_options *o,
                              struct spin_targeted *out);
void spin_target_free(struct spin_targeted *t);
