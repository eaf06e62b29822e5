/* 3DGStream (Sun et al., CVPR 2024): a cloud for frame 0 and, for each later frame, a small network
 * that moves the Gaussians from the previous frame to this one, and a few added Gaussians that
 * exist in this frame only.
 *
 *     OUT/frame000001/point_cloud/iteration_<i1>/point_cloud.ply        the moved cloud
 *     OUT/frame000001/NTC.pth                                           the network
 *     OUT/frame000001/point_cloud/iteration_<i2>/added/point_cloud.ply  added Gaussians
 *     INIT/point_cloud/iteration_<n>/point_cloud.ply                    frame 0
 * or, packed for the viewer (files with index i belong to frame i + 1),
 *     init_3dgs.ply  NTCs/{config.json, NTC_%06d.pth}  additional_3dgs/additions_%06d.ply  raw/
 *
 * raw/ may contain frame folders like those above. The moved clouds are exact and are read if every
 * frame has one. Otherwise the networks are evaluated frame by frame, which accumulates
 * half-precision errors. Rows of the base, which is the cloud without added Gaussians, come first,
 * in the same order in every frame; rows of the added Gaussians follow. */
#include "importers/lib/model.h"
#include "importers/lib/ntc_eval.h"
#include "importers/lib/views_check.h"
#include "math/quat.h"

/* A frame and the paths of its files; NULL: the file is missing. */
struct step {
    int number;
    const char *cloud, *network, *added;
    size_t n_added;
};

struct clip {
    struct spin_model base; /* base.path: the input folder; base.canonical: frame 0 */
    /* The frames, sorted by number. The first is frame 0, unless the cloud of frame 0 is missing.
     */
    struct step *step;
    size_t n_steps, capacity;
    bool evaluate; /* true: evaluate the networks; false: read the moved clouds */
    bool packed;   /* the folder is packed for the viewer */
    struct ntc_shape shape;
    size_t n; /* number of Gaussians in the base */
    int sh_degree;
    size_t *counts;
    int *numbers;
    int i1, i2, first;    /* iterations <i1>, <i2> and <n>, from cfg_args.json; -1: unknown */
    const char *config;   /* path of the networks' configuration; NULL: the default */
    struct ntc network;   /* loaded only while it is applied to the base */
    float *means, *quats; /* [n][3], [n][4] the base, moved to frame step[at]; NULL before any frame
                             is read */
    size_t at;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    bool frames = false, ours = spin_peek_has(peek, "cfg_args.json");

    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        frames = frames || spin_frame_number(peek->names[i]) > 0;
        ours = ours || strncmp(peek->names[i], "init_3dgs", 9) == 0;
    }
    if (spin_peek_has(peek, "NTCs"))
        return 90;
    return frames ? (ours ? 80 : 30) : 0; /* other methods have frame folders too */
}

/* ---- Finding the files ----------------------------------------------------------------------- */

static spin_status step_of(struct clip *clip, int number, struct step **out)
{
    for (size_t i = 0; i < clip->n_steps; i++) {
        if (clip->step[i].number == number) {
            *out = &clip->step[i];
            return SPIN_OK;
        }
    }
    SPIN_TRY(
        spin_array_grow(clip->n_steps, &clip->capacity, sizeof *clip->step, (void **)&clip->step));
    *out = &clip->step[clip->n_steps++];
    **out = (struct step){.number = number};
    return SPIN_OK;
}

/* Finds <folder>/point_cloud/iteration_<n>/<file>, where n is `iteration` if that file exists, else
 * the largest n with such a file. *out is NULL if no such file exists. */
static spin_status find_cloud(struct clip *clip, const char *folder, int iteration,
                              const char *file, const char **out)
{
    const char *clouds, *name = NULL;
    char wanted[16];

    *out = NULL;
    snprintf(wanted, sizeof wanted, "%d", iteration);
    SPIN_TRY(spin_model_join(&clip->base, &clouds, folder, "point_cloud"));
    if (!spin_path_is_folder(clouds))
        return SPIN_OK;
    if (iteration >= 0)
        SPIN_TRY(spin_model_choose(&clip->base, wanted, clouds, file, NULL, NULL, &name));
    if (!name)
        SPIN_TRY(spin_model_choose(&clip->base, NULL, clouds, file, NULL, NULL, &name));
    return name ? spin_model_join(&clip->base, out, clouds, "%s/%s", name, file) : SPIN_OK;
}

static spin_status find_raw(struct clip *clip, const char *folder)
{
    char **names;
    size_t n;

    SPIN_TRY(spin_model_names(&clip->base, folder, &names, &n));
    for (size_t i = 0; i < n; i++) {
        struct step *step;
        const char *sub;

        if (spin_frame_number(names[i]) < 0)
            continue;
        SPIN_TRY(spin_model_join(&clip->base, &sub, folder, "%s", names[i]));
        if (!spin_path_is_folder(sub))
            continue;
        SPIN_TRY(step_of(clip, spin_frame_number(names[i]), &step));
        SPIN_TRY(find_cloud(clip, sub, clip->i1, "point_cloud.ply", &step->cloud));
        SPIN_TRY(find_cloud(clip, sub, clip->i2, "added/point_cloud.ply", &step->added));
        if (!step->network)
            SPIN_TRY(spin_model_find(&clip->base, &step->network, sub, "NTC.pth"));
    }
    return SPIN_OK;
}

/* Assigns the files <prefix><digits><ending> of a folder to their frames: the file with index i
 * belongs to frame i + 1. */
static spin_status find_indexed(struct clip *clip, const char *folder, const char *prefix,
                                const char *ending)
{
    size_t n = 0, n_prefix = strlen(prefix);
    const char *sub;
    char **names;

    SPIN_TRY(spin_model_join(&clip->base, &sub, clip->base.path, "%s", folder));
    if (spin_path_is_folder(sub))
        SPIN_TRY(spin_model_names(&clip->base, sub, &names, &n));
    for (size_t i = 0; i < n; i++) {
        const char *digits = names[i] + n_prefix, **slot;
        size_t n_digits;
        struct step *step;

        if (strncmp(names[i], prefix, n_prefix) != 0)
            continue;
        n_digits = strspn(digits, "0123456789");
        if (n_digits == 0 || n_digits > 8 || strcmp(digits + n_digits, ending) != 0)
            continue;
        SPIN_TRY(step_of(clip, atoi(digits) + 1, &step));
        slot = strcmp(ending, ".pth") == 0 ? &step->network : &step->added;
        if (!*slot)
            SPIN_TRY(spin_model_join(&clip->base, slot, sub, "%s", names[i]));
    }
    return SPIN_OK;
}

/* Sets *out to `path` if that is a file. If it is a folder, sets *out to the cloud of the model in
 * this folder. If there is no such file or cloud, sets *out to NULL. */
static spin_status find_first(struct clip *clip, const char *path, const char **out)
{
    *out = NULL;
    if (spin_path_is_folder(path))
        return find_cloud(clip, path, clip->first, "point_cloud.ply", out);
    return spin_path_exists(path) ? spin_model_text(&clip->base, out, "%s", path) : SPIN_OK;
}

/* Finds the cloud of frame 0: that at the path in option `init` or, without the option, the first
 * of these that exists: the file init_3dgs.ply, the model in the folder init_3dgs, the model in the
 * input folder, a model in another folder beside the frames. If frame 0 already has a cloud, only
 * the option replaces it. */
static spin_status find_init(struct clip *clip)
{
    static const char *const places[] = {"init_3dgs.ply", "init_3dgs", "."};
    const char *given = spin_model_option(&clip->base, "init"), *path, *cloud = NULL;
    struct step *step;
    char **names;
    size_t n;

    if (given) {
        SPIN_TRY(find_first(clip, given, &cloud));
        if (!cloud)
            return spin_not_found("option 'init': '%s' is neither a PLY nor a folder with "
                                  "point_cloud/iteration_*/point_cloud.ply",
                                  given);
    }
    SPIN_TRY(spin_model_names(&clip->base, clip->base.path, &names, &n));
    for (size_t i = 0; i < 3 + n && !cloud; i++) {
        if (i >= 3 && (spin_frame_number(names[i - 3]) >= 0 || names[i - 3][0] == '.'))
            continue;
        SPIN_TRY(spin_model_join(&clip->base, &path, clip->base.path, "%s",
                                 i < 3 ? places[i] : names[i - 3]));
        if (i < 1 || spin_path_is_folder(path))
            SPIN_TRY(find_first(clip, path, &cloud));
    }
    if (!cloud)
        return SPIN_OK;
    SPIN_TRY(step_of(clip, 0, &step));
    if (!step->cloud || given)
        step->cloud = cloud;
    return SPIN_OK;
}

static void read_iteration(const spin_json *root, const char *key, int *out)
{
    int64_t value;

    if (spin_json_integer(spin_json_get(root, key), &value) && value >= 0 && value < INT_MAX / 2)
        *out = (int)value;
}

/* Reads the saved iterations from cfg_args.json, which is optional. */
static spin_status read_settings(struct clip *clip)
{
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
    const char *path;
    int second = -1;

    clip->i1 = clip->i2 = clip->first = -1;
    SPIN_TRY(spin_model_find(&clip->base, &path, clip->base.path, "cfg_args.json"));
    if (path)
        SPIN_TRY(spin_json_load(path, &root));
    read_iteration(root, "iterations", &clip->i1);
    read_iteration(root, "iterations_s2", &second);
    read_iteration(root, "first_load_iteration", &clip->first);
    if (clip->i1 >= 0 && second >= 0)
        clip->i2 = clip->i1 + second;
    return SPIN_OK;
}

static int by_number(const void *a, const void *b)
{
    const struct step *x = a, *y = b;

    return x->number < y->number ? -1 : x->number > y->number;
}

static spin_status find_files(struct clip *clip)
{
    const char *folder = clip->base.path, *raw;

    SPIN_TRY(read_settings(clip));
    clip->packed = spin_model_holds(folder, "NTCs");
    if (clip->packed) {
        SPIN_TRY(find_indexed(clip, "NTCs", "NTC_", ".pth"));
        SPIN_TRY(spin_model_join(&clip->base, &raw, folder, "raw"));
        if (spin_path_is_folder(raw))
            SPIN_TRY(find_raw(clip, raw));
        SPIN_TRY(find_indexed(clip, "additional_3dgs", "additions_", ".ply"));
    } else {
        SPIN_TRY(find_raw(clip, folder));
    }
    if (clip->n_steps == 0)
        return spin_not_found("'%s' contains neither frame folders nor 'NTCs'", folder);
    SPIN_TRY(find_init(clip));
    qsort(clip->step, clip->n_steps, sizeof *clip->step, by_number);
    for (size_t i = 1; i < clip->n_steps; i++) {
        if (clip->step[i].number != clip->step[i - 1].number + 1)
            return spin_malformed("'%s' has frames %d and %d, but not %d between them", folder,
                                  clip->step[i - 1].number, clip->step[i].number,
                                  clip->step[i - 1].number + 1);
    }
    return SPIN_OK;
}

/* ---- Choosing clouds or networks ------------------------------------------------------------- */

/* Sets clip->config to the file that option `config` names or, without the option, to the first
 * file that exists at the paths to which upstream writes the configuration. */
static spin_status find_config(struct clip *clip)
{
    static const char *const places[] = {"NTCs/config.json", "config.json", "cache_conf.json",
                                         "../cache_conf.json"};
    const char *given = spin_model_option(&clip->base, "config");

    if (given)
        return spin_model_text(&clip->base, &clip->config, "%s", given);
    for (size_t i = 0; i < sizeof places / sizeof *places && !clip->config; i++)
        SPIN_TRY(spin_model_find(&clip->base, &clip->config, clip->base.path, "%s", places[i]));
    return SPIN_OK;
}

/* Reads the configuration of the networks. Also reads the first network, so that a mismatch with
 * the configuration is reported early. */
static spin_status prepare_networks(struct clip *clip)
{
    spin_status status;

    SPIN_TRY(find_config(clip));
    if (clip->config) {
        SPIN_TRY(spin_ntc_open_config(clip->config, &clip->shape));
    } else {
        spin_ntc_default_shape(&clip->shape);
        SPIN_TRY(spin_ntc_layout(&clip->shape));
    }
    status = spin_ntc_open(clip->step[1].network, &clip->shape, &clip->network);
    if (status != SPIN_OK && clip->config)
        return spin_fail_context(status, "with the configuration '%s'", clip->config);
    if (status != SPIN_OK)
        return spin_fail_context(status,
                                 "with the default configuration, since there is no "
                                 "config.json: give the config.json of the run with --config");
    status = spin_mlp_team_create(3 * spin_mlp_widest(&clip->network.net), &clip->base.team);
    spin_ntc_free(&clip->network);
    return status;
}

/* Returns the number of the first frame after frame 0 that has no network (if `network`) or no
 * moved cloud (otherwise), or -1 if there is no such frame. */
static int first_without(const struct clip *clip, bool network)
{
    for (size_t i = clip->step[0].number == 0; i < clip->n_steps; i++) {
        if (!(network ? clip->step[i].network : clip->step[i].cloud))
            return clip->step[i].number;
    }
    return -1;
}

static spin_status choose_way(struct clip *clip)
{
    enum { AUTO, CLOUDS, NETWORKS };
    int way, no_cloud = first_without(clip, false), no_network = first_without(clip, true);

    SPIN_TRY(spin_option_word(clip->base.values, "way", "auto|clouds|networks", &way));
    if (clip->step[0].number == 0 && !clip->step[0].cloud)
        return spin_not_found("'%s': frame 0 has no cloud: give it with --init", clip->base.path);
    clip->evaluate = way == NETWORKS || (way == AUTO && no_cloud >= 0 && no_network < 0);
    if (!clip->evaluate && no_cloud >= 0)
        return spin_not_found("'%s': frame %d has no moved cloud%s", clip->base.path, no_cloud,
                              no_network >= 0 ? ", and not every frame has a network" : "");
    if (!clip->evaluate)
        return SPIN_OK;
    if (no_network >= 0)
        return spin_not_found("'%s': frame %d has no network", clip->base.path, no_network);
    if (clip->step[0].number != 0)
        return spin_not_found("'%s': the networks start from the cloud of frame 0, which is "
                              "missing: give the cloud with --init",
                              clip->base.path);
    return clip->n_steps > 1 ? prepare_networks(clip) : SPIN_OK;
}

/* ---- Clouds ---------------------------------------------------------------------------------- */

static spin_status inspect_base(struct clip *clip, size_t i)
{
    const struct step *step = &clip->step[i];
    struct spin_gs_ply cloud;
    size_t n;

    if (i > 0 && clip->evaluate)
        return SPIN_OK;
    SPIN_TRY(spin_model_cloud(&clip->base, step->cloud, &cloud));
    n = (size_t)cloud.vertex->count;
    if (i > 0 && n != clip->n)
        return spin_malformed("'%s' has %zu Gaussians, but '%s' has %zu, expected the same number",
                              step->cloud, n, clip->step[i - 1].cloud, clip->n);
    if (i > 0 && cloud.sh_degree != clip->sh_degree)
        return spin_malformed("'%s' has SH degree %d, but '%s' has %d", step->cloud,
                              cloud.sh_degree, clip->step[i - 1].cloud, clip->sh_degree);
    if (n == 0)
        return spin_malformed("'%s' contains 0 vertices", step->cloud);
    clip->n = n;
    clip->sh_degree = cloud.sh_degree;
    return SPIN_OK;
}

/* Sets step->n_added and checks the SH degree of the added Gaussians. If there are none, any degree
 * is valid. */
static spin_status inspect_added(struct clip *clip, struct step *step)
{
    struct spin_gs_ply cloud;

    if (!step->added)
        return SPIN_OK;
    SPIN_TRY(spin_model_cloud(&clip->base, step->added, &cloud));
    step->n_added = (size_t)cloud.vertex->count;
    if (step->n_added > 0 && cloud.sh_degree != clip->sh_degree)
        return spin_malformed("'%s' has SH degree %d, but the cloud to which it is added has %d",
                              step->added, cloud.sh_degree, clip->sh_degree);
    return SPIN_OK;
}

/* Reads a cloud of n rows into the rows of `out` from `first` on. */
static spin_status read_cloud(struct clip *clip, const char *path, size_t n, unsigned columns,
                              size_t first, struct spin_splats *out)
{
    struct spin_gs_ply cloud;

    SPIN_TRY(spin_model_cloud(&clip->base, path, &cloud));
    if (cloud.vertex->count != n || cloud.sh_degree != out->sh_degree)
        return spin_fail(SPIN_E_IO, "'%s' changed while it was being read", path);
    SPIN_TRY(spin_gs_ply_read(&cloud, columns, first, out));
    for (size_t i = 0; (columns & SPIN_COL_QUATS) && i < n; i++)
        spin_quat_normalise(out->quats + 4 * (first + i));
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status describe(struct clip *clip)
{
    struct spin_sequence_info *sequence = clip->base.sequence;
    size_t n_added = 0;

    SPIN_TRY(
        spin_model_alloc(&clip->base, clip->n_steps, sizeof *clip->counts, (void **)&clip->counts));
    SPIN_TRY(spin_model_alloc(&clip->base, clip->n_steps, sizeof *clip->numbers,
                              (void **)&clip->numbers));
    for (size_t i = 0; i < clip->n_steps; i++) {
        clip->counts[i] = clip->n + clip->step[i].n_added;
        clip->numbers[i] = clip->step[i].number;
        n_added += clip->step[i].n_added;
    }
    sequence->n_frames = (int)clip->n_steps;
    sequence->counts = clip->counts;
    sequence->numbers = clip->numbers;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = clip->sh_degree;
    sequence->time_last = (double)(clip->n_steps - 1);
    snprintf(sequence->variant, sizeof sequence->variant, "3DGStream%s, %s",
             clip->packed ? " packed for its viewer" : "",
             clip->evaluate ? "networks evaluated" : "moved clouds");
    if (n_added > 0)
        spin_note(sequence,
                  "splats from row %zu on have no tracks: they are Gaussians that were added for a "
                  "single frame (on average %.1f per frame)",
                  clip->n, (double)n_added / (double)clip->n_steps);
    if (clip->step[0].number != 0)
        spin_note(sequence,
                  "the cloud of frame 0 was not found, so the clip begins with frame %d: give the "
                  "cloud with --init",
                  clip->step[0].number);
    if (clip->evaluate)
        spin_note(sequence, "positions and rotations come from half-precision networks, whose "
                            "errors accumulate from frame to frame");
    if (clip->evaluate && !clip->config)
        spin_note(sequence, "there is no config.json: the default configuration is used, which "
                            "matches the sizes of the networks");
    return SPIN_OK;
}

static spin_status open_clip(void *self, const char *path)
{
    struct clip *clip = self;

    clip->at = SIZE_MAX;
    SPIN_TRY(spin_model_text(&clip->base, &clip->base.path, "%s", path));
    SPIN_TRY(find_files(clip));
    SPIN_TRY(choose_way(clip));
    for (size_t i = 0; i < clip->n_steps; i++) {
        SPIN_TRY(inspect_base(clip, i));
        SPIN_TRY(inspect_added(clip, &clip->step[i]));
    }
    return describe(clip);
}

static void stream_close(void *self)
{
    if (self)
        free(((struct clip *)self)->step);
    spin_model_close(self);
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Resets the base to frame 0, from which the first network moves it to frame 1. */
static spin_status rewind_base(struct clip *clip)
{
    struct spin_splats *first = &clip->base.canonical;

    if (!clip->means) {
        unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;

        SPIN_TRY(spin_splats_reserve(first, clip->n, columns, clip->sh_degree));
        SPIN_TRY(read_cloud(clip, clip->step[0].cloud, clip->n, columns, 0, first));
        SPIN_TRY(spin_model_alloc(&clip->base, clip->n, 4 * sizeof(float), (void **)&clip->quats));
        SPIN_TRY(spin_model_alloc(&clip->base, clip->n, 3 * sizeof(float), (void **)&clip->means));
    }
    memcpy(clip->means, first->means, 3 * clip->n * sizeof(float));
    memcpy(clip->quats, first->quats, 4 * clip->n * sizeof(float));
    clip->at = 0;
    return SPIN_OK;
}

static void move_block(void *context, size_t first, int n, float *scratch)
{
    struct clip *clip = context;

    spin_ntc_apply(&clip->network, n, clip->means + 3 * first, clip->quats + 4 * first, scratch);
}

/* Applies networks until the base is at step `target`; restarts from frame 0 if the base is already
 * past that step. */
static spin_status move_base(struct clip *clip, size_t target)
{
    if (clip->at > target)
        SPIN_TRY(rewind_base(clip));
    while (clip->at < target) {
        const char *network = clip->step[clip->at + 1].network;

        SPIN_TRY(spin_ntc_open(network, &clip->shape, &clip->network));
        spin_mlp_team_run(&clip->base.team, clip->n, move_block, clip);
        spin_ntc_free(&clip->network);
        clip->at++;
    }
    return SPIN_OK;
}

static void copy_base(const struct clip *clip, unsigned columns, struct spin_splats *out)
{
    for (int c = 0; c < SPIN_MODEL_COLUMNS; c++) {
        size_t width;
        const float *from = spin_model_values(&clip->base.canonical, c, &width);

        from = c == 0 ? clip->means : c == 1 ? clip->quats : from;
        if (columns & 1u << c)
            memcpy(spin_model_values(out, c, &width), from, clip->n * width * sizeof *from);
    }
}

static spin_status stream_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct clip *clip = self;
    const struct step *step;

    if (frame < 0 || (size_t)frame >= clip->n_steps)
        return spin_not_found("there is no frame %d", frame);
    step = &clip->step[frame];
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, clip->n + step->n_added, columns, clip->sh_degree));
    if (clip->evaluate) {
        SPIN_TRY(move_base(clip, (size_t)frame));
        copy_base(clip, columns, out);
    } else {
        SPIN_TRY(read_cloud(clip, step->cloud, clip->n, columns, 0, out));
    }
    if (step->n_added > 0)
        SPIN_TRY(read_cloud(clip, step->added, step->n_added, columns, clip->n, out));
    return clip->evaluate ? spin_model_check(clip->base.path, time, columns, out) : SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"init", "PATH", "the model of frame 0 (default: beside the frames)", NULL},
    {"way", "auto|clouds|networks",
     "clouds: read the moved clouds; networks: evaluate the networks; auto: clouds if every frame "
     "has one, else networks",
     "auto"},
    {"config", "FILE", "configuration of the networks (default: NTCs/config.json)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(3dgstream, struct clip, open_clip, stream_close,
                    .summary = "3DGStream: the output folder, or one packed for its viewer",
                    .upstream = "SJoJoK/3DGStream 747ddfe", .options = options, .probe = probe,
                    .frame = stream_frame)
