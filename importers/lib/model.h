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
    struct spin_ply ply;     /* the open cloud; closed by the next, and when open() returns */
    struct spin_torch torch; /* the open checkpoint */
    const struct spin_value *tensors; /* its dict of tensors */
    const char *prefix;               /* prefix of the tensors' names */
    struct run_config settings;       /* cfg_args, and the YAML of some methods */
    struct spin_splats canonical;
    struct spin_splats_4d splats_4d;
    struct mlp_team team;
    /* Arguments of open(), valid until it returns. */
    const struct spin_plugin_values *values;
    struct spin_sequence_info *sequence;
};

/* Defines the importer `id`: open() calls fn(model, path) with a zeroed `type`, and `closes` is its
 * close(). Other members of the importer follow, `.summary = "..."` and so on. */
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
/* spin_model_close() is an importer's close(): it frees all that the struct above holds, and the
 * model. spin_model_clear() does not free the model itself, such as one on the stack. */
void spin_model_close(void *self);
void spin_model_clear(struct spin_model *m);

/* The value of an option, or NULL; spin_model_given() returns it like a value of cfg_args. */
const char *spin_model_option(const struct spin_model *m, const char *key);
struct cfg_span spin_model_given(const struct spin_model *m, const char *key);
/* Reads the option, else `key` of cfg_args; if neither is given, *out keeps its value. */
spin_status spin_model_bool(const struct spin_model *m, const char *option, const char *key,
                            bool *out);
spin_status spin_model_number(const struct spin_model *m, const char *option, const char *key,
                              double *out);
/* The index in words "a|b|c" of the option's value (`option` may be NULL), else of the quoted value
 * of `key` in cfg_args; -1 if neither is given or cfg_args has another word. */
spin_status spin_model_word(const struct spin_model *m, const char *option, const char *key,
                            const char *words, int *out);
/* (m, count, size, out): zeroed memory, freed with the model; scratch is freed when open() returns.
 */
#define spin_model_alloc(m, ...) spin_arena_take(&(m)->arena, __VA_ARGS__)
#define spin_model_scratch(m, ...) spin_arena_take(&(m)->scratch, __VA_ARGS__)
/* Joins a folder and a formatted path; spin_model_text(m, out, fmt, ...) formats text only. */
#define spin_model_text(m, out, ...) spin_model_join(m, out, "", __VA_ARGS__)
spin_status spin_model_join(struct spin_model *m, const char **out, const char *folder,
                            const char *fmt, ...) SPIN_PRINTF(4, 5);
/* Like spin_model_join(), but NULL if no such file or folder exists. */
#define spin_model_find(m, out, ...) spin_model_there(spin_model_join(m, out, __VA_ARGS__), out)
spin_status spin_model_there(spin_status status, const char **out);
/* The parent folder of a path; the absolute path. */
spin_status spin_model_folder(struct spin_model *m, const char **out, const char *path);
spin_status spin_model_absolute(struct spin_model *m, const char **out, const char *path);
/* Like spin_folder_list(), but freed with the model. */
spin_status spin_model_names(struct spin_model *m, const char *folder, char ***names, size_t *n);

/* Describes a typical sequence: continuous times 0 to 1, row i the same Gaussian at all times, all
 * columns, of which those in `moved` change. counts: NULL, or valid as long as the model. */
void spin_model_describe(const struct spin_model *m, const size_t *counts, int sh_degree,
                         unsigned moved);

/* For models of 4D splats, when m->splats_4d is filled: settles them and describes the sequence as
 * continuous, 0 to 1, without identity. spin_model_slice() and spin_model_splats_4d() are their
 * frame() and splats_4d(). */
spin_status spin_model_settle_4d(struct spin_model *m);
spin_status spin_model_slice(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out);
spin_status spin_model_splats_4d(void *self, const struct spin_splats_4d **out);

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Whether a folder has an entry of this name; whether the first bytes contain a word. */
bool spin_peek_has(const struct spin_peek *peek, const char *name);
bool spin_peek_says(const struct spin_peek *peek, const char *word);

/* ---- Columns --------------------------------------------------------------------------------- */

/* Columns by number, in the order of enum spin_column, from means to SH: the values and the floats
 * per row. */
enum { SPIN_MODEL_COLUMNS = 5 };
float *spin_model_values(const struct spin_splats *s, int column, size_t *width);
/* Refuses a frame with nonfinite values: evaluating a finite file can overflow. */
spin_status spin_model_check(const char *path, double time, unsigned columns,
                             const struct spin_splats *s);

/* ---- The folder of a run --------------------------------------------------------------------- */

/* N of a folder named exactly iteration_<digits>, else -1. */
long long spin_model_iteration(const char *name);
bool spin_model_holds(const char *folder, const char *file);
/* The name of the save to read: an iteration_<N> in `folder` that contains `file` and, unless
 * folder2 is NULL, also contains file2 in folder2. `wanted` is N or "best"; NULL means the largest
 * complete N, or "best" when there is no number. NULL when there is none. */
spin_status spin_model_choose(struct spin_model *m, const char *wanted, const char *folder,
                              const char *file, const char *folder2, const char *file2,
                              const char **out);
/* Sets the model's path: `path` itself if it is a file; else, of the files in `inner` of that
 * folder, or in the folder, the one with the greatest step_of(name), where -1 excludes a file.
 * `called` names such files in messages. */
spin_status spin_model_newest(struct spin_model *m, const char *path, const char *inner,
                              long long (*step_of)(const char *name), const char *called);
/* The folder of the save to read, by option `iteration`, for models whose file `network` is beside
 * the cloud: `path` is the model's folder, its point_cloud, a save, or one of the two files. NULL
 * when there is none. */
spin_status spin_model_save(struct spin_model *m, const char *path, const char *network,
                            const char **out);
/* Whether `file` is in a save of the model, or in the model's folder; *coarse: there are saves of
 * the coarse stage. */
bool spin_model_search(const char *path, const char *file, bool *coarse);
/* Finds the file `name` in folder `path`, or else in `save` or up to two folders above it; save may
 * be NULL. NULL when there is none. */
spin_status spin_model_beside(struct spin_model *m, const char *path, const char *save,
                              const char *name, const char **out);
/* For checkpoints: opens the cfg_args beside the model's path, and the YAML of option `config`,
 * else one beside it that has time_duration. */
spin_status spin_model_config(struct spin_model *m);
/* Opens the cfg_args that spin_model_beside() finds; settings.cfg.path stays NULL when there is
 * none. */
spin_status spin_model_cfg(struct spin_model *m, const char *path, const char *save);

/* ---- The cloud ------------------------------------------------------------------------------- */

/* Reads a property of the vertices into every `step`-th float of out; nonfinite values are an
 * error. */
spin_status spin_model_column(const struct spin_ply *ply, const struct spin_ply_element *e,
                              const char *name, float *out, size_t step);
/* The same for prefix0, prefix1, ... into out[0..n), with `step` floats per vertex. */
spin_status spin_model_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                               const char *prefix, int n, float *out, size_t step);
/* Number of properties whose names begin with `prefix`. */
int spin_model_count(const struct spin_ply_element *e, const char *prefix);
/* Opens any PLY as m->ply. */
spin_status spin_model_ply(struct spin_model *m, const char *path);
/* The same, requiring at least one vertex; spin_model_cloud() requires Gaussians instead, perhaps
 * none, of SH degree at most 3. */
spin_status spin_model_vertices(struct spin_model *m, const char *path,
                                const struct spin_ply_element **vertex);
spin_status spin_model_cloud(struct spin_model *m, const char *path, struct spin_gs_ply *cloud);
/* Reads all columns of at least one Gaussian into m->canonical as stored, quaternions not
 * normalised. If `extra` is not NULL, also reads properties extra0, extra1, ... into values
 * [n][n_extra]; with n_extra 0, the property of that very name. */
spin_status spin_model_read(struct spin_model *m, const char *path, const char *extra, int n_extra,
                            float **values);

/* ---- Tensors --------------------------------------------------------------------------------- */

/* Opens the checkpoint at `path`, calls fn(m) and closes it. Errors name the path. */
spin_status spin_model_torch(struct spin_model *m, const char *path,
                             spin_status (*fn)(struct spin_model *m));
/* Sets m->tensors to the root of the checkpoint, which must be a dict. */
spin_status spin_model_dict(struct spin_model *m);
/* Refuses tensors whose names do not begin with the prefix and one of `stems`, which ends with
 * NULL: derived methods add to the network, which would change the result. */
spin_status spin_model_keys(const struct spin_model *m, const char *const *stems);
/* The value named prefix + key, or NULL. */
const struct spin_value *spin_model_get(const struct spin_model *m, const char *fmt, ...)
    SPIN_PRINTF(2, 3);
/* Reads a tensor by name as floats, freed with the model; -1 in `shape` matches any size. info: or
 * NULL. */
spin_status spin_model_floats(struct spin_model *m, const char *key, int n_dims,
                              const int64_t *shape, struct spin_array *info, float **out);
/* Appends the layer `key`.weight, `key`.bias to a network; n_in and n_out may be -1 for any size.
 */
spin_status spin_model_layer(struct spin_model *m, const char *key, int n_in, int n_out,
                             enum mlp_ending ending, struct mlp_net *net);
/* Appends layers stem.from, stem.(from + 2), ... while there are any, each [width][width] followed
 * by a ReLU. */
spin_status spin_model_trunk(struct spin_model *m, const char *stem, int from, int width,
                             struct mlp_net *net);
/* Appends two layers, name.1 followed by a ReLU, and name.3. */
spin_status spin_model_head(struct spin_model *m, const char *name, int width, int n_out,
                            struct mlp_net *net);
