/* Reads and writes cached frames. Each is a bundle of one frame, which is written atomically and
 * checked when it is opened. */
#include "train/frame_cache.h"

#include <ctype.h>
#include <unistd.h>

#include "base/base.h"
#include "scene/bundle.h"

static const unsigned held = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;

static spin_status path_of(const char *folder, int index, char **out)
{
    char name[32];

    snprintf(name, sizeof name, "%05d.spin", index);
    return spin_path_join(folder, name, out);
}

spin_status spin_frame_cache_put(const char *folder, int index, const char *key,
                                 const char *code_path, const struct spin_splats *splats)
{
    SPIN_LEAVES(spin_bundle_writer_abandon) struct spin_bundle_writer w = {0};
    SPIN_LEAVES(spin_bundle_meta_free) struct spin_bundle_meta meta = {0};
    spin_json *extra;
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_folder_make(folder));
    SPIN_TRY(path_of(folder, index, &path));
    SPIN_TRY(spin_bundle_meta_reserve(&meta, 1));
    meta.frame[0].number = index;
    meta.frame[0].n = splats->n;
    meta.n_source_frames = 1;
    meta.columns = held;
    meta.sh_degree = splats->sh_degree;
    SPIN_TRY(spin_bundle_writer_open(path, true, true, &w));
    w.zip.n_threads = 1; /* other threads write other frames at the same time */
    SPIN_TRY(spin_bundle_write_frame(&w, 0, held, 0, splats));
    extra = spin_json_object();
    spin_json_set_string(extra, "key", key);
    spin_json_set_string(extra, "path", code_path);
    return spin_bundle_writer_finish(&w, &meta, extra);
}

/* Opens the bundle of a cached frame. SPIN_E_USAGE if its key is not `key`. */
static spin_status open_frame(const char *path, const char *key, struct spin_bundle *out)
{
    const char *text;

    SPIN_TRY(spin_bundle_open(path, out));
    text = spin_json_string(spin_json_get(out->json, "key"));
    if (text && strcmp(text, key) == 0 && out->meta.columns == held)
        return SPIN_OK;
    spin_bundle_close(out);
    return spin_misuse(
        "'%s' was made from another input or with other options, or its images have changed; give "
        "the same ones, or --force without --resume to start anew",
        path);
}

spin_status spin_frame_cache_find(const char *folder, int index, const char *key, bool *found,
                                  struct spin_shelved *out)
{
    struct spin_bundle bundle;
    const char *text;
    SPIN_FREED char *path = NULL;

    *found = false;
    SPIN_TRY(path_of(folder, index, &path));
    if (!spin_path_exists(path))
        return SPIN_OK;
    SPIN_TRY(open_frame(path, key, &bundle));
    text = spin_json_string(spin_json_get(bundle.json, "path"));
    *found = true;
    out->n = bundle.meta.frame[0].n;
    snprintf(out->path, sizeof out->path, "%s", text ? text : "");
    spin_bundle_close(&bundle);
    return SPIN_OK;
}

spin_status spin_frame_cache_get(const char *folder, int index, const char *key, unsigned columns,
                                 struct spin_splats *out)
{
    SPIN_LEAVES(spin_bundle_close) struct spin_bundle bundle = {0};
    SPIN_FREED char *path = NULL;

    SPIN_TRY(path_of(folder, index, &path));
    SPIN_TRY(open_frame(path, key, &bundle));
    return spin_bundle_frame(&bundle, 0, columns, out);
}

/* True for the name of a cached frame, "00012.spin", and for a temporary file that a killed run has
 * left, "00012.spin.tmp.*". */
static bool is_ours(const char *name)
{
    size_t digits = 0;

    while (isdigit((unsigned char)name[digits]))
        digits++;
    return digits >= 5 && strncmp(name + digits, ".spin", 5) == 0;
}

void spin_frame_cache_clear(const char *folder)
{
    char **names = NULL;
    size_t n = 0;

    if (!spin_path_is_folder(folder) || spin_folder_list(folder, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n; i++) {
        char *path = NULL;

        if (is_ours(names[i]) && spin_path_join(folder, names[i], &path) == SPIN_OK)
            remove(path);
        free(path);
    }
    spin_folder_list_free(names);
    rmdir(folder);
}
