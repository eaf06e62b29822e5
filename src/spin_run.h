/* spin_run.h - the calls behind the commands: their options and what they report. See spin.h; the options of a
 * retraining are in spin_train.h. */
#ifndef SPIN_RUN_H
#define SPIN_RUN_H

#include "spin_train.h"

#ifdef __cplusplus
extern "C" {
#endif

struct spin_import_options {
    const char *input, *output;   /* output NULL: describe only */
    const char *from;             /* importer, NULL: detect */
    const char *data, *data_from; /* data set, or NULL */
    const char *pair;             /* "auto", "number" or "order"; NULL: auto */
    const char *frame_times; /* of the data set: "auto", "data", "unit" or "count"; NULL: auto */
    int n_frames;            /* continuous methods: sample this many; 0: not asked */
    const double *times;     /* continuous methods: sample here */
    int n_times;
    struct spin_range range;
    bool positions_only, force;
    bool sync;                       /* write the bundle to the disk (fsync) before it is renamed */
    bool full;                       /* describe: read every frame, not up to 16 of them */
    const char *check_cameras;       /* folder for PNGs of the points over data's images, or NULL */
    const char *const *plugin_pairs; /* see struct spin_plugin_values */
};

/* The calls below report what they did as a JSON document, malloc'ed; its keys are those of --json, which the
 * commands' manuals describe. Of several processes rank 0 has it. NULL: it is not wanted. */

/* Import a foreign run to a bundle, or only describe it. */
spin_status spin_import(const struct spin_import_options *o, char **report);

/* What a bundle holds and how it was made. Of its arrays only the headers are read. SPIN_E_NOT_RECOGNISED when the
 * file is no bundle. */
spin_status spin_bundle_describe(const char *path, char **report);

spin_status spin_retrain(const struct spin_retrain_options *o, char **report);

struct spin_eval_options {
    const char *input, *data, *data_from, *pair;
    enum spin_split split;
    const int *test_cameras;
    int n_test_cameras;
    struct spin_range range;
    double image_scale;
    bool source;        /* measure the imported attributes */
    const char *images; /* folder for renders, or NULL */
    enum spin_dynamic_from dynamic;
    const char *report, *log; /* a page of HTML; what spin-retrain --log wrote; or NULL */
    const char *lpips; /* folder with the weights of one or both networks of LPIPS; or NULL */
    const char *lpips_backbone, *lpips_lin; /* the two files of one network; or NULL */
    float background[3];
    const char *device;
    int n_threads;
    bool force;
};

spin_status spin_eval(const struct spin_eval_options *o, char **report);

struct spin_export_options {
    const char *input, *output, *to;
    struct spin_range range;
    bool source, force;
    bool sync;  /* files are on the disk before they have their names */
    bool check; /* read back what was written */
    const char *data, *data_from, *pair;
    float background[3];
    const char *device;
    int n_threads;
    const char *const *plugin_pairs;
};

spin_status spin_export(const struct spin_export_options *o, char **report);

#ifdef __cplusplus
}
#endif

#endif
