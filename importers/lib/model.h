/* The model of an importer from open() to close(): its memory, the search for the files that a
 * training wrote, and the reading of columns, tensors and layers. An importer's own struct begins
 * with a struct spin_model. */
#pragma once

#include "base/base.h"
#include "formats/gs_ply.h"
#include "importers/lib/mlp_eval.h"
#include "importers/lib/run_config.h"
#include "io/torch.h"

/* ---- Opening and closing --------------------------------------------------------------------- */

struct spin_model {
    struct spin_arena arena;         /* paths, weights and tables, freed with the model */
    struct spin_arena scratch;       /* memory that is freed when open() returns */
    struct spin_model_block *blocks; /* private: malloc() blocks, freed with the model */
    const char *path;                /* the file that frame() names in error messages */
    /* The cloud that is open. It is closed when another cloud is opened, and when open() returns.
     */
    struct spin_ply ply;
    struct spin_torch torch;          /* the checkpoint that is open */
    const struct spin_value *tensors; /* the dict of tensors in `torch` */
    const char *prefix;               /* prefix of the names in `tensors`; "" by default */
    struct run_config settings;       /* cfg_args and, for some methods, a YAML file */
    struct spin_splats canonical;     /* the cloud before its deformation */
    struct spin_splats_4d splats_4d;
    struct spin_sound sound;
    struct mlp_team team;
    /* Arguments of open(), valid until open() returns. */
    const struct spin_plugin_values *values;
    struct spin_sequence_info *sequence;
};

/* Defines the importer `id`. Its open() allocates the model, a zeroed `type`, and calls fn(model,
 * path); its close() is `closes`. The variable arguments initialise other members of the struct
 * spin_importer, such as `.summary = "..."`. */
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
/* Defines the importer `id`, a reader of data sets whose plug-in name is `label`. Its views() calls
 * fn(set, views), where `set` is a zeroed `type` that is cleared when fn returns. */
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
/* spin_model_close() frees the members of struct spin_model and the model itself; importers use it
 * as their close(). spin_model_clear() frees only the members, for a model on the stack. */
void spin_model_close(void *self);
void spin_model_clear(struct spin_model *m);

/* Returns the value of the option `key`, or NULL if the option is not given.
 * spin_model_option_span() returns the same text as a span, so that it can be parsed like a value
 * of cfg_args; `at` is NULL if the option is not given. */
const char *spin_model_option(const struct spin_model *m, const char *key);
struct cfg_span spin_model_option_span(const struct spin_model *m, const char *key);
/* Reads the value of `option` or, if the option is not given, that of `key` in cfg_args. If
 * cfg_args does not contain the key either, *out keeps its value. */
spin_status spin_model_bool(const struct spin_model *m, const char *option, const char *key,
                            bool *out);
spin_status spin_model_number(const struct spin_model *m, const char *option, const char *key,
                              double *out);
/* Sets *out to the index of a word in the list `words`, such as "a|b|c". The word is the value of
 * `option`, if `option` is not NULL and is given, otherwise the quoted value of `key` in cfg_args.
 * *out is -1 if there is neither value, or if the value in cfg_args is not in the list. An option
 * whose value is not in the list is an error. */
spin_status spin_model_word(const struct spin_model *m, const char *option, const char *key,
                            const char *words, int *out);
/* Set *out to zeroed memory for `count` elements of `size` bytes, where the arguments are (m,
 * count, size, out). Memory of spin_model_alloc() is freed with the model, memory of
 * spin_model_scratch() when open() returns. */
#define spin_model_alloc(m, ...) spin_arena_take(&(m)->arena, __VA_ARGS__)
#define spin_model_scratch(m, ...) spin_arena_take(&(m)->scratch, __VA_ARGS__)
/* Sets *out to the path of `folder`, a slash and the formatted text. spin_model_text(m, out, fmt,
 * ...) sets *out to the formatted text alone. The result is freed with the model. */
#define spin_model_text(m, out, ...) spin_model_join(m, out, "", __VA_ARGS__)
spin_status spin_model_join(struct spin_model *m, const char **out, const char *folder,
                            const char *fmt, ...) SPIN_PRINTF(4, 5);
/* Like spin_model_join(), but sets *out to NULL if no such file or folder exists. */
#define spin_model_find(m, out, ...) spin_model_if_exists(spin_model_join(m, out, __VA_ARGS__), out)
spin_status spin_model_if_exists(spin_status status, const char **out);
/* spin_model_folder() sets *out to the parent folder of `path`, spin_model_absolute() to the
 * absolute form of `path`. */
spin_status spin_model_folder(struct spin_model *m, const char **out, const char *path);
spin_status spin_model_absolute(struct spin_model *m, const char **out, const char *path);
/* Sets *out to the file name `name` of a document that may have been written on Windows. Removes
 * trailing white space, and replaces backslashes by slashes unless `folder` contains a file with
 * the original name. */
spin_status spin_model_name(struct spin_model *m, const char *folder, const char *name,
                            const char **out);
/* Like spin_folder_list(), but the list is freed with the model. */
spin_status spin_model_names(struct spin_model *m, const char *folder, char ***names, size_t *n);

/* Fills m->sequence as most methods need it: times are continuous from 0 to 1, row i is the same
 * Gaussian at all times, and all columns exist. The columns in `moved` change over time; all others
 * are static. `counts` is NULL or the address of the number of Gaussians, which must stay valid as
 * long as the model exists. */
void spin_model_describe(const struct spin_model *m, const size_t *counts, int sh_degree,
                         unsigned moved);

/* For models that are 4D splats; to be called once, when m->splats_4d is filled. Drops rows with
 * nonfinite values (SPIN_E_MALFORMED if no row is left), prepares the splats for slicing, and fills
 * m->sequence: times are continuous from 0 to 1, and row i may be another Gaussian in every frame.
 * Importers of such models use spin_model_slice() as frame() and spin_model_splats_4d() as
 * splats_4d(). */
spin_status spin_model_finish_4d(struct spin_model *m);
/* Sets the sound of m->sequence to a copy of *sound, unless sound->data is NULL. */
spin_status spin_model_sound(struct spin_model *m, const struct spin_sound *sound);
spin_status spin_model_slice(void *self, int frame, double time, unsigned columns,
                             struct spin_splats *out);
spin_status spin_model_splats_4d(void *self, const struct spin_splats_4d **out);

/* ---- Recognising ----------------------------------------------------------------------------- */

/* spin_peek_has() returns whether the input is a folder that contains an entry with this name,
 * spin_peek_contains() whether peek->head contains the word. */
bool spin_peek_has(const struct spin_peek *peek, const char *name);
bool spin_peek_contains(const struct spin_peek *peek, const char *word);

/* ---- Columns --------------------------------------------------------------------------------- */

/* Columns are numbered in the order of enum spin_column: 0 means, 1 quaternions, 2 log scales, 3
 * logit opacities, 4 SH. spin_model_values() returns the values of a column and sets *width to the
 * number of floats per row. */
enum { SPIN_MODEL_COLUMNS = 5 };
float *spin_model_values(const struct spin_splats *s, int column, size_t *width);
/* Returns SPIN_E_MALFORMED if the given columns of a frame contain nonfinite values. Even if all
 * values of the file are finite, the evaluation of the model can overflow. */
spin_status spin_model_check(const char *path, double time, unsigned columns,
                             const struct spin_splats *s);

/* ---- The folder of a training ---------------------------------------------------------------- */

/* Returns N if the name is exactly iteration_<N>, otherwise -1. */
long long spin_model_iteration(const char *name);
bool spin_model_holds(const char *folder, const char *file);
/* Sets *out to the name of the checkpoint to read: a folder iteration_<N> in `folder` that contains
 * `file`. If folder2 is not NULL, a folder with the same name in folder2 must contain file2.
 * `wanted` is N or "best", or NULL for the largest N with these files; iteration_best is then read
 * only if no numbered folder has the files. *out is NULL if no folder matches. */
spin_status spin_model_choose(struct spin_model *m, const char *wanted, const char *folder,
                              const char *file, const char *folder2, const char *file2,
                              const char **out);
/* Sets m->path to the file to read. If `path` is a file, this is `path`. If it is a folder, this is
 * the file with the largest step_of(name) in the folder path/inner or, if that does not exist, in
 * `path`; step_of() returns -1 for names of other files. `called` describes the files in messages.
 */
spin_status spin_model_newest(struct spin_model *m, const char *path, const char *inner,
                              long long (*step_of)(const char *name), const char *called);
/* For models with a file `network` in the same folder as point_cloud.ply: sets *out to the folder
 * of the checkpoint to read, or to NULL if there is none. `path` is the model's folder, its
 * subfolder point_cloud, the folder of a checkpoint, or either of the two files in it. For the
 * first two, option `iteration` selects the checkpoint. */
spin_status spin_model_checkpoint(struct spin_model *m, const char *path, const char *network,
                                  const char **out);
/* Returns whether `file` exists in the model's folder `path` or in the folder of one of its
 * checkpoints. Sets *coarse to whether the model has checkpoints of the coarse stage, folders
 * coarse_iteration_<N>. */
bool spin_model_search(const char *path, const char *file, bool *coarse);
/* Sets *out to the first existing file `name` in the folder `path`, in the folder `save`, and in
 * the two folders above `save`, or to NULL if there is none. If `save` is NULL, only `path` is
 * searched. */
spin_status spin_model_find_upwards(struct spin_model *m, const char *path, const char *save,
                                    const char *name, const char **out);
/* For models that consist of one checkpoint file, m->path. Opens two optional files as m->settings:
 * cfg_args in the folder of the checkpoint, and a YAML file. The YAML file is that of option
 * `config` or, without the option, one in the same folder that contains time_duration. */
spin_status spin_model_config(struct spin_model *m);
/* Opens the cfg_args that spin_model_find_upwards() finds; settings.cfg.path stays NULL if there is
 * none.
 */
spin_status spin_model_cfg(struct spin_model *m, const char *path, const char *save);

/* ---- The cloud ------------------------------------------------------------------------------- */

/* Reads the property `name` of all vertices. The value of vertex i is written to out[i * step].
 * Nonfinite values are an error. */
spin_status spin_model_column(const struct spin_ply *ply, const struct spin_ply_element *e,
                              const char *name, float *out, size_t step);
/* Reads the n properties <prefix>0, <prefix>1, ... of all vertices. The values of vertex i are
 * written to out[i * step] and the n - 1 floats that follow. Nonfinite values are an error. */
spin_status spin_model_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                               const char *prefix, int n, float *out, size_t step);
/* Returns the number of properties whose names begin with `prefix`. */
int spin_model_count(const struct spin_ply_element *e, const char *prefix);
/* Chooses a shift if positions are so far from 0 that floats would round them to steps of more than
 * some millionths of the scene's extent, and stores it as `shift` and as that of m->sequence, with
 * a note. means [n][3]: the positions, rounded to floats; nonfinite ones are ignored. If the file
 * itself contains floats (`wide` is false), a shift cannot restore precision, so the function only
 * warns. */
spin_status spin_model_choose_shift(struct spin_model *m, const char *path, const float *means,
                                    size_t n, bool wide, double shift[3]);
/* Opens a PLY file as m->ply, whatever elements it contains. */
spin_status spin_model_ply(struct spin_model *m, const char *path);
/* Open a PLY file as m->ply and find its vertices. spin_model_vertices() accepts any properties but
 * requires at least one vertex. spin_model_cloud() requires the properties of Gaussians, with SH of
 * degree 0 to 3, but accepts 0 vertices. */
spin_status spin_model_vertices(struct spin_model *m, const char *path,
                                const struct spin_ply_element **vertex);
spin_status spin_model_cloud(struct spin_model *m, const char *path, struct spin_gs_ply *cloud);
/* Reads all columns of a cloud with at least one vertex into m->canonical. The values are those of
 * the file; quaternions are not normalised. If `extra` is not NULL, also reads further properties:
 * <extra>0, <extra>1, ... into *values [n][n_extra] or, if n_extra is 0, the property `extra` into
 * *values [n]. */
spin_status spin_model_read(struct spin_model *m, const char *path, const char *extra, int n_extra,
                            float **values);

/* ---- Tensors --------------------------------------------------------------------------------- */

/* Opens the checkpoint at `path` as m->torch, calls fn(m) and closes the checkpoint. Error messages
 * contain the path. */
spin_status spin_model_torch(struct spin_model *m, const char *path,
                             spin_status (*fn)(struct spin_model *m));
/* Sets m->tensors to the root of the checkpoint m->torch; it is an error if that is not a dict. */
spin_status spin_model_dict(struct spin_model *m);
/* Returns SPIN_E_UNSUPPORTED if there is a tensor whose name does not begin with m->prefix followed
 * by one of `stems`, a list that ends with NULL. Such a tensor belongs to a derived method, whose
 * result would be different. */
spin_status spin_model_keys(const struct spin_model *m, const char *const *stems);
/* Returns the value in m->tensors whose name is m->prefix followed by the formatted text, or NULL
 * if there is none. */
const struct spin_value *spin_model_get(const struct spin_model *m, const char *fmt, ...)
    SPIN_PRINTF(2, 3);
/* Reads the tensor whose name is m->prefix followed by `key` into floats *out, which are freed with
 * the model. It must have the shape `shape` [n_dims], where -1 matches any size. If `info` is not
 * NULL, *info receives the description of the tensor. */
spin_status spin_model_floats(struct spin_model *m, const char *key, int n_dims,
                              const int64_t *shape, struct spin_array *info, float **out);
/* Appends a layer to a network. Its tensors are <key>.weight [n_out][n_in] and <key>.bias [n_out];
 * if n_in or n_out is -1, any size is accepted. */
spin_status spin_model_layer(struct spin_model *m, const char *key, int n_in, int n_out,
                             enum mlp_ending ending, struct mlp_net *net);
/* Appends the layers <stem>.<from>, <stem>.<from + 2>, ... until a number does not exist. Each has
 * weights [width][width] and is followed by a ReLU. */
spin_status spin_model_trunk(struct spin_model *m, const char *stem, int from, int width,
                             struct mlp_net *net);
/* Appends two layers: <name>.1 with weights [width][width], followed by a ReLU, and <name>.3 with
 * weights [n_out][width]. */
spin_status spin_model_head(struct spin_model *m, const char *name, int width, int n_out,
                            struct mlp_net *net);
