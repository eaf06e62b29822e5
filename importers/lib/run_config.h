/* Settings of a run that are not in its checkpoint: from cfg_args, from the YAML that training was
 * given, from options, or guessed (the range of times). */
#pragma once

#include "io/file.h"

/* cfg_args, which the descendants of 3DGS write beside a model: Python's repr of an argparse
 * Namespace.
 *
 *     Namespace(sh_degree=3, ..., grid_args={'bound': 1.6}, no_do=True, ...)
 *
 * Values are Python literals. They are returned as spans of the file's text and never evaluated. */
#define CFG_MAX_BYTES (1u << 20)

struct cfg_span {
    const char *at, *end; /* start and end of a value; at is NULL without one */
};

struct cfg_args {
    struct spin_map map;
    struct cfg_span all; /* between the brackets of Namespace(...) */
    char *path;          /* NULL: the run has none */
};

bool spin_cfg_is(struct cfg_span s, const char *text);

/* The value of an option; `at` is NULL when there is none. Of duplicates the last counts, as in
 * Python. */
struct cfg_span spin_cfg_get(const struct cfg_args *cfg, const char *key);

/* The value of a key in a dict. */
struct cfg_span spin_cfg_item(struct cfg_span dict, const char *key);

bool spin_cfg_number(struct cfg_span s, double *out);

/* Parses a list or tuple of exactly n numbers, or a single number, which is stored n times. */
bool spin_cfg_numbers(struct cfg_span s, int n, double *out);

/* Parses True, False, None (false) or a number (0 is false). */
bool spin_cfg_bool(struct cfg_span s, bool *out);

/* Reads an option of cfg_args. A value of another type is an error; if the option is missing, *out
 * keeps its value. */
spin_status spin_cfg_read_bool(const struct cfg_args *cfg, const char *key, bool *out);

spin_status spin_cfg_read_number(const struct cfg_args *cfg, const char *key, double *out);

spin_status spin_cfg_open(const char *path, struct cfg_args *out);

struct run_config {
    struct cfg_args cfg;  /* path is NULL when the run has none */
    struct spin_map yaml; /* data is NULL when the run has none */
    char *yaml_path;      /* NULL: there is none */
};

/* The clip's times, in the unit of the data set and of the YAML. */
struct clip_times {
    double first, last;
    bool guessed;
};

/* The value of the first "key: value" at any depth, since forks nest sections differently. *next is
 * set to the start of the following line. */
struct cfg_span spin_yaml_find(const struct run_config *s, const char *key, const char **next);

bool spin_yaml_bool(const struct run_config *s, const char *key, bool fallback);

void spin_run_config_close(struct run_config *s);

spin_status spin_yaml_open(const char *path, struct run_config *s);
void spin_yaml_close(struct run_config *s);

/* frame_ratio, by which training divided the data set's times: from cfg_args, else from the YAML,
 * else 1. */
spin_status spin_run_config_ratio(const struct run_config *s, double *out);

/* Finds the clip's times: `asked` ("A,B" or NULL), else time_duration of the YAML, else a guess
 * from the n times of the Gaussians. The Gaussians' times are those of the data set divided by
 * `ratio`. Methods initialise them over a range that is `spread` times as long as the clip. */
spin_status spin_run_config_times(const struct run_config *s, const char *asked, const float *time,
                                  size_t n, double ratio, double spread, struct clip_times *out);
