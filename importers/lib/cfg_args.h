/* cfg_args: what the descendants of 3DGS write beside a model, the repr of an argparse Namespace.
 *
 *     Namespace(sh_degree=3, ..., grid_args={'bound': 1.6}, no_do=True, ...)
 *
 * Values are Python literals. They are looked up in the text, as spans of it, and never evaluated. */
#ifndef SPIN_IMPORTERS_LIB_CFG_ARGS_H
#define SPIN_IMPORTERS_LIB_CFG_ARGS_H

#include "io/file.h"

#define CFG_MAX_BYTES (1u << 20)

struct cfg_span {
    const char *at, *end; /* of a value; at == NULL: there is none */
};

struct cfg_args {
    struct spin_map map;
    struct cfg_span all; /* between the brackets of Namespace(...) */
    char *path;          /* NULL: the run has none */
};

struct cfg_span spin_cfg_trim(struct cfg_span s);

bool spin_cfg_is(struct cfg_span s, const char *text);

/* The value of an option; `at` is NULL when there is none. Of two the last counts, as in Python. */
struct cfg_span spin_cfg_get(const struct cfg_args *cfg, const char *key);

/* The value of a key in a dict. */
struct cfg_span spin_cfg_item(struct cfg_span dict, const char *key);

bool spin_cfg_number(struct cfg_span s, double *out);

/* A number, or a list or tuple of exactly n of them; a number alone stands for all. */
bool spin_cfg_numbers(struct cfg_span s, int n, double *out);

/* True, False, and the numbers that stand for them. */
bool spin_cfg_bool(struct cfg_span s, bool *out);

/* An option that must be of its kind when it is there; `out` keeps its value when it is not. */
spin_status spin_cfg_read_bool(const struct cfg_args *cfg, const char *key, bool *out);

spin_status spin_cfg_read_number(const struct cfg_args *cfg, const char *key, double *out);

void spin_cfg_close(struct cfg_args *cfg);

spin_status spin_cfg_open(const char *path, struct cfg_args *out);

#endif
