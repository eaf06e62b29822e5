/* One rule for every exporter that fills a folder: what was there is not touched unasked. */
#include "io/output_folder.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/watch.h"

static spin_status take_existing(const char *path, bool force, const char *ending,
                                 struct spin_output_folder *out)
{
    char **names = NULL;

    if (!spin_path_is_folder(path))
        return spin_fail(SPIN_E_IO, "'%s' exists and is not a folder", path);
    SPIN_TRY(spin_folder_list(path, &names, &out->n_before));
    spin_folder_list_free(names);
    if (out->n_before > 0 && !force)
        return spin_fail(SPIN_E_IO, "folder '%s' exists and is not empty; use --force to overwrite",
                         path);
    spin_out_sweep_folder(path, ending);
    return SPIN_OK;
}

spin_status spin_output_folder_begin(const char *path, bool force, const char *ending,
                                     struct spin_output_folder *out)
{
    *out = (struct spin_output_folder){0};
    if (spin_path_is_taken(path)) {
        SPIN_TRY(take_existing(path, force, ending, out));
    } else {
        SPIN_TRY(spin_folder_make(path));
        out->created = true;
    }
    SPIN_TRY(spin_strdup(path, &out->path));
    if (out->created)
        spin_watch_out(out->path);
    return SPIN_OK;
}

void spin_output_folder_end(struct spin_output_folder *folder)
{
    if (folder->path)
        spin_unwatch_out(folder->path);
    free(folder->path);
    *folder = (struct spin_output_folder){0};
}

void spin_output_folder_abandon(struct spin_output_folder *folder)
{
    if (folder->created && folder->path)
        (void)rmdir(folder->path); /* refuses when files are in it, which is what we want */
    spin_output_folder_end(folder);
}

/* ---- Numbered names -------------------------------------------------------------------------- */

static spin_status fail_pattern(const char *text)
{
    return spin_fail(SPIN_E_USAGE,
                     "--pattern '%s': expected a file name with exactly one %%d or %%0Nd, N 1 to 9",
                     text);
}

spin_status spin_pattern_parse(const char *text, struct spin_pattern *out)
{
    const char *field = strchr(text, '%');
    const char *at;

    *out = (struct spin_pattern){.text = text};
    if (!field || strchr(text, '/'))
        return fail_pattern(text);
    at = field + 1;
    if (*at == '0') {
        out->zeros = true;
        at++;
        if (*at < '1' || *at > '9')
            return fail_pattern(text);
        out->width = *at++ - '0';
    }
    if (*at != 'd' || strchr(at, '%'))
        return fail_pattern(text);
    out->n_before = (int)(field - text);
    out->after = at + 1;
    return SPIN_OK;
}

spin_status spin_pattern_path(const struct spin_pattern *p, const char *folder, int number,
                              char **out)
{
    char name[512];

    if (snprintf(name, sizeof name, p->zeros ? "%.*s%0*d%s" : "%.*s%*d%s", p->n_before, p->text,
                 p->width, number, p->after) >= (int)sizeof name)
        return spin_fail(SPIN_E_USAGE, "--pattern makes too long a name: '%.40s...'", name);
    return spin_path_join(folder, name, out);
}
