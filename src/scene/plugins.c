/* Plug-ins loaded at run time: the shared objects that SPIN_PLUGIN_PATH names, and nothing else. An
 * object's functions call ours, which the commands export to it (src/plugin.sym).
 *
 * What is broken is left out and remembered with the reason: a warning for most, an error when it is
 * the one that the user asked for. An object that cannot be loaded has no names to be asked for by, so
 * it answers to its file's name without ".so". */
#include <dlfcn.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "io/file.h"

enum {
    MAX_PLUGINS = 128, /* of a kind, those built in included */
    MAX_FAULTS = 64,   /* reasons kept; more than that are only counted */
    MAX_NAME = 31      /* letters; spin_import_report has room for 32 */
};

struct fault {
    char name[MAX_NAME + 1]; /* what it would be asked for by */
    char text[1024];
};

static pthread_once_t once = PTHREAD_ONCE_INIT;
static struct {
    const struct spin_importer *importer[MAX_PLUGINS + 1]; /* NULL-terminated */
    const struct spin_exporter *exporter[MAX_PLUGINS + 1];
    const char *importer_origin[MAX_PLUGINS], *exporter_origin[MAX_PLUGINS]; /* NULL: built in */
    size_t n_importers, n_exporters;
    struct fault *fault; /* [n_faults] */
    size_t n_faults, n_faults_lost;
    bool warned;
} all;

static const char *search_path(void)
{
    const char *path = getenv("SPIN_PLUGIN_PATH");

    return path && *path ? path : NULL;
}

/* ---- Faults ---------------------------------------------------------------------------------- */

static void keep_fault(const char *name, const char *fmt, ...) SPIN_PRINTF(2, 3);
static void keep_fault(const char *name, const char *fmt, ...)
{
    struct fault *f;
    va_list args;

    if (!all.fault)
        all.fault = calloc(MAX_FAULTS, sizeof *all.fault);
    if (!all.fault || all.n_faults == MAX_FAULTS) {
        all.n_faults_lost++;
        return;
    }
    f = &all.fault[all.n_faults++];
    snprintf(f->name, sizeof f->name, "%s", name);
    va_start(args, fmt);
    vsnprintf(f->text, sizeof f->text, fmt, args);
    va_end(args);
}

static const struct fault *find_fault(const char *name)
{
    for (size_t i = 0; i < all.n_faults; i++) {
        if (strcmp(all.fault[i].name, name) == 0)
            return &all.fault[i];
    }
    return NULL;
}

/* ---- One importer, one exporter -------------------------------------------------------------- */

/* Lower case letters, digits, '-' and '_', so that a name can be typed, listed and kept in a bundle. */
static bool is_name(const char *name)
{
    size_t n = name ? strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789-_") : 0;

    return n > 0 && n <= MAX_NAME && !name[n] && name[0] != '-';
}

/* What is wrong with it, or NULL. */
static const char *importer_lacks(const struct spin_importer *importer)
{
    if (importer->abi != SPIN_PLUGIN_ABI)
        return "an importer in it is of another version";
    if (!is_name(importer->name))
        return "an importer in it has no name of a-z, 0-9, '-' and '_'";
    if (!importer->summary)
        return "its importer has no summary";
    if (importer->open && !importer->frame)
        return "its importer has open() but no frame()";
    if (!importer->open && !importer->views)
        return "its importer has neither open() nor views()";
    return NULL;
}

static const char *exporter_lacks(const struct spin_exporter *exporter)
{
    if (exporter->abi != SPIN_PLUGIN_ABI)
        return "an exporter in it is of another version";
    if (!is_name(exporter->name))
        return "an exporter in it has no name of a-z, 0-9, '-' and '_'";
    if (!exporter->summary)
        return "its exporter has no summary";
    if (!exporter->begin || !exporter->frame || !exporter->end || !exporter->abort)
        return "its exporter lacks one of begin(), frame(), end() and abort()";
    return NULL;
}

static void keep_clash(const char *path, const char *kind, const char *name, const char *origin)
{
    keep_fault(name, "plug-in '%s': an %s called '%s' is there already: %s", path, kind, name,
               origin ? origin : "built in");
}

/* True when it is kept, and path with it. */
static bool add_importer(const struct spin_importer *importer, const char *path, const char *stem)
{
    const char *lack = importer_lacks(importer);

    if (lack) {
        keep_fault(is_name(stem) ? stem : "", "plug-in '%s': %s", path, lack);
        return false;
    }
    for (size_t i = 0; i < all.n_importers; i++) {
        if (all.importer[i] == importer) /* its object is named twice */
            return false;
        if (strcmp(all.importer[i]->name, importer->name) == 0) {
            keep_clash(path, "importer", importer->name, all.importer_origin[i]);
            return false;
        }
    }
    if (all.n_importers == MAX_PLUGINS) {
        keep_fault(importer->name, "plug-in '%s': there are %d importers already", path,
                   MAX_PLUGINS);
        return false;
    }
    all.importer_origin[all.n_importers] = path;
    all.importer[all.n_importers++] = importer;
    return true;
}

/* True when it is kept, and path with it. */
static bool add_exporter(const struct spin_exporter *exporter, const char *path, const char *stem)
{
    const char *lack = exporter_lacks(exporter);

    if (lack) {
        keep_fault(is_name(stem) ? stem : "", "plug-in '%s': %s", path, lack);
        return false;
    }
    for (size_t i = 0; i < all.n_exporters; i++) {
        if (all.exporter[i] == exporter)
            return false;
        if (strcmp(all.exporter[i]->name, exporter->name) == 0) {
            keep_clash(path, "exporter", exporter->name, all.exporter_origin[i]);
            return false;
        }
    }
    if (all.n_exporters == MAX_PLUGINS) {
        keep_fault(exporter->name, "plug-in '%s': there are %d exporters already", path,
                   MAX_PLUGINS);
        return false;
    }
    all.exporter_origin[all.n_exporters] = path;
    all.exporter[all.n_exporters++] = exporter;
    return true;
}

/* ---- One object ------------------------------------------------------------------------------ */

/* The loader's words, less the path that it puts in front. */
static const char *why_not_loaded(const char *path)
{
    const char *text = dlerror();
    size_t n = strlen(path);

    if (!text)
        return "cannot be loaded";
    return strncmp(text, path, n) == 0 && strncmp(text + n, ": ", 2) == 0 ? text + n + 2 : text;
}

/* Take what the object has; `path` is kept too when that is anything. */
static bool take_object(const char *path, const char *stem, void *object)
{
    const struct spin_plugin *plugin = dlsym(object, "spin_plugin");
    bool kept = false;

    if (!plugin) {
        keep_fault(stem, "plug-in '%s': it defines no 'spin_plugin'", path);
        return false;
    }
    if (plugin->abi != SPIN_PLUGIN_ABI) {
        keep_fault(stem, "plug-in '%s': it was built for version %d of spin.h, this is %d", path,
                   plugin->abi, SPIN_PLUGIN_ABI);
        return false;
    }
    for (size_t i = 0; plugin->importers && plugin->importers[i]; i++)
        kept |= add_importer(plugin->importers[i], path, stem);
    for (size_t i = 0; plugin->exporters && plugin->exporters[i]; i++)
        kept |= add_exporter(plugin->exporters[i], path, stem);
    return kept;
}

/* "points.so" -> "points" */
static void stem_of(const char *path, char stem[MAX_NAME + 1])
{
    const char *name = spin_path_name(path);
    size_t n = strlen(name);

    if (n > 3 && strcmp(name + n - 3, ".so") == 0)
        n -= 3;
    snprintf(stem, MAX_NAME + 1, "%.*s", n < MAX_NAME ? (int)n : MAX_NAME, name);
}

/* An absolute path, so that the system's own search for libraries has no say. */
static void load_object(const char *given)
{
    char stem[MAX_NAME + 1], *path = NULL;
    void *object;

    stem_of(given, stem);
    if (spin_path_absolute(given, &path) != SPIN_OK) {
        keep_fault(stem, "plug-in '%s' of SPIN_PLUGIN_PATH is not there", given);
        return;
    }
    object = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!object)
        keep_fault(stem, "plug-in '%s': %s", path, why_not_loaded(path));
    else if (take_object(path, stem, object))
        return; /* its code and path are in use until the end */
    else
        dlclose(object);
    free(path);
}

static bool ends_in_so(const char *name)
{
    size_t n = strlen(name);

    return n > 3 && strcmp(name + n - 3, ".so") == 0;
}

static void load_folder(const char *folder)
{
    char **names = NULL;
    size_t n = 0;

    if (spin_folder_list(folder, &names, &n) != SPIN_OK) {
        keep_fault("", "SPIN_PLUGIN_PATH: %s", spin_last_error());
        return;
    }
    for (size_t i = 0; i < n; i++) {
        char *path = NULL;

        if (ends_in_so(names[i]) && spin_path_join(folder, names[i], &path) == SPIN_OK)
            load_object(path);
        free(path);
    }
    spin_folder_list_free(names);
}

/* ---- All of them ----------------------------------------------------------------------------- */

static void add_built_in(void)
{
    for (; spin_importers[all.n_importers]; all.n_importers++)
        all.importer[all.n_importers] = spin_importers[all.n_importers];
    for (; spin_exporters[all.n_exporters]; all.n_exporters++)
        all.exporter[all.n_exporters] = spin_exporters[all.n_exporters];
}

/* Empty pieces of the path are no folder: least of all the one we happen to be in. */
static void load_all(void)
{
    char *path = strdup(search_path()), *rest = path, *piece;

    add_built_in();
    while ((piece = strsep(&rest, ":"))) {
        if (*piece && spin_path_is_folder(piece))
            load_folder(piece);
        else if (*piece)
            load_object(piece);
    }
    free(path);
    spin_fail(SPIN_OK, "%s", ""); /* nothing that the caller asked for has failed */
}

static bool is_known(const char *name)
{
    for (size_t i = 0; i < all.n_importers; i++) {
        if (strcmp(all.importer[i]->name, name) == 0)
            return true;
    }
    for (size_t i = 0; i < all.n_exporters; i++) {
        if (strcmp(all.exporter[i]->name, name) == 0)
            return true;
    }
    return false;
}

static void warn_once(const char *chosen)
{
    if (all.warned)
        return;
    all.warned = true;
    for (size_t i = 0; i < all.n_faults; i++) {
        const struct fault *f = &all.fault[i];

        if (!chosen || strcmp(f->name, chosen) != 0 || is_known(chosen))
            spin_warn("%s; it is left out", f->text);
    }
    if (all.n_faults_lost)
        spin_warn("SPIN_PLUGIN_PATH: %zu more plug-ins are left out", all.n_faults_lost);
}

/* Whoever has no plug-ins pays for one look at the environment. */
void spin_plugins_load(const char *chosen)
{
    if (!search_path())
        return;
    pthread_once(&once, load_all);
    warn_once(chosen);
}

const struct spin_importer *const *spin_importer_list(void)
{
    spin_plugins_load(NULL);
    return all.n_importers ? all.importer : spin_importers;
}

const struct spin_exporter *const *spin_exporter_list(void)
{
    spin_plugins_load(NULL);
    return all.n_exporters ? all.exporter : spin_exporters;
}

const char *spin_plugin_origin(const void *plugin)
{
    for (size_t i = 0; i < all.n_importers; i++) {
        if (all.importer[i] == plugin)
            return all.importer_origin[i];
    }
    for (size_t i = 0; i < all.n_exporters; i++) {
        if (all.exporter[i] == plugin)
            return all.exporter_origin[i];
    }
    return NULL;
}

const char *spin_plugin_fault(const char *name)
{
    const struct fault *f = *name ? find_fault(name) : NULL;

    return f ? f->text : NULL;
}
