/* For tests that run the commands: a shell command and its output, numbers from JSON, sizes of
 * images. */
#ifndef SPIN_TESTS_CMD_COMMAND_H
#define SPIN_TESTS_CMD_COMMAND_H

#include <sys/wait.h>

#include "tests/check.h"
#include "tests/tap.h"

static const char clip[] = "fixtures/court-mini";
static const char *folder, *bin;
static char said[1 << 16]; /* by the last command, on both streams */

/* With SPIN_RECORD=1 a test also prints what it does not check, in lines that begin with "#~", for
 * tests/tools/changes.py. */
static void record(const char *command, int status)
{
    printf("#~ run %s: %d\n", command, status);
    for (const char *line = said; *line;) {
        int n = (int)strcspn(line, "\n");

        printf("#~ said %.*s\n", n, line);
        line += n + (line[n] == '\n');
    }
}

/* Runs a shell command and returns its exit code; its output is in `said`. */
__attribute__((format(printf, 1, 2))) static int shell(const char *format, ...)
{
    char command[2000], path[600];
    va_list args;
    FILE *f;
    int n, status;

    va_start(args, format);
    n = snprintf(command, sizeof command, "( ");
    n += vsnprintf(command + n, sizeof command - (size_t)n, format, args);
    va_end(args);
    snprintf(path, sizeof path, "%s/said", folder);
    snprintf(command + n, sizeof command - (size_t)n, " ) >%s 2>&1 </dev/null", path);
    status = system(command);
    f = fopen(path, "r");
    said[f ? fread(said, 1, sizeof said - 1, f) : 0] = '\0';
    if (f)
        fclose(f);
    if (getenv("SPIN_RECORD"))
        record(command, status);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

/* A member as JSON, or NULL. */
__attribute__((unused)) static spin_json *json_in(const struct spin_npz *npz, const char *name)
{
    const struct spin_zip_member *member = spin_zip_find(&npz->zip, name);
    const unsigned char *text = NULL;
    void *owned = NULL;
    spin_json *j = NULL;

    if (member && spin_zip_read(&npz->zip, member, true, 1 << 20, &text, &owned) == SPIN_OK)
        spin_json_parse(name, (const char *)text, member->size, &j);
    free(owned);
    return j;
}

__attribute__((unused)) static double number(const spin_json *object, const char *key)
{
    double value = NAN;

    spin_json_number(spin_json_get(object, key), &value);
    return value;
}

__attribute__((unused)) static double number_at(const spin_json *object, const char *key, size_t i)
{
    double value = NAN;

    spin_json_number(spin_json_at(spin_json_get(object, key), i), &value);
    return value;
}

/* A top-level number in the JSON of the last command. */
__attribute__((unused)) static double said_number(const char *key)
{
    spin_json *j = NULL;
    double value;

    spin_json_parse("stdout", said, strlen(said), &j);
    value = number(j, key);
    spin_json_free(j);
    return value;
}

__attribute__((unused)) static bool said_text(const char *key, const char *want)
{
    spin_json *j = NULL;
    const char *text;
    bool same;

    spin_json_parse("stdout", said, strlen(said), &j);
    text = spin_json_string(spin_json_get(j, key));
    same = text && strstr(text, want);
    spin_json_free(j);
    return same;
}

/* Whether FOLDER/name is a PNG of this size. */
__attribute__((unused)) static bool is_png(const char *sub, const char *name, int width, int height)
{
    unsigned char head[24] = {0};
    char path[700];
    FILE *f;
    bool whole;

    snprintf(path, sizeof path, "%s/%s/%s", folder, sub, name);
    f = fopen(path, "rb");
    whole = f && fread(head, 1, 24, f) == 24;
    if (f)
        fclose(f);
    return whole && head[18] * 256 + head[19] == width && head[22] * 256 + head[23] == height;
}

/* Imports the clip as in.spin. */
__attribute__((unused)) static void begin_commands(void)
{
    bin = getenv("SPIN_BIN") ? getenv("SPIN_BIN") : "build/release/bin";
    folder = check_folder();
    if (!ok(shell("%s/spin-import %s --data %s -o %s/in.spin", bin, clip, clip, folder) == 0,
            "imports the clip")) {
        printf("#   %s\n", said);
        exit(tap_done());
    }
}

#endif
