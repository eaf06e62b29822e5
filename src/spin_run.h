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
    const char *pair;             /* pairing of frames: "auto", "number" or "order"; NULL: auto */
    /* Times of the data set's frames: "auto", "data", "unit" or "count"; NULL: auto. */
    const char *frame_times;
    int n_frames;        /* continuous methods: number of samples; 0: not given */
    int default_frames;  /* number of samples if nothing says how many; 0: an error */
    const double *times; /* continuous methods: [n_times] sample times */
    int n_times;
    struct spin_range range;
    bool positions_only, force;
    /* Precision of the stored 4D splats: 0 lossless, 1 half, 2 compact (see enum
     * spin_precision). */
    unsigned precision;
    bool sync; /* true: the bundle is flushed to the disk (fsync) before it is renamed */
    bool full; /* true: a description reads every frame instead of at most 16 */
    /* Folder for PNGs of the points drawn over the data set's images, or NULL. */
    const char *check_cameras;
    const char *const *plugin_pairs; /* see struct spin_plugin_values */
};

/* The calls below return a report as a JSON document, which the caller frees with free(). Its keys
 * are those of --json, see the manuals of the commands. Of several ranks only rank 0 returns the
 * report. */

/* Imports a run of another method as a bundle, or only describes the run. */
spin_status spin_import(const struct spin_import_options *o, char **report);

/* Describes the contents of a bundle and how they were made. Reads only meta.json and the headers
 * of the arrays. SPIN_E_NOT_RECOGNISED if the file is not a bundle. */
spin_status spin_bundle_describe(const char *path, char **report);

/* Lists the views of a bundle's data set: an array of objects with the members frame (from 0),
 * number, camera, test, width, height, fx, fy, cx, cy, w2c (see struct spin_camera), image, and
 * mask (or null). data, data_from: NULL means those that the bundle records. */
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
    bool source;        /* true: the source is measured instead of the retrained splats */
    const char *images; /* folder for rendered images, or NULL */
    enum spin_dynamic_from dynamic;
    /* True: only the pixels inside the masks of the data set, or inside the alpha of its images,
     * are measured. */
    bool mask;
    bool temporal; /* measure flicker: differences between successive frames of static cameras */
    /* report: HTML page to write, or NULL. log: log of spin-retrain --log that the page shows, or
     * NULL. */
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

/* Measures n bundles on the same views. o->input, o->log and o->images are ignored; o->report is a
 * page that compares the bundles. figures: folder for charts and images, or NULL. The member "runs"
 * of the JSON document is an array of the documents of spin_eval(), each with "input" and "name"
 * added. */
spin_status spin_compare(const struct spin_eval_options *o, const char *const *input, int n,
                         const char *figures, char **report);

/* AUTO: as trained. OFF: drop the backdrop that the training added, to isolate a subject. */
enum spin_export_backdrop { SPIN_EXPORT_BACKDROP_AUTO, SPIN_EXPORT_BACKDROP_OFF };

struct spin_export_options {
    const char *input, *output, *to;
    /* The program that the output is for, such as "unreal"; NULL: none. spin_export() sets options
     * that are not given for it, and `to` may then be NULL. */
    const char *target;
    /* Warn if frames do not have the same splats in the same order. Set for some programs. */
    bool equal_rows;
    struct spin_range range;
    bool source, force;
    bool sync;  /* flush files to the disk (fsync) before renaming them */
    bool check; /* true: the output is read back and compared with the bundle */
    /* What to keep: "5000" splats per frame, "50%" of the splats, as many as fit into a total of
     * "2MB", or as few as reach a PSNR of "40dB" against all splats; NULL: all. */
    const char *decimate;
    /* File of a sound track that begins with the first frame of the bundle, or "none"; NULL: the
     * sound of the bundle, if it has one. */
    const char *sound;
    const char *data, *data_from, *pair;
    float background[3];
    bool transparent; /* render images with alpha instead of the background */
    const char *device;
    int n_threads;
    const char *const *plugin_pairs;

    /* Region to keep, in the scene's own units and axes, before scale and translation: low and high
     * corner of a bounding box, or centre and radius of a sphere. */
    double crop[6];
    int n_crop; /* 6: bounding box; 4: sphere; 0: keep everything */
    /* Keep splats whose centre is inside the image of at least so many training views of their
     * frame; 0: all. */
    int min_views;
    /* Keep splats whose RMS distance to their three nearest neighbours is at most this multiple of
     * the median distance; 0: all. */
    double floaters;
    enum spin_export_backdrop backdrop;
    double min_opacity; /* drop splats of a lower opacity, 0 to below 1 */
    /* Drop splats with a standard deviation above this multiple of the diagonal of the bounding box
     * of the frame's positions; INFINITY: no limit. 0 means 1, or no limit for exporters that
     * render. */
    double max_scale;
    double scale;        /* above 0; 0: 1 */
    double translate[3]; /* applied after the scale */
    /* Do not add the coordinates that the import subtracted from positions far from 0. Exporters
     * that render, and web pages, never add them. */
    bool relative;
    /* Lower opacities instead of marking the splats for antialiasing, for images of this width and
     * height; 0: those of the training. */
    bool bake_antialias;
    int bake_size[2];
};

spin_status spin_export(const struct spin_export_options *o, char **report);

/* The exporter for files with this extension, such as "html" for "clip.html"; or NULL. Names of
 * formats and extensions are case-insensitive. */
const char *spin_exporter_for(const char *output);
/* Suggests a supported extension instead of one that no exporter writes, which begins with a dot:
 * one for the same kind of file, or else one that is spelled similarly; NULL if there is none. */
const char *spin_exporter_nearest(const char *ending);
/* The exporter for a format, or for the nearest supported format: "video" for "mp4" and for "mov".
 * NULL if there is none. */
const char *spin_exporter_of_format(const char *format);
/* The exporter of this name; NULL if there is none. */
const struct spin_exporter *spin_exporter_named(const char *name);
/* SPIN_E_USAGE if the extension of output belongs to another exporter. */
spin_status spin_exporter_check_name(const struct spin_exporter *e, const char *output);
/* SPIN_E_USAGE if the name of a bundle has the extension of another format. */
spin_status spin_bundle_check_name(const char *output);
/* SPIN_E_USAGE if the name of a report, which is an HTML page, has another extension. */
spin_status spin_report_check_name(const char *path);

/* Convert a run to a format that viewers play, with the calls above. The bundle is kept beside the
 * output, with the extension .spin. */
struct spin_convert_options {
    /* input: a run or a bundle. output: NULL means the input's name with .html, in the current
     * folder. */
    const char *input, *output;
    const char *to;               /* exporter; NULL: by the extension of the output */
    const char *target;           /* see struct spin_export_options */
    const char *from;             /* importer; NULL: detect */
    const char *data, *data_from; /* data set; NULL: the only one in or beside the run */
    int n_frames;                 /* see struct spin_import_options */
    int lod;            /* streamed SOG: option `lod` of the importer sog; -1: its default */
    bool no_retrain;    /* false: the clip is retrained if there is a data set */
    const char *preset; /* preset of the retraining; NULL: the default */
    int iterations;     /* iterations of the retraining; 0: those of the preset */
    const char *sound;  /* see struct spin_export_options */
    /* Filters of the export, see struct spin_export_options; the retraining uses all splats. */
    double crop[6];
    int n_crop;
    double floaters;
    const char *const *export_pairs; /* options of the exporter, as plugin_pairs; or NULL */
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
