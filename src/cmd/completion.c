/* Completion scripts for bash and zsh, from the tables of options. */
#include <ctype.h>
#include <stdio.h>
#include <string.h>

#include "cmd/args.h"

/* What stands after an option: nothing, one of some words, a path, or what nobody can guess. */
enum value { NO_VALUE, WORDS, PATH, OTHER };

enum { MOST = 4096 };

/* One word more, with a blank after each. */
static void add(char words[MOST], const char *word, size_t length)
{
    size_t n = strlen(words);

    if (n + length + 2 <= MOST)
        snprintf(words + n, MOST - n, "%.*s ", (int)length, word);
}

/* Of "auto|none|CX,CY,CZ,R" those that are meant literally: they have no capitals. */
static void add_choices(char words[MOST], const char *arg)
{
    for (size_t length;; arg += length + 1) {
        size_t capitals = 0;

        length = strcspn(arg, "|");
        for (size_t i = 0; i < length; i++)
            capitals += isupper((unsigned char)arg[i]) != 0;
        if (!capitals)
            add(words, arg, length);
        if (!arg[length])
            return;
    }
}

static enum value value_of_word(const char *arg, char words[MOST])
{
    static const char *const paths[] = {"FILE", "DIR", "FOLDER", "PATH", "OUT", NULL};

    *words = '\0';
    if (!arg)
        return NO_VALUE;
    if (strchr(arg, '|'))
        add_choices(words, arg);
    if (*words)
        return WORDS;
    for (const char *const *p = paths; *p; p++)
        if (!strncmp(arg, *p, strlen(*p)))
            return PATH;
    return OTHER;
}

static enum value value_of(const struct spin_args_command *command, const struct spin_args_plugin *plugin,
                           size_t n_plugins, const struct spin_args_row *row, char words[MOST])
{
    *words = '\0';
    if (command->plugin_selector && !strcmp(row->name, command->plugin_selector))
        for (size_t i = 0; i < n_plugins; i++)
            add(words, plugin[i].name, strlen(plugin[i].name));
    if (!strcmp(row->name, "data-from"))
        for (const struct spin_importer *const *i = spin_importer_list(); *i; i++)
            if ((*i)->views)
                add(words, (*i)->name, strlen((*i)->name));
    if (row->kind == SPIN_ARG_COLOUR)
        add(words, "black white", 11);
    return *words ? WORDS : value_of_word(row->arg, words);
}

/* ---- bash ------------------------------------------------------------------------------------ */

/* What bash does after this option, unless that is to complete the next one. */
static void bash_case(const char *indent, char brief, const char *name, enum value value, const char *words)
{
    if (value == NO_VALUE)
        return;
    printf("%s", indent);
    if (brief)
        printf("-%c | ", brief);
    printf("--%s) ", name);
    if (value == WORDS)
        printf("values='%s' ;;\n", words);
    else
        printf(value == PATH ? "return ;;\n" : "values=' ' ;;\n");
}

static void print_bash(const struct spin_args_command *command, const struct spin_args_plugin *plugin,
                       size_t n_plugins)
{
    const char *selector = command->plugin_selector ? command->plugin_selector : "";
    char words[MOST];

    printf("# Completion of %s, printed by '%s --completion bash'.\n", command->name, command->name);
    printf("_%.4s_%s()\n{\n", command->name, command->name + 5);
    printf("    local cur=${COMP_WORDS[COMP_CWORD]} prev=${COMP_WORDS[COMP_CWORD - 1]} chosen='' i options values=''\n"
           "    # bash makes three words of --name=value.\n"
           "    if [ \"$cur\" = = ]; then\n"
           "        cur=''\n"
           "    elif [ \"$prev\" = = ]; then\n"
           "        prev=${COMP_WORDS[COMP_CWORD - 2]}\n"
           "    fi\n"
           "    for ((i = 1; i < COMP_CWORD; i++)); do\n"
           "        [ \"${COMP_WORDS[i]}\" = --%s ] || continue\n"
           "        chosen=${COMP_WORDS[i + 1]}\n"
           "        [ \"$chosen\" != = ] || chosen=${COMP_WORDS[i + 2]}\n"
           "    done\n"
           "    options='",
           selector);
    for (const struct spin_args_row *row = command->rows; row->name || row->section; row++)
        if (row->name)
            printf("--%s ", row->name);
    printf("'\n    case $prev in\n");
    for (const struct spin_args_row *row = command->rows; row->name || row->section; row++)
        if (row->name)
            bash_case("    ", row->short_name, row->name, value_of(command, plugin, n_plugins, row, words), words);
    printf("    esac\n    case $chosen in\n");
    for (size_t i = 0; i < n_plugins; i++) {
        if (!plugin[i].options || !plugin[i].options->key)
            continue;
        printf("    %s)\n        options+='", plugin[i].name);
        for (const struct spin_plugin_option *o = plugin[i].options; o->key; o++)
            printf("--%s ", o->key);
        printf("'\n        case $prev in\n");
        for (const struct spin_plugin_option *o = plugin[i].options; o->key; o++)
            bash_case("        ", 0, o->key, value_of_word(o->arg, words), words);
        printf("        esac\n        ;;\n");
    }
    printf("    esac\n"
           "    if [ -z \"$values\" ]; then\n"
           "        case $cur in\n"
           "        -*) values=$options ;;\n"
           "        *) return ;;\n" /* a file: what complete -o default does */
           "        esac\n"
           "    fi\n"
           "    compopt +o default 2>/dev/null\n"
           "    mapfile -t COMPREPLY < <(compgen -W \"$values\" -- \"$cur\")\n"
           "}\n"
           "complete -o default -F _%.4s_%s %s\n",
           command->name, command->name + 5, command->name);
}

/* ---- zsh ------------------------------------------------------------------------------------- */

/* Inside single quotes, as _arguments takes it. */
static void zsh_text(const char *text)
{
    for (; *text; text++) {
        if (strchr("[]:\\", *text))
            putchar('\\');
        printf(*text == '\'' ? "'\\''" : "%c", *text);
    }
}

static void zsh_option(const char *name, char brief, const char *arg, const char *help, bool again,
                       enum value value, const char *words)
{
    const char *equals = value == NO_VALUE ? "" : "=";

    printf("        ");
    if (brief && !again)
        printf("'(-%c --%s)'", brief, name);
    if (again)
        printf("'*'");
    if (brief)
        printf("{-%c%s,--%s%s}", brief, value == NO_VALUE ? "" : "+", name, equals);
    else
        printf("--%s%s", name, equals);
    printf("'[");
    zsh_text(help);
    printf("]");
    if (value != NO_VALUE) {
        printf(":");
        zsh_text(arg);
        if (value == WORDS)
            printf(":(%.*s)", (int)strlen(words) - 1, words);
        else
            printf(value == PATH ? ":_files" : ": ");
    }
    printf("'\n");
}

static void print_zsh(const struct spin_args_command *command, const struct spin_args_plugin *plugin, size_t n_plugins)
{
    const char *selector = command->plugin_selector;
    char words[MOST];

    printf("#compdef %s\n# Printed by '%s --completion zsh'.\n", command->name, command->name);
    printf("local chosen\nlocal -a specs\nspecs=(\n");
    for (const struct spin_args_row *row = command->rows; row->name || row->section; row++)
        if (row->name)
            zsh_option(row->name, row->short_name, row->arg, row->help, row->kind == SPIN_ARG_COUNT,
                       value_of(command, plugin, n_plugins, row, words), words);
    printf(")\n");
    if (selector)
        printf("chosen=${${(M)words:#--%s=*}#--%s=}\n"
               "(( ${words[(I)--%s]} )) && chosen=${words[${words[(I)--%s]} + 1]}\n"
               "case $chosen in\n",
               selector, selector, selector, selector);
    for (size_t i = 0; i < n_plugins; i++) {
        if (!plugin[i].options || !plugin[i].options->key)
            continue;
        printf("(%s)\n    specs+=(\n", plugin[i].name);
        for (const struct spin_plugin_option *o = plugin[i].options; o->key; o++)
            zsh_option(o->key, 0, o->arg, o->help, false, value_of_word(o->arg, words), words);
        printf("    ) ;;\n");
    }
    if (selector)
        printf("esac\n");
    printf("_arguments -s -S $specs '*:file:_files'\n");
}

void spin_args_print_completion(const struct spin_args_command *command, const struct spin_args_plugin *plugin,
                                size_t n_plugins, const char *shell)
{
    (strcmp(shell, "zsh") ? print_bash : print_zsh)(command, plugin, n_plugins);
}
