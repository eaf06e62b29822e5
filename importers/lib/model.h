/* The model of an importer from open() to close(): its memory, the search for the files of a run,
 * and the reading of columns, tensors and layers. An importer's own struct begins with a struct
 * spin_model. */
#pragma once

#include "base/base.h"
#include "formats/gs_ply.h"
#include "importers/lib/mlp_eval.h"
#include "importers/lib/run_config.h"
#include "io/torch.h"

/* ---- Life ------------------------------------------------------------------------------------ */

struct spin_model {
    struct spin_arena arena;         /* paths, weights, tables: freed with the model */
    struct spin_arena scratch;       /* freed when open() returns */
    struct spin_model_block *blocks; /* private: malloc() blocks freed with the model */
    const char *path;                /* the file that frame() names in errors */
    struct spin_ply
        ply; /* the open cloud; closed when the next one is opened, and when open() returns */
    struct spin_torch torch;          /* the open checkpoint */
    const struct spin_value *tensors; /* its dict of tensors */
    const char *prefix;               /* prefix of the tensors' names */
    struct run_config settings;       /* cfg_args, and the YAML of some methods */
    struct spin_splats canonical;
    struct spin_splats_4d splats_4d;
    struct mlp_team team;
    /* Arguments of open(), valid until open() returns. */
    const struct spin_plugin_values *values;
    struct spin_sequence_info *sequence;
};

/* Defines the importer `id`: open() calls fn(model, path) with a zeroed `type`, and `closes` is its
 * close(). The variable arguments initialise other members of the importer, such as `.summary =
 * "..."`. */
#define SPIN_MODEL_IMPORTER(id, type, fn, closes, ...)                                             \
    static spin_status spin_open_##id(const char *path, const struct spin_plugin_values *values,   \
                                      void **self, struct spin_sequence_info *sequence)            \
    {                                                                                              \
        return spin_model_open(path, values, self, sequence, sizeof(type), fn);                    \
    }                                                                                              \
                                                                                                   \
    const struct spin_importer spin_importer_##id = {.abi = SPIN_PLUGIN_ABI,                       \
                                                     .name = #id,                                  \
                                                     .open = spin_open_##id,                       \
                                                     .close = closes,                              \
                                                     __VA_ARGS__};
/* Defines a reader of data sets with the plug-in name `label`; its zeroed `type` lives only during
 * fn(set, views). */
#define SPIN_VIEWS_IMPORTER(id, label, type, fn, ...)                                              \
    static spin_status spin_views_##id(const char *path, const struct spin_plugin_values *values,  \
                                       struct spin_views *out)                                     \
    {                                                                                              \
        type set = {0};                                                                            \
        struct spin_model *m = (struct spin_model *)&set;                                          \
        spin_status status;                                                                        \
                                                                                                   \
        m->path = path;                                                                            \
        m->values = values;                                                                        \
        status = fn(&set, out);                                                                    \
        spin_model_clear(m);                                                                       \
        return status;                                                                             \
    }                                                                                              \
                                                                                                   \
    const struct spin_importer spin_importer_##id = {                                              \
        .abi = SPIN_PLUGIN_ABI, .name = label, .views = spin_views_##id, __VA_ARGS__};
spin_status spin_model_open(const char *path, const struct spin_plugin_values *values, void **self,
                            struct spin_sequence_info *sequence, size_t bytes,
                            spin_status (*fn)(void *self, const char *path));
/* spin_model_close() is an importer's close(): it frees the members of struct spin_model and the
 * model. spin_model_clear() frees the members only, for a model on the stack. */
void spin_model_close(void *self);
void spin_model_clear(struct spin_model *m);

/* The value of an option, or NULL. spin_model_given() returns the same text as a span, to be parsed
 * like a value of cfg_args. */
const char *spin_model_option(const struct spin_model *m, const char *key);
struct cfg_span spin_model_given(const struct spin_model *m, const char *key);
/* Reads the option, else `key` of cfg_args; if neither is given, *out keeps its value. */
spin_status spin_model_bool(const struct spin_model *m, const char *option, const char *key,
                            bool *out);
spin_status spin_model_number(const struct spin_model *m, const char *option, const char *key,
                              double *out);
/* Sets *out to the index, in words "a|b|c", of the option's value (`option` may be NULL), else of
 * the quoted value of `key` in cfg_args; to -1 if neither is given or the value in cfg_args is none
 * of the words. An option with another value is an error. */
spin_status spin_model_word(const struct spin_model *m, const char *option, const char *key,
                            const char *words, int *out);
/* Arguments (m, count, size, out): allocates zeroed memory, which is freed with the model or, by
 * spin_model_scratch(), when open() returns. */
#define spin_model_alloc(m, ...) spin_arena_take(&(m)->arena, __VA_ARGS__)
#define spin_model_scratch(m, ...) spin_arena_take(&(m)->scratch, __VA_ARGS__)
/* Joins a folder and a formatted path; spin_model_text(m, out, fmt, ...) formats text only. */
#define spin_model_text(m, out, ...) spin_model_join(m, out, "", __VA_ARGS__)
spin_status spin_model_join(struct spin_model *m, const char **out, const char *folder,
                            const char *fmt, ...) SPIN_PRINTF(4, 5);
/* Like spin_model_join(), but sets *out to NULL if no such file or folder exists. */
#define spin_model_find(m, out, ...) spin_model_there(spin_model_join(m, out, __VA_ARGS__), out)
spin_status spin_model_there(spin_status status, const char **out);
/* Sets *out to the parent folder of `path`, or by spin_model_absolute() to the absolute path. */
spin_status spin_model_folder(struct spin_model *m, const char **out, const char *path);
spin_status spin_model_absolute(struct spin_model *m, const char **out, const char *path);
/* Like spin_folder_list(), but the list is freed with the model. */
spin_status spin_model_names(struct spin_model *m, const char *folder, char ***names, size_t *n);

/* Describes a typical sequence: times are continuous from 0 to 1, row i is the same Gaussian at all
 * times, and all columns exist, of which those in `moved` change. counts: NULL, or valid as long as
 * the model. */
void spin_model_describe(const struct spin_model *m, const size_t *counts, int sh_degree,
                         unsigned moved);

/* For models of 4D splats. To be called once m->splats_4d is filled: drops rows with nonfinite
 * values (SPIN_E_MALFORMED if none is left), prepares the splats for slicing, and describes the
 * sequence as continuous, 0 to 1, without identity. spin_model_slice() and spin_model_splats_4d()
 * are the frame() and splats_4d() of such models. */
spin_status spin_model_settle_4d(struct spin_model *m);
spin_status spin_model_slice(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out);
spin_status spin_model_splats_4d(void *self, const struct spin_splats_4d **out);

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Whether the input is a folder with an entry of this name; whether peek->head contains a word. */
bool spin_peek_has(const struct spin_peek *peek, const char *name);
bool spin_peek_says(const struct spin_peek *peek, const char *word);

/* ---- Columns --------------------------------------------------------------------------------- */

/* Returns the values of a column and sets *width to its floats per row. Columns are numbered in the
 * order of enum spin_column, from means to SH. */
enum { SPIN_MODEL_COLUMNS = 5 };
float *spin_model_values(const struct spin_splats *s, int column, size_t *width);
/* Refuses a frame with nonfinite values: evaluating a finite file can overflow. */
spin_status spin_model_check(const char *path, double time, unsigned columns,
                             const struct spin_splats *s);

/* ---- The folder of a run --------------------------------------------------------------------- */

/* N of a folder named exactly iteration_<digits>, else -1. */
long long spin_model_iteration(const char *name);
bool spin_model_holds(const char *folder, const char *file);
/* Sets *out to the name of the checkpoint to read: a folder iteration_<N> in `folder` that contains
 * `file`. Unless folder2 is NULL, a folder of the same name in folder2 must contain file2. `wanted`
 * is N or "best"; NULL selects the largest N with these files, or iteration_best if there is no
 * number. *out is NULL if no folder matches. */
spin_status spin_model_choose(struct spin_model *m, const char *wanted, const char *folder,
                              const char *file, const char *folder2, const char *file2,
                              const char **out);
/* Sets the model's path to `path` if that is a file. Otherwise searches the folder path/inner or,
 * without one, `path` for the file with the largest step_of(name); files with -1 are skipped.
 * `called` describes these files in messages. */
spin_status spin_model_newest(struct spin_model *m, const char *path, const char *inner,
                              long long (*step_of)(const char *name), const char *called);
/* Sets *out to the folder of the checkpoint to read, for models with the file `network` beside
 * point_cloud.ply. `path` is the model's folder, its folder point_cloud, the folder of a
 * checkpoint, or one of the two files; option `iteration` selects a checkpoint of the model. *out
 * is NULL if there is none. */
spin_status spin_model_save(struct spin_model *m, const char *path, const char *network,
                            const char **out);
/* Whether `file` is in the model's folder or in one of its checkpoints. Sets *coarse to whether
 * there are checkpoints of the coarse stage. */
bool spin_model_search(const char *path, const char *file, bool *coarse);
/* Finds the file `name` in the folder `path`, else in the folder `save` or up to two levels above
 * `save`, which may be NULL. *out is NULL if there is no such file. */
spin_status spin_model_beside(struct spin_model *m, const char *path, const char *save,
                              const char *name, const char **out);
/* For models of a single checkpoint file, m->path: opens cfg_args, if it exists in the same folder,
 * and the YAML file named by option `config`. Without the option, opens a YAML file in that folder
 * that contains time_duration, if there is one. */
spin_status spin_model_config(struct spin_model *m);
/* Opens the cfg_args that spin_model_beside() finds; settings.cfg.path stays NULL if there is none.
 */
spin_status spin_model_cfg(struct spin_model *m, const char *path, const char *save);

/* ---- The cloud ------------------------------------------------------------------------------- */

/* Reads a property of the vertices into every `step`-th float of out; nonfinite values are an
 * error. */
spin_status spin_model_column(const struct spin_ply *ply, const struct spin_ply_element *e,
                              const char *name, float *out, size_t step);
/* Reads the n properties prefix0, prefix1, ... in this way into out[0..n), with `step` floats per
 * vertex. */
spin_status spin_model_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                               const char *prefix, int n, float *out, size_t step);
/* Number of properties whose names begin with `prefix`. */
int spin_model_count(const struct spin_ply_element *e, const char *prefix);
/* Opens any PLY as m->ply. */
spin_status spin_model_ply(struct spin_model *m, const char *path);
/* spin_model_vertices() also requires at least one vertex. spin_model_cloud() requires the
 * properties of Gaussians, with SH of degree 0 to 3, but accepts 0 vertices. */
spin_status spin_model_vertices(struct spin_model *m, const char *path,
                                const struct spin_ply_element **vertex);
spin_status spin_model_cloud(struct spin_model *m, const char *path, struct spin_gs_ply *cloud);
/* Reads all columns of a cloud, which must not be empty, into m->canonical as stored, without
 * normalising quaternions. If `extra` is not NULL, also reads the properties extra0, extra1, ...
 * into *values [n][n_extra] or, if n_extra is 0, the property called `extra` into *values [n]. */
spin_status spin_model_read(struct spin_model *m, const char *path, const char *extra, int n_extra,
                            float **values);

/* ---- Tensors --------------------------------------------------------------------------------- */

/* Opens the checkpoint at `path`, calls fn(m) and closes it. Errors name the path. */
spin_status spin_model_torch(struct spin_model *m, const char *path,
                             spin_status (*fn)(struct spin_model *m));
/* Sets m->tensors to the root of the checkpoint, which must be a dict. */
spin_status spin_model_dict(struct spin_model *m);
/* Refuses tensors whose names do not begin with the prefix and one of `stems`, a list that ends
 * with NULL: other tensors are those of derived methods and would change the result. */
spin_status spin_model_keys(const struct spin_model *m, const char *const *stems);
/* The value whose name is the prefix and the formatted key, or NULL. */
const struct spin_value *spin_model_get(const struct spin_model *m, const char *fmt, ...)
    SPIN_PRINTF(2, 3);
/* Reads the tensor prefix + key as floats, which are freed with the model; -1 in `shape` matches
 * any size. `info` may be NULL. */
spin_status spin_model_floats(struct spin_model *m, const char *key, int n_dims,
                              const int64_t *shape, struct spin_array *info, float **out);
/* Appends the layer `key`.weight, `key`.bias to a network; n_in and n_out may be -1 for any size.
 */
spin_status spin_model_layer(struct spin_model *m, const char *key, int n_in, int n_out,
                             enum mlp_ending ending, struct mlp_net *net);
/* Appends the layers stem.from, stem.(from + 2), ... up to the first that does not exist, each
 * [width][width] followed by a ReLU. */
spin_status spin_model_trunk(struct spin_model *m, const char *stem, int from, int width,
                             struct mlp_net *net);
/* Appends two layers, name.1 followed by a ReLU, and name.3. */
spin_status spin_model_head(struct spin_model *m, const char *name, int width, int n_out,
                            struct mlp_net *net);
