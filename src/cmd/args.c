/* The parser of the command line, and exit codes. */
#include "cmd/args.h"

#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "spin_run.h"
#include "base/text.h"
#include "cmd/signals.h"

enum { MAX_PLUGINS = 128 };

/* ---- Messages and exit codes ----------------------------------------------------------------- */

/* Of several processes that fail alike one says so. */
static bool speaks = true;

/* Text from outside may hold line breaks and escape sequences; an error stays one plain line. */
static void put_line(const char *name, const char *text, const char *tail)
{
    char line[4096];

    if (!speaks)
        return;
    snprintf(line, sizeof line, "%s", text);
    spin_text_tidy(line, false);
    fprintf(stderr, "%s: %s%s\n", name, line, tail);
}

int spin_args_misuse(const struct spin_args_command *command, const char *fmt, ...)
{
    char text[1024], tail[96];
    va_list args;

    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    snprintf(tail, sizeof tail, " (try '%s --help')", command->name);
    put_line(command->name, text, tail);
    return SPIN_EXIT_USAGE;
}

bool spin_args_ended(const struct spin_args_command *command, spin_status status, int *code)
{
    const char *error;

    status = spin_ranks_end(status, &speaks);
    *code = SPIN_EXIT_OK;
    if (status == SPIN_OK)
        return speaks;
    error = spin_last_error();
    put_line(command->name, *error ? error : "failed without saying why", "");
    fflush(stdout);
    *code = status == SPIN_E_USAGE ? SPIN_EXIT_USAGE : SPIN_EXIT_FAILED;
    if (status == SPIN_E_CANCELLED)
        *code = spin_signals_exit_code();
    spin_ranks_exit(*code);
    return false;
}

int spin_args_finish(const struct spin_args_command *command, int code)
{
    errno = 0;
    if (fflush(stdout) == 0 && !ferror(stdout))
        return code;
    if (errno != EPIPE) /* a reader that has left needs no explanation */
        put_line(command->name,
                 "cannot write to the standard output: ", strerror(errno ? errno : EIO));
    return SPIN_EXIT_FAILED;
}

/* ---- Values ---------------------------------------------------------------------------------- */

static bool has_limits(const struct spin_args_row *row) { return row->min < row->max; }

static bool within(const struct spin_args_row *row, double value)
{
    return !has_limits(row) || (value >= row->min && value <= row->max);
}

/* strtol and friends skip leading space and accept less than the whole text; options do not. */
static bool begins_like_number(const char *text) { return *text && strchr("+-.0123456789", *text); }

static bool parse_int(const char *text, size_t length, int *out)
{
    char copy[32], *end;

    if (length == 0 || length >= sizeof copy || !begins_like_number(text))
        return false;
    memcpy(copy, text, length);
    copy[length] = '\0';
    errno = 0;
    long value = strtol(copy, &end, 10);
    if (errno || *end || end == copy || value < INT_MIN || value > INT_MAX)
        return false;
    *out = (int)value;
    return true;
}

static bool parse_uint64(const char *text, uint64_t *out)
{
    char *end;

    if (!begins_like_number(text) || *text == '-')
        return false;
    errno = 0;
    unsigned long long value = strtoull(text, &end, 10);
    if (errno || *end || end == text)
        return false;
    *out = value;
    return true;
}

/* Hexadecimal floats are left out: they are always typing errors here. Underflow is not an error. */
static bool parse_double(const char *text, size_t length, double *out)
{
    char copy[64], *end;

    if (length == 0 || length >= sizeof copy || !begins_like_number(text))
        return false;
    memcpy(copy, text, length);
    copy[length] = '\0';
    if (strpbrk(copy, "xXpP"))
        return false;
    double value = strtod(copy, &end);
    if (*end || end == copy || !isfinite(value))
        return false;
    *out = value;
    return true;
}

static int count_items(const char *text)
{
    int n = 1;

    for (; *text; text++)
        n += *text == ',';
    return n;
}

/* Into the row's struct spin_args_ints or _doubles. */
static bool parse_list(const struct spin_args_row *row, const char *text)
{
    struct spin_args_ints *ints = row->kind == SPIN_ARG_INTS ? row->into : NULL;
    struct spin_args_doubles *doubles = ints ? NULL : row->into;
    int n = count_items(text);

    free(ints ? (void *)ints->value : (void *)doubles->value);
    if (ints)
        *ints = (struct spin_args_ints){calloc((size_t)n, sizeof *ints->value), n};
    else
        *doubles = (struct spin_args_doubles){calloc((size_t)n, sizeof *doubles->value), n};
    if (ints ? !ints->value : !doubles->value)
        return false;
    for (int i = 0; i < n; i++) {
        size_t length = strcspn(text, ",");

        if (ints ? !parse_int(text, length, &ints->value[i]) || !within(row, ints->value[i])
                 : !parse_double(text, length, &doubles->value[i]) ||
                       !within(row, doubles->value[i]))
            return false;
        text += length + 1;
    }
    return true;
}

int spin_args_numbers(const struct spin_args_row *row, const char *text, double *out, int room)
{
    int n = count_items(text);

    for (int i = 0; i < n; i++) {
        size_t length = strcspn(text, ",");

        if (n > room || !parse_double(text, length, &out[i]) || !within(row, out[i]))
            return 0;
        text += length + 1;
    }
    return n;
}

/* A:B or A:B:STEP, half open and not empty. */
static bool parse_range(const char *text, struct spin_range *range)
{
    int part[3] = {0, 0, 1};
    int n = 0;

    for (;;) {
        size_t length = strcspn(text, ":");

        if (n == 3 || !parse_int(text, length, &part[n++]))
            return false;
        if (!text[length])
            break;
        text += length + 1;
    }
    if (n < 2 || part[0] < 0 || part[1] <= part[0] || part[2] < 1)
        return false;
    *range = (struct spin_range){true, part[0], part[1], part[2]};
    return true;
}

static bool parse_colour(const struct spin_args_row *row, const char *text)
{
    static const struct spin_args_row channel = {.min = 0, .max = 1};
    float *colour = row->into;
    double value[3];

    if (!strcmp(text, "black") || !strcmp(text, "white")) {
        colour[0] = colour[1] = colour[2] = *text == 'w';
        return true;
    }
    if (spin_args_numbers(&channel, text, value, 3) != 3)
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
    /* Older scripts say --method explicit. */
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

/* What the value should have been, for the message. */
static void describe(const struct spin_args_row *row, char *out, size_t room)
{
    const char *what = row->arg;

    switch (row->kind) {
    case SPIN_ARG_INT:
        what = "a whole number";
        break;
    case SPIN_ARG_UINT64:
        what = "a whole number from 0";
        break;
    case SPIN_ARG_DOUBLE:
        what = "a number";
        break;
    case SPIN_ARG_INTS:
        what = "whole numbers with commas between";
        break;
    case SPIN_ARG_DOUBLES:
        what = "numbers with commas between";
        break;
    case SPIN_ARG_STRING:
        what = "a text that is not empty";
        break;
    case SPIN_ARG_RANGE:
        what = "A:B or A:B:STEP with 0 <= A < B and STEP >= 1";
        break;
    case SPIN_ARG_COLOUR:
        what = "black, white or R,G,B with each in 0..1";
        break;
    default:
        break;
    }
    int n = snprintf(out, room, "%s", what);
    if (row->kind == SPIN_ARG_UINT64 && has_limits(row) && n > 0 && (size_t)n < room)
        snprintf(out + n, room - (size_t)n, " to %.0f", row->max);
    else if (has_limits(row) && n > 0 && (size_t)n < room)
        snprintf(out + n, room - (size_t)n, " from %.10g to %.10g", row->min, row->max);
}

/* Store a value; true when it is one. */
static bool store(const struct spin_args_row *row, const char *text)
{
    switch (row->kind) {
    case SPIN_ARG_INT: {
        int value;

        if (!parse_int(text, strlen(text), &value) || !within(row, value))
            return false;
        *(int *)row->into = value;
        return true;
    }
    case SPIN_ARG_DOUBLE: {
        double value;

        if (!parse_double(text, strlen(text), &value) || !within(row, value))
            return false;
        *(double *)row->into = value;
        return true;
    }
    case SPIN_ARG_UINT64:
        return parse_uint64(text, row->into) && within(row, (double)*(uint64_t *)row->into);
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
        return parse_colour(row, text);
    case SPIN_ARG_CUSTOM:
        return row->parse(row, text);
    case SPIN_ARG_FLAG:
    case SPIN_ARG_COUNT:
        break;
    }
    return false;
}

static bool takes_value(const struct spin_args_row *row)
{
    return row->kind != SPIN_ARG_FLAG && row->kind != SPIN_ARG_COUNT;
}

static void set_flag(const struct spin_args_row *row)
{
    if (row->kind == SPIN_ARG_COUNT)
        ++*(int *)row->into;
    else
        *(bool *)row->into = true;
}

/* ---- Looking up ------------------------------------------------------------------------------ */

static bool is_end(const struct spin_args_row *row) { return !row->name && !row->section; }

static const struct spin_args_row *find_long(const struct spin_args_row *rows, const char *name,
                                             size_t length)
{
    for (; !is_end(rows); rows++)
        if (rows->name && strlen(rows->name) == length && !memcmp(rows->name, name, length))
            return rows;
    return NULL;
}

static const struct spin_args_row *find_short(const struct spin_args_row *rows, char name)
{
    for (; !is_end(rows); rows++)
        if (rows->name && rows->short_name == name)
            return rows;
    return NULL;
}

/* Edits that turn one name into the other (Levenshtein); names longer than 31 count as far. */
static int distance(const char *a, size_t n_a, const char *b, size_t n_b)
{
    int row[32];

    if (n_a > 31 || n_b > 31)
        return 99;
    for (size_t j = 0; j <= n_b; j++)
        row[j] = (int)j;
    for (size_t i = 1; i <= n_a; i++) {
        int diagonal = row[0];

        row[0] = (int)i;
        for (size_t j = 1; j <= n_b; j++) {
            int change = diagonal + (a[i - 1] != b[j - 1]);
            int best = row[j] < row[j - 1] ? row[j] + 1 : row[j - 1] + 1;

            diagonal = row[j];
            row[j] = best < change ? best : change;
        }
    }
    return row[n_b];
}

/* What all functions below share while one command line is read. */
struct parser {
    const struct spin_args_command *command;
    struct spin_args_words *words;
    int max_words;
    struct spin_args_plugin plugin[MAX_PLUGINS];
    size_t n_plugins;
    const char *chosen; /* plug-in named on the command line, or NULL */
    size_t n_pairs;     /* strings in words->plugin_pairs */
    int argc, next;
    char **argv;
};

static bool is_candidate(const struct parser *p, size_t plugin)
{
    return p->plugin[plugin].options && (!p->chosen || !strcmp(p->chosen, p->plugin[plugin].name));
}

static int misuse_unknown(const struct parser *p, const char *name, size_t length)
{
    const char *best = NULL;
    int best_distance = length < 5 ? 2 : 3;

    for (const struct spin_args_row *row = p->command->rows; !is_end(row); row++) {
        int d = row->name ? distance(name, length, row->name, strlen(row->name)) : 99;

        if (d < best_distance ||
            (row->name && length >= 3 && !strncmp(row->name, name, length) && best_distance > 0)) {
            best = row->name;
            best_distance = d < best_distance ? d : 0;
        }
    }
    for (size_t i = 0; i < p->n_plugins; i++)
        for (const struct spin_plugin_option *o = p->plugin[i].options;
             is_candidate(p, i) && o->key; o++) {
            int d = distance(name, length, o->key, strlen(o->key));

            if (d < best_distance) {
                best = o->key;
                best_distance = d;
            }
        }
    if (best)
        return spin_args_misuse(p->command, "unknown option '--%.*s', did you mean '--%s'?",
                                (int)length, name, best);
    return spin_args_misuse(p->command, "unknown option '--%.*s'", (int)length, name);
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
    }
    return chosen;
}

static const struct spin_plugin_option *find_plugin_option(const struct parser *p, const char *name,
                                                           size_t length, bool *torn)
{
    const struct spin_plugin_option *found = NULL;

    *torn = false;
    for (size_t i = 0; i < p->n_plugins; i++) {
        if (!is_candidate(p, i))
            continue;
        for (const struct spin_plugin_option *o = p->plugin[i].options; o->key; o++) {
            if (strlen(o->key) != length || memcmp(o->key, name, length))
                continue;
            if (found && !found->arg != !o->arg)
                *torn = true;
            found = o;
        }
    }
    return found;
}

static bool keep_pair(struct parser *p, const char *key, const char *value)
{
    const char **pairs = realloc(p->words->plugin_pairs, (p->n_pairs + 3) * sizeof *pairs);

    if (!pairs)
        return false;
    p->words->plugin_pairs = pairs;
    pairs[p->n_pairs++] = key;
    pairs[p->n_pairs++] = value;
    pairs[p->n_pairs] = NULL;
    return true;
}

/* The next word as a value; another option in its place means that the value was forgotten. */
static const char *next_value(struct parser *p)
{
    if (p->next >= p->argc || !strncmp(p->argv[p->next], "--", 2))
        return NULL;
    return p->argv[p->next++];
}

/* --name, --name=value, --name value of a plug-in. */
static int take_plugin_option(struct parser *p, const char *name, size_t length, const char *value)
{
    bool torn;
    const struct spin_plugin_option *option = find_plugin_option(p, name, length, &torn);

    if (!option)
        return misuse_unknown(p, name, length);
    if (torn)
        return spin_args_misuse(p->command, "'--%s' means different things; say which %s with --%s",
                                option->key, p->command->plugin_kind, p->command->plugin_selector);
    if (option->arg && !value)
        value = next_value(p);
    if (option->arg && !value)
        return spin_args_misuse(p->command, "'--%s' needs a value %s", option->key, option->arg);
    if (!option->arg && value)
        return spin_args_misuse(p->command, "'--%s' takes no value", option->key);
    if (!keep_pair(p, option->key, value ? value : "1"))
        return spin_args_misuse(p->command, "out of memory");
    return SPIN_EXIT_OK;
}

static int take_value(struct parser *p, const struct spin_args_row *row, const char *value)
{
    char expected[160];

    if (!value)
        value = next_value(p);
    if (!value)
        return spin_args_misuse(p->command, "'--%s' needs a value %s", row->name, row->arg);
    if (store(row, value))
        return SPIN_EXIT_OK;
    describe(row, expected, sizeof expected);
    return spin_args_misuse(p->command, "'--%s' takes %s, not '%s'", row->name, expected, value);
}

static int take_long(struct parser *p, const char *text)
{
    size_t length = strcspn(text, "=");
    const char *value = text[length] ? text + length + 1 : NULL;
    const struct spin_args_row *row = find_long(p->command->rows, text, length);

    if (!row)
        return take_plugin_option(p, text, length, value);
    if (takes_value(row))
        return take_value(p, row, value);
    if (value)
        return spin_args_misuse(p->command, "'--%s' takes no value", row->name);
    set_flag(row);
    return SPIN_EXIT_OK;
}

/* -q, -vvv, -ofile, -o file. */
static int take_short(struct parser *p, const char *text)
{
    for (; *text; text++) {
        const struct spin_args_row *row = find_short(p->command->rows, *text);

        if (!row)
            return spin_args_misuse(p->command, "unknown option '-%c'", *text);
        if (takes_value(row))
            return take_value(p, row, text[1] ? text + 1 : NULL);
        set_flag(row);
    }
    return SPIN_EXIT_OK;
}

static int take_word(struct parser *p, const char *text)
{
    if (p->words->n == p->max_words)
        return spin_args_misuse(p->command, "unexpected argument '%s'", text);
    p->words->word[p->words->n++] = text;
    return SPIN_EXIT_OK;
}

static int read_all(struct parser *p)
{
    bool only_words = false;

    for (p->next = 1; p->next < p->argc;) {
        const char *text = p->argv[p->next++];
        int code;

        if (!only_words && !strcmp(text, "--")) {
            only_words = true;
            continue;
        }
        if (only_words || text[0] != '-' || !text[1])
            code = take_word(p, text);
        else if (text[1] == '-')
            code = take_long(p, text + 2);
        else
            code = take_short(p, text + 1);
        if (code != SPIN_EXIT_OK)
            return code;
    }
    return SPIN_EXIT_OK;
}

/* ---- The front door -------------------------------------------------------------------------- */

static int check_chosen(const struct parser *p)
{
    const char *best = NULL;
    int best_distance = 3;

    if (!p->chosen)
        return SPIN_EXIT_OK;
    for (size_t i = 0; i < p->n_plugins; i++) {
        const char *name = p->plugin[i].name;
        int d = distance(p->chosen, strlen(p->chosen), name, strlen(name));

        if (d == 0)
            return SPIN_EXIT_OK;
        if (d < best_distance) {
            best = name;
            best_distance = d;
        }
    }
    if (spin_plugin_fault(p->chosen)) {
        put_line(p->command->name, spin_plugin_fault(p->chosen), "");
        return SPIN_EXIT_FAILED;
    }
    if (best)
        return spin_args_misuse(p->command, "no %s is called '%s', did you mean '%s'?",
                                p->command->plugin_kind, p->chosen, best);
    return spin_args_misuse(p->command, "no %s is called '%s'; --list shows them",
                            p->command->plugin_kind, p->chosen);
}

static const struct spin_args_plugin *chosen_plugin(const struct parser *p)
{
    for (size_t i = 0; i < p->n_plugins; i++)
        if (p->chosen && !strcmp(p->chosen, p->plugin[i].name))
            return &p->plugin[i];
    return NULL;
}

/* --help answers whatever else was typed, so it is looked for before mistakes are. */
static bool asks_for_help(int argc, char **argv)
{
    for (int i = 1; i < argc && strcmp(argv[i], "--"); i++)
        if (!strcmp(argv[i], "--help") || !strcmp(argv[i], "-h"))
            return true;
    return false;
}

bool spin_args_parse(const struct spin_args_command *command, int argc, char **argv, int max_words,
                     struct spin_args_words *words, int *exit_code)
{
    const struct spin_args_common *common = command->common;
    struct parser p = {
        .command = command, .words = words, .max_words = max_words, .argc = argc, .argv = argv};

    *words = (struct spin_args_words){0};
    setvbuf(stderr, NULL, _IOLBF, 0); /* a line is one write: mpirun puts nothing into it */
    speaks = spin_ranks_place() <= 0;
    if (command->plugins) {
        /* first: which options are known depends on it, wherever it stands */
        p.chosen = spin_args_find(argc, argv, command->plugin_selector);
        spin_plugins_load(p.chosen);
        p.n_plugins = command->plugins(p.plugin, MAX_PLUGINS);
    }
    if (asks_for_help(argc, argv)) {
        *exit_code = check_chosen(&p);
        if (*exit_code == SPIN_EXIT_OK && speaks) {
            spin_args_print_help(command, chosen_plugin(&p));
            *exit_code = spin_args_finish(command, SPIN_EXIT_OK);
        }
        return false;
    }
    *exit_code = check_chosen(&p);
    if (*exit_code == SPIN_EXIT_OK)
        *exit_code = read_all(&p);
    if (*exit_code != SPIN_EXIT_OK)
        return false;
    if (common->version || common->completion) {
        if (speaks && common->version)
            printf("%s %s\n", command->name, SPIN_VERSION);
        else if (speaks)
            spin_args_print_completion(command, p.plugin, p.n_plugins, common->completion);
        *exit_code = spin_args_finish(command, SPIN_EXIT_OK);
        return false;
    }
    spin_set_verbosity(common->quiet ? -1 : common->verbose > 4 ? 4 : common->verbose);
    spin_signals_catch();
    spin_catch_cut_files(command->name);
    return true;
}

bool spin_args_begin(const struct spin_args_command *command, int *code)
{
    spin_status status = spin_ranks_begin();

    return status == SPIN_OK || spin_args_ended(command, status, code);
}
