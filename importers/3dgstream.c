/* 3DGStream (Sun et al., CVPR 2024): a cloud, and for each later frame a small network that moves
 * it and a few Gaussians that live in that frame only.
 *
 *     OUT/frame000001/point_cloud/iteration_<i1>/point_cloud.ply        the cloud, moved
 *     OUT/frame000001/NTC.pth                                           the network that moved it
 *     OUT/frame000001/point_cloud/iteration_<i2>/added/point_cloud.ply  what was added
 *     INIT/point_cloud/iteration_<n>/point_cloud.ply                    frame 0
 * or, packed for the viewer, where index i makes frame i + 1,
 *     init_3dgs.ply  NTCs/{config.json, NTC_%06d.pth}  additional_3dgs/additions_%06d.ply  raw/
 *
 * The moved clouds are exact and are read when all are there. Else the networks are evaluated one
 * frame after the other, which adds up the errors of half precision. Rows of the base come first
 * and keep their order from frame to frame; rows of the added ones follow. */
#include "spin.h"

#include <ctype.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>

#include "base/option.h"
#include "importers/lib/finite.h"
#include "importers/lib/model_folder.h"
#include "importers/lib/notes.h"
#include "importers/lib/ntc_eval.h"
#include "io/json.h"
#include "io/torch.h"
#include "math/quat.h"

/* Files of one frame; those that are not there are NULL. */
struct step {
    int number;
    char *cloud, *network, *added;
    size_t n_added;
};

struct clip {
    char *folder;
    struct step *step; /* sorted by number; step 0 is frame 0 when the first cloud is known */
    size_t n_steps, capacity;
    bool evaluate; /* the networks, instead of reading the moved clouds */
    bool packed;
    struct ntc_shape shape;
    size_t n; /* Gaussians of the base */
    int sh_degree;
    size_t *counts;
    int *numbers;
    int i1, i2, first;       /* iterations from cfg_args.json, or -1 */
    char *config;            /* of the networks, or NULL */
    struct spin_splats base; /* frame 0 */
    float *means, *quats;    /* [n][3], [n][4]: the base at step `at` */
    size_t at;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* "frame000012": 12, else -1. */
static int frame_number(const char *name)
{
    long long number = -1;

    if (strncmp(name, "frame", 5) == 0 && name[5] &&
        strspn(name + 5, "0123456789") == strlen(name + 5))
        number = spin_path_number(name);
    return number <= INT_MAX ? (int)number : -1;
}

static int probe(const struct spin_peek *peek)
{
    bool frames = false, networks = false, ours = false;

    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        const char *name = peek->names[i];

        frames = frames || frame_number(name) > 0;
        networks = networks || strcmp(name, "NTCs") == 0;
        ours = ours || strcmp(name, "cfg_args.json") == 0 || strncmp(name, "init_3dgs", 9) == 0;
    }
    if (networks)
        return 90;
    return frames ? (ours ? 80 : 30) : 0; /* folders of frames are anybody's */
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
    SPIN_TRY(spin_room(clip->n_steps, &clip->capacity, sizeof *clip->step, (void **)&clip->step));
    *out = &clip->step[clip->n_steps++];
    **out = (struct step){.number = number};
    return SPIN_OK;
}

/* <folder>/point_cloud/iteration_<n>/<file>: that iteration when it is there, else the largest with
 * such a file. *out stays NULL when there is none. */
static spin_status find_cloud(const char *folder, int iteration, const char *file, char **out)
{
    struct model_folder_pick pick = {.file = file};
    char wanted[16], *clouds = NULL, *name = NULL, *sub = NULL;
    spin_status status;

    snprintf(wanted, sizeof wanted, "%d", iteration);
    SPIN_TRY(spin_path_join(folder, "point_cloud", &clouds));
    pick.folder = clouds;
    status = SPIN_OK;
    if (spin_path_is_folder(clouds) && iteration >= 0)
        status = spin_model_folder_choose(&pick, wanted, &name);
    if (spin_path_is_folder(clouds) && status == SPIN_OK && !name)
        status = spin_model_folder_choose(&pick, NULL, &name);
    if (status == SPIN_OK && name)
        status = spin_path_join(clouds, name, &sub);
    if (status == SPIN_OK && sub)
        status = spin_path_join(sub, file, out);
    free(sub);
    free(name);
    free(clouds);
    return status;
}

/* *out = folder/name when that file exists and nothing was found before. */
static spin_status take_file(const char *folder, const char *name, char **out)
{
    char *path = NULL;

    if (*out)
        return SPIN_OK;
    SPIN_TRY(spin_path_join(folder, name, &path));
    if (spin_path_exists(path) && !spin_path_is_folder(path))
        *out = path;
    else
        free(path);
    return SPIN_OK;
}

static spin_status find_raw(struct clip *clip, const char *folder)
{
    char **names = NULL, *sub = NULL;
    size_t n = 0;
    spin_status status;

    SPIN_TRY(spin_folder_list(folder, &names, &n));
    status = SPIN_OK;
    for (size_t i = 0; i < n && status == SPIN_OK; i++) {
        struct step *step;

        if (frame_number(names[i]) < 0)
            continue;
        SPIN_TRY_OUT(spin_path_join(folder, names[i], &sub));
        if (spin_path_is_folder(sub)) {
            SPIN_TRY_OUT(step_of(clip, frame_number(names[i]), &step));
            SPIN_TRY_OUT(find_cloud(sub, clip->i1, "point_cloud.ply", &step->cloud));
            SPIN_TRY_OUT(find_cloud(sub, clip->i2, "added/point_cloud.ply", &step->added));
            SPIN_TRY_OUT(take_file(sub, "NTC.pth", &step->network));
        }
        free(sub);
        sub = NULL;
    }
out:
    free(sub);
    spin_folder_list_free(names);
    return status;
}

/* Files <prefix><digits><ending> of a folder; index i belongs to frame i + 1. */
static spin_status find_indexed(struct clip *clip, const char *folder, const char *prefix,
                                const char *ending)
{
    char **names = NULL, *sub = NULL;
    size_t n = 0, n_prefix = strlen(prefix);
    spin_status status;

    SPIN_TRY(spin_path_join(clip->folder, folder, &sub));
    status = SPIN_OK;
    if (spin_path_is_folder(sub))
        status = spin_folder_list(sub, &names, &n);
    for (size_t i = 0; i < n && status == SPIN_OK; i++) {
        const char *digits = names[i] + n_prefix;
        size_t n_digits;
        struct step *step;
        char **slot;

        if (strncmp(names[i], prefix, n_prefix) != 0)
            continue;
        n_digits = strspn(digits, "0123456789");
        if (n_digits == 0 || n_digits > 8 || strcmp(digits + n_digits, ending) != 0)
            continue;
        SPIN_TRY_OUT(step_of(clip, atoi(digits) + 1, &step));
        slot = ending[1] == 'p' && ending[2] == 't' ? &step->network : &step->added;
        if (!*slot)
            SPIN_TRY_OUT(spin_path_join(sub, names[i], slot));
    }
out:
    spin_folder_list_free(names);
    free(sub);
    return status;
}

/* A PLY, or a model's folder. */
static spin_status find_first(const char *path, int iteration, char **out)
{
    if (!spin_path_is_folder(path))
        return spin_path_exists(path) ? spin_strdup(path, out) : SPIN_OK;
    return find_cloud(path, iteration, "point_cloud.ply", out);
}

/* Frame 0: where the user says, else beside the frames, else a model's folder among them. */
static spin_status find_init(struct clip *clip, const char *given)
{
    static const char *const places[] = {"init_3dgs.ply", "init_3dgs", "."};
    char **names = NULL, *path = NULL, *cloud = NULL;
    size_t n = 0;
    struct step *step;
    spin_status status;

    if (given) {
        SPIN_TRY(find_first(given, clip->first, &cloud));
        if (!cloud)
            return spin_fail(SPIN_E_NOT_FOUND,
                             "option 'init': '%s' is neither a PLY nor has it "
                             "point_cloud/iteration_*/point_cloud.ply",
                             given);
    }
    SPIN_TRY_OUT(spin_folder_list(clip->folder, &names, &n));
    for (size_t i = 0; i < 3 + n && !cloud; i++) {
        if (i >= 3 && (frame_number(names[i - 3]) >= 0 || names[i - 3][0] == '.'))
            continue;
        SPIN_TRY_OUT(spin_path_join(clip->folder, i < 3 ? places[i] : names[i - 3], &path));
        if (i < 1 || spin_path_is_folder(path))
            SPIN_TRY_OUT(find_first(path, clip->first, &cloud));
        free(path);
        path = NULL;
    }
    status = SPIN_OK;
    if (cloud) {
        SPIN_TRY_OUT(step_of(clip, 0, &step));
        if (!step->cloud || given) {
            free(step->cloud);
            step->cloud = cloud;
            cloud = NULL;
        }
    }
out:
    spin_folder_list_free(names);
    free(path);
    free(cloud);
    return status;
}

static void read_iteration(const spin_json *root, const char *key, int *out)
{
    int64_t value;

    if (spin_json_integer(spin_json_get(root, key), &value) && value >= 0 && value < INT_MAX / 2)
        *out = (int)value;
}

/* cfg_args.json says which iterations were saved; it may be missing. */
static spin_status read_settings(struct clip *clip)
{
    char *path = NULL;
    spin_json *root = NULL;
    int second = -1;
    spin_status status = SPIN_OK;

    clip->i1 = clip->i2 = clip->first = -1;
    SPIN_TRY(spin_path_join(clip->folder, "cfg_args.json", &path));
    if (spin_path_exists(path))
        status = spin_json_load(path, &root);
    free(path);
    SPIN_TRY(status);
    read_iteration(root, "iterations", &clip->i1);
    read_iteration(root, "iterations_s2", &second);
    read_iteration(root, "first_load_iteration", &clip->first);
    if (clip->i1 >= 0 && second >= 0)
        clip->i2 = clip->i1 + second;
    spin_json_free(root);
    return SPIN_OK;
}

static int by_number(const void *a, const void *b)
{
    const struct step *x = a, *y = b;

    return x->number < y->number ? -1 : x->number > y->number;
}

static spin_status find_files(struct clip *clip, const struct spin_plugin_values *values)
{
    char *path = NULL;
    spin_status status;

    SPIN_TRY(read_settings(clip));
    clip->packed = spin_model_folder_holds(clip->folder, "NTCs");
    if (clip->packed) {
        SPIN_TRY(find_indexed(clip, "NTCs", "NTC_", ".pth"));
        SPIN_TRY(spin_path_join(clip->folder, "raw", &path));
        status = spin_path_is_folder(path) ? find_raw(clip, path) : SPIN_OK;
        free(path);
        SPIN_TRY(status);
        SPIN_TRY(find_indexed(clip, "additional_3dgs", "additions_", ".ply"));
    } else {
        SPIN_TRY(find_raw(clip, clip->folder));
    }
    if (clip->n_steps == 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' holds neither frame folders nor 'NTCs'",
                         clip->folder);
    SPIN_TRY(find_init(clip, spin_plugin_value(values, "init", NULL)));
    qsort(clip->step, clip->n_steps, sizeof *clip->step, by_number);
    for (size_t i = 1; i < clip->n_steps; i++) {
        if (clip->step[i].number != clip->step[i - 1].number + 1)
            return spin_fail(SPIN_E_MALFORMED, "'%s' has frames %d and %d, but not %d between them",
                             clip->folder, clip->step[i - 1].number, clip->step[i].number,
                             clip->step[i - 1].number + 1);
    }
    return SPIN_OK;
}

/* ---- Choosing the way ------------------------------------------------------------------------ */

/* The configuration of the networks: where the user says, or where the upstream leaves it. */
static spin_status find_config(struct clip *clip, const struct spin_plugin_values *values)
{
    static const char *const places[] = {"NTCs/config.json", "config.json", "cache_conf.json",
                                         "../cache_conf.json"};
    const char *given = spin_plugin_value(values, "config", NULL);

    if (given)
        return spin_strdup(given, &clip->config);
    for (size_t i = 0; i < sizeof places / sizeof *places; i++)
        SPIN_TRY(take_file(clip->folder, places[i], &clip->config));
    return SPIN_OK;
}

/* Also reads the first network, so that one that does not fit is noticed at once. */
static spin_status prepare_networks(struct clip *clip, const struct spin_plugin_values *values)
{
    struct ntc network;
    spin_status status;

    SPIN_TRY(find_config(clip, values));
    if (clip->config) {
        SPIN_TRY(spin_ntc_open_config(clip->config, &clip->shape));
    } else {
        spin_ntc_default_shape(&clip->shape);
        SPIN_TRY(spin_ntc_layout(&clip->shape));
    }
    status = spin_ntc_open(clip->step[1].network, &clip->shape, &network);
    if (status == SPIN_OK)
        spin_ntc_free(&network);
    else if (!clip->config)
        status = spin_fail_context(status,
                                   "there is no config.json (give it with --config), and with the "
                                   "usual configuration");
    return status;
}

/* The number of the first later frame without such a file, or -1. */
static int first_without(const struct clip *clip, bool network)
{
    for (size_t i = clip->step[0].number == 0; i < clip->n_steps; i++) {
        if (!(network ? clip->step[i].network : clip->step[i].cloud))
            return clip->step[i].number;
    }
    return -1;
}

static spin_status choose_way(struct clip *clip, const struct spin_plugin_values *values)
{
    enum { AUTO, CLOUDS, NETWORKS };
    int way, no_cloud = first_without(clip, false), no_network = first_without(clip, true);

    SPIN_TRY(spin_option_word(values, "way", "auto|clouds|networks", &way));
    if (clip->step[0].number == 0 && !clip->step[0].cloud)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s': frame 0 has no cloud", clip->folder);
    clip->evaluate = way == NETWORKS || (way == AUTO && no_cloud >= 0 && no_network < 0);
    if (!clip->evaluate && no_cloud >= 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s': frame %d has no moved cloud%s", clip->folder,
                         no_cloud, no_network >= 0 ? ", and not every frame has a network" : "");
    if (!clip->evaluate)
        return SPIN_OK;
    if (no_network >= 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s': frame %d has no network", clip->folder,
                         no_network);
    if (clip->step[0].number != 0)
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s': the networks move the cloud of frame 0, which is not there: say "
                         "where it is with --init",
                         clip->folder);
    return clip->n_steps > 1 ? prepare_networks(clip, values) : SPIN_OK;
}

/* ---- Clouds ---------------------------------------------------------------------------------- */

/* Rows and SH degree of a cloud; the properties are all there. */
static spin_status inspect(const char *path, size_t *n, int *sh_degree)
{
    struct spin_gs_ply cloud;
    struct spin_ply ply;

    SPIN_TRY(spin_model_folder_cloud(path, &ply, &cloud));
    *n = (size_t)cloud.vertex->count;
    *sh_degree = cloud.sh_degree;
    spin_ply_close(&ply);
    return SPIN_OK;
}

static spin_status inspect_base(struct clip *clip, size_t i)
{
    const struct step *step = &clip->step[i];
    size_t n;
    int degree;

    if (i > 0 && clip->evaluate)
        return SPIN_OK;
    SPIN_TRY(inspect(step->cloud, &n, &degree));
    if (i > 0 && n != clip->n)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has %zu Gaussians, but '%s' has %zu", step->cloud,
                         n, clip->step[i - 1].cloud, clip->n);
    if (i > 0 && degree != clip->sh_degree)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has SH degree %d, but '%s' has %d", step->cloud,
                         degree, clip->step[i - 1].cloud, clip->sh_degree);
    if (n == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s': 0 vertices", step->cloud);
    clip->n = n;
    clip->sh_degree = degree;
    return SPIN_OK;
}

/* The added clouds may be empty, whatever properties they then have. */
static spin_status inspect_added(struct clip *clip, struct step *step)
{
    int degree;

    if (!step->added)
        return SPIN_OK;
    SPIN_TRY(inspect(step->added, &step->n_added, &degree));
    if (step->n_added > 0 && degree != clip->sh_degree)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has SH degree %d, but the cloud it adds to has %d",
                         step->added, degree, clip->sh_degree);
    return SPIN_OK;
}

/* Columns of out that begin at row `first`, read from a cloud of n rows. */
static spin_status read_cloud(const char *path, size_t n, unsigned columns, size_t first,
                              struct spin_splats *out)
{
    struct spin_gs_ply cloud;
    struct spin_ply ply;
    spin_status status;

    SPIN_TRY(spin_model_folder_cloud(path, &ply, &cloud));
    if (cloud.vertex->count != n || cloud.sh_degree != out->sh_degree)
        SPIN_TRY_OUT(spin_fail(SPIN_E_IO, "'%s' changed while it was being read", path));
    status = spin_gs_ply_read(&cloud, columns, first, out);
    for (size_t i = 0; (columns & SPIN_COL_QUATS) && status == SPIN_OK && i < n; i++)
        spin_quat_normalise(out->quats + 4 * (first + i));
out:
    spin_ply_close(&ply);
    return status;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status describe(struct clip *clip, struct spin_sequence_info *sequence)
{
    size_t n_added = 0;

    SPIN_TRY(spin_alloc(clip->n_steps, sizeof *clip->counts, (void **)&clip->counts));
    SPIN_TRY(spin_alloc(clip->n_steps, sizeof *clip->numbers, (void **)&clip->numbers));
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
                  "rows from %zu on are Gaussians added for one frame (%.1f a frame): they "
                  "have no tracks",
                  clip->n, (double)n_added / (double)clip->n_steps);
    if (clip->step[0].number != 0)
        spin_note(sequence,
                  "the cloud of frame 0 was not found: the clip begins with frame %d "
                  "(--init says where it is)",
                  clip->step[0].number);
    if (clip->evaluate)
        spin_note(sequence, "positions and rotations come from half-precision networks, whose "
                            "errors add up from frame to frame");
    if (clip->evaluate && !clip->config)
        spin_note(sequence, "there is no config.json: the networks' usual configuration was "
                            "taken, which fits");
    return SPIN_OK;
}

static spin_status stream_open(const char *path, const struct spin_plugin_values *values,
                               void **self, struct spin_sequence_info *sequence)
{
    struct clip *clip;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *clip, self));
    clip = *self;
    clip->at = SIZE_MAX;
    SPIN_TRY(spin_strdup(path, &clip->folder));
    SPIN_TRY(find_files(clip, values));
    SPIN_TRY(choose_way(clip, values));
    for (size_t i = 0; i < clip->n_steps; i++) {
        SPIN_TRY(inspect_base(clip, i));
        SPIN_TRY(inspect_added(clip, &clip->step[i]));
    }
    return describe(clip, sequence);
}

static void stream_close(void *self)
{
    struct clip *clip = self;

    if (!clip)
        return;
    for (size_t i = 0; i < clip->n_steps; i++) {
        free(clip->step[i].cloud);
        free(clip->step[i].network);
        free(clip->step[i].added);
    }
    spin_splats_free(&clip->base);
    free(clip->step);
    free(clip->folder);
    free(clip->config);
    free(clip->counts);
    free(clip->numbers);
    free(clip->means);
    free(clip->quats);
    free(clip);
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* The base at step 0, which the networks start from. */
static spin_status rewind_base(struct clip *clip)
{
    if (!clip->means) {
        unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;

        SPIN_TRY(spin_splats_reserve(&clip->base, clip->n, columns, clip->sh_degree));
        SPIN_TRY(read_cloud(clip->step[0].cloud, clip->n, columns, 0, &clip->base));
        SPIN_TRY(spin_alloc(clip->n, 4 * sizeof(float), (void **)&clip->quats));
        SPIN_TRY(spin_alloc(clip->n, 3 * sizeof(float), (void **)&clip->means));
    }
    memcpy(clip->means, clip->base.means, 3 * clip->n * sizeof(float));
    memcpy(clip->quats, clip->base.quats, 4 * clip->n * sizeof(float));
    clip->at = 0;
    return SPIN_OK;
}

/* Moves the base to a step: on from where it is, or from the first again. */
static spin_status move_base(struct clip *clip, size_t target)
{
    if (clip->at > target)
        SPIN_TRY(rewind_base(clip));
    while (clip->at < target) {
        struct ntc network;

        SPIN_TRY(spin_ntc_open(clip->step[clip->at + 1].network, &clip->shape, &network));
        spin_ntc_apply(&network, clip->n, clip->means, clip->quats);
        spin_ntc_free(&network);
        clip->at++;
    }
    return SPIN_OK;
}

static void copy_base(const struct clip *clip, unsigned columns, struct spin_splats *out)
{
    size_t n = clip->n, step = 3 * (size_t)((clip->sh_degree + 1) * (clip->sh_degree + 1));

    if (columns & SPIN_COL_MEANS)
        memcpy(out->means, clip->means, 3 * n * sizeof(float));
    if (columns & SPIN_COL_QUATS)
        memcpy(out->quats, clip->quats, 4 * n * sizeof(float));
    if (columns & SPIN_COL_LOG_SCALES)
        memcpy(out->log_scales, clip->base.log_scales, 3 * n * sizeof(float));
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        memcpy(out->logit_opacities, clip->base.logit_opacities, n * sizeof(float));
    if (columns & SPIN_COL_SH)
        memcpy(out->sh, clip->base.sh, step * n * sizeof(float));
}

static spin_status stream_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct clip *clip = self;
    const struct step *step;

    if (frame < 0 || (size_t)frame >= clip->n_steps)
        return spin_fail(SPIN_E_NOT_FOUND, "there is no frame %d", frame);
    step = &clip->step[frame];
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, clip->n + step->n_added, columns, clip->sh_degree));
    if (clip->evaluate) {
        SPIN_TRY(move_base(clip, (size_t)frame));
        copy_base(clip, columns, out);
    } else {
        SPIN_TRY(read_cloud(step->cloud, clip->n, columns, 0, out));
    }
    if (step->n_added > 0)
        SPIN_TRY(read_cloud(step->added, step->n_added, columns, clip->n, out));
    return clip->evaluate ? spin_model_folder_check(clip->folder, time, columns, out) : SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"init", "PATH", "the model of frame 0 (beside the frames)", NULL},
    {"way", "auto|clouds|networks", "read the moved clouds or evaluate the networks", "auto"},
    {"config", "FILE", "configuration of the networks (NTCs/config.json)", NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_3dgstream = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "3dgstream",
    .summary = "3DGStream: the output folder, or one packed for its viewer",
    .upstream = "SJoJoK/3DGStream 747ddfe",
    .options = options,
    .probe = probe,
    .open = stream_open,
    .frame = stream_frame,
    .close = stream_close,
};
