/* Model folders of 3DGS and its descendants: which save to read, the canonical cloud in it, and the
 * text beside it. */
#ifndef SPIN_IMPORTERS_LIB_MODEL_FOLDER_H
#define SPIN_IMPORTERS_LIB_MODEL_FOLDER_H

#include "formats/gs_ply.h"
#include "importers/lib/cfg_args.h"

/* N of a folder named exactly iteration_<digits>, else -1. */
long long spin_model_folder_iteration(const char *name);

bool spin_model_folder_holds(const char *folder, const char *file);

/* `folder`/iteration_<N> holds `file`, and `other`/iteration_<N> (other not NULL) holds
 * `other_file`. */
struct model_folder_pick {
    const char *folder, *file, *other, *other_file;
};

/* The name of the save to read, "iteration_<N>": `wanted` is N or "best", NULL the largest N that
 * is whole, and "best" when there is no number. *out stays NULL when there is none. */
spin_status spin_model_folder_choose(const struct model_folder_pick *pick, const char *wanted,
                                     char **out);

/* The folder of the save to read, for models whose network `network` lies beside the cloud: `path`
 * is the model's folder, the point_cloud in it, a save, or one of the two files. *out stays NULL
 * when there is none; allocated. */
spin_status spin_model_folder_save(const char *path, const char *wanted, const char *network,
                                   char **out);

/* Whether `file` is in a save of the model, or in the model itself; *coarse: there are saves of a
 * first stage only. */
bool spin_model_folder_search(const char *path, const char *file, bool *coarse);

/* The file `name` in folder `path`, or else in `save` or up to two folders above it; save may be NULL.
 * *out is NULL when there is none; allocated. */
spin_status spin_model_folder_beside(const char *path, const char *save, const char *name,
                                     char **out);

/* Opens the cfg_args found so; cfg->path stays NULL when there is none. */
spin_status spin_model_folder_cfg(const char *path, const char *save, struct cfg_args *cfg);

/* A property of the vertices into out, every `step` floats; finite. */
spin_status spin_model_folder_column(const struct spin_ply *ply, const struct spin_ply_element *e,
                                     const char *name, float *out, size_t step);

/* prefix0, prefix1, ... into out[0..n), every `step` floats. */
spin_status spin_model_folder_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                                      const char *prefix, int n, float *out, size_t step);

/* Properties whose names begin so. */
int spin_model_folder_count(const struct spin_ply_element *e, const char *prefix);

/* The vertices of a cloud of any properties; at least one. Closed again on failure. */
spin_status spin_model_folder_open(const char *path, struct spin_ply *ply,
                                   const struct spin_ply_element **vertex);

/* The Gaussians of a cloud, perhaps none; SH degree at most 3. Closed again on failure. */
spin_status spin_model_folder_cloud(const char *path, struct spin_ply *ply,
                                    struct spin_gs_ply *cloud);

/* All columns as they are stored, quaternions not normalised. extra: one more property [n], or
 * NULL. */
spin_status spin_model_folder_read(const char *path, struct spin_splats *out,
                                   const char *extra_name, float **extra);

/* The network's arithmetic can leave the range of floats where the file did not. */
spin_status spin_model_folder_check(const char *path, double time, unsigned columns,
                                    const struct spin_splats *s);

#endif
