/* Settings of a training that its checkpoint does not contain. They are read from cfg_args, from
 * the YAML file that was given to the training, or from options; the range of times is guessed if
 * none of these sources states it. */
#pragma once

#include "spin.h"
#include "io/file.h"
#include "io/text_file.h"

/* cfg_args is a file that the descendants of 3DGS write to the model's folder. It contains Python's
 * repr() of an argparse Namespace.
 *
 *     Namespace(sh_degree=3, ..., grid_args={'bound': 1.6}, no_do=True, ...)
 *
 * Values are Python literals. They are returned as spans of the file's text and never evaluated. */
#define CFG_MAX_BYTES (1u << 20)

struct cfg_span {
    const char *at, *end; /* start and end of a value; `at` is NULL if there is no value */
};

struct cfg_args {
    struct spin_text_file file;
    struct cfg_span all; /* the text between the brackets of Namespace(...) */
    char *path;          /* path of the file; NULL: there is no cfg_args */
};

bool spin_cfg_is(struct cfg_span s, const char *text);

/* Returns the value of `key`; `at` is NULL if there is none. If the file contains the key more than
 * once, the last value is returned, as in Python. */
struct cfg_span spin_cfg_get(const struct cfg_args *cfg, const char *key);

/* Returns the value of `key` in the dict {...}; `at` is NULL if there is none. */
struct cfg_span spin_cfg_item(struct cfg_span dict, const char *key);

bool spin_cfg_number(struct cfg_span s, double *out);

/* Parses a list or tuple of exactly n numbers, or a single number, which is stored n times. */
bool spin_cfg_numbers(struct cfg_span s, int n, double *out);

/* Parses True, true, False, false, None or a number. None and 0 are false, other numbers are true.
 */
bool spin_cfg_bool(struct cfg_span s, bool *out);

/* Read the value of `key`. A value of another type is an error. If the key is missing, *out keeps
 * its value. */
spin_status spin_cfg_read_bool(const struct cfg_args *cfg, const char *key, bool *out);

spin_status spin_cfg_read_number(const struct cfg_args *cfg, const char *key, double *out);

spin_status spin_cfg_open(const char *path, struct cfg_args *out);

struct run_config {
    struct cfg_args cfg;        /* cfg_args; cfg.path is NULL if there is none */
    struct spin_text_file yaml; /* the YAML file; yaml.text is NULL if there is none */
    char *yaml_path;            /* path of the YAML file; NULL: there is none */
};

/* The clip's first and last time, in the unit of the data set and of the YAML file. */
struct clip_times {
    double first, last;
    bool guessed; /* the times were guessed from those of the Gaussians */
};

/* Returns the value of the first line "<key>: <value>" of the YAML file, at any depth, since forks
 * nest sections differently, and sets *next to the start of the following line. `at` is NULL if
 * there is no such line. */
struct cfg_span spin_yaml_find(const struct run_config *s, const char *key, const char **next);

bool spin_yaml_bool(const struct run_config *s, const char *key, bool fallback);

void spin_run_config_close(struct run_config *s);

spin_status spin_yaml_open(const char *path, struct run_config *s);
void spin_yaml_close(struct run_config *s);

/* Sets *out to frame_ratio, by which training divided the data set's times. It is read from
 * cfg_args or, if cfg_args lacks it, from the YAML file; the default is 1. */
spin_status spin_run_config_ratio(const struct run_config *s, double *out);

/* Returns whether cfg_args or the path of the YAML file names a data set of Blender, where z points
 * up: is_blender is True; a folder in the path of the data set, of the model or of the settings is
 * named after D-NeRF; or the folder of the data set is named like a scene of D-NeRF. */
bool spin_run_config_is_blender(const struct run_config *s);

/* Finds the clip's times. They are the first of these that exists: the text "A,B" in `asked`, which
 * may be NULL; time_duration of the YAML file; a guess from `time`, the times of the n Gaussians.
 * The Gaussians' times are those of the data set divided by `ratio`. Methods initialise the
 * Gaussians' times over a range that is `spread` times as long as the clip. */
spin_status spin_run_config_times(const struct run_config *s, const char *asked, const float *time,
                                  size_t n, double ratio, double spread, struct clip_times *out);

/* ---- Camera positions ------------------------------------------------------------------------ */

/* From an option, or from the cameras.json that descendants of 3DGS write. */

enum { CAMERA_PLACES_MOST = 64 };

struct camera_places {
    int n;
    float place[CAMERA_PLACES_MOST][3]; /* [n] positions in world units */
};

/* Parses the value of --camera: "X,Y,Z", or several positions separated by ";". NULL yields no
 * positions. Errors are SPIN_E_USAGE. */
spin_status spin_camera_places_parse(const char *text, struct camera_places *out);

/* Reads the file `path`, a list of cameras, and stores their positions without duplicates, in the
 * order of the list. If there are more than CAMERA_PLACES_MOST, keeps CAMERA_PLACES_MOST of them,
 * evenly spaced in the list. An empty list, or an entry without a position, is an error; the
 * message names the file and the entry. */
spin_status spin_camera_places_load(const char *path, struct camera_places *out);
