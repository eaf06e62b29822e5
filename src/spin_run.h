/* spin_run.h - the functions that the commands call, with their options and reports. The options of
 * spin_retrain() are in spin_train.h. */
#ifndef SPIN_RUN_H
#define SPIN_RUN_H

#include "spin_train.h"

#ifdef __cplusplus
extern "C" {
#endif

struct spin_import_options {
    const char *input, *output;   /* output NULL: only describe the run */
    const char *from;             /* importer; NULL: detect */
    const char *data, *data_from; /* data set and its importer; NULL: none, detect */
    const char *pair;             /* pairing of frames: "auto", "number" or "order"; NULL: auto */
    /* How times are assigned to the frames of the data set, see --frame-times in spin-import(1):
     * "auto", "data", "unit" or "count"; NULL: auto. */
    const char *frame_times;
    int n_frames;        /* continuous methods: number of samples; 0: not given */
    int default_frames;  /* number of samples if neither run nor data set determines it */
    const double *times; /* continuous methods: [n_times] sample times */
    int n_times;
    struct spin_range range;
    bool positions_only, force;
    /* Precision in which 4D splats are stored: 0 lossless, 1 half, 2 compact (see enum
     * spin_precision). */
    unsigned precision;
    bool sync; /* true: flush the bundle to the disk (fsync) before renaming it */
    bool full; /* true: a description is based on all frames instead of at most 16 */
    /* Folder for PNG images that show the points drawn over the data set's images, so that a user
     * can check the cameras; or NULL. */
    const char *check_cameras;
    const char *const *plugin_pairs; /* see struct spin_plugin_values */
};

/* The functions below that have a parameter `report` set *report to a JSON document, which the
 * caller frees with free(). Its keys are those that the command prints with --json, see the manuals
 * of the commands. If there are several ranks, only rank 0 returns a report. */

/* Imports a run of another method as a bundle, or only describes the run. */
spin_status spin_import(const struct spin_import_options *o, char **report);

/* Describes the contents of a bundle, and how these were made. Reads only meta.json and the headers
 * of the arrays. SPIN_E_NOT_RECOGNISED if the file is not a bundle. */
spin_status spin_bundle_describe(const char *path, char **report);

/* Lists the views of a bundle's data set: an array of objects with the members frame (from 0),
 * number, camera, test, width, height, fx, fy, cx, cy, w2c (see struct spin_camera), image, and
 * mask (or null). data, data_from: data set and its importer; NULL: those that are stored in the
 * bundle. */
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
    bool source;        /* true: measure the source instead of the retrained splats */
    const char *images; /* folder for rendered images, or NULL */
    enum spin_dynamic_from dynamic;
    /* True: measure only the subject: the pixels inside the masks of the data set or, if it has no
     * masks, the pixels of its images with an alpha above 0.5. */
    bool mask;
    bool temporal; /* true: measure flicker between successive frames of static cameras */
    /* report: file for an HTML page with the results, or NULL. log: file written by spin-retrain
     * --log, which the page shows as a chart; or NULL. */
    const char *report, *log;
    /* Folder with the weights of one or two LPIPS networks; NULL: do not measure LPIPS. */
    const char *lpips;
    /* Instead of a folder: the two files with the weights of one LPIPS network; or NULL. */
    const char *lpips_backbone, *lpips_lin;
    float background[3];
    const char *device;
    int n_threads;
    bool force;
};

spin_status spin_eval(const struct spin_eval_options *o, char **report);

/* Measures n bundles on the same views. o->input, o->log and o->images are ignored; o->report is a
 * file for an HTML page that compares the bundles. figures: folder for charts and images, or NULL.
 * The member "runs" of *report is an array with one report of spin_eval() for each bundle; each
 * report has the additional members "input" and "name". */
spin_status spin_compare(const struct spin_eval_options *o, const char *const *input, int n,
                         const char *figures, char **report);

/* Whether to export the backdrop, splats that a training adds behind the subject. AUTO: yes, if the
 * training added one. OFF: drop the backdrop, to isolate the subject. */
enum spin_export_backdrop { SPIN_EXPORT_BACKDROP_AUTO, SPIN_EXPORT_BACKDROP_OFF };

struct spin_export_options {
    const char *input, *output, *to;
    /* The program that will open the output, such as "unreal"; NULL: none. spin_export() chooses
     * suitable values for options that are not given, and `to` may then be NULL. */
    const char *target;
    /* True: warn if frames do not have the same splats in the same order. spin_export() sets this
     * for programs that require it. */
    bool equal_rows;
    struct spin_range range;
    bool source, force;
    bool sync;  /* true: flush files to the disk (fsync) before renaming them */
    bool check; /* true: read the output back and compare it with the bundle */
    /* How many splats to keep: "5000" per frame, "50%" of all, as many as fit into a total size of
     * "2MB", or as few as reach a PSNR of "40dB" against renders of all splats; NULL: all. */
    const char *decimate;
    /* File of a sound track that begins with the first frame of the bundle, or "none"; NULL: the
     * sound of the bundle, if it has one. */
    const char *sound;
    const char *data, *data_from, *pair;
    float background[3];
    bool transparent; /* true: render images with alpha instead of the background */
    const char *device;
    int n_threads;
    const char *const *plugin_pairs;

    /* Region to keep, in the units and axes of the bundle, before `scale` and `translate`: low and
     * high corner of a bounding box (6 values), or centre and radius of a sphere (4 values). */
    double crop[6];
    int n_crop; /* number of values of crop; 0: keep everything */
    /* Keep splats whose centre is inside the image of at least this number of training views of
     * their frame; 0: keep all. */
    int min_views;
    /* Keep splats whose RMS distance to their three nearest neighbours is at most this multiple of
     * the median of this distance over all splats, or at most three times their largest standard
     * deviation; 0: keep all. */
    double floaters;
    enum spin_export_backdrop backdrop;
    double min_opacity; /* drop splats of a lower opacity; 0 or more, below 1 */
    /* Drop splats with a standard deviation above this multiple of the diagonal of the bounding box
     * of the frame's positions. INFINITY: no limit. 0: the default, which is no limit for exporters
     * that render, and 1 for others. */
    double max_scale;
    double scale;        /* factor on positions and sizes; 0 means 1 */
    double translate[3]; /* applied after the scale */
    /* True: do not add the offset that the import subtracted from positions far from 0 (`shift` of
     * struct spin_sequence_info). Web pages and exporters that render never add this offset. */
    bool relative;
    /* True: instead of marking the splats for antialiasing, lower their opacities to the values
     * that antialiasing would give in images of width bake_size[0] and height bake_size[1]; {0, 0}:
     * the size of the training images. */
    bool bake_antialias;
    int bake_size[2];
};

spin_status spin_export(const struct spin_export_options *o, char **report);

/* The name of the exporter for files with the extension of `output`, such as "html" for
 * "clip.html"; NULL if there is none. In all these functions, names of formats and extensions are
 * case-insensitive. */
const char *spin_exporter_for(const char *output);
/* Suggests a supported extension for `ending`, an unsupported extension with its dot: one for the
 * same kind of file or, if there is none, one that is spelled similarly. NULL if there is neither.
 */
const char *spin_exporter_nearest(const char *ending);
/* The name of the exporter for a format, or for the most similar supported format: "video" for
 * "mp4" and also for "mov". NULL if there is none. */
const char *spin_exporter_of_format(const char *format);
/* The exporter of this name; NULL if there is none. */
const struct spin_exporter *spin_exporter_named(const char *name);
/* SPIN_E_USAGE if the extension of output belongs to another exporter. */
spin_status spin_exporter_check_name(const struct spin_exporter *e, const char *output);
/* SPIN_E_USAGE if the name of a bundle has the extension of another format. */
spin_status spin_bundle_check_name(const char *output);
/* SPIN_E_USAGE if the name of a report, which is an HTML page, has another extension. */
spin_status spin_report_check_name(const char *path);

/* Options of spin_convert(), which imports, retrains and exports a run, to convert the run to a
 * format that viewers play. The bundle is kept beside the output, with the extension .spin. */
struct spin_convert_options {
    /* input: a run or a bundle. output: NULL means the name of the input with the extension .html,
     * in the current folder. */
    const char *input, *output;
    const char *to;     /* exporter; NULL: chosen by the extension of the output */
    const char *target; /* see struct spin_export_options */
    const char *from;   /* importer; NULL: detect */
    /* Data set and its importer; NULL: the only data set in or beside the run, if there is one. */
    const char *data, *data_from;
    int n_frames;       /* see struct spin_import_options */
    int lod;            /* option `lod` of the importer sog, for streamed SOG; -1: default */
    bool no_retrain;    /* true: do not retrain the clip, even if there is a data set */
    const char *preset; /* preset of the retraining; NULL: the default */
    int iterations;     /* iterations of the retraining; 0: those of the preset */
    /* Number of splats with which a retraining on renders begins, for frames that consist of
     * different splats: "50000" per frame, "50%" of all, or "auto" (60 % of the static and 40 % of
     * the dynamic splats); NULL: all. */
    const char *splats;
    const char *sound; /* see struct spin_export_options */
    /* Filters of the export, see struct spin_export_options. The retraining uses all splats. */
    double crop[6];
    int n_crop;
    double floaters;
    const char *const *export_pairs; /* options of the exporter, see struct spin_plugin_values */
    const char *device;
    int n_threads;
    bool force;
};

/* Converts a run. After an interruption, the same call resumes the unfinished retraining. */
spin_status spin_convert(const struct spin_convert_options *o, char **report);

#ifdef __cplusplus
}
#endif

#endif
