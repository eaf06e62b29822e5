/* The --help text of a command. */
#include <stdio.h>
#include <string.h>

#include "cmd/args.h"

enum { HELP_COLUMN = 28, HELP_WIDTH = 84 };

/* `left` in the first column, `help` wrapped in the second. */
static void print_row(const char *left, const char *help)
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

static void print_option(const struct spin_args_row *row)
{
    char left[96], brief[8] = "    ";

    if (row->short_name)
        snprintf(brief, sizeof brief, "-%c, ", row->short_name);
    snprintf(left, sizeof left, "  %s--%s%s%s", brief, row->name, row->arg ? " " : "",
             row->arg ? row->arg : "");
    print_row(left, row->help);
}

static void print_plugin_options(const struct spin_args_command *command,
                                 const struct spin_args_plugin *plugin)
{
    printf("\nOptions of the %s '%s':\n", command->plugin_kind, plugin->name);
    if (!plugin->options || !plugin->options->key)
        printf("  none\n");
    for (const struct spin_plugin_option *o = plugin->options; o && o->key; o++) {
        char left[96], help[512];

        snprintf(left, sizeof left, "      --%s%s%s", o->key, o->arg ? " " : "",
                 o->arg ? o->arg : "");
        snprintf(help, sizeof help, o->fallback ? "%s (%s)" : "%s", o->help, o->fallback);
        print_row(left, help);
    }
}

void spin_args_print_help(const struct spin_args_command *command,
                          const struct spin_args_plugin *chosen)
{
    printf("%s: %s\n\n", command->name, command->summary);
    for (const char *const *line = command->usage; *line; line++)
        printf("  %s\n", *line);
    for (const struct spin_args_row *row = command->rows; row->name || row->section; row++) {
        if (row->name)
            print_option(row);
        else
            printf("\n%s:\n", row->section);
    }
    if (chosen)
        print_plugin_options(command, chosen);
    if (command->plugin_kind && !chosen)
        printf("\nAn %s can have options of its own: %s --%s NAME --help\n", command->plugin_kind,
               command->name, command->plugin_selector);
    printf("\nThe manual page has examples: man %s\n", command->name);
}
