/* The programs of --for, and the options that are set for each of them. Sources: docs/viewers.md
 * for the programs that the tests open; otherwise the documentation of the program, see
 * man/spin-export.1. */
#include "run/targets.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "base/base.h"
#include "io/file.h"

static const struct spin_target targets[] = {
    {.name = "unreal",
     .to = "ply",
     .ending = "/",
     .equal_rows = true,
     .set = {{"ply", "start", "0"}},
     .tried = "untested"},
    {.name = "unity",
     .to = "ply",
     .ending = "/",
     .set = {{"ply", "sh", "3"}, {"spz", "spz-version", "3"}},
     .tried = "untested"},
    {.name = "nuke", .to = "usd", .ending = ".usdc", .tried = "untested"},
    {.name = "houdini", .to = "usd", .ending = ".usdc", .tried = "untested"},
    {.name = "omniverse",
     .to = "usd",
     .ending = ".usdc",
     .set = {{"spz", "spz-version", "3"}},
     .tried = "untested"},
    {.name = "blender",
     .to = "ply",
     .ending = "/",
     .set = {{"ply", "start", "1"}},
     .tried = "untested"},
    {.name = "supersplat", .to = "compressed-ply", .ending = "/", .tried = "by reader"},
    {.name = "spark",
     .to = "spz",
     .ending = "/",
     .set = {{"spz", "spz-version", "3"}},
     .tried = "measured"},
    {.name = "playcanvas", .to = "sog", .ending = "/", .tried = "measured"},
    {.name = "babylon",
     .to = "gltf",
     .ending = ".glb",
     .set = {{"gltf", "axes", "gltf"}},
     .tried = "measured"},
    {.name = "visionos",
     .to = "ply",
     .ending = "/",
     .set = {{"spz", "spz-version", "3"}},
     .tried = "untested"},
};

static spin_status find_target(const char *name, const struct spin_target **out)
{
    char known[256] = "";

    for (size_t i = 0; i < sizeof targets / sizeof *targets; i++) {
        size_t used = strlen(known);

        *out = &targets[i];
        if (strcasecmp(targets[i].name, name) == 0)
            return SPIN_OK;
        snprintf(known + used, sizeof known - used, "%s%s", used ? ", " : "", targets[i].name);
    }
    return spin_misuse("--for: unknown program '%s'; known: %s", name, known);
}

spin_status spin_target_exporter(const char *name, const char **to)
{
    const struct spin_target *target;

    SPIN_TRY(find_target(name, &target));
    *to = target->to;
    return SPIN_OK;
}

/* Returns whether a name of an output determines its form: it has a known extension, ends in a
 * slash, is a pattern of names, or exists. */
static bool is_determined(const char *output)
{
    size_t n = strlen(output);

    return spin_exporter_for(output) || (n > 0 && output[n - 1] == '/') || strpbrk(output, "%#") ||
           spin_path_is_folder(output);
}

spin_status spin_target_output(const char *name, const char *to, const char *output, char **out)
{
    const struct spin_target *target;

    SPIN_TRY(find_target(name, &target));
    if ((to && strcasecmp(to, target->to) != 0) || is_determined(output))
        return spin_strdup(output, out);
    SPIN_TRY(spin_alloc(strlen(output) + strlen(target->ending) + 1, 1, (void **)out));
    strcpy(*out, output);
    strcat(*out, target->ending);
    return SPIN_OK;
}

/* Returns whether the list of options of a plug-in has a value for `key`. */
static bool has_value(const char *const *pairs, const char *key)
{
    for (; pairs && *pairs; pairs += 2)
        if (strcmp(*pairs, key) == 0)
            return true;
    return false;
}

/* Appends to the list of options those options of the target that the user did not give, and prints
 * the appended options to `said`. */
static spin_status add_options(const struct spin_target *target, struct spin_export_options *o,
                               struct spin_targeted *out, FILE *said)
{
    size_t n = 0;

    while (o->plugin_pairs && o->plugin_pairs[n])
        n++;
    SPIN_TRY(spin_alloc(n + 2 * SPIN_TARGET_SET + 1, sizeof *out->pairs, (void **)&out->pairs));
    if (n > 0)
        memcpy(out->pairs, o->plugin_pairs, n * sizeof *out->pairs);
    for (const char *const(*s)[3] = target->set; (*s)[0]; s++) {
        if (strcmp((*s)[0], o->to) != 0 || has_value(o->plugin_pairs, (*s)[1]))
            continue;
        out->pairs[n++] = (*s)[1];
        out->pairs[n++] = (*s)[2];
        fprintf(said, " --%s %s", (*s)[1], (*s)[2]);
    }
    o->plugin_pairs = out->pairs;
    return SPIN_OK;
}

spin_status spin_target_apply(const char *name, struct spin_export_options *o,
                              struct spin_targeted *out)
{
    const char *given = o->to, *by_name;
    SPIN_FREED char *text = NULL;
    size_t n_text;
    spin_status status;
    FILE *said;

    SPIN_TRY(find_target(name, &out->target));
    SPIN_TRY(spin_target_output(name, o->to, o->output, &out->output));
    o->output = out->output;
    by_name = spin_exporter_for(o->output);
    o->to = given ? given : by_name ? by_name : out->target->to;
    said = spin_text_open(&text, &n_text);
    if (!said)
        return spin_fail(SPIN_E_MEMORY, "no memory for the options of --for");
    if (!given)
        fprintf(said, " --to %s", o->to);
    status = add_options(out->target, o, out, said);
    o->equal_rows = out->target->equal_rows;
    if (out->target->equal_rows && o->max_scale <= 0) {
        o->max_scale = INFINITY;
        fprintf(said, " --max-scale 0");
    }
    if (fclose(said) != 0)
        return spin_fail(SPIN_E_MEMORY, "no memory for the options of --for");
    SPIN_TRY(status);
    spin_log(0, "for %s (%s): '%s'%s", out->target->name, out->target->tried, o->output,
             *text ? text : ", with the options given");
    return SPIN_OK;
}

void spin_target_free(struct spin_targeted *t)
{
    free(t->output);
    free(t->pairs);
}
