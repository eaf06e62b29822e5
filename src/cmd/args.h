/* The command line. A table has a row for each option; from it come the parser, --help, what shells
 * complete, and the checks of the manual. --help shows what matters on one screen, --help all the
 * table. Also here: what all commands do around their work, and exit codes.
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
    SPIN_ARG_FLAG,    /* bool                                                        */
    SPIN_ARG_COUNT,   /* int, one more each time                                     */
    SPIN_ARG_INT,     /* int, min..max                                               */
    SPIN_ARG_UINT64,  /* uint64_t, min..max, up to 2^53                              */
    SPIN_ARG_DOUBLE,  /* double, min..max, finite                                    */
    SPIN_ARG_STRING,  /* const char *, not empty                                     */
    SPIN_ARG_CHOICE,  /* const char *, one of arg's a|b|c                            */
    SPIN_ARG_ENUM,    /* unsigned, place of one of arg's a|b|c                       */
    SPIN_ARG_SWITCH,  /* bool, the second of arg's a|b                               */
    SPIN_ARG_INTS,    /* struct spin_args_list, each min..max                        */
    SPIN_ARG_DOUBLES, /* struct spin_args_list, each min..max                        */
    SPIN_ARG_RANGE,   /* struct spin_range, A:B or A:B:STEP                          */
    SPIN_ARG_COLOUR,  /* float[3]: black, white or R,G,B                             */
    SPIN_ARG_CUSTOM,  /* parse() decides                                             */
    SPIN_ARG_PLUGIN   /* of a plug-in: kept as text; a flag when it has no argument  */
};

struct spin_args_list {
    int *ints;       /* [n] of SPIN_ARG_INTS    */
    double *doubles; /* [n] of SPIN_ARG_DOUBLES */
    int n;
};

struct spin_args_row {
    const char *name; /* long name without dashes; NULL: a heading, or the end */
    char brief;       /* its letter; 0: none */
    const char *arg;  /* word for the value; NULL for flags */
    enum spin_args_kind kind;
    void *into;       /* where the value goes, see the kind */
    const char *help; /* one sentence without a capital or full stop; the heading; NULL: the end */
    double min, max;  /* of numbers; 0, 0: no limit */
    /* SPIN_ARG_CUSTOM: store text; false when it makes no sense. SPIN_ARG_COLOUR: words that are no
     * colour, or NULL */
    bool (*parse)(const struct spin_args_row *row, const char *text);
};

/* The last words are .min = and .max = or .parse =, where the kind has them. */
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

/* Rows of commands that look at the data set of a bundle, into their options `o`. */
#define SPIN_ARG_DATA_ROWS(o)                                                                      \
    SPIN_ARG("data", 0, "DIR", STRING, (o).data,                                                   \
             "multi-view video (the one named in the bundle)"),                                    \
        SPIN_ARG("data-from", 0, "NAME", STRING, (o).data_from,                                    \
                 "format of the data set (detected)"),                                             \
        SPIN_ARG("pair", 0, "auto|number|order", CHOICE, (o).pair,                                 \
                 "match frames to images by frame number or by order (auto)")
#define SPIN_ARG_DEVICE_ROW(o)                                                                     \
    SPIN_ARG("device", 0, "auto|cpu|cuda", CHOICE, (o).device, "device to compute on (auto)")

/* For parse(): the place of text in "a|b|c", or -1; how many numbers there are, with commas between
 * and each in the row's limits, or 0 when one is wrong or they are more than room. */
int spin_args_choice(const char *text, const char *choices);
int spin_args_numbers(const struct spin_args_row *row, const char *text, double *out, int room);

/* The last value of --name, before anything is parsed; or NULL. */
const char *spin_args_find(int argc, char **argv, const char *name);

/* ---- A command ------------------------------------------------------------------------------- */

struct spin_args_command {
    const char *name;            /* "spin-import" */
    const char *summary;         /* one line */
    const char *const *usage;    /* lines, NULL-terminated */
    const char *const *examples; /* three, and what each does; NULL-terminated */
    const char *const *main; /* options that --help shows, the most used first; NULL-terminated */
    const struct spin_args_row *rows;
    const char
        *plugin_kind; /* "importer" or "exporter": their own options are taken too; or NULL */
    const char *plugin_selector; /* the option that names one: "from" */
    bool lists_exporters;        /* --help all has their names and summaries */
    bool takes_many;             /* words, else one */
    const char *several;         /* what to do with more than one; or NULL */
    const char *const *words; /* what shells offer for the first word; NULL-terminated, or NULL */
};

/* What every command has: its options, whose rows follow those of the table, and what was left
 * after them. */
struct spin_args {
    bool json, force;
    int quiet, verbose;
    int n_threads;          /* 0: all */
    const char *word;       /* NULL: there was none */
    const char **all_words; /* [n_words] */
    int n_words;
    const char **plugin_pairs; /* NULL-terminated key, value, ...; NULL when there are none */
};
extern struct spin_args spin_args;

/* Parse argv into what the rows point at and into spin_args, then do what all commands do: --help,
 * --version, verbosity, signals. Returns true when the command should go on; else *exit_code is
 * what main() returns. */
bool spin_args_parse(const struct spin_args_command *command, int argc, char **argv,
                     int *exit_code);

/* One line "name: message (try 'name --help')" on stderr; returns SPIN_EXIT_USAGE. */
int spin_args_misuse(const struct spin_args_command *command, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));

/* Around the work: join the other processes, when there are some; and end with the status of all.
 * False: this process is done, with this code; the reason of a failure is on stderr as one line
 * "name: last error", of one process. */
bool spin_args_begin(const struct spin_args_command *command, int *code);
bool spin_args_ended(const struct spin_args_command *command, spin_status status, int *code);

/* The report of the work, a JSON document: as it is with --json, else by this template for people
 * (io/template.h). It is freed. NULL template: nothing without --json. Returns what main() returns.
 */
int spin_args_report(const struct spin_args_command *command, char *json, const char *template);

/* Flush stdout; returns code, or SPIN_EXIT_FAILED with a line when the output could not be written.
 */
int spin_args_finish(const struct spin_args_command *command, int code);
