/* Options of the commands: one table row per option, from which come the parser, the --help text
 * and, by way of that text, the check that the manual page is complete (tests/lint/manual.sh).
 * Also here: exit codes.
 *
 *     static struct spin_args_common common;
 *     static int size = 3;
 *     static const struct spin_args_row rows[] = {
 *         SPIN_ARG_HEADING("Work"),
 *         SPIN_ARG("size", 's', "N", "how large (3)", SPIN_ARG_INT, &size, 1, 9),
 *         SPIN_ARG_COMMON_ROWS(common),
 *     };
 */
#ifndef SPIN_CMD_ARGS_H
#define SPIN_CMD_ARGS_H

#include "spin.h"

#include <stdio.h>

enum spin_exit { SPIN_EXIT_OK = 0, SPIN_EXIT_FAILED = 1, SPIN_EXIT_USAGE = 2 };

/* ---- The table ------------------------------------------------------------------------------- */

enum spin_args_kind {
    SPIN_ARG_FLAG,    /* bool *                                    */
    SPIN_ARG_COUNT,   /* int *, one more each time                 */
    SPIN_ARG_INT,     /* int *, min..max                           */
    SPIN_ARG_UINT64,  /* uint64_t *                                */
    SPIN_ARG_DOUBLE,  /* double *, min..max, finite                */
    SPIN_ARG_STRING,  /* const char **, not empty                  */
    SPIN_ARG_CHOICE,  /* const char **, one of arg's a|b|c         */
    SPIN_ARG_ENUM,    /* unsigned *, place of one of arg's a|b|c   */
    SPIN_ARG_SWITCH,  /* bool *, the second of arg's a|b           */
    SPIN_ARG_INTS,    /* struct spin_args_ints *, each min..max     */
    SPIN_ARG_DOUBLES, /* struct spin_args_doubles *, each min..max  */
    SPIN_ARG_RANGE,   /* struct spin_range *, A:B or A:B:STEP      */
    SPIN_ARG_COLOUR,  /* float *, [3]: black, white or R,G,B       */
    SPIN_ARG_CUSTOM   /* parse() decides                           */
};

struct spin_args_ints {
    int *value; /* [n], allocated */
    int n;
};

struct spin_args_doubles {
    double *value; /* [n], allocated */
    int n;
};

struct spin_args_row {
    const char *name; /* long name without dashes; NULL: a heading */
    char short_name;  /* 0: none */
    const char *arg;  /* word for the value; NULL for flags */
    const char *help; /* one sentence without a capital or full stop */
    enum spin_args_kind kind;
    void *into;      /* where the value goes, see the kind */
    double min, max; /* numbers; 0, 0: no limit */
    /* SPIN_ARG_CUSTOM: store text; false when it makes no sense */
    bool (*parse)(const struct spin_args_row *row, const char *text);
    const char *section; /* the heading, when name is NULL */
};

#define SPIN_ARG(name, brief, arg, help, kind, into, min, max)                                     \
    {                                                                                              \
        name, brief, arg, help, kind, into, min, max, NULL, NULL                                   \
    }
#define SPIN_ARG_END                                                                               \
    {                                                                                              \
        NULL, 0, NULL, NULL, SPIN_ARG_FLAG, NULL, 0, 0, NULL, NULL                                 \
    }
#define SPIN_ARG_HEADING(text)                                                                     \
    {                                                                                              \
        NULL, 0, NULL, NULL, SPIN_ARG_FLAG, NULL, 0, 0, NULL, text                                 \
    }

/* Options that every command has. */
struct spin_args_common {
    bool help, version, json, force;
    const char *completion; /* name of a shell, or NULL */
    int quiet, verbose;
    int n_threads; /* 0: all */
};

/* Their rows, to be put at the end of a command's table. */
#define SPIN_ARG_COMMON_ROWS(c)                                                                    \
    SPIN_ARG_HEADING("Common"),                                                                    \
        SPIN_ARG("force", 0, NULL, "overwrite what is there", SPIN_ARG_FLAG, &(c).force, 0, 0),    \
        SPIN_ARG("json", 0, NULL, "print one JSON document", SPIN_ARG_FLAG, &(c).json, 0, 0),      \
        SPIN_ARG("threads", 0, "N", "threads to use (all cores)", SPIN_ARG_INT, &(c).n_threads, 1, \
                 1024),                                                                            \
        SPIN_ARG("quiet", 'q', NULL, "say less", SPIN_ARG_COUNT, &(c).quiet, 0, 0),                \
        SPIN_ARG("verbose", 'v', NULL, "say more; up to four times", SPIN_ARG_COUNT, &(c).verbose, \
                 0, 0),                                                                            \
        SPIN_ARG("completion", 0, "bash|zsh", "print the script that completes this command's "     \
                 "options in that shell", SPIN_ARG_CHOICE, &(c).completion, 0, 0),                 \
        SPIN_ARG("help", 'h', NULL, "this text", SPIN_ARG_FLAG, &(c).help, 0, 0),                  \
        SPIN_ARG("version", 0, NULL, "name and version", SPIN_ARG_FLAG, &(c).version, 0, 0),       \
        SPIN_ARG_END

/* Rows of commands that look at the data set of a bundle, into their options `o`. */
#define SPIN_ARG_DATA_ROWS(o)                                                                      \
    SPIN_ARG("data", 0, "DIR", "the multi-view video (the one named in the bundle)",               \
             SPIN_ARG_STRING, &(o).data, 0, 0),                                                    \
        SPIN_ARG("data-from", 0, "NAME", "kind of that data set (detected)", SPIN_ARG_STRING,      \
                 &(o).data_from, 0, 0),                                                            \
        SPIN_ARG("pair", 0, "auto|number|order", "how frames find their images (auto)",            \
                 SPIN_ARG_CHOICE, &(o).pair, 0, 0)
#define SPIN_ARG_MACHINE_ROWS(o)                                                                   \
    SPIN_ARG_HEADING("Machine"), SPIN_ARG("device", 0, "auto|cpu|cuda", "what computes (auto)",    \
                                          SPIN_ARG_CHOICE, &(o).device, 0, 0)

/* For parse(): the place of text in "a|b|c", or -1; how many numbers there are, with commas between and each
 * in min..max, or 0 when one is wrong or they are more than room. */
int spin_args_choice(const char *text, const char *choices);
int spin_args_numbers(const struct spin_args_row *row, const char *text, double *out, int room);

/* The last value of --name, before anything is parsed; or NULL. */
const char *spin_args_find(int argc, char **argv, const char *name);

/* ---- Plug-ins -------------------------------------------------------------------------------- */

/* What the parser needs to know of an importer or exporter. */
struct spin_args_plugin {
    const char *name;
    const struct spin_plugin_option *options; /* or NULL */
};

/* ---- A command ------------------------------------------------------------------------------- */

struct spin_args_command {
    const char *name;         /* "spin-import" */
    const char *summary;      /* one line */
    const char *const *usage; /* lines, NULL-terminated */
    const struct spin_args_row *rows;
    struct spin_args_common *common;

    /* Plug-ins whose own options are taken too. */
    const char *plugin_kind;     /* "importer", or NULL: none */
    const char *plugin_selector; /* the option that names one: "from" */
    size_t (*plugins)(struct spin_args_plugin *out, size_t room);
};

/* What was left after the options. */
struct spin_args_words {
    const char *word[4];
    int n;
    const char **plugin_pairs; /* NULL-terminated key, value, ...; NULL when there are none */
};

/* Parse argv into what the rows point at, then do what all commands do: --help, --version, verbosity,
 * signals. Returns true when the command should go on; else *exit_code is what main() returns. At most
 * max_words words are accepted. */
bool spin_args_parse(const struct spin_args_command *command, int argc, char **argv, int max_words,
                     struct spin_args_words *words, int *exit_code);

/* The --help text; with the options of a plug-in, or NULL. */
void spin_args_print_help(const struct spin_args_command *command,
                          const struct spin_args_plugin *chosen);

/* A script that completes the command's options, their values and those of its n plug-ins; shell: bash or zsh. */
void spin_args_print_completion(const struct spin_args_command *command, const struct spin_args_plugin *plugin,
                                size_t n_plugins, const char *shell);

/* One line "name: message (try 'name --help')" on stderr; returns SPIN_EXIT_USAGE. */
int spin_args_misuse(const struct spin_args_command *command, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));

/* Around the work: join the other processes, when there are some; and end with the status of all. False: this
 * process is done, with this code; the reason of a failure is on stderr as one line "name: last error", of one
 * process. */
bool spin_args_begin(const struct spin_args_command *command, int *code);
bool spin_args_ended(const struct spin_args_command *command, spin_status status, int *code);

/* Flush stdout; returns code, or SPIN_EXIT_FAILED with a line when the output could not be written. */
int spin_args_finish(const struct spin_args_command *command, int code);

#endif
