/* Command line of all commands: the parser, --help, shell completion, signals and exit codes. */
#include "cmd/args.h"

#include <ctype.h>
#include <errno.h>
#include <limits.h>
#include <math.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "base/program.h"
#include "base/text.h"
#include "io/template.h"
#include "spin_run.h"

enum { HELP_COLUMN = 28, HELP_WIDTH = 100 };
enum help { NO_HELP, SHORT_HELP, WHOLE_HELP };

struct spin_args spin_args;
static bool wants_help_flag, wants_version;
static enum help wants_help;
static const char *wants_completion; /* name of the shell, or NULL */

static const struct spin_args_row common_rows[] = {
    SPIN_ARG_HEADING("Common"),
    SPIN_ARG("force", 0, NULL, FLAG, spin_args.force, "overwrite existing output"),
    SPIN_ARG("json", 0, NULL, FLAG, spin_args.json, "print the report as one JSON document"),
    SPIN_ARG("threads", 0, "N", INT, spin_args.n_threads,
             "number of threads (all cores); no effect on imports", .min = 1, .max = 1024),
    SPIN_ARG("quiet", 'q', NULL, COUNT, spin_args.quiet, "print less"),
    SPIN_ARG("verbose", 'v', NULL, COUNT, spin_args.verbose, "print more"),
    SPIN_ARG("completion", 0, "bash|zsh", CHOICE, wants_completion,
             "print the completion script for this shell"),
    SPIN_ARG("help", 'h', NULL, FLAG, wants_help_flag,
             "show the main options; --help all: every option"),
    SPIN_ARG("version", 0, NULL, FLAG, wants_version, "print name and version"),
    SPIN_ARG_END,
};

/* State of the parser while it reads one command line. */
struct parser {
    const struct spin_args_command *command;
    /* Rows of this command, then common_rows, then those of plug-ins; terminated by SPIN_ARG_END.
     */
    struct spin_args_row *rows;
    size_t n_rows, n_shown; /* --help and completion list only the first n_shown rows */
    const char *chosen;     /* plug-in that is named on the command line, or NULL */
    size_t n_pairs;         /* number of strings in spin_args.plugin_pairs */
    int argc, next;
    char **argv;
};

/* ---- Messages, signals and exit codes -------------------------------------------------------- */

/* True in one rank only, so that an error common to all ranks is printed once. */
static bool speaks = true;

/* Prints an error as one line, without the control characters that names of files may contain. */
static void print_error(const char *name, const char *text, const char *tail)
{
    char line[4096];

    if (!speaks)
        return;
    snprintf(line, sizeof line, "%s", text);
    spin_text_tidy(line, false);
    fprintf(stderr, "%s: %s%s\n", name, line, tail);
}

/* Reports that memory ran out. Unlike spin_args_misuse(), the message does not refer to --help. */
static int fail_memory(const struct spin_args_command *command)
{
    print_error(command->name, "out of memory", "");
    return SPIN_EXIT_FAILED;
}

int spin_args_misuse(const struct spin_args_command *command, const char *fmt, ...)
{
    char text[1024], tail[96];
    va_list args;

    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    snprintf(tail, sizeof tail, " (try '%s --help')", command->name);
    print_error(command->name, text, tail);
    return SPIN_EXIT_USAGE;
}

static volatile sig_atomic_t signal_seen;

/* The first signal cancels the work, which then saves its checkpoint; a second Ctrl-C exits at
 * once. */
static void on_signal(int number)
{
    if (number == SIGINT && signal_seen == SIGINT)
        _exit(128 + number);
    signal_seen = number;
    spin_cancel();
}

/* SIGPIPE is ignored, so that a long run does not end halfway if the reader of its output quits;
 * spin_args_finish() reports the failed write. */
static void catch_signals(void)
{
    struct sigaction action = {.sa_handler = on_signal, .sa_flags = SA_RESTART};

    sigemptyset(&action.sa_mask);
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    if (signal(SIGHUP, SIG_IGN) != SIG_IGN) /* under nohup, SIGHUP stays ignored */
        sigaction(SIGHUP, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
    /* A write beyond the file size limit then fails with EFBIG, which is reported. */
    signal(SIGXFSZ, SIG_IGN);
}

bool spin_args_begin(const struct spin_args_command *command, int *code)
{
    spin_status status = spin_ranks_begin();

    return status == SPIN_OK || spin_args_ended(command, status, code);
}

bool spin_args_ended(const struct spin_args_command *command, spin_status status, int *code)
{
    const char *error;

    status = spin_ranks_end(status, &speaks);
    *code = SPIN_EXIT_OK;
    if (status == SPIN_OK)
        return speaks;
    error = spin_last_error();
    print_error(command->name, *error ? error : "failed for an unknown reason", "");
    fflush(stdout);
    *code = status == SPIN_E_USAGE ? SPIN_EXIT_USAGE : SPIN_EXIT_FAILED;
    if (status == SPIN_E_CANCELLED)
        *code = 128 + (signal_seen ? signal_seen : SIGINT);
    spin_ranks_exit(*code);
    return false;
}

int spin_args_finish(const struct spin_args_command *command, int code)
{
    errno = 0;
    if (fflush(stdout) == 0 && !ferror(stdout))
        return code;
    if (errno != EPIPE) /* EPIPE: the reader of our output has ended */
        print_error(command->name,
                    "cannot write to standard output: ", strerror(errno ? errno : EIO));
    return SPIN_EXIT_FAILED;
}

int spin_args_report(const struct spin_args_command *command, char *json, const char *template)
{
    spin_json *document = NULL;

    if (spin_args.json)
        puts(json ? json : "null");
    else if (template && json &&
             spin_json_parse("report", json, strlen(json), &document) == SPIN_OK)
        spin_template_write(stdout, template, document, false);
    spin_json_free(document);
    free(json);
    return spin_args_finish(command, SPIN_EXIT_OK);
}

/* ---- Values ---------------------------------------------------------------------------------- */

/* Parses a decimal number. Returns false if the text is not a decimal number, or if the number is
 * outside the row's limits. strtod() alone would also accept leading spaces, hexadecimal floats and
 * "inf". */
static bool parse_number(const struct spin_args_row *row, const char *text, size_t length,
                         double *out)
{
    bool small = row->kind == SPIN_ARG_INT || row->kind == SPIN_ARG_INTS;
    const char *digits = small || row->kind == SPIN_ARG_UINT64 ? "+-0123456789" : "+-.0123456789eE";
    char copy[64], *end;

    if (length == 0 || length >= sizeof copy || strspn(text, digits) < length)
        return false;
    memcpy(copy, text, length);
    copy[length] = '\0';
    *out = strtod(copy, &end);
    return !*end && isfinite(*out) && !(small && fabs(*out) > INT_MAX) &&
           (row->min >= row->max || (*out >= row->min && *out <= row->max));
}

int spin_args_numbers(const struct spin_args_row *row, const char *text, double *out, int room)
{
    for (int n = 0; n < room; text++) {
        size_t length = strcspn(text, ",");

        if (!parse_number(row, text, length, &out[n++]))
            return 0;
        text += length;
        if (!*text)
            return n;
    }
    return 0;
}

static bool no_memory; /* true: the last store_value() failed because memory ran out */

static bool parse_list(const struct spin_args_row *row, const char *text)
{
    struct spin_args_list *list = row->into;
    int room = 1;

    for (const char *c = text; *c; c++)
        room += *c == ',';
    free(list->ints);
    free(list->doubles);
    list->ints = calloc((size_t)room, sizeof *list->ints);
    list->doubles = calloc((size_t)room, sizeof *list->doubles);
    no_memory = !list->ints || !list->doubles;
    list->n = no_memory ? 0 : spin_args_numbers(row, text, list->doubles, room);
    for (int i = 0; i < list->n && row->kind == SPIN_ARG_INTS; i++)
        list->ints[i] = (int)list->doubles[i];
    return list->n > 0;
}

/* Parses A:B or A:B:STEP, a half-open range that is not empty. */
static bool parse_range(const char *text, struct spin_range *range)
{
    static const struct spin_args_row whole = {.kind = SPIN_ARG_INT};
    double part[3] = {0, 0, 1};

    for (int n = 0;; text++) {
        size_t length = strcspn(text, ":");

        if (n == 3 || !parse_number(&whole, text, length, &part[n++]))
            return false;
        text += length;
        if (!*text && n < 2)
            return false;
        if (!*text)
            break;
    }
    if (part[0] < 0 || part[1] <= part[0] || part[2] < 1)
        return false;
    *range = (struct spin_range){true, (int)part[0], (int)part[1], (int)part[2]};
    return true;
}

static bool parse_colour(const struct spin_args_row *row, const char *text)
{
    float *colour = row->into;
    double value[3];

    if (!strcmp(text, "black") || !strcmp(text, "white")) {
        colour[0] = colour[1] = colour[2] = *text == 'w';
        return true;
    }
    if (spin_args_numbers(row, text, value, 3) != 3)
        return false;
    for (int c = 0; c < 3; c++)
        colour[c] = (float)value[c];
    return true;
}

int spin_args_choice(const char *text, const char *choices)
{
    size_t length = strlen(text);

    for (int place = 0;; place++) {
        size_t n = strcspn(choices, "|");

        if (n == length && !memcmp(choices, text, n))
            return place;
        if (!choices[n])
            return -1;
        choices += n + 1;
    }
}

static bool parse_enum(const struct spin_args_row *row, const char *text)
{
    /* "explicit" is the former name of --method frames; older scripts still use it. */
    bool before = strcmp(row->name, "method") == 0 && strcmp(text, "explicit") == 0;
    int place = spin_args_choice(before ? "frames" : text, row->arg);

    if (place < 0)
        return false;
    if (row->kind == SPIN_ARG_SWITCH)
        *(bool *)row->into = place == 1;
    else
        *(unsigned *)row->into = (unsigned)place;
    return true;
}

/* Parses text and stores the value in the row's variable. Returns false if text is not a valid
 * value. */
static bool store_value(const struct spin_args_row *row, const char *text)
{
    double value;

    switch (row->kind) {
    case SPIN_ARG_INT:
    case SPIN_ARG_UINT64:
    case SPIN_ARG_DOUBLE:
        if (spin_args_numbers(row, text, &value, 1) != 1)
            return false;
        if (row->kind == SPIN_ARG_INT)
            *(int *)row->into = (int)value;
        else if (row->kind == SPIN_ARG_UINT64)
            *(uint64_t *)row->into = (uint64_t)value;
        else
            *(double *)row->into = value;
        return true;
    case SPIN_ARG_STRING:
        *(const char **)row->into = text;
        return *text != '\0';
    case SPIN_ARG_CHOICE:
        *(const char **)row->into = text;
        return spin_args_choice(text, row->arg) >= 0;
    case SPIN_ARG_ENUM:
    case SPIN_ARG_SWITCH:
        return parse_enum(row, text);
    case SPIN_ARG_INTS:
    case SPIN_ARG_DOUBLES:
        return parse_list(row, text);
    case SPIN_ARG_RANGE:
        return parse_range(text, row->into);
    case SPIN_ARG_COLOUR:
        return (row->parse && row->parse(row, text)) || parse_colour(row, text);
    case SPIN_ARG_CUSTOM:
        return row->parse(row, text);
    case SPIN_ARG_FLAG:
    case SPIN_ARG_COUNT:
    case SPIN_ARG_PLUGIN:
        break;
    }
    return false;
}

static int misuse_value(const struct parser *p, const struct spin_args_row *row, const char *text)
{
    static const char *const names[] = {[SPIN_ARG_INT] = "a whole number",
                                        [SPIN_ARG_UINT64] = "a whole number",
                                        [SPIN_ARG_DOUBLE] = "a number",
                                        [SPIN_ARG_STRING] = "a non-empty string",
                                        [SPIN_ARG_INTS] = "whole numbers separated by commas",
                                        [SPIN_ARG_DOUBLES] = "numbers separated by commas",
                                        [SPIN_ARG_RANGE] =
                                            "A:B or A:B:STEP with 0 <= A < B and STEP >= 1",
                                        [SPIN_ARG_COLOUR] = "black, white or R,G,B with each",
                                        [SPIN_ARG_PLUGIN] = NULL};
    const char *what = names[row->kind] ? names[row->kind] : row->arg;

    if (no_memory)
        return fail_memory(p->command);
    if (row->min >= row->max)
        return spin_args_misuse(p->command, "'--%s' takes %s, not '%s'", row->name, what, text);
    return spin_args_misuse(p->command, "'--%s' takes %s from %.16g to %.16g, not '%s'", row->name,
                            what, row->min, row->max, text);
}

/* ---- Names ----------------------------------------------------------------------------------- */

static int misuse_unknown(const struct parser *p, const char *name, size_t length)
{
    const char *best = NULL;
    int best_distance = length < 5 ? 2 : 3;

    for (const struct spin_args_row *row = p->rows; row->help; row++) {
        int d = row->name ? spin_text_distance(name, length, row->name) : 99;

        if (row->name && length >= 3 && !strncmp(row->name, name, length))
            d = 0;
        if (d < best_distance) {
            best = row->name;
            best_distance = d;
        }
    }
    if (best)
        return spin_args_misuse(p->command, "unknown option '--%.*s', did you mean '--%s'?",
                                (int)length, name, best);
    return spin_args_misuse(p->command, "unknown option '--%.*s'", (int)length, name);
}

/* Returns the name of the i-th importer or exporter, and sets *options to its options. Returns NULL
 * if i is too large. */
static const char *plugin_name(const struct parser *p, size_t i,
                               const struct spin_plugin_option **options)
{
    const struct spin_importer *importer;
    const struct spin_exporter *exporter;

    if (!p->command->plugin_kind)
        return NULL;
    if (*p->command->plugin_kind == 'i') {
        importer = spin_importer_list()[i];
        *options = importer ? importer->options : NULL;
        return importer ? importer->name : NULL;
    }
    exporter = spin_exporter_list()[i];
    *options = exporter ? exporter->options : NULL;
    return exporter ? exporter->name : NULL;
}

/* Reports an error if the plug-in chosen on the command line does not exist. Returns an exit
 * code. */
static int check_chosen(const struct parser *p)
{
    const struct spin_plugin_option *options;
    const char *name, *best = NULL;
    int best_distance = 3;

    if (!p->chosen)
        return SPIN_EXIT_OK;
    if (strlen(p->chosen) < 5)
        best_distance = 2;
    for (size_t i = 0; (name = plugin_name(p, i, &options)); i++) {
        int d = spin_text_distance(p->chosen, strlen(p->chosen), name);

        if (!strcasecmp(p->chosen, name))
            return SPIN_EXIT_OK;
        if (d < best_distance) {
            best = name;
            best_distance = d;
        }
    }
    if (spin_plugin_fault(p->chosen)) {
        print_error(p->command->name, spin_plugin_fault(p->chosen), "");
        return SPIN_EXIT_FAILED;
    }
    if (p->command->lists_exporters && spin_exporter_of_format(p->chosen))
        best = spin_exporter_of_format(p->chosen);
    if (best)
        return spin_args_misuse(p->command, "unknown %s '%s', did you mean '%s'?",
                                p->command->plugin_kind, p->chosen, best);
    return spin_args_misuse(p->command, "unknown %s '%s'; --list shows those available",
                            p->command->plugin_kind, p->chosen);
}

static bool add_row(struct parser *p, struct spin_args_row row)
{
    void *rows = realloc(p->rows, (p->n_rows + 2) * sizeof row);

    if (!rows)
        return false;
    p->rows = rows;
    p->rows[p->n_rows++] = row;
    p->rows[p->n_rows] = (struct spin_args_row)SPIN_ARG_END;
    return true;
}

/* Collects all options, including those of the chosen plug-in, or of all plug-ins if none is
 * chosen. */
static bool list_rows(struct parser *p)
{
    const struct spin_plugin_option *o;
    const char *name;

    for (const struct spin_args_row *row = p->command->rows; row->help; row++)
        if (!add_row(p, *row))
            return false;
    for (const struct spin_args_row *row = common_rows; row->help; row++)
        if (!add_row(p, *row))
            return false;
    p->n_shown = p->n_rows;
    for (size_t i = 0; (name = plugin_name(p, i, &o)); i++)
        for (; o && o->key && (!p->chosen || !strcasecmp(p->chosen, name)); o++)
            if (!add_row(p, (struct spin_args_row){.name = o->key,
                                                   .arg = o->arg,
                                                   .kind = SPIN_ARG_PLUGIN,
                                                   .into = (void *)(uintptr_t)o->fallback,
                                                   .help = o->help}))
                return false;
    if (p->chosen)
        p->n_shown = p->n_rows;
    return true;
}

static const struct spin_args_row *find_row(const struct parser *p, const char *name, size_t length)
{
    for (const struct spin_args_row *row = p->rows; row->help; row++)
        if (row->name && strlen(row->name) == length && !memcmp(row->name, name, length))
            return row;
    return NULL;
}

static const struct spin_args_row *find_brief(const struct parser *p, char brief)
{
    for (const struct spin_args_row *row = p->rows; row->help; row++)
        if (row->name && row->brief == brief)
            return row;
    return NULL;
}

/* ---- --help ---------------------------------------------------------------------------------- */

/* Prints `left` in the first column and `help`, wrapped, in the second. */
static void print_help_row(const char *left, const char *help)
{
    int column = printf("%s", left);

    if (column > HELP_COLUMN - 2) {
        putchar('\n');
        column = 0;
    }
    while (*help) {
        int room = HELP_WIDTH - HELP_COLUMN;
        int length = (int)strlen(help);

        if (length > room) {
            length = room;
            while (length > 0 && help[length] != ' ')
                length--;
            if (length == 0)
                length = (int)strcspn(help, " ");
        }
        printf("%*s%.*s\n", HELP_COLUMN - column, "", length, help);
        column = 0;
        help += length;
        help += strspn(help, " ");
    }
}

static void print_row(const struct spin_args_row *row)
{
    const char *fallback = row->kind == SPIN_ARG_PLUGIN ? row->into : NULL;
    char left[96], help[1024], brief[8] = "    ";

    if (row->brief)
        snprintf(brief, sizeof brief, "-%c, ", row->brief);
    snprintf(left, sizeof left, "  %s--%s%s%s", brief, row->name, row->arg ? " " : "",
             row->arg ? row->arg : "");
    snprintf(help, sizeof help, fallback ? "%s (%s)" : "%s", row->help, fallback);
    print_help_row(left, help);
}

static void print_lines(const char *heading, const char *const *line)
{
    printf("%s\n", heading);
    for (; *line; line++)
        printf("  %s\n", *line);
}

/* Prints the options of the chosen plug-in. */
static void print_plugin(const struct parser *p)
{
    bool none = true;

    printf("\nOptions of the %s '%s':\n", p->command->plugin_kind, p->chosen);
    for (const struct spin_args_row *row = p->rows; row->help; row++) {
        if (row->kind != SPIN_ARG_PLUGIN)
            continue;
        print_row(row);
        none = false;
    }
    if (none)
        printf("  none\n");
}

/* Prints the exporters: if `whole`, one per line with its summary, else only their names. */
static void print_exporters(const struct spin_args_command *command, bool whole)
{
    char left[96], names[512] = "";
    size_t at = 0;

    if (whole)
        printf("\nExporters (NAME of --%s):\n", command->plugin_selector);
    for (const struct spin_exporter *const *i = spin_exporter_list(); *i; i++) {
        snprintf(left, sizeof left, "      %s", (*i)->name);
        if (whole)
            print_help_row(left, (*i)->summary);
        else if (at < sizeof names)
            at +=
                (size_t)snprintf(names + at, sizeof names - at, "%s%s", at ? ", " : "", (*i)->name);
    }
    if (!whole) {
        printf("\nExporters (NAME of --%s):\n", command->plugin_selector);
        print_help_row("     ", names);
    }
}

static void print_help(const struct parser *p)
{
    const struct spin_args_command *command = p->command;

    printf("%s: %s\n", command->name, command->summary);
    print_lines("", command->usage);
    if (wants_help == WHOLE_HELP) {
        for (const struct spin_args_row *row = p->rows; row < p->rows + p->n_shown; row++) {
            if (!row->name)
                printf("\n%s:\n", row->help);
            else if (row->kind != SPIN_ARG_PLUGIN)
                print_row(row);
        }
    } else if (!p->chosen) {
        print_lines("\nExamples:", command->examples);
        printf("\nOptions:\n");
        for (const char *const *name = command->main; *name; name++)
            print_row(find_row(p, *name, strlen(*name)));
    }
    if (command->lists_exporters && !p->chosen)
        print_exporters(command, wants_help == WHOLE_HELP);
    if (p->chosen)
        print_plugin(p);
    else if (command->plugin_kind)
        printf("%sOptions of one %s: %s --%s NAME --help\n", command->lists_exporters ? "" : "\n",
               command->plugin_kind, command->name, command->plugin_selector);
    if (wants_help == SHORT_HELP)
        printf("\nAll options: %s --help all, or man %s\n", command->name, command->name);
    else
        printf("\nManual: man %s\n", command->name);
}

/* ---- Completion ------------------------------------------------------------------------------ */

/* Prints a completion script. With this script, the shell runs `spin-x --complete WORD...`, which
 * prints the completions of the last word, one per line; options are followed by a colon and their
 * help text. */
static void print_completion(const struct spin_args_command *command, const char *shell)
{
    const char *name = command->name;
    char function[32];

    snprintf(function, sizeof function, "_%s", name);
    for (char *c = function; *c; c++)
        if (*c == '-')
            *c = '_';
    if (*shell == 'z')
        printf("#compdef %s\nlocal -a found=(${(f)\"$(%s --complete ${words[2,CURRENT]})\"})\n"
               "compset -P '--*='\nif (( $#found )); then _describe %s found; else _files; fi\n",
               name, name, name);
    else
        printf("%s()\n{\n"
               "    mapfile -t COMPREPLY < <(%s --complete \"${COMP_WORDS[@]:1:COMP_CWORD}\")\n"
               "    COMPREPLY=(\"${COMPREPLY[@]%%%%:*}\")\n}\n"
               "complete -o default -F %s %s\n",
               function, name, function, name);
}

static void print_candidate(const char *word, size_t length, const char *begun)
{
    if (!strncmp(word, begun, strlen(begun)))
        printf("%.*s\n", (int)length, word);
}

/* Completes values that are fixed words: names of plug-ins and of data set formats, and the words
 * without capitals in arg, such as auto and none in "auto|none|CX,CY,CZ,R". */
static void print_value_candidates(const struct parser *p, const struct spin_args_row *row,
                                   const char *begun)
{
    const struct spin_plugin_option *options;
    const char *name, *selector = p->command->plugin_selector;

    for (size_t i = 0;
         selector && !strcmp(row->name, selector) && (name = plugin_name(p, i, &options)); i++)
        print_candidate(name, strlen(name), begun);
    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++)
        if ((*i)->views && !strcmp(row->name, "data-from"))
            print_candidate((*i)->name, strlen((*i)->name), begun);
    name = row->kind == SPIN_ARG_COLOUR ? "black|white" : strchr(row->arg, '|') ? row->arg : "";
    for (size_t length; *name; name += length + (name[length] == '|')) {
        size_t capitals = 0;

        length = strcspn(name, "|");
        for (size_t i = 0; i < length; i++)
            capitals += isupper((unsigned char)name[i]) != 0;
        if (!capitals)
            print_candidate(name, length, begun);
    }
}

static void print_candidates(const struct parser *p, int n, char **word)
{
    const char *begun = n > 0 ? word[n - 1] : "", *before = n > 1 ? word[n - 2] : "";
    size_t length = strlen(before);
    const struct spin_args_row *row;

    /* bash passes --name=value as three words, zsh as one. */
    if (!strcmp(begun, "="))
        begun = "";
    else if (!strcmp(before, "=") && n > 2)
        length = strlen(before = word[n - 3]);
    else if (!strncmp(begun, "--", 2) && strchr(begun, '=')) {
        before = begun;
        length = strcspn(before, "=");
        begun += length + 1;
    }
    row = length > 2 && !strncmp(before, "--", 2) ? find_row(p, before + 2, length - 2)
          : length == 2 && *before == '-'         ? find_brief(p, before[1])
                                                  : NULL;
    if (row && row->arg) {
        print_value_candidates(p, row, begun);
        return;
    }
    for (const char *const *first = p->command->words; first && *first && n == 1; first++)
        print_candidate(*first, strlen(*first), begun);
    for (row = p->rows; *begun == '-' && row < p->rows + p->n_shown; row++)
        if (row->name && !strncmp(begun, "--", 2) &&
            !strncmp(row->name, begun + 2, strlen(begun + 2)))
            printf("--%s:%s\n", row->name, row->help);
}

/* ---- Reading the command line ---------------------------------------------------------------- */

const char *spin_args_find(int argc, char **argv, const char *name)
{
    const char *chosen = NULL;
    size_t length = strlen(name);

    for (int i = 1; i < argc && strcmp(argv[i], "--"); i++) {
        if (strncmp(argv[i], "--", 2) || strncmp(argv[i] + 2, name, length))
            continue;
        if (argv[i][2 + length] == '=')
            chosen = argv[i] + 3 + length;
        else if (!argv[i][2 + length] && i + 1 < argc)
            chosen = argv[++i];
        /* bash splits --name=value into three words, see print_candidates(). */
        if (chosen && !strcmp(chosen, "=") && i + 1 < argc)
            chosen = argv[++i];
    }
    return chosen;
}

/* Stores an option of a plug-in as a key and a value. The plug-in parses the value itself. */
static int keep_pair(struct parser *p, const struct spin_args_row *row, const char *value)
{
    const char **pairs = realloc(spin_args.plugin_pairs, (p->n_pairs + 3) * sizeof *pairs);

    for (const struct spin_args_row *other = row; other->help; other++)
        if (other->name && !strcmp(other->name, row->name) && !other->arg != !row->arg)
            return spin_args_misuse(
                p->command, "the meaning of '--%s' depends on the %s: choose one with --%s",
                row->name, p->command->plugin_kind, p->command->plugin_selector);
    if (!pairs)
        return fail_memory(p->command);
    spin_args.plugin_pairs = pairs;
    pairs[p->n_pairs++] = row->name;
    pairs[p->n_pairs++] = value;
    pairs[p->n_pairs] = NULL;
    return SPIN_EXIT_OK;
}

/* Stores an option. If `value` is NULL, the next word is the value; if that word is a long option,
 * the value is missing. */
static int store_option(struct parser *p, const struct spin_args_row *row, const char *value)
{
    if (!row->arg && value)
        return spin_args_misuse(p->command, "'--%s' takes no value", row->name);
    if (row->arg && !value && p->next < p->argc && strncmp(p->argv[p->next], "--", 2))
        value = p->argv[p->next++];
    if (row->arg && !value)
        return spin_args_misuse(p->command, "'--%s' needs a value: %s", row->name, row->arg);
    if (row->kind == SPIN_ARG_PLUGIN)
        return keep_pair(p, row, value ? value : "1");
    if (row->kind == SPIN_ARG_COUNT)
        ++*(int *)row->into;
    else if (row->kind == SPIN_ARG_FLAG)
        *(bool *)row->into = true;
    else if (!store_value(row, value))
        return misuse_value(p, row, value);
    return SPIN_EXIT_OK;
}

/* Parses --name, --name=value and --name value; `text` is what follows the dashes. */
static int parse_long(struct parser *p, const char *text)
{
    size_t length = strcspn(text, "=");
    const struct spin_args_row *row = find_row(p, text, length);

    return row ? store_option(p, row, text[length] ? text + length + 1 : NULL)
               : misuse_unknown(p, text, length);
}

/* Parses -q, -vvv, -ofile and -o file; `text` is what follows the dash. */
static int parse_brief(struct parser *p, const char *text)
{
    int code = SPIN_EXIT_OK;

    for (; *text && code == SPIN_EXIT_OK; text++) {
        const struct spin_args_row *row = find_brief(p, *text);

        if (!row)
            return spin_args_misuse(p->command, "unknown option '-%c'", *text);
        if (row->arg)
            return store_option(p, row, text[1] ? text + 1 : NULL);
        code = store_option(p, row, NULL);
    }
    return code;
}

static int keep_word(struct parser *p, const char *text)
{
    const char **words =
        realloc(spin_args.all_words, ((size_t)spin_args.n_words + 1) * sizeof *words);

    if (!words)
        return fail_memory(p->command);
    spin_args.all_words = words;
    words[spin_args.n_words++] = text;
    spin_args.word = words[0];
    return SPIN_EXIT_OK;
}

static int parse_all(struct parser *p)
{
    bool only_words = false;
    int code = SPIN_EXIT_OK;

    for (p->next = 1; p->next < p->argc && code == SPIN_EXIT_OK;) {
        const char *text = p->argv[p->next++];

        if (!only_words && !strcmp(text, "--"))
            only_words = true;
        else if (!only_words && text[0] == '-' && text[1] == '-')
            code = parse_long(p, text + 2);
        else if (!only_words && text[0] == '-' && text[1])
            code = parse_brief(p, text + 1);
        else if (spin_args.word && !p->command->takes_many)
            return spin_args_misuse(p->command, "unexpected argument '%s'%s%s", text,
                                    p->command->several ? ": " : "",
                                    p->command->several ? p->command->several : "");
        else
            code = keep_word(p, text);
    }
    return code;
}

/* --help succeeds even if other arguments are wrong, so it is searched for before parsing. */
static enum help find_help(int argc, char **argv)
{
    for (int i = 1; i < argc && strcmp(argv[i], "--"); i++) {
        bool here = !strcmp(argv[i], "--help") || !strcmp(argv[i], "-h");

        if (!strcmp(argv[i], "--help=all") || (here && i + 1 < argc && !strcmp(argv[i + 1], "all")))
            return WHOLE_HELP;
        if (here)
            return SHORT_HELP;
    }
    return NO_HELP;
}

/* Handles --help, --version and completion, or else parses all arguments. Returns true if the
 * command should run; otherwise sets *code to the exit code of the program. */
static bool handle_arguments(struct parser *p, int *code)
{
    bool completes = p->argc > 1 && !strcmp(p->argv[1], "--complete");

    if (!list_rows(p)) {
        *code = fail_memory(p->command);
        return false;
    }
    wants_help = find_help(p->argc, p->argv);
    *code = completes ? SPIN_EXIT_OK : check_chosen(p);
    if (*code == SPIN_EXIT_OK && !completes && !wants_help)
        *code = parse_all(p);
    if (*code != SPIN_EXIT_OK)
        return false;
    if (speaks && completes)
        print_candidates(p, p->argc - 2, p->argv + 2);
    else if (speaks && wants_help)
        print_help(p);
    else if (speaks && wants_version)
        printf("%s %s\n", p->command->name, SPIN_VERSION);
    else if (speaks && wants_completion)
        print_completion(p->command, wants_completion);
    else if (!wants_help && !wants_version && !wants_completion)
        return true;
    *code = spin_args_finish(p->command, SPIN_EXIT_OK);
    return false;
}

bool spin_args_parse(const struct spin_args_command *command, int argc, char **argv, int *exit_code)
{
    struct parser p = {.command = command, .argc = argc, .argv = argv};
    bool goes_on;

    spin_program_restart(argv);
    /* One write() per line, so that mpirun does not mix lines of several ranks. */
    setvbuf(stderr, NULL, _IOLBF, 0);
    speaks = spin_ranks_env_rank() <= 0;
    if (command->plugin_kind) {
        /* Load plug-ins before parsing, since they define options. */
        p.chosen = spin_args_find(argc, argv, command->plugin_selector);
        spin_plugins_load(p.chosen);
    }
    goes_on = handle_arguments(&p, exit_code);
    free(p.rows);
    if (!goes_on)
        return false;
    spin_set_verbosity(spin_args.quiet ? -1 : spin_args.verbose > 4 ? 4 : spin_args.verbose);
    catch_signals();
    spin_catch_cut_files(command->name);
    return true;
}
