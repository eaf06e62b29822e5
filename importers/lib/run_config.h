/* What a checkpoint does not say and the files around it may: cfg_args, the YAML that training was
 * given, the range of times; and lines for the notes of a track. */
#ifndef SPIN_IMPORTERS_LIB_RUN_CONFIG_H
#define SPIN_IMPORTERS_LIB_RUN_CONFIG_H

#include "importers/lib/cfg_args.h"

struct run_config {
    struct cfg_args cfg;  /* no text when the run has none */
    struct spin_map yaml; /* likewise */
    char *yaml_path;      /* NULL: there is none */
};

/* The clip's times, in the unit of the data set and of the YAML. */
struct clip_times {
    double first, last;
    bool guessed;
};

/* The value of "key: value" at any depth: forks indent sections under one another. *next is behind
 * its line. */
struct cfg_span spin_yaml_find(const struct run_config *s, const char *key, const char **next);

bool spin_yaml_bool(const struct run_config *s, const char *key, bool fallback);

void spin_run_config_close(struct run_config *s);

/* cfg_args beside `file`, and the YAML that the user named (else one found there with `key`). */
spin_status spin_run_config_open(const char *file, const char *config, const char *key,
                                 struct run_config *s);

/* frame_ratio, by which training divided the data set's times: of cfg_args, else of the YAML, else 1. */
spin_status spin_run_config_ratio(const struct run_config *s, double *out);

int spin_compare_times(const void *a, const void *b);

/* What the user says ("A,B"), else the YAML, else a guess that the notes tell. `time` are the
 * Gaussians' own, in the file's unit, which is the data set's divided by `ratio`. */
spin_status spin_run_config_times(const struct run_config *s, const char *asked, const double *time,
                                  size_t n, double ratio, double spread, struct clip_times *out);

#endif
