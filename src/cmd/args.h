/* Command lines. A command declares a table with a row for each option; the parser, --help, shell
 * completion and the lint of the manual are derived from it. `--help` prints the main options, and
 * `--help all` prints the whole table. This module also handles what all commands have in common:
 * signals, ranks, reports and exit codes.
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

/* How a value is parsed, and the type of the variable that receives the value. */
enum spin_args_kind {
    SPIN_ARG_FLAG,    /* bool */
    SPIN_ARG_COUNT,   /* int that each use of the option increments */
    SPIN_ARG_INT,     /* int from min to max */
    SPIN_ARG_UINT64,  /* uint64_t from min to max, at most 2^53 */
    SPIN_ARG_DOUBLE,  /* finite double from min to max */
    SPIN_ARG_STRING,  /* const char *, not empty */
    SPIN_ARG_CHOICE,  /* const char *, one of the words in arg, such as "a|b|c" */
    SPIN_ARG_ENUM,    /* unsigned, index of the given word in arg, such as "a|b|c" */
    SPIN_ARG_SWITCH,  /* bool, true if the second word of arg is given, such as "a|b" */
    SPIN_ARG_INTS,    /* struct spin_args_list, each value from min to max */
    SPIN_ARG_DOUBLES, /* struct spin_args_list, each value from min to max */
    SPIN_ARG_RANGE,   /* struct spin_range, given as A:B or A:B:STEP */
    SPIN_ARG_COLOUR,  /* float[3], given as black, white or R,G,B */
    SPIN_ARG_CUSTOM,  /* parse() parses and stores the value */
    SPIN_ARG_PLUGIN   /* option of a plug-in, whose value is stored as text; if arg is NULL, it is a
                         flag */
};

struct spin_args_list {
    int *ints;       /* [n] values of SPIN_ARG_INTS */
    double *doubles; /* [n] values of SPIN_ARG_DOUBLES */
    int n;
};

struct spin_args_row {
    const char *name; /* long name without dashes; NULL for a heading or the end */
    char brief;       /* one-letter name of the option; 0: there is none */
    const char *arg;  /* placeholder of the value in --help; NULL for flags */
    enum spin_args_kind kind;
    void *into; /* address of the variable that receives the value; its type depends on `kind` */
    const char *help; /* help text, a lower-case sentence without full stop; the text of a heading;
                         NULL at the end */
    double min, max;  /* limits of numbers; both 0: no limits */
    /* Parses and stores text; returns false if text is invalid. Required by SPIN_ARG_CUSTOM. With
     * SPIN_ARG_COLOUR, it may accept words other than colours; NULL: there are no such words. */
    bool (*parse)(const struct spin_args_row *row, const char *text);
};

/* The variable arguments initialise .min and .max, or .parse. */
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

/* Rows for commands that use the data set of a bundle; the values are stored in the options struct
 * `o`. */
#define SPIN_ARG_DATA_ROWS(o)                                                                      \
    SPIN_ARG("data", 0, "DIR", STRING, (o).data,                                                   \
             "multi-view video (the one named in the bundle)"),                                    \
        SPIN_ARG("data-from", 0, "NAME", STRING, (o).data_from,                                    \
                 "format of the data set (detected)"),                                             \
        SPIN_ARG("pair", 0, "auto|number|order", CHOICE, (o).pair,                                 \
                 "match frames to images by frame number or by order (auto)")
#define SPIN_ARG_DEVICE_ROW(o)                                                                     \
    SPIN_ARG("device", 0, "auto|cpu|cuda", CHOICE, (o).device, "device to compute on (auto)")

/* Helpers for parse(). spin_args_choice() returns the index of text in choices such as "a|b|c", or
 * -1. spin_args_numbers() parses numbers separated by commas and returns their count. It returns 0
 * if there are more than `room` numbers, or if one is invalid or outside the row's limits. */
int spin_args_choice(const char *text, const char *choices);
int spin_args_numbers(const struct spin_args_row *row, const char *text, double *out, int room);

/* Returns the last value of --name on the command line, or NULL. Can be called before
 * spin_args_parse(). */
const char *spin_args_find(int argc, char **argv, const char *name);

/* ---- A command ------------------------------------------------------------------------------- */

struct spin_args_command {
    const char *name;            /* "spin-import" */
    const char *summary;         /* one line */
    const char *const *usage;    /* NULL-terminated lines */
    const char *const *examples; /* NULL-terminated lines: a command and what it does */
    const char *const *main;     /* names of the options that --help prints; NULL-terminated */
    const struct spin_args_row *rows;
    /* "importer" or "exporter": the command accepts the options of these plug-ins. NULL: it accepts
     * no options of plug-ins. */
    const char *plugin_kind;
    const char *plugin_selector; /* option that chooses a plug-in, such as "from" */
    bool lists_exporters;        /* true: --help lists the exporters */
    bool takes_many;             /* true: the command accepts more than one positional argument */
    /* Hint in the error message about a second positional argument, or NULL. */
    const char *several;
    /* Completions of the first positional argument, NULL-terminated, or NULL. */
    const char *const *words;
};

/* Values of the options common to all commands, and the positional arguments. */
struct spin_args {
    bool json, force;
    int quiet, verbose;
    int n_threads;          /* number of threads; 0: one for each core */
    const char *word;       /* first positional argument, or NULL */
    const char **all_words; /* [n_words] */
    int n_words;
    const char **plugin_pairs; /* options of plug-ins: key, value, key, value, ..., NULL; or NULL if
                                  there are none */
};
extern struct spin_args spin_args;

/* Parses argv into the variables of the rows and into spin_args, handles --help, --version and
 * completion, sets the verbosity and installs signal handlers. Returns true if the command should
 * run; otherwise main() should return *exit_code. */
bool spin_args_parse(const struct spin_args_command *command, int argc, char **argv,
                     int *exit_code);

/* Prints the line "name: message (try 'name --help')" to stderr. Returns SPIN_EXIT_USAGE. */
int spin_args_misuse(const struct spin_args_command *command, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));

/* Call spin_args_begin() before the work, to join the other ranks, and spin_args_ended() after the
 * work, to combine the status of all ranks. Both return false if this process should exit, and set
 * *code to its exit code. If an error occurred, one rank prints the line "name: message" to
 * stderr. */
bool spin_args_begin(const struct spin_args_command *command, int *code);
bool spin_args_ended(const struct spin_args_command *command, spin_status status, int *code);

/* Prints the report and frees it: with --json as the JSON document, else as the text that
 * `template` defines (io/template.h). If `template` is NULL, nothing is printed. Returns the exit
 * code for main(). */
int spin_args_report(const struct spin_args_command *command, char *json, const char *template);

/* Flushes stdout. Returns code, or SPIN_EXIT_FAILED with a message if the output could not be
 * written. */
int spin_args_finish(const struct spin_args_command *command, int code);
