#include "formats/usd_compose.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/base.h"

#define MAX_DEPTH 64
#define MAX_NODES 100000
#define MAX_OPINIONS 256
#define MAX_CLIPS 1000000

/* ---- Files ----------------------------------------------------------------------------------- */

static spin_status copy_text(struct spin_usd_stage *s, const char *text, const char **out)
{
    size_t n = strlen(text) + 1;

    SPIN_TRY(spin_arena_take(&s->arena, n, 1, (void **)out));
    memcpy((void *)(uintptr_t)*out, text, n);
    return SPIN_OK;
}

/* Resolves the asset path `asset`, which is relative to the file `from`. "./" is always removed.
 * "../" is resolved only within packages, since names of zip members are compared as text; outside
 * packages, the file system resolves it. */
static spin_status resolve_path(struct spin_usd_stage *s, const char *from, const char *asset,
                                const char **out)
{
    size_t n = *asset != '/' ? (size_t)(spin_path_name(from) - from) : 0;
    char *path;

    SPIN_TRY(spin_arena_take(&s->arena, n + strlen(asset) + 1, 1, (void **)&path));
    memcpy(path, from, n);
    while (strncmp(asset, "./", 2) == 0 || (s->packed && strncmp(asset, "../", 3) == 0)) {
        for (bool up = asset[1] == '.' && n > 0; up && --n > 0 && path[n - 1] != '/';)
            continue;
        asset += asset[1] == '.' ? 3 : 2;
    }
    memcpy(path + n, asset, strlen(asset) + 1);
    *out = path;
    return SPIN_OK;
}

static bool file_exists(const struct spin_usd_stage *s, const char *path)
{
    return s->packed ? spin_zip_find(&s->package, path) != NULL : spin_path_exists(path);
}

/* USD requires that members of packages are not compressed, so that readers can map them into
 * memory. */
static spin_status open_member(struct spin_usd_stage *s, const char *name, struct spin_map *out)
{
    const struct spin_zip_member *member = spin_zip_find(&s->package, name);
    const unsigned char *data;
    void *owned = NULL;

    if (!member)
        return spin_not_found("'%s' has no member '%s'", s->package.path, name);
    if (member->method != 0)
        return spin_malformed("'%s': member '%s' is compressed, which packages of USD must not be",
                              s->package.path, name);
    SPIN_TRY(spin_zip_read(&s->package, member, true, member->size, &data, &owned));
    *out = (struct spin_map){data, (size_t)member->size};
    return SPIN_OK;
}

static void close_file(struct spin_usd_stage *s, struct usd_file *file)
{
    spin_usd_close(&file->layer);
    if (!s->packed)
        spin_map_close(&file->map);
    file->map = (struct spin_map){NULL, 0};
}

static spin_status fail_file(const struct spin_usd_stage *s, const char *path, spin_status status)
{
    return s->packed ? spin_fail_context(status, "cannot read '%s' in '%s'", path, s->package.path)
                     : spin_fail_reading(status, path);
}

/* Opens the layer at file->path. All other members of *file must be zero. */
static spin_status open_file(struct spin_usd_stage *s, struct usd_file *file)
{
    spin_status status;

    SPIN_TRY(s->packed ? open_member(s, file->path, &file->map)
                       : spin_map_open(file->path, &file->map));
    file->number = ++s->n_opened;
    status = spin_usd_open(file->map.data, file->map.size, &file->layer);
    s->variants = s->variants || file->layer.variants;
    if (status == SPIN_OK)
        return SPIN_OK;
    close_file(s, file);
    return fail_file(s, file->path, status);
}

/* Sets *out to the layer at a path, which stays open until the stage is closed. */
static spin_status find_file(struct spin_usd_stage *s, const char *path, struct usd_file **out)
{
    for (*out = s->file; *out; *out = (*out)->next)
        if (strcmp((*out)->path, path) == 0)
            return SPIN_OK;
    SPIN_TRY(spin_arena_take(&s->arena, 1, sizeof **out, (void **)out));
    (*out)->path = path;
    SPIN_TRY(open_file(s, *out));
    (*out)->next = s->file;
    s->file = *out;
    return SPIN_OK;
}

spin_status spin_usd_open_root(struct spin_usd_stage *s, const char *path, struct usd_file **out)
{
    unsigned char head[4];
    size_t n = 0;

    SPIN_TRY(spin_file_head(path, head, sizeof head, &n));
    if (spin_zip_detect(head, n)) {
        SPIN_TRY(spin_zip_open(path, &s->package));
        s->packed = true;
        if (s->package.n == 0)
            return spin_malformed("'%s': the package is empty", path);
        path = s->package.member[0].name;
    }
    SPIN_TRY(copy_text(s, path, &path));
    return find_file(s, path, out);
}

void spin_usd_close_files(struct spin_usd_stage *s)
{
    for (struct usd_node *p = s->splats; p; p = p->next)
        if (p->clips && p->clips->open)
            close_file(s, p->clips->open);
    for (struct usd_file *file = s->file; file; file = file->next)
        close_file(s, file);
    if (s->packed)
        spin_zip_close(&s->package);
}

/* ---- Composition ----------------------------------------------------------------------------- */

/* The list of opinions about a prim, while it is being collected. */
struct opinions {
    struct usd_opinion of[MAX_OPINIONS];
    size_t n;
};

/* Appends the opinions of a file and of its sublayers about the prim at `path`. */
static spin_status add_stack(struct spin_usd_stage *s, struct opinions *list, struct usd_file *file,
                             const char *path, int depth)
{
    struct spin_usd_field *sub = spin_usd_field(file->layer.root.metadata, "subLayers");
    struct spin_usd_items items = {sub ? &sub->value : NULL, 0};
    struct spin_usd_prim *prim = spin_usd_prim_at(&file->layer, path);
    struct spin_usd_value item;

    if (depth == MAX_DEPTH || list->n == MAX_OPINIONS)
        return spin_malformed(
            "'%s': layers are nested too deeply, or include each other in a cycle", file->path);
    if (prim)
        list->of[list->n++] = (struct usd_opinion){file, prim};
    while (sub && sub->value.layer && spin_usd_next(&items, &item)) {
        SPIN_FREED char *asset = NULL, *unused = NULL;
        struct usd_file *below;
        const char *at;

        SPIN_TRY(spin_usd_reference(&item, &asset, &unused));
        SPIN_TRY(resolve_path(s, file->path, asset, &at));
        SPIN_TRY(find_file(s, at, &below));
        SPIN_TRY(add_stack(s, list, below, path, depth + 1));
    }
    return SPIN_OK;
}

char *spin_usd_metadata_text(const struct usd_file *file, const char *name)
{
    struct spin_usd_field *field = spin_usd_field(file->layer.root.metadata, name);
    char *text = NULL;

    if (field && field->value.layer && spin_usd_text(&field->value, &text) != SPIN_OK)
        return NULL;
    return text;
}

/* Appends the opinions about the prim to which a reference refers. item: an item of a list of
 * references. A reference to a missing file is skipped with a note; other programs skip it too. */
static spin_status add_reference(struct spin_usd_stage *s, struct opinions *list,
                                 struct usd_file *file, const struct spin_usd_value *item)
{
    SPIN_FREED char *asset = NULL, *path = NULL, *chosen = NULL;
    const char *at;

    SPIN_TRY(spin_usd_reference(item, &asset, &path));
    if (*asset) {
        SPIN_TRY(resolve_path(s, file->path, asset, &at));
        if (!file_exists(s, at)) {
            snprintf(s->missing, sizeof s->missing, "%s", asset);
            return SPIN_OK;
        }
        SPIN_TRY(find_file(s, at, &file));
    }
    if (*path == '\0')
        chosen = spin_usd_metadata_text(file, "defaultPrim");
    return *path || chosen ? add_stack(s, list, file, *path ? path : chosen, 0) : SPIN_OK;
}

/* Follows the references in all opinions of the list, and appends the opinions about the prims to
 * which they refer. References in appended opinions are followed too. */
static spin_status add_references(struct spin_usd_stage *s, struct opinions *list)
{
    for (size_t i = 0; i < list->n; i++)
        for (struct spin_usd_field *f = list->of[i].prim->metadata; f; f = f->next) {
            struct spin_usd_items items = {&f->value, 0};
            struct spin_usd_value item;

            if (!f->value.layer ||
                (strcmp(f->name, "references") != 0 && strcmp(f->name, "payload") != 0))
                continue;
            while (spin_usd_next(&items, &item))
                SPIN_TRY(add_reference(s, list, list->of[i].file, &item));
        }
    return SPIN_OK;
}

static const char *type_of(const struct usd_node *node)
{
    for (size_t i = 0; i < node->n; i++)
        if (*node->opinion[i].prim->type)
            return node->opinion[i].prim->type;
    return "";
}

static bool is_defined(const struct usd_node *node)
{
    bool defined = false;

    for (size_t i = 0; i < node->n; i++) {
        struct spin_usd_field *active = spin_usd_field(node->opinion[i].prim->metadata, "active");
        double is = 1;

        defined = defined || node->opinion[i].prim->defined;
        if (active && active->value.layer && spin_usd_doubles(&active->value, 1, 1, &is) == SPIN_OK)
            return defined && is != 0;
    }
    return defined;
}

static spin_status read_pairs(struct spin_usd_stage *s, const struct spin_usd_value *set,
                              const char *name, double **out, size_t *n)
{
    struct spin_usd_value value;

    *n = 0;
    SPIN_TRY(spin_usd_entry(set, name, &value));
    if (!value.layer)
        return SPIN_OK;
    SPIN_TRY(spin_usd_count(&value, 2, n));
    SPIN_TRY(spin_arena_take(&s->arena, *n, 2 * sizeof **out, (void **)out));
    SPIN_TRY(spin_usd_doubles(&value, 2, *n, *out));
    for (size_t i = 0; i < *n; i++)
        if (!isfinite((*out)[2 * i]) || !isfinite((*out)[2 * i + 1]) ||
            (i > 0 && (*out)[2 * i] < (*out)[2 * i - 2]))
            return spin_malformed("the times of clips in '%s' do not increase", name);
    return SPIN_OK;
}

static spin_status read_assets(struct spin_usd_stage *s, const struct spin_usd_value *list,
                               struct usd_clips *out)
{
    struct spin_usd_items items = {list, 0}, again = items;
    struct spin_usd_value item;

    while (spin_usd_next(&items, &item))
        out->n_assets++;
    SPIN_TRY(spin_arena_take(&s->arena, out->n_assets, sizeof *out->asset, (void **)&out->asset));
    for (size_t i = 0; i < out->n_assets && spin_usd_next(&again, &item); i++) {
        SPIN_FREED char *text = NULL;

        SPIN_TRY(spin_usd_text(&item, &text));
        SPIN_TRY(copy_text(s, text, (const char **)&out->asset[i]));
    }
    return SPIN_OK;
}

static spin_status entry_number(const struct spin_usd_value *set, const char *name, double *out)
{
    struct spin_usd_value value;

    SPIN_TRY(spin_usd_entry(set, name, &value));
    return value.layer ? spin_usd_doubles(&value, 1, 1, out)
                       : spin_malformed("clips with a template have no '%s'", name);
}

/* Adds the file of a time code to the clips, if the file exists. In the name of the file, the time
 * code replaces the `#` signs of the template, and is padded with zeros to the number of these
 * signs. */
static spin_status add_template(struct spin_usd_stage *s, const char *template, double time,
                                struct usd_clips *out)
{
    size_t before = strcspn(template, "#"), digits = strspn(template + before, "#");
    const char *after = template + before + digits, *path;
    char name[4096];
    int n = snprintf(name, sizeof name, "%.*s%0*.0f%s", (int)before, template, (int)digits, time,
                     after);

    if (digits == 0 || digits > 32 || strchr(after, '#') || n < 0 || (size_t)n >= sizeof name)
        return spin_unsupported(
            "the clip template '%.80s' is not supported: expected one run of '#'", template);
    SPIN_TRY(resolve_path(s, out->folder_of, name, &path));
    if (!file_exists(s, path))
        return SPIN_OK;
    SPIN_TRY(copy_text(s, name, (const char **)&out->asset[out->n_assets]));
    out->active[2 * out->n_assets] = time;
    out->active[2 * out->n_assets + 1] = (double)out->n_assets;
    out->n_active = ++out->n_assets;
    return SPIN_OK;
}

/* Reads clips whose file names follow a template, with one file for each time code of a range. */
static spin_status read_template(struct spin_usd_stage *s, const struct spin_usd_value *set,
                                 const struct spin_usd_value *name, struct usd_clips *out)
{
    SPIN_FREED char *template = NULL;
    double first = 0, last = 0, stride = 0, n;

    SPIN_TRY(spin_usd_text(name, &template));
    SPIN_TRY(entry_number(set, "templateStartTime", &first));
    SPIN_TRY(entry_number(set, "templateEndTime", &last));
    SPIN_TRY(entry_number(set, "templateStride", &stride));
    n = floor((last - first) / stride + 1e-6) + 1;
    if (!(stride >= 1 && first >= 0 && n >= 1 && n <= MAX_CLIPS && first == floor(first) &&
          stride == floor(stride)))
        return spin_unsupported(
            "clips from time code %g to %g with a stride of %g are not supported: "
            "expected integers",
            first, last, stride);
    SPIN_TRY(spin_arena_take(&s->arena, (size_t)n, sizeof *out->asset, (void **)&out->asset));
    SPIN_TRY(spin_arena_take(&s->arena, (size_t)n, 2 * sizeof *out->active, (void **)&out->active));
    for (size_t i = 0; i < (size_t)n; i++)
        SPIN_TRY(add_template(s, template, first + (double)i * stride, out));
    return out->n_active > 0 ? SPIN_OK
                             : spin_not_found("no file matches the clip template '%s'", template);
}

/* Reads the file names and the times of the clips. */
static spin_status read_list(struct spin_usd_stage *s, const struct spin_usd_value *set,
                             struct usd_clips *out)
{
    struct spin_usd_value value;

    SPIN_TRY(spin_usd_entry(set, "assetPaths", &value));
    if (value.layer) {
        SPIN_TRY(read_assets(s, &value, out));
        SPIN_TRY(read_pairs(s, set, "active", &out->active, &out->n_active));
        return read_pairs(s, set, "times", &out->times, &out->n_times);
    }
    SPIN_TRY(spin_usd_entry(set, "templateAssetPath", &value));
    return value.layer ? read_template(s, set, &value, out)
                       : spin_malformed("clips have neither assetPaths nor templateAssetPath");
}

/* Reads the clips of a prim from a set of clips, which is a dictionary. */
static spin_status read_clips(struct spin_usd_stage *s, const struct spin_usd_value *set,
                              struct usd_clips *out, struct usd_node *node)
{
    struct spin_usd_value value;
    SPIN_FREED char *path = NULL;

    SPIN_TRY(read_list(s, set, out));
    SPIN_TRY(spin_usd_entry(set, "primPath", &value));
    if (!value.layer)
        return spin_malformed("the clips of '%s' have no primPath", node->path);
    SPIN_TRY(spin_usd_text(&value, &path));
    SPIN_TRY(copy_text(s, path, &node->clip_path));
    for (size_t i = 0; i < out->n_active; i++)
        if (!(out->active[2 * i + 1] >= 0 && out->active[2 * i + 1] < (double)out->n_assets))
            return spin_malformed("the clips of '%s' use file number %g, counted from 0, but there "
                                  "are only %zu files",
                                  node->path, out->active[2 * i + 1], out->n_assets);
    node->clips = out->n_active > 0 ? out : NULL;
    return SPIN_OK;
}

/* Reads the value clips of a prim, if it has any. */
static spin_status find_clips(struct spin_usd_stage *s, struct usd_node *node)
{
    for (size_t i = 0; i < node->n; i++) {
        const struct usd_opinion *o = &node->opinion[i];
        struct spin_usd_field *field = spin_usd_field(o->prim->metadata, "clips");
        struct spin_usd_value set;
        struct usd_clips *clips;

        if (!field || !field->value.layer)
            continue;
        SPIN_TRY_IN(spin_usd_entry(&field->value, NULL, &set), "cannot read '%s'", o->file->path);
        if (!set.layer)
            continue;
        SPIN_TRY(spin_arena_take(&s->arena, 1, sizeof *clips, (void **)&clips));
        clips->folder_of = o->file->path;
        SPIN_TRY_IN(read_clips(s, &set, clips, node), "cannot read '%s'", o->file->path);
        return SPIN_OK;
    }
    return SPIN_OK;
}

/* Creates the node of a prim from the opinions in `list`, to which the opinions found by references
 * are added. */
static spin_status make_node(struct spin_usd_stage *s, struct usd_node *parent, const char *name,
                             struct opinions *list, struct usd_node **out)
{
    struct usd_node *node;
    char *path;

    if (++s->n_nodes > MAX_NODES)
        return spin_malformed("'%s': the layers define too many prims, or references form a cycle",
                              s->file->path);
    SPIN_TRY(spin_arena_take(&s->arena, 1, sizeof *node, (void **)&node));
    node->parent = parent;
    node->n_local = list->n;
    SPIN_TRY(add_references(s, list));
    node->n = list->n;
    SPIN_TRY(spin_arena_take(&s->arena, list->n, sizeof *list->of, (void **)&node->opinion));
    memcpy(node->opinion, list->of, list->n * sizeof *list->of);
    SPIN_TRY(spin_arena_take(&s->arena, (parent ? strlen(parent->path) : 0) + strlen(name) + 2, 1,
                             (void **)&path));
    sprintf(path, "%s%s%s", parent ? parent->path : "", parent ? "/" : "", name);
    node->path = path;
    if (parent && parent->clips) {
        node->clips = parent->clips;
        SPIN_TRY(spin_arena_take(&s->arena, strlen(parent->clip_path) + strlen(name) + 2, 1,
                                 (void **)&path));
        sprintf(path, "%s/%s", parent->clip_path, name);
        node->clip_path = path;
    }
    *out = node;
    return find_clips(s, node);
}

/* Collects the opinions about the child `name` of a prim. *n_local: receives the number of opinions
 * of the stage's own layers. */
static void find_child(const struct usd_node *parent, const char *name, struct opinions *out,
                       size_t *n_local)
{
    out->n = *n_local = 0;
    for (size_t i = 0; i < parent->n; i++) {
        const struct usd_opinion *o = &parent->opinion[i];
        struct spin_usd_prim *child = spin_usd_child(o->prim, name, strlen(name));

        if (child)
            out->of[out->n++] = (struct usd_opinion){o->file, child};
        *n_local += child && i < parent->n_local;
    }
}

/* Returns whether an opinion before opinion i has a child of this name, which means that the child
 * has already been visited. */
static bool is_repeated(const struct usd_node *node, size_t i, const char *name)
{
    for (size_t k = 0; k < i; k++)
        if (spin_usd_child(node->opinion[k].prim, name, strlen(name)))
            return true;
    return false;
}

static void note_type(struct spin_usd_stage *s, const char *type)
{
    if (strncmp(type, "ParticleField", 13) == 0 && !*s->other)
        snprintf(s->other, sizeof s->other, "%s", type);
}

/* Visits a node and all its descendants, and appends those that contain splats to a list. *tail:
 * pointer to the NULL at the end of the list. */
static spin_status visit(struct spin_usd_stage *s, struct usd_node *node, int depth,
                         struct usd_node ***tail)
{
    if (node->parent && !is_defined(node))
        return SPIN_OK;
    if (depth == MAX_DEPTH)
        return spin_malformed("'%s': prims are nested too deeply, or references form a cycle",
                              s->file->path);
    if (strcmp(type_of(node), SPIN_USD_TYPE) == 0) {
        **tail = node;
        *tail = &node->next;
    } else {
        note_type(s, type_of(node));
    }
    for (size_t i = 0; i < node->n; i++)
        for (struct spin_usd_prim *c = node->opinion[i].prim->child; c; c = c->next) {
            struct opinions list;
            struct usd_node *child;
            size_t n_local;

            if (is_repeated(node, i, c->name))
                continue;
            find_child(node, c->name, &list, &n_local);
            SPIN_TRY(make_node(s, node, c->name, &list, &child));
            child->n_local = n_local;
            SPIN_TRY(visit(s, child, depth + 1, tail));
        }
    return SPIN_OK;
}

spin_status spin_usd_compose(struct spin_usd_stage *s, struct usd_file *root)
{
    struct opinions list = {.n = 0};
    struct usd_node *top, **tail = &s->splats;

    SPIN_TRY(add_stack(s, &list, root, "", 0));
    SPIN_TRY(make_node(s, NULL, "", &list, &top));
    return visit(s, top, 0, &tail);
}

/* ---- Values at a time ------------------------------------------------------------------------ */

/* Converts a time code of the stage to a time code of the clips, by linear interpolation in
 * c->times. */
static double clip_time(const struct usd_clips *c, double time)
{
    const double *t = c->times;
    size_t i = 0;

    if (c->n_times == 0)
        return time;
    while (i + 1 < c->n_times && t[2 * i + 2] <= time)
        i++;
    if (i + 1 == c->n_times || t[2 * i] >= time || t[2 * i + 2] == t[2 * i])
        return t[2 * i + 1];
    return t[2 * i + 1] +
           (time - t[2 * i]) * (t[2 * i + 3] - t[2 * i + 1]) / (t[2 * i + 2] - t[2 * i]);
}

spin_status spin_usd_open_clip(struct spin_usd_stage *s, struct usd_clips *c, size_t i)
{
    const char *asset = c->asset[(size_t)c->active[2 * i + 1]];
    struct usd_file *file = c->open;

    if (file && file->map.data && c->at == i)
        return SPIN_OK;
    if (!file)
        SPIN_TRY(spin_arena_take(&s->arena, 1, sizeof *file, (void **)&file));
    else
        close_file(s, file);
    c->open = file;
    c->at = i;
    SPIN_TRY(resolve_path(s, c->folder_of, asset, &file->path));
    return open_file(s, file);
}

/* Sets *out to the value of an attribute in the clip that is active at a time, or to NULL if the
 * attribute has no samples in this clip. */
static spin_status find_in_clips(struct spin_usd_stage *s, const struct usd_node *node,
                                 const char *name, double time, struct spin_usd_value **out)
{
    struct usd_clips *c = node->clips;
    struct spin_usd_prim *prim;
    struct spin_usd_field *field;
    size_t i = 0;

    while (i + 1 < c->n_active && c->active[2 * i + 2] <= time)
        i++;
    SPIN_TRY(spin_usd_open_clip(s, c, i));
    prim = spin_usd_prim_at(&c->open->layer, node->clip_path);
    field = prim ? spin_usd_field(prim->attribute, name) : NULL;
    *out = field ? spin_usd_sample_at(field, clip_time(c, time)) : NULL;
    return SPIN_OK;
}

/* Opinions are searched from the strongest to the weakest. Clips are weaker than the stage's own
 * layers, but stronger than references. */
spin_status spin_usd_find_value(struct spin_usd_stage *s, const struct usd_node *node,
                                const char *name, double time, struct spin_usd_value **out)
{
    *out = NULL;
    for (size_t i = 0; i <= node->n && !*out; i++) {
        struct spin_usd_field *field;

        if (i == node->n_local && node->clips)
            SPIN_TRY(find_in_clips(s, node, name, time, out));
        if (*out || i == node->n)
            continue;
        field = spin_usd_field(node->opinion[i].prim->attribute, name);
        if (field && field->n_samples > 0)
            *out = spin_usd_sample_at(field, time);
        else if (field && field->value.layer)
            *out = &field->value;
    }
    *out = *out && (*out)->layer ? *out : NULL;
    return SPIN_OK;
}
