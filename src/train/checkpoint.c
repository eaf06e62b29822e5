/* The state of a retraining: first values, fingerprint, save and load.
 *
 * The unfinished state lives beside the output as OUT.part, written whole or not at all. */
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "train/morton.h"
#include "train/run.h"

enum { PORTION = 1 << 20 }; /* floats that are carried to the host at a time */

static void set_string(spin_json *j, const char *key, const char *format, double v)
{
    char text[64];

    snprintf(text, sizeof text, format, v);
    spin_json_set_string(j, key, text);
}

/* The options that decide the result. Stored with the network, compared before a resume. */
static spin_json *options_to_json(const struct spin_run *r)
{
    const struct spin_retrain_options *o = r->o;
    spin_json *j = spin_json_object(), *base = spin_json_array(), *finest = spin_json_array();
    spin_json *back = spin_json_array(), *test = spin_json_array();
    char seed[32];

    for (int d = 0; d < 4; d++) {
        spin_json_push_number(base, o->base_resolution[d]);
        spin_json_push_number(finest, o->finest_resolution[d]);
    }
    for (int c = 0; c < 3; c++)
        spin_json_push_number(back, (double)o->background[c]);
    for (size_t i = 0; i < r->clip.views.n; i++)
        if (r->clip.views.view[i].test &&
            r->clip.views.view[i].dataset_frame == r->clip.dataset_frame[0])
            spin_json_push_number(test, r->clip.views.view[i].camera_id);
    spin_json_set_integer(j, "iterations", o->iterations);
    spin_json_set_integer(j, "batch", o->batch);
    spin_json_set_integer(j, "hash_log2", o->hash_log2);
    spin_json_set(j, "base_resolution", base);
    spin_json_set(j, "finest_resolution", finest);
    spin_json_set_number(j, "lambda_dssim", o->lambda_dssim);
    snprintf(seed, sizeof seed, "%" PRIu64, o->seed);
    spin_json_set_string(j, "seed", seed);
    spin_json_set_integer(j, "warmup", o->warmup);
    spin_json_set_number(j, "lr_table", o->lr_table);
    spin_json_set_number(j, "lr_sh", o->lr_sh);
    spin_json_set_number(j, "lr_scale", o->lr_scale);
    spin_json_set_number(j, "lr_rotation", o->lr_rotation);
    spin_json_set_number(j, "lr_opacity", o->lr_opacity);
    spin_json_set_number(j, "lr_position", o->lr_position);
    spin_json_set_number(j, "lr_head_factor", o->lr_head_factor);
    if (o->sh_increase_every > 0) /* said only where it is not as in the paper, as what follows */
        spin_json_set_integer(j, "sh_increase_every", o->sh_increase_every);
    if (o->hash_init_range != SPIN_HASH_INIT_RANGE)
        spin_json_set_number(j, "hash_init_range", o->hash_init_range);
    if (o->lambda_scale > 0)
        spin_json_set_number(j, "lambda_scale", o->lambda_scale);
    if (o->lambda_opacity > 0)
        spin_json_set_number(j, "lambda_opacity", o->lambda_opacity);
    if (o->dynamic_weight != 1)
        spin_json_set_number(j, "dynamic_weight", o->dynamic_weight);
    if (spin_run_has_residual(r)) {
        bool source = o->residual == SPIN_RESIDUAL_SOURCE;

        spin_json_set_string(j, "residual", source ? "source" : "points");
        spin_json_set_number(j, "lr_residual", o->lr_residual);
    }
    spin_json_set_bool(j, "learn_exposure", o->learn_exposure);
    spin_json_set_number(j, "lr_exposure", o->lr_exposure);
    spin_json_set_number(j, "init_log_scale", r->init_log_scale);
    spin_json_set_integer(j, "views_per_frame", o->views_per_frame);
    spin_json_set_number(j, "image_scale", o->image_scale);
    spin_json_set_number(j, "spatial_extent", r->extent);
    spin_json_set(j, "background", back);
    spin_json_set(j, "test_cameras", test);
    if (r->refined)
        spin_json_set(j, "refine", spin_run_refine_settings(r));
    return j;
}

spin_json *spin_run_to_json(const struct spin_run *r)
{
    spin_json *j = spin_field_to_json(&r->field);

    spin_json_set(j, "options", options_to_json(r));
    spin_json_set_string(j, "device", r->device.op->name);
    return j;
}

/* The network's plan and options, the frames, what they are learned from, and the CRCs of the input's
 * arrays. It is made before
 * frames are refined, and then has what they will be made from. */
spin_status spin_run_fingerprint(struct spin_run *r)
{
    bool network = r->o->method == SPIN_METHOD_NETWORK;
    spin_json *j = network ? spin_run_to_json(r) : spin_json_object();
    spin_json *frames = spin_json_array();
    const struct spin_zip *zip = &r->clip.bundle.npz.zip;
    double sum = 0;
    char images[20];

    for (size_t i = 0; i < zip->n; i++)
        sum += (double)zip->member[i].crc;
    for (int f = 0; f < r->clip.n_frames; f++) {
        spin_json_push_number(frames, spin_run_info(r, f)->number);
        spin_json_push_number(frames, (double)r->counts[f]);
        if (r->refined)
            spin_json_push_string(frames, r->refined[f].key);
    }
    snprintf(images, sizeof images, "%016" PRIx64, spin_run_imprint(r, -1));
    spin_json_set(j, "frames", frames);
    spin_json_set_string(j, "images", images);
    set_string(j, "input", "%.0f", sum);
    r->fingerprint = spin_json_text(j, false);
    spin_json_free(j);
    return r->fingerprint ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "out of memory");
}

/* Our order of a frame's splats: along a space-filling curve, so that neighbours share cache lines. */
spin_status spin_run_sort(struct spin_run *r)
{
    void *block = NULL;

    SPIN_TRY(spin_alloc((size_t)r->clip.n_frames, sizeof *r->permutation, &block));
    r->permutation = block;
    for (int f = 0; f < r->clip.n_frames; f++) {
        block = NULL;
        SPIN_TRY(spin_alloc(r->counts[f] + 1, sizeof(uint32_t), &block));
        r->permutation[f] = block;
        SPIN_TRY(spin_run_means(r, f));
        SPIN_TRY(spin_morton_order(r->counts[f], r->splats.means, r->permutation[f]));
    }
    return SPIN_OK;
}

spin_status spin_run_begin(struct spin_run *r)
{
    struct spin_device *d = &r->device;
    struct spin_trainer *t = &r->trainer;
    size_t floats = t->table.n + t->heads.n;
    void *block = NULL;
    float *host;

    floats = floats > r->clip.n_max * 3 ? floats : r->clip.n_max * 3;
    SPIN_TRY(spin_alloc(floats, sizeof(float), &block));
    host = block;
    spin_field_init(&r->field, r->o->seed, r->o->hash_init_range, r->init_log_scale, host,
                    host + t->table.n);
    if (r->o->sh_increase_every > 0)
        spin_field_clear_sh(&r->field, host + t->table.n);
    if (spin_run_has_residual(r))
        spin_field_clear_heads(&r->field, host + t->table.n);
    d->op->upload(d, t->table.p, host, t->table.n * sizeof(float));
    d->op->upload(d, t->heads.p, host + t->table.n, t->heads.n * sizeof(float));
    for (int f = 0; f < r->clip.n_frames; f++) {
        spin_status status = spin_run_means(r, f);

        if (status != SPIN_OK) {
            free(block);
            return status;
        }
        for (size_t i = 0; i < r->counts[f]; i++)
            memcpy(host + 3 * i, r->splats.means + 3 * (size_t)r->permutation[f][i],
                   3 * sizeof(float));
        d->op->upload(d, t->frame[f].pos, host, r->counts[f] * 3 * sizeof(float));
        if (spin_run_has_residual(r))
            status = spin_run_residual_begin(r, f);
        if (status != SPIN_OK) {
            free(block);
            return status;
        }
    }
    free(block);
    return SPIN_OK;
}

/* Everything the state holds, in one list: walked to save and to load. */
struct piece {
    char name[48];
    float *at; /* device */
    size_t n;
};

static spin_status list_pieces(struct spin_run *r, struct piece **out, size_t *n)
{
    struct spin_trainer *t = &r->trainer;
    struct spin_param *param[3] = {&t->table, &t->heads, &t->exposures.param};
    const char *param_name[3] = {"table", "heads", "tint"};
    void *block = NULL;
    struct piece *piece;
    size_t k = 0;

    SPIN_TRY(spin_alloc(10 + 6 * (size_t)t->n_frames, sizeof *piece, &block));
    piece = block;
    for (int i = 0; i < 3; i++) {
        float *at[3] = {param[i]->p, param[i]->m, param[i]->v};

        for (int j = 0; j < 3; j++, k++) {
            snprintf(piece[k].name, sizeof piece[k].name, "%s/%c", param_name[i], "pmv"[j]);
            piece[k].at = at[j];
            piece[k].n = param[i]->n;
        }
    }
    if (t->lazy.lazy.last)
        piece[k++] = (struct piece){"table/last", t->lazy.lazy.last, t->lazy.n_lines};
    for (int f = 0; f < t->n_frames; f++) {
        float *at[3] = {t->frame[f].pos, t->frame[f].m, t->frame[f].v};

        for (int j = 0; j < 3; j++, k++) {
            snprintf(piece[k].name, sizeof piece[k].name, "frames/%05d/%c", f, "pmv"[j]);
            piece[k].at = at[j];
            piece[k].n = 3 * t->frame[f].n;
        }
    }
    for (int f = 0; f < t->n_frames && spin_run_has_residual(r); f++) {
        float *at[3] = {t->frame[f].residual, t->frame[f].residual_m, t->frame[f].residual_v};

        for (int j = 0; j < 3; j++, k++) {
            snprintf(piece[k].name, sizeof piece[k].name, "own/%05d/%c", f, "pmv"[j]);
            piece[k].at = at[j];
            piece[k].n = SPIN_RESIDUAL * t->frame[f].n;
        }
    }
    *out = piece;
    *n = k;
    return SPIN_OK;
}

/* Values [first, first + n) of an array of the state. */
static spin_status check_finite(const struct spin_run *r, const char *name, size_t first,
                                const float *v, size_t n)
{
    bool bad = false;
    size_t i = 0;

    for (size_t k = 0; k < n; k++)
        bad |= !isfinite(v[k]);
    if (!bad)
        return SPIN_OK;
    while (isfinite(v[i]))
        i++;
    return spin_fail(SPIN_E_MALFORMED,
                     "array '%s' is not finite at value %zu after iteration %lld: lower the "
                     "learning rates, or look for bad points",
                     name, first + i, (long long)r->trainer.iteration);
}

spin_status spin_run_check_finite(struct spin_run *r)
{
    size_t n_pieces = 0;
    struct piece *piece = NULL;
    void *block = NULL;
    spin_status status;

    SPIN_TRY_OUT(list_pieces(r, &piece, &n_pieces));
    SPIN_TRY_OUT(spin_alloc(PORTION, sizeof(float), &block));
    for (size_t i = 0; i < n_pieces; i++) {
        size_t length = strlen(piece[i].name);

        if (piece[i].name[length - 1] != 'p') /* moments go into parameters with the next step */
            continue;
        for (size_t first = 0; first < piece[i].n; first += PORTION) {
            size_t n = piece[i].n - first < PORTION ? piece[i].n - first : PORTION;

            r->device.op->download(&r->device, block, piece[i].at + first, n * sizeof(float));
            SPIN_TRY_OUT(check_finite(r, piece[i].name, first, block, n));
        }
    }
out:
    free(piece);
    free(block);
    return status;
}

spin_status spin_run_write_array(struct spin_run *r, struct spin_zip_writer *w, const char *name,
                                 int n_dims, const uint64_t *shape, const float *at, size_t n)
{
    void *block = NULL;
    spin_status status;

    SPIN_TRY(spin_npz_write_begin(w, name, "<f4", n_dims, shape));
    SPIN_TRY(spin_alloc(PORTION, sizeof(float), &block));
    for (size_t first = 0; first < n; first += PORTION) {
        size_t floats = n - first < PORTION ? n - first : PORTION;

        r->device.op->download(&r->device, block, at + first, floats * sizeof(float));
        SPIN_TRY_OUT(check_finite(r, name, first, block, floats));
        SPIN_TRY_OUT(spin_zip_member_write(w, block, floats * sizeof(float)));
    }
    status = spin_zip_member_end(w);
out:
    free(block);
    return status;
}

static spin_status save_pieces(struct spin_run *r, struct spin_zip_writer *w)
{
    struct piece *piece = NULL;
    size_t n = 0;
    spin_status status;

    SPIN_TRY_OUT(list_pieces(r, &piece, &n));
    for (size_t i = 0; i < n; i++) {
        uint64_t shape[1] = {piece[i].n};

        SPIN_TRY_OUT(spin_run_write_array(r, w, piece[i].name, 1, shape, piece[i].at, piece[i].n));
    }
out:
    free(piece);
    return status;
}

static spin_status write_text(struct spin_zip_writer *w, const char *name, const char *text)
{
    size_t n = strlen(text);

    SPIN_TRY(spin_zip_member_begin(w, name, n));
    SPIN_TRY(spin_zip_member_write(w, text, n));
    return spin_zip_member_end(w);
}

spin_status spin_run_save(struct spin_run *r)
{
    struct spin_zip_writer w;
    spin_json *j = spin_json_object(), *steps = spin_json_array();
    char *text;
    spin_status status;

    for (int f = 0; f < r->trainer.n_frames; f++)
        spin_json_push_number(steps, (double)r->trainer.frame[f].steps);
    spin_json_set_integer(j, "iteration", r->trainer.iteration);
    spin_json_set_number(j, "seconds", r->worked_before_s + spin_now_s() - r->worked_s);
    spin_json_set(j, "steps", steps);
    spin_json_set_string(j, "fingerprint", r->fingerprint);
    spin_json_set_string(j, "path", r->paths);
    text = spin_json_text(j, true);
    spin_json_free(j);
    status = spin_zip_writer_open(r->part, true, &w);
    if (status == SPIN_OK) {
        w.out.sync = true; /* it stands for hours of work */
        status = write_text(&w, "state.json", text ? text : "");
        if (status == SPIN_OK)
            status = save_pieces(r, &w);
        if (status == SPIN_OK)
            status = spin_zip_writer_commit(&w);
        else
            spin_zip_writer_abandon(&w);
    }
    free(text);
    r->saved_s = spin_now_s();
    if (status != SPIN_OK)
        return spin_fail_context(status, "cannot save the unfinished state");
    r->saved = r->trainer.iteration;
    spin_log(1, "saved the state of iteration %lld to '%s'", (long long)r->trainer.iteration,
             r->part);
    return SPIN_OK;
}

void spin_run_did(struct spin_run *r, const char *paths)
{
    bool other = false;

    for (const char *at = paths ? paths : ""; *at;) {
        size_t n = strcspn(at, "+"), used = strlen(r->paths);
        char one[sizeof r->paths];

        snprintf(one, sizeof one, "%.*s", (int)n, at);
        at += n + (at[n] == '+');
        if (one[strspn(one, "abcdefghijklmnopqrstuvwxyz0123456789")] || strstr(r->paths, one) ||
            used + strlen(one) + 2 > sizeof r->paths)
            continue;
        snprintf(r->paths + used, sizeof r->paths - used, "%s%s", used ? "+" : "", one);
        other = true;
    }
    if (other)
        spin_warn(
            "the processor's code path is %s now and was another before (%s): the two differ in "
            "the last bits, so the result is not bit for bit that of an unbroken run",
            r->device.path, r->paths);
}

/* They index tables of that length. */
static spin_status check_last(const float *last, size_t n, int64_t iteration)
{
    for (size_t i = 0; i < n; i++)
        if (!(last[i] >= 0 && last[i] <= (float)iteration))
            return spin_fail(SPIN_E_MALFORMED, "array 'table/last': row %zu is no step done", i);
    return SPIN_OK;
}

static spin_status load_pieces(struct spin_run *r, struct spin_npz *npz)
{
    struct piece *piece = NULL;
    size_t n = 0;
    void *block = NULL;
    spin_status status;

    SPIN_TRY_OUT(list_pieces(r, &piece, &n));
    for (size_t i = 0; i < n; i++) {
        struct spin_array a;
        int64_t shape[1] = {(int64_t)piece[i].n};

        SPIN_TRY_OUT(spin_npz_array_of(npz, piece[i].name, true, 1, shape, &a));
        SPIN_TRY_OUT(spin_grow(piece[i].n + 1, sizeof(float), &block));
        spin_array_to_f32(&a, 0, piece[i].n, block);
        SPIN_TRY_OUT(check_finite(r, piece[i].name, 0, block, piece[i].n));
        if (piece[i].at == r->trainer.lazy.lazy.last)
            SPIN_TRY_OUT(check_last(block, piece[i].n, r->trainer.iteration));
        r->device.op->upload(&r->device, piece[i].at, block, piece[i].n * sizeof(float));
    }
out:
    free(piece);
    free(block);
    return status;
}

static spin_status load_header(struct spin_run *r, struct spin_npz *npz)
{
    const struct spin_zip_member *member = spin_zip_find(&npz->zip, "state.json");
    const unsigned char *bytes;
    void *owned = NULL;
    spin_json *j = NULL;
    int64_t iteration, steps;
    const char *fingerprint;
    spin_status status;

    if (!member)
        return spin_fail(SPIN_E_MALFORMED, "no state.json");
    SPIN_TRY_OUT(spin_zip_read(&npz->zip, member, true, 1 << 26, &bytes, &owned));
    SPIN_TRY_OUT(spin_json_parse("state.json", (const char *)bytes, member->size, &j));
    fingerprint = spin_json_string(spin_json_get(j, "fingerprint"));
    if (!fingerprint || strcmp(fingerprint, r->fingerprint) != 0) {
        status = spin_fail(SPIN_E_USAGE, "it was made from another input or with other options "
                                         "than these, or its images have changed; give the same "
                                         "ones, or --force without --resume to start anew");
        goto out;
    }
    if (!spin_json_integer(spin_json_get(j, "iteration"), &iteration) || iteration < 0 ||
        iteration > r->o->iterations) {
        status = spin_fail(SPIN_E_MALFORMED, "state.json: bad iteration");
        goto out;
    }
    spin_json_number(spin_json_get(j, "seconds"), &r->worked_before_s);
    r->trainer.iteration = iteration;
    spin_run_did(r, spin_json_string(spin_json_get(j, "path")));
    for (int f = 0; f < r->trainer.n_frames; f++) {
        const spin_json *step = spin_json_at(spin_json_get(j, "steps"), (size_t)f);
        double v = 0;

        if (!spin_json_number(step, &v) || v < 0 || v > 1e15) {
            status = spin_fail(SPIN_E_MALFORMED, "state.json: bad steps");
            goto out;
        }
        steps = (int64_t)v;
        r->trainer.frame[f].steps = steps;
    }
    status = SPIN_OK;
out:
    spin_json_free(j);
    free(owned);
    return status;
}

spin_status spin_run_load(struct spin_run *r)
{
    struct spin_npz npz;
    spin_status status = spin_npz_open(r->part, &npz);

    if (status == SPIN_OK) {
        status = load_header(r, &npz);
        if (status == SPIN_OK)
            status = load_pieces(r, &npz);
        spin_npz_close(&npz);
    }
    if (status != SPIN_OK)
        return spin_fail_context(status, "cannot resume from '%s'", r->part);
    r->saved = r->trainer.iteration;
    spin_log(0, "resuming at iteration %lld of %d", (long long)r->trainer.iteration,
             r->o->iterations);
    return SPIN_OK;
}
