/* Loads plug-ins at run time: only the shared objects and folders listed in SPIN_PLUGIN_PATH.
 * Plug-ins call functions of this library, which the commands export to them (src/plugin.sym).
 *
 * A broken plug-in is skipped, and the reason is stored as a fault. A fault is printed as a
 * warning, or returned as an error if the user selected this plug-in by name. If an object cannot
 * be loaded, the names of its plug-ins are unknown; the fault then gets the file name of the
 * object, without ".so", as its name. */
#include <dlfcn.h>
#include <pthread.h>
#include <stdarg.h>

#include "base/base.h"
#include "io/file.h"

enum {
    /* maximum number of importers, and of exporters, including the built-in ones */
    MAX_PLUGINS = 128,
    /* maximum number of faults that are stored; further faults are only counted */
    MAX_FAULTS = 64,
    /* Maximum length of a name; `from` of struct spin_bundle_meta has space for 32 bytes. */
    MAX_NAME = 31
};

/* Plug-ins are not supported on Windows: a shared object there names the only executable from which
 * it can import functions, but spin4d consists of several commands. */
#ifdef _WIN32
enum { CAN_LOAD = false };
#else
enum { CAN_LOAD = true };
#endif

struct fault {
    char name[MAX_NAME + 1]; /* name of the plug-in, as given to --from; "": unknown */
    char text[1024];         /* text of the warning or error */
};

/* All plug-ins of one kind: all importers, or all exporters. */
struct list {
    const char *kind;
    struct {
        const void *plugin;
        const char *name, *origin; /* `origin` is the path of the object; NULL: built in */
    } entry[MAX_PLUGINS];
    size_t n;
};

static pthread_once_t once = PTHREAD_ONCE_INIT;
static struct {
    /* list[0]: importers; list[1]: exporters */
    struct list list[2];
    const struct spin_importer *importer[MAX_PLUGINS + 1]; /* NULL-terminated */
    const struct spin_exporter *exporter[MAX_PLUGINS + 1];
    struct fault *fault; /* [n_faults] */
    size_t n_faults, n_faults_lost;
    bool warned;
} all = {.list = {{.kind = "importer"}, {.kind = "exporter"}}};

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

/* Returns whether a name consists of lower case letters, digits, '-' and '_' only. Other characters
 * are not allowed, since names are typed, listed and stored in bundles. */
static bool is_name(const char *name)
{
    size_t n = name ? strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789-_") : 0;

    return n > 0 && n <= MAX_NAME && !name[n] && name[0] != '-';
}

/* Returns a description of what is wrong with an importer; NULL if nothing is wrong. */
static const char *importer_lacks(const struct spin_importer *importer)
{
    if (importer->abi != SPIN_PLUGIN_ABI)
        return "an importer was built for another version of spin.h: rebuild it";
    if (!is_name(importer->name))
        return "an importer has an invalid name: use a-z, 0-9, '-' and '_'";
    if (!importer->summary)
        return "an importer has no summary";
    if (importer->open && !importer->frame)
        return "an importer has open() but no frame()";
    if (!importer->open && !importer->views)
        return "an importer has neither open() nor views()";
    return NULL;
}

static const char *exporter_lacks(const struct spin_exporter *exporter)
{
    if (exporter->abi != SPIN_PLUGIN_ABI)
        return "an exporter was built for another version of spin.h: rebuild it";
    if (!is_name(exporter->name))
        return "an exporter has an invalid name: use a-z, 0-9, '-' and '_'";
    if (!exporter->summary)
        return "an exporter has no summary";
    if (!exporter->begin || (!exporter->frame && !exporter->splats_4d) || !exporter->end ||
        !exporter->abort)
        return "an exporter lacks begin(), end(), abort(), or both frame() and splats_4d()";
    return NULL;
}

/* Adds a plug-in to the list, and returns whether it was added; if so, `path` must stay allocated.
 * `lack` describes what is wrong with the plug-in, or is NULL if nothing is. `stem` is the file
 * name of the object without ".so". */
static bool add_plugin(struct list *list, const void *plugin, const char *name, const char *lack,
                       const char *path, const char *stem)
{
    if (lack) {
        keep_fault(is_name(stem) ? stem : "", "plug-in '%s': %s", path, lack);
        return false;
    }
    for (size_t i = 0; i < list->n; i++) {
        if (list->entry[i].plugin == plugin) /* the object is listed twice in SPIN_PLUGIN_PATH */
            return false;
        if (strcmp(list->entry[i].name, name) == 0) {
            keep_fault(name, "plug-in '%s': an %s called '%s' exists already: %s", path, list->kind,
                       name, list->entry[i].origin ? list->entry[i].origin : "built in");
            return false;
        }
    }
    if (list->n == MAX_PLUGINS) {
        keep_fault(name, "plug-in '%s': the limit of %d %ss is exceeded", path, MAX_PLUGINS,
                   list->kind);
        return false;
    }
    list->entry[list->n].plugin = plugin;
    list->entry[list->n].name = name;
    list->entry[list->n++].origin = path;
    return true;
}

static bool add_importer(const struct spin_importer *i, const char *path, const char *stem)
{
    if (!add_plugin(&all.list[0], i, i->name, importer_lacks(i), path, stem))
        return false;
    all.importer[all.list[0].n - 1] = i;
    return true;
}

static bool add_exporter(const struct spin_exporter *e, const char *path, const char *stem)
{
    if (!add_plugin(&all.list[1], e, e->name, exporter_lacks(e), path, stem))
        return false;
    all.exporter[all.list[1].n - 1] = e;
    return true;
}

/* ---- One object ------------------------------------------------------------------------------ */

/* Returns the message of dlerror() without the path that it may begin with. */
static const char *why_not_loaded(const char *path)
{
    const char *text = dlerror();
    size_t n = strlen(path);

    if (!text)
        return "cannot be loaded";
    return strncmp(text, path, n) == 0 && strncmp(text + n, ": ", 2) == 0 ? text + n + 2 : text;
}

/* Adds the plug-ins of an object, and returns whether at least one was added; if so, `path` must
 * stay allocated. */
static bool add_object(const char *path, const char *stem, void *object)
{
    const struct spin_plugin *plugin = dlsym(object, "spin_plugin");
    bool kept = false;

    if (!plugin) {
        keep_fault(stem, "plug-in '%s': the symbol 'spin_plugin' is missing", path);
        return false;
    }
    if (plugin->abi != SPIN_PLUGIN_ABI) {
        keep_fault(stem, "plug-in '%s': built for version %d of spin.h, expected version %d", path,
                   plugin->abi, SPIN_PLUGIN_ABI);
        return false;
    }
    for (size_t i = 0; plugin->importers && plugin->importers[i]; i++)
        kept |= add_importer(plugin->importers[i], path, stem);
    for (size_t i = 0; plugin->exporters && plugin->exporters[i]; i++)
        kept |= add_exporter(plugin->exporters[i], path, stem);
    return kept;
}

/* Sets `stem` to the file name without ".so": "points" for "dir/points.so". */
static void stem_of(const char *path, char stem[MAX_NAME + 1])
{
    const char *name = spin_path_name(path);
    size_t n = strlen(name) - (spin_text_ends(name, ".so") ? 3 : 0);

    snprintf(stem, MAX_NAME + 1, "%.*s", n < MAX_NAME ? (int)n : MAX_NAME, name);
}

/* Loads an object and adds its plug-ins. dlopen() gets an absolute path, so that it does not search
 * the library folders of the system. */
static void load_object(const char *given)
{
    char stem[MAX_NAME + 1], *path = NULL;
    void *object;

    stem_of(given, stem);
    if (spin_path_absolute(given, &path) != SPIN_OK) {
        keep_fault(stem, "plug-in '%s' of SPIN_PLUGIN_PATH does not exist", given);
        return;
    }
    object = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!object)
        keep_fault(stem, "plug-in '%s': %s", path, why_not_loaded(path));
    else if (add_object(path, stem, object))
        return; /* object and path are in use until exit: free neither */
    else
        dlclose(object);
    free(path);
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

        if (spin_text_ends(names[i], ".so") && spin_path_join(folder, names[i], &path) == SPIN_OK)
            load_object(path);
        free(path);
    }
    spin_folder_list_free(names);
}

/* ---- All of them ----------------------------------------------------------------------------- */

static void add_built_in(void)
{
    for (size_t i = 0; spin_importers[i]; i++)
        add_importer(spin_importers[i], NULL, NULL);
    for (size_t i = 0; spin_exporters[i]; i++)
        add_exporter(spin_exporters[i], NULL, NULL);
}

/* Adds the built-in importers and exporters and all plug-ins of SPIN_PLUGIN_PATH. An empty entry of
 * this variable is skipped, and does not mean the current folder. */
static void load_all(void)
{
    char *path = strdup(search_path()), *rest = path, *piece;

    add_built_in();
    if (!CAN_LOAD)
        keep_fault("", "SPIN_PLUGIN_PATH: spin4d for Windows loads no plug-ins");
    while (CAN_LOAD && (piece = strsep(&rest, ":"))) {
        if (*piece && spin_path_is_folder(piece))
            load_folder(piece);
        else if (*piece)
            load_object(piece);
    }
    free(path);
    /* clear the last error, since a skipped plug-in is not an error of the caller */
    spin_fail(SPIN_OK, "%s", "");
}

static bool is_known(const char *name)
{
    for (int k = 0; k < 2; k++) {
        for (size_t i = 0; i < all.list[k].n; i++) {
            if (strcmp(all.list[k].entry[i].name, name) == 0)
                return true;
        }
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
            spin_warn("%s; the plug-in is skipped", f->text);
    }
    if (all.n_faults_lost)
        spin_warn("SPIN_PLUGIN_PATH: %zu more plug-ins are skipped", all.n_faults_lost);
}

/* Loads all plug-ins on the first call. Called before every use of the lists; without
 * SPIN_PLUGIN_PATH, a call costs one getenv(). */
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
    return all.list[0].n ? all.importer : spin_importers;
}

const struct spin_exporter *const *spin_exporter_list(void)
{
    spin_plugins_load(NULL);
    return all.list[1].n ? all.exporter : spin_exporters;
}

const char *spin_plugin_origin(const void *plugin)
{
    for (int k = 0; k < 2; k++) {
        for (size_t i = 0; i < all.list[k].n; i++) {
            if (all.list[k].entry[i].plugin == plugin)
                return all.list[k].entry[i].origin;
        }
    }
    return NULL;
}

const char *spin_plugin_fault(const char *name)
{
    const struct fault *f = *name ? find_fault(name) : NULL;

    return f ? f->text : NULL;
}
