/* spin_run.h - the calls behind the commands, with their options and reports. The options of a
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
    /* Of the data set: "auto", "data", "unit" or "count"; NULL: auto. */
    const char *frame_times;
    int n_frames;        /* continuous methods: number of samples; 0: not given */
    const double *times; /* continuous methods: sample at these times */
    int n_times;
    struct spin_range range;
    bool positions_only, force;
    /* Of the values of 4D splats: 0 lossless, 1 half, 2 compact (see enum spin_precision). */
    unsigned precision;
    bool sync; /* flush the bundle to the disk (fsync) before renaming it */
    bool full; /* describe only: read every frame instead of at most 16 */
    /* Folder for PNGs of the points drawn over the data set's images, or NULL. */
    const char *check_cameras;
    const char *const *plugin_pairs; /* see struct spin_plugin_values */
};

/* The calls below return a report as a JSON document, which the caller frees with free(); its keys
 * are those of --json, see the commands' manuals. report may be NULL. With several ranks only rank
 * 0 returns it. */

/* Import a foreign run as a bundle, or only describe it. */
spin_status spin_import(const struct spin_import_options *o, char **report);

/* Describe a bundle's contents and how it was made; reads only the headers of its arrays.
 * SPIN_E_NOT_RECOGNISED if the file is not a bundle. */
spin_status spin_bundle_describe(const char *path, char **report);

/* The images of a bundle's data set, as an array of: frame (from 0), number, camera, test, width,
 * height, fx, fy, cx, cy, w2c (see struct spin_camera), image, mask (or null). data, data_from:
 * NULL to use those recorded in the bundle. */
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
    bool source;        /* measure the source instead of the retrained splats */
    const char *images; /* folder for rendered images, or NULL */
    enum spin_dynamic_from dynamic;
    /* Score only the pixels inside the data set's masks or the images' alpha. */
    bool mask;
    /* HTML page to write; log written by spin-retrain --log; or NULL. */
    const char *report, *log;
    /* Folder with the weights of one or both LPIPS networks; or NULL. */
    const char *lpips;
    /* The two files of one LPIPS network; or NULL. */
    const char *lpips_backbone, *lpips_lin;
    float background[3];
    const char *device;
    int n_threads;
    bool force;
};

spin_status spin_eval(const struct spin_eval_options *o, char **report);

/* The same for n bundles on the same views; o->input, log and images are ignored, report is a page
 * that compares the bundles. figures: folder for charts and images, or NULL. The JSON document has
 * "runs": those of spin_eval(), each with "input" and "name". */
spin_status spin_compare(const struct spin_eval_options *o, const char *const *input, int n,
                         const char *figures, char **report);

/* AUTO: as trained. OFF: drop the backdrop that the training added, to isolate a subject. */
enum spin_export_backdrop { SPIN_EXPORT_BACKDROP_AUTO, SPIN_EXPORT_BACKDROP_OFF };

struct spin_export_options {
    const char *input, *output, *to;
    struct spin_range range;
    bool source, force;
    bool sync;  /* flush files to the disk (fsync) before renaming them */
    bool check; /* read back the output and compare */
    /* The goal: "5000" splats, "50%" of them, "2MB" in all, or a loss of "40dB"; NULL: keep all. */
    const char *decimate;
    const char *data, *data_from, *pair;
    float background[3];
    bool transparent; /* render images with alpha instead of the background */
    const char *device;
    int n_threads;
    const char *const *plugin_pairs;

    /* Splats to keep, in the scene's own units and axes; then scale and translation. */
    double crop[6]; /* low and high corner of a bounding box, or centre and radius of a sphere */
    int n_crop;     /* 6: bounding box; 4: sphere; 0: none */
    /* Keep splats whose centre is inside the image of at least so many training views of their
     * frame. */
    int min_views;
    /* Largest RMS distance to the three nearest splats, as a multiple of the median; 0: no
     * limit. */
    double floaters;
    enum spin_export_backdrop backdrop;
    double min_opacity; /* drop splats of a lower opacity, 0 to below 1 */
    /* Drop splats with a standard deviation above this multiple of the diagonal of the bounding box
     * of the frame's positions; INFINITY: no limit. 0 means 1, or no limit for exporters that
     * render. */
    double max_scale;
    double scale;        /* above 0; 0: 1 */
    double translate[3]; /* applied after the scale */
};

spin_status spin_export(const struct spin_export_options *o, char **report);

/* The exporter for files with this extension, such as "html" for "clip.html"; or NULL. Names of
 * formats and extensions are case-insensitive. */
const char *spin_exporter_for(const char *output);
/* For an extension that no exporter writes: the supported extension of the same kind, else the one
 * with the most similar spelling, or NULL. */
const char *spin_exporter_nearest(const char *ending);
/* The exporter for a format or the nearest supported one, such as "video" for "mp4" and "mov"; or
 * NULL. */
const char *spin_exporter_of_format(const char *format);
const struct spin_exporter *spin_exporter_named(const char *name); /* or NULL */
/* SPIN_E_USAGE if the extension of output belongs to another exporter. */
spin_status spin_exporter_check_name(const struct spin_exporter *e, const char *output);
/* SPIN_E_USAGE if the name of a bundle has the extension of another format. */
spin_status spin_bundle_check_name(const char *output);
/* The same for the HTML page of a report. */
spin_status spin_report_check_name(const char *path);

/* Convert a run to a format that viewers play, with the calls above. The bundle is kept beside the
 * output, with the extension .spin. */
struct spin_convert_options {
    const char *input,
        *output;      /* run or bundle; NULL: the input's name with .html, in the current folder */
    const char *to;   /* exporter; NULL: by the extension of the output */
    const char *from; /* importer; NULL: detect */
    const char *data, *data_from; /* data set; NULL: the only one in or beside the run */
    int n_frames;                 /* see struct spin_import_options */
    bool no_retrain;              /* otherwise retrain if there is a data set */
    const char *preset;           /* of the retraining; NULL: the default */
    int iterations;               /* of the retraining; 0: the preset's */
    const char *device;
    int n_threads;
    bool force;
};

/* After an interruption, the same call resumes the unfinished retraining. */
spin_status spin_convert(const struct spin_convert_options *o, char **report);

#ifdef __cplusplus
}
#endif

#endif
