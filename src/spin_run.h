/* spin_run.h - the calls behind the commands: their options and what they report. See spin.h; the
 * options of a retraining are in spin_train.h. */
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
    unsigned precision;        /* of the values of 4D splats: 0 to the bit, 1 half, 2 compact, as of
                                  spin_precision */
    bool sync;                 /* write the bundle to the disk (fsync) before it is renamed */
    bool full;                 /* describe: read every frame, not up to 16 of them */
    const char *check_cameras; /* folder for PNGs of the points over data's images, or NULL */
    const char *const *plugin_pairs; /* see struct spin_plugin_values */
};

/* The calls below report what they did as a JSON document, malloc'ed; its keys are those of --json,
 * which the commands' manuals describe. Of several processes rank 0 has it. NULL: it is not wanted.
 */

/* Import a foreign run to a bundle, or only describe it. */
spin_status spin_import(const struct spin_import_options *o, char **report);

/* What a bundle holds and how it was made. Of its arrays only the headers are read.
 * SPIN_E_NOT_RECOGNISED when the file is no bundle. */
spin_status spin_bundle_describe(const char *path, char **report);

/* The pictures of its data set, an array: frame (from 0), number, camera, test, width, height, fx,
 * fy, cx, cy, w2c (as of struct spin_camera), image, mask (or null). data, data_from: NULL as the
 * bundle says. */
spin_status spin_bundle_views(const char *path, const char *data, const char *data_from,
                              char **report);

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
    bool mask; /* score what the data set's masks or the images' alpha show, and nothing else */
    const char *report, *log; /* a page of HTML; what spin-retrain --log wrote; or NULL */
    const char *lpips; /* folder with the weights of one or both networks of LPIPS; or NULL */
    const char *lpips_backbone, *lpips_lin; /* the two files of one network; or NULL */
    float background[3];
    const char *device;
    int n_threads;
    bool force;
};

spin_status spin_eval(const struct spin_eval_options *o, char **report);

/* The same of n bundles on the same views; o->input, log and images do not count, report is a page
 * that compares them. figures: a folder for its charts and pictures, or NULL. The document has
 * "runs", which are those of spin_eval() with "input" and "name" each. */
spin_status spin_compare(const struct spin_eval_options *o, const char *const *input, int n,
                         const char *figures, char **report);

/* AUTO: as trained. OFF: without the backdrop of a training, for a subject alone. */
enum spin_export_backdrop { SPIN_EXPORT_BACKDROP_AUTO, SPIN_EXPORT_BACKDROP_OFF };

struct spin_export_options {
    const char *input, *output, *to;
    struct spin_range range;
    bool source, force;
    bool sync;            /* files are on the disk before they have their names */
    bool check;           /* read back what was written */
    const char *decimate; /* "5000" splats, "50%" of them, "2MB" in all or a loss of "40dB"; NULL:
                             all are written */
    const char *data, *data_from, *pair;
    float background[3];
    bool transparent; /* pictures have alpha instead of a background */
    const char *device;
    int n_threads;
    const char *const *plugin_pairs;

    /* What is left of the scene, by its own units and axes; then its size and place. */
    double crop[6];  /* low and high corner of a box, or centre and radius of a sphere */
    int n_crop;      /* 6: a box; 4: a sphere; 0: none */
    int min_views;   /* training views of its frame that a splat is in; 0: any */
    double floaters; /* largest distance to the nearest, as a multiple of the median; 0: any */
    enum spin_export_backdrop backdrop;
    double scale;        /* above 0; 0: 1 */
    double translate[3]; /* after the scale */
};

spin_status spin_export(const struct spin_export_options *o, char **report);

/* The exporter that writes files with this ending, such as "html" for "clip.html"; or NULL. Names
 * of formats and endings have no case. */
const char *spin_exporter_for(const char *output);
/* What is written of the same kind as files with an ending that nothing writes; else the ending
 * that is spelled most like it, or NULL. */
const char *spin_exporter_nearest(const char *ending);
/* The exporter that writes a format or its nearest, such as "video" for "mp4" and "mov"; or NULL.
 */
const char *spin_exporter_of_format(const char *format);
const struct spin_exporter *spin_exporter_named(const char *name); /* or NULL */
/* SPIN_E_USAGE where the name of the output is that of files of another exporter. */
spin_status spin_exporter_check_name(const struct spin_exporter *e, const char *output);
/* SPIN_E_USAGE where a bundle would be named as another format. */
spin_status spin_bundle_check_name(const char *output);
/* The same of a page of HTML. */
spin_status spin_report_check_name(const char *path);

/* A run into what viewers play, by the calls above. Beside the output lies its bundle, OUTPUT's
 * name with .spin. */
struct spin_convert_options {
    const char *input, *output;   /* a run or a bundle; NULL: the input's name with .html, here */
    const char *to;               /* exporter; NULL: what the output's ending says */
    const char *from;             /* importer; NULL: detected */
    const char *data, *data_from; /* data set; NULL: the only one in the run or beside it */
    int n_frames;                 /* as of an import */
    bool no_retrain;              /* else it is retrained, when there is a data set */
    const char *preset;           /* of a retraining; NULL: the default */
    int iterations;               /* of it; 0: the preset's */
    const char *device;
    int n_threads;
    bool force;
};

/* After an interruption the same call goes on with the unfinished retraining. */
spin_status spin_convert(const struct spin_convert_options *o, char **report);

#ifdef __cplusplus
}
#endif

#endif
