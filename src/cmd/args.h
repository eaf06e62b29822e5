/* Command lines. A command declares a table with a row for each option; the parser, --help, shell
 * completion and the lint of the manual are derived from it. --help prints the main options,
 * --help all the whole table. This module also has what all commands do around their work: signals,
 * ranks, reports and exit codes.
 *
 *     static int size = 3;
 *     static const struct spin_args_row rows[] = {
 *         SPIN_ARG_HEADING("Work"),
 *         SPIN_ARG("size", 's', "N", INT, size, "how large (3)", .min = 1, .max = 9),
 *         SPIN_ARG_END,
 *     };
 */
#pragma once

#include "spin.h"

enum spin_exit { SPIN_EXIT_OK = 0, SPIN_EXIT_FAILED = 1, SPIN_EXIT_USAGE = 2 };

/* ---- The table ------------------------------------------------------------------------------- */

enum spin_args_kind {
    SPIN_ARG_FLAG,    /* bool */
    SPIN_ARG_COUNT,   /* int, incremented by each use */
    SPIN_ARG_INT,     /* int, min..max */
    SPIN_ARG_UINT64,  /* uint64_t, min..max, up to 2^53 */
    SPIN_ARG_DOUBLE,  /* double, min..max, finite */
    SPIN_ARG_STRING,  /* const char *, never empty */
    SPIN_ARG_CHOICE,  /* const char *, one of arg's a|b|c */
    SPIN_ARG_ENUM,    /* unsigned, index in arg's a|b|c */
    SPIN_ARG_SWITCH,  /* bool, true for the second of arg's a|b */
    SPIN_ARG_INTS,    /* struct spin_args_list, each min..max */
    SPIN_ARG_DOUBLES, /* struct spin_args_list, each min..max */
    SPIN_ARG_RANGE,   /* struct spin_range, A:B or A:B:STEP */
    SPIN_ARG_COLOUR,  /* float[3]: black, white or R,G,B */
    SPIN_ARG_CUSTOM,  /* stored by parse() */
    SPIN_ARG_PLUGIN   /* of a plug-in, stored as text; without arg: a flag */
};

struct spin_args_list {
    int *ints;       /* [n] of SPIN_ARG_INTS */
    double *doubles; /* [n] of SPIN_ARG_DOUBLES */
    int n;
};

struct spin_args_row {
    const char *name; /* long name without dashes; NULL for a heading or the end */
    char brief;       /* one-letter name, or 0 */
    const char *arg;  /* placeholder of the value, or NULL for flags */
    enum spin_args_kind kind;
    void *into;       /* variable of the type given at the kind */
    const char *help; /* lower-case sentence without full stop; a heading; or NULL at the end */
    double min, max;  /* limits of numbers; 0, 0: none */
    /* SPIN_ARG_CUSTOM: stores text, returns false if it is invalid. SPIN_ARG_COLOUR: handles words
     * other than colours, or NULL. */
    bool (*parse)(const struct spin_args_row *row, const char *text);
};

/* The variable arguments set .min and .max, or .parse, for the kinds that use them. */
#define SPIN_ARG(row_name, row_brief, row_arg, row_kind, row_into, row_help, ...)                  \
    {                                                                                              \
        .name = row_name, .brief = row_brief, .arg = row_arg, .kind = SPIN_ARG_##row_kind,         \
        .into = &(row_into), .help = row_help, __VA_ARGS__                                         \
    }
#define SPIN_ARG_HEADING(text)                                                                     \
    {                                                                                              \
        .help = text                                                                               \
    }
#define SPIN_ARG_END                                                                               \
    {                                                                                              \
        .help = NULL                                                                               \
    }

/* Rows of commands that use the data set of a bundle; they fill the options struct `o`. */
#define SPIN_ARG_DATA_ROWS(o)                                                                      \
    SPIN_ARG("data", 0, "DIR", STRING, (o).data,                                                   \
             "multi-view video (the one named in the bundle)"),                                    \
        SPIN_ARG("data-from", 0, "NAME", STRING, (o).data_from,                                    \
                 "format of the data set (detected)"),                                             \
        SPIN_ARG("pair", 0, "auto|number|order", CHOICE, (o).pair,                                 \
                 "match frames to images by frame number or by order (auto)")
#define SPIN_ARG_DEVICE_ROW(o)                                                                     \
    SPIN_ARG("device", 0, "auto|cpu|cuda", CHOICE, (o).device, "device to compute on (auto)")

/* Helpers for parse(). spin_args_choice(): index of text in "a|b|c", or -1. spin_args_numbers():
 * reads numbers separated by commas, each within the row's limits; returns their count, or 0 if one
 * is invalid or there are more than `room`. */
int spin_args_choice(const char *text, const char *choices);
int spin_args_numbers(const struct spin_args_row *row, const char *text, double *out, int room);

/* The last value of --name on the command line, or NULL; usable before parsing. */
const char *spin_args_find(int argc, char **argv, const char *name);

/* ---- A command ------------------------------------------------------------------------------- */

struct spin_args_command {
    const char *name;            /* "spin-import" */
    const char *summary;         /* one line */
    const char *const *usage;    /* NULL-terminated lines */
    const char *const *examples; /* NULL-terminated lines: a command and what it does */
    const char *const *main;     /* names of the options that --help prints; NULL-terminated */
    const struct spin_args_row *rows;
    const char
        *plugin_kind; /* "importer" or "exporter" if the command accepts their options; or NULL */
    const char *plugin_selector; /* option that chooses a plug-in, such as "from" */
    bool lists_exporters;        /* --help all prints the exporters' names and summaries */
    bool takes_many;             /* more than one positional argument */
    const char *several;         /* hint for users who pass more than one argument; or NULL */
    const char *const *words;    /* completions of the first argument; NULL-terminated, or NULL */
};

/* Values of the options common to all commands, and the positional arguments. */
struct spin_args {
    bool json, force;
    int quiet, verbose;
    int n_threads;          /* 0: all */
    const char *word;       /* first positional argument, or NULL */
    const char **all_words; /* [n_words] */
    int n_words;
    const char **plugin_pairs; /* key, value, ..., NULL-terminated; NULL if there are none */
};
extern struct spin_args spin_args;

/* Parses argv into the variables of the rows and into spin_args, handles --help, --version and
 * completion, sets the verbosity and installs signal handlers. Returns true if the command should
 * run; else main() returns *exit_code. */
bool spin_args_parse(const struct spin_args_command *command, int argc, char **argv,
                     int *exit_code);

/* Prints "name: message (try 'name --help')" as one line to stderr; returns SPIN_EXIT_USAGE. */
int spin_args_misuse(const struct spin_args_command *command, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));

/* Call these before and after the work. begin joins the other ranks; ended combines the status of
 * all ranks. Both return false if this process is done, with its exit code in *code. One rank
 * prints a failure as one line "name: last error" to stderr. */
bool spin_args_begin(const struct spin_args_command *command, int *code);
bool spin_args_ended(const struct spin_args_command *command, spin_status status, int *code);

/* Prints the report of the work and frees it: the JSON document itself with --json, else its text
 * by `template` (io/template.h); a NULL template prints nothing. Returns the exit code of main().
 */
int spin_args_report(const struct spin_args_command *command, char *json, const char *template);

/* Flushes stdout. Returns code, or SPIN_EXIT_FAILED with a message if the output could not be
 * written. */
int spin_args_finish(const struct spin_args_command *command, int code);
