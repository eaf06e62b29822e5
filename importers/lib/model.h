/* A model of a method from open() to close(): what it holds, how the files of a run are found and
 * read, and how tensors, layers and columns get out of them. An importer's own struct begins with a
 * struct spin_model. */
#pragma once

#include "base/base.h"
#include "formats/gs_ply.h"
#include "importers/lib/mlp_eval.h"
#include "importers/lib/run_config.h"
#include "io/torch.h"

/* ---- Life ------------------------------------------------------------------------------------ */

struct spin_model {
    struct spin_arena arena;         /* paths, weights, tables: what lives as long as the model */
    struct spin_arena scratch;       /* until open() is over */
    struct spin_model_block *blocks; /* private: of malloc(), as long */
    const char *path;                /* the file that frame() names */
    struct spin_ply ply;     /* the cloud at hand; closed by the next, and when open() is over */
    struct spin_torch torch; /* the checkpoint at hand */
    const struct spin_value *tensors; /* the dict with its tensors, */
    const char *prefix;               /* and what their names begin with */
    struct run_config settings;       /* cfg_args, and the YAML of some methods */
    struct spin_splats canonical;
    struct spin_splats_4d splats_4d;
    struct mlp_team team;
    /* Those of open(), while it runs. */
    const struct spin_plugin_values *values;
    struct spin_sequence_info *sequence;
};

/* Defines the importer `id`, whose model is a `type`: a new one is given to fn(model, path), and to
 * closes(model) at last. What else its table has follows, `.summary = "..."` and so on. */
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
/* The same of a reader of data sets, whose struct lives while fn(it, views) runs: `label` is the
 * plug-in's. */
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
/* An importer's close(): all that the struct above holds, and the model. Or without the model:
 * readers of data sets begin with a struct of zeros and values alone, for its memory. */
void spin_model_close(void *self);
void spin_model_clear(struct spin_model *m);

/* The value of an option, or NULL; the same as a value of cfg_args. */
const char *spin_model_option(const struct spin_model *m, const char *key);
struct cfg_span spin_model_given(const struct spin_model *m, const char *key);
/* What the option says, else `key` of cfg_args, else nothing: *out keeps its value. */
spin_status spin_model_bool(const struct spin_model *m, const char *option, const char *key,
                            bool *out);
spin_status spin_model_number(const struct spin_model *m, const char *option, const char *key,
                              double *out);
/* Which of words "a|b|c" the option (or NULL) says, else `key` of cfg_args in its quotes; -1:
 * neither, or another. */
spin_status spin_model_word(const struct spin_model *m, const char *option, const char *key,
                            const char *words, int *out);
/* (m, count, size, out): zeroed, as long as the model lives; until open() is over. */
#define spin_model_alloc(m, ...) spin_arena_take(&(m)->arena, __VA_ARGS__)
#define spin_model_scratch(m, ...) spin_arena_take(&(m)->scratch, __VA_ARGS__)
/* A path: `fmt` below a folder; (m, out, fmt, ...): text alone. */
#define spin_model_text(m, out, ...) spin_model_join(m, out, "", __VA_ARGS__)
spin_status spin_model_join(struct spin_model *m, const char **out, const char *folder,
                            const char *fmt, ...) SPIN_PRINTF(4, 5);
/* The same where there is such a file (or folder), else NULL. */
#define spin_model_find(m, out, ...) spin_model_there(spin_model_join(m, out, __VA_ARGS__), out)
spin_status spin_model_there(spin_status status, const char **out);
/* The folder that a path lies in. */
spin_status spin_model_folder(struct spin_model *m, const char **out, const char *path);
spin_status spin_model_absolute(struct spin_model *m, const char **out, const char *path);
/* As spin_folder_list(). */
spin_status spin_model_names(struct spin_model *m, const char *folder, char ***names, size_t *n);

/* What most sequences have in common: any time from 0 to 1, rows of which each is the same
 * Gaussian, all columns, of which those in `moved` change. counts: as long as the model, or NULL.
 */
void spin_model_describe(const struct spin_model *m, const size_t *counts, int sh_degree,
                         unsigned moved);

/* Models that are 4D splats fill m->splats_4d, and call this: they are settled, and described as
 * any time from 0 to 1 without identity. Their frame() and splats_4d() are the two below. */
spin_status spin_model_settle_4d(struct spin_model *m);
spin_status spin_model_slice(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out);
spin_status spin_model_splats_4d(void *self, const struct spin_splats_4d **out);

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Whether a folder has an entry of this name; whether a word stands in the first bytes. */
bool spin_peek_has(const struct spin_peek *peek, const char *name);
bool spin_peek_says(const struct spin_peek *peek, const char *word);

/* ---- Columns --------------------------------------------------------------------------------- */

/* Of splats by number, in the order of enum spin_column, from means to SH: values and floats of a
 * row. */
enum { SPIN_MODEL_COLUMNS = 5 };
float *spin_model_values(const struct spin_splats *s, int column, size_t *width);
/* The columns of a frame: arithmetic can leave the range of floats where the file did not. */
spin_status spin_model_check(const char *path, double time, unsigned columns,
                             const struct spin_splats *s);

/* ---- The folder of a run --------------------------------------------------------------------- */

/* N of a folder named exactly iteration_<digits>, else -1. */
long long spin_model_iteration(const char *name);
bool spin_model_holds(const char *folder, const char *file);
/* The name of the save to read, "iteration_<N>" of `folder` with `file` in it, and `file2` (not
 * NULL) in that of folder2: `wanted` is N or "best", NULL the largest N that is whole, and "best"
 * when there is no number. NULL when there is none. */
spin_status spin_model_choose(struct spin_model *m, const char *wanted, const char *folder,
                              const char *file, const char *folder2, const char *file2,
                              const char **out);
/* The model's path: `path` itself, or of the files of this folder, or of `inner` in it, the one of
 * the greatest step, by step_of(name), -1: none. `called` says in messages what such files are
 * called. */
spin_status spin_model_newest(struct spin_model *m, const char *path, const char *inner,
                              long long (*step_of)(const char *name), const char *called);
/* The folder of the save to read, as option `iteration` says, for models whose network `network`
 * lies beside the cloud: `path` is the model's folder, the point_cloud in it, a save, or one of the
 * two files. NULL when there is none. */
spin_status spin_model_save(struct spin_model *m, const char *path, const char *network,
                            const char **out);
/* Whether `file` is in a save of the model, or in the model itself; *coarse: there are saves of a
 * first stage only. */
bool spin_model_search(const char *path, const char *file, bool *coarse);
/* The file `name` in folder `path`, or else in `save` or up to two folders above it; save may be
 * NULL. NULL when there is none. */
spin_status spin_model_beside(struct spin_model *m, const char *path, const char *save,
                              const char *name, const char **out);
/* For checkpoints: the cfg_args beside the model's path, and the YAML that option `config` names,
 * else one found there that tells the clip's times. */
spin_status spin_model_config(struct spin_model *m);
/* Opens the cfg_args found so into the settings, whose path stays NULL when there is none. */
spin_status spin_model_cfg(struct spin_model *m, const char *path, const char *save);

/* ---- The cloud ------------------------------------------------------------------------------- */

/* A property of the vertices into out, every `step` floats; finite. */
spin_status spin_model_column(const struct spin_ply *ply, const struct spin_ply_element *e,
                              const char *name, float *out, size_t step);
/* prefix0, prefix1, ... into out[0..n), every `step` floats. */
spin_status spin_model_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                               const char *prefix, int n, float *out, size_t step);
/* Properties whose names begin so. */
int spin_model_count(const struct spin_ply_element *e, const char *prefix);
/* Opens a cloud of any kind as the one at hand. */
spin_status spin_model_ply(struct spin_model *m, const char *path);
/* The same of any properties and at least one vertex; of Gaussians, perhaps none, of SH degree at
 * most 3. */
spin_status spin_model_vertices(struct spin_model *m, const char *path,
                                const struct spin_ply_element **vertex);
spin_status spin_model_cloud(struct spin_model *m, const char *path, struct spin_gs_ply *cloud);
/* All columns into the canonical splats as they are stored, quaternions not normalised. Besides,
 * where `extra` is not NULL, properties extra0, extra1, ... [n][n_extra]; n_extra 0: the one of
 * that very name. */
spin_status spin_model_read(struct spin_model *m, const char *path, const char *extra, int n_extra,
                            float **values);

/* ---- Tensors --------------------------------------------------------------------------------- */

/* With the checkpoint at `path` open, fn(m); it is closed then. Failures name the path. */
spin_status spin_model_torch(struct spin_model *m, const char *path,
                             spin_status (*fn)(struct spin_model *m));
/* What was saved is a dict: the tensors. */
spin_status spin_model_dict(struct spin_model *m);
/* All their names begin with the prefix and one of these: methods built on one add to its network,
 * which would change the result. The list ends with NULL. */
spin_status spin_model_keys(const struct spin_model *m, const char *const *stems);
/* The value prefix + key, and whether there is one: NULL when not. */
const struct spin_value *spin_model_get(const struct spin_model *m, const char *fmt, ...)
    SPIN_PRINTF(2, 3);
/* A tensor by name as floats; -1 in `shape` matches anything. info: or NULL. */
spin_status spin_model_floats(struct spin_model *m, const char *key, int n_dims,
                              const int64_t *shape, struct spin_array *info, float **out);
/* Appends to a network the layer `key`.weight, `key`.bias; n_in and n_out are -1 where any will do.
 */
spin_status spin_model_layer(struct spin_model *m, const char *key, int n_in, int n_out,
                             enum mlp_ending ending, struct mlp_net *net);
/* Layers stem.from, stem.(from + 2), ... as long as there are any, each [width][width] with a ReLU
 * behind it. */
spin_status spin_model_trunk(struct spin_model *m, const char *stem, int from, int width,
                             struct mlp_net *net);
/* Two layers, name.1 with a ReLU and name.3. */
spin_status spin_model_head(struct spin_model *m, const char *name, int width, int n_out,
                            struct mlp_net *net);
