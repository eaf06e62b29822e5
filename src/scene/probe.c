/* Choosing an importer: by name, or by asking every one of them to look at the input's outside. */
#include "scene/probe.h"

#include <stdio.h>
#include <string.h>

#include "base/err.h"
#include "io/file.h"
#include "io/torch.h"

/* Two probes this close are a tie: the numbers are guesses. */
#define TIE 10

static bool is_candidate(const struct spin_importer *importer, bool want_views)
{
    return want_views ? importer->views != NULL : importer->open != NULL;
}

/* "d3dgs, ply" */
static void list_names(bool want_views, char *text, size_t n_text)
{
    size_t used = 0;

    text[0] = '\0';
    for (const struct spin_importer *const *i = spin_importer_list(); *i && used < n_text; i++) {
        if (is_candidate(*i, want_views))
            used +=
                (size_t)snprintf(text + used, n_text - used, "%s%s", used ? ", " : "", (*i)->name);
    }
}

static spin_status find_by_name(const char *from, bool want_views, const struct spin_importer **out)
{
    char names[512];

    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++) {
        if (strcmp((*i)->name, from) == 0 && is_candidate(*i, want_views)) {
            *out = *i;
            return SPIN_OK;
        }
    }
    if (spin_plugin_fault(from))
        return spin_fail(SPIN_E_UNSUPPORTED, "%s", spin_plugin_fault(from));
    list_names(want_views, names, sizeof names);
    return spin_fail(SPIN_E_USAGE, "no importer of %s is called '%s'; there are %s",
                     want_views ? "data sets" : "runs", from, names);
}

/* A file that no importer knows may tell itself what is wrong with it: it is empty, a web page or a
 * checkpoint of which a part is missing or is not data. */
static bool may_tell(const struct spin_peek *peek)
{
    static const char *const heads[] = {"version https://git-lfs", "<!doctype", "<!DOCTYPE",
                                        "<html"};
    const unsigned char *head = peek->head;

    if (peek->is_folder)
        return false;
    for (size_t i = 0; i < sizeof heads / sizeof *heads; i++) {
        if (peek->n_head >= strlen(heads[i]) && memcmp(head, heads[i], strlen(heads[i])) == 0)
            return true;
    }
    if (peek->n_head >= 4 && memcmp(head, "PK\3\4", 4) == 0)
        return !*peek->tail_names || strstr(peek->tail_names, "data.pkl");
    return peek->n_head == 0 || (peek->n_head >= 2 && head[0] == 0x80 && head[1] <= 5);
}

static spin_status fail_unknown(const struct spin_peek *peek)
{
    struct spin_torch torch;

    if (!may_tell(peek))
        return spin_fail(SPIN_E_NOT_RECOGNISED,
                         "cannot recognise '%s': no importer knows it (see spin-import --list)",
                         peek->path);
    SPIN_TRY(spin_torch_open(peek->path, &torch));
    spin_torch_close(&torch);
    return spin_fail(SPIN_E_NOT_RECOGNISED,
                     "cannot recognise '%s': a PyTorch checkpoint of no method that an importer "
                     "knows (see spin-import --list)",
                     peek->path);
}

static spin_status find_by_probe(const struct spin_peek *peek, bool want_views,
                                 const struct spin_importer **out)
{
    const struct spin_importer *best = NULL, *second = NULL;
    int best_score = 0, second_score = 0;

    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++) {
        const struct spin_importer *importer = *i;
        int score;

        if (!is_candidate(importer, want_views) || !importer->probe)
            continue;
        score = importer->probe(peek);
        if (score > best_score) {
            second = best;
            second_score = best_score;
            best = importer;
            best_score = score;
        } else if (score > second_score) {
            second = importer;
            second_score = score;
        }
    }
    if (!best)
        return fail_unknown(peek);
    if (second && best_score - second_score < TIE)
        return spin_fail(SPIN_E_NOT_RECOGNISED,
                         "cannot recognise '%s': it may be '%s' or '%s'; say which with %s",
                         peek->path, best->name, second->name,
                         want_views ? "--data-from" : "--from");
    *out = best;
    return SPIN_OK;
}

spin_status spin_importer_find(const char *path, const char *from, bool want_views,
                               const struct spin_importer **out)
{
    struct spin_peek peek;
    spin_status status;

    *out = NULL;
    if (from)
        return find_by_name(from, want_views, out);
    SPIN_TRY(spin_peek_open(path, &peek));
    status = find_by_probe(&peek, want_views, out);
    spin_peek_free(&peek);
    return status;
}

spin_status spin_plugin_check(const char *plugin, const struct spin_plugin_option *options,
                              const char *const *pairs)
{
    for (size_t i = 0; pairs && pairs[i]; i += 2) {
        const struct spin_plugin_option *o = options;

        while (o && o->key && strcmp(o->key, pairs[i]) != 0)
            o++;
        if (!o || !o->key)
            return spin_fail(SPIN_E_USAGE, "'%s' has no option --%s", plugin, pairs[i]);
    }
    return SPIN_OK;
}
