/* Saves and loads checkpoints. A checkpoint is an archive of arrays with a header "state.json". */
#include "train/checkpoint.h"

#include "base/base.h"

enum { PORTION = 1 << 20 }; /* number of floats downloaded at a time */
/* Upper bounds, in bytes, for the estimate of a checkpoint's size. HEADER_BYTES: state.json without
 * its entries for frames. PIECE_BYTES: the headers of an array in the archive. FRAME_BYTES: the
 * entries of a frame in state.json. */
enum { HEADER_BYTES = 4096, PIECE_BYTES = 512, FRAME_BYTES = 128 };

double spin_checkpoint_seconds(const struct spin_checkpoint *c)
{
    return c->before_s + spin_now_s() - c->start_s;
}

/* Fails if one of the n values v is not finite. v is the range [first, first + n) of the array
 * `name`. */
static spin_status check_values(const struct spin_trainer *t, const char *name, size_t first,
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
    return spin_malformed("array '%s' has a value that is not finite at index %zu, after iteration "
                          "%lld: lower the learning rates, or check the points of the input",
                          name, first + i, (long long)t->iteration);
}

/* Compares the hashes of the parameters of all ranks, and fails if they differ, since the updates
 * on all ranks must be identical. */
static spin_status compare_ranks(const struct spin_trainer *t, uint64_t hash)
{
    SPIN_FREED uint64_t *all = NULL;
    spin_status status;

    if (t->n_ranks == 1)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)spin_n_ranks(), sizeof *all, (void **)&all));
    all[spin_rank()] = hash;
    status = spin_ranks_gather(all, sizeof *all);
    for (int r = 1; status == SPIN_OK && r < spin_n_ranks(); r++)
        if (all[r] != all[0])
            status = spin_fail(
                SPIN_E_DEVICE,
                "the parameters of rank %d differ from those of rank 0 after iteration %lld: the "
                "MPI library does not compute bit-identical sums on all ranks; use another MPI "
                "library",
                r, (long long)t->iteration);
    return status;
}

/* True if the array belongs to a frame that has not changed since its last check. Skipping these
 * frames matters if they are kept in temporary files. */
static bool is_checked(const struct spin_trainer *t, const struct spin_state_array *piece)
{
    return piece->of_frame && t->frame[piece->frame].steps == t->frame[piece->frame].checked;
}

/* Sets *bad to true if a parameter is not finite, otherwise to false. The check runs on the device.
 */
static spin_status find_nonfinite(const struct spin_trainer *t,
                                  const struct spin_state_array *piece, size_t n_pieces, bool *bad)
{
    struct spin_device *d = t->device;
    void SPIN_DEV *count = NULL;
    uint32_t found = 0;
    spin_status status;

    SPIN_TRY(d->op->reserve(d, sizeof found, &count));
    for (size_t i = 0; i < n_pieces; i++)
        if (spin_state_is_parameter(&piece[i]) && piece[i].n > 0 && !is_checked(t, &piece[i]))
            d->op->not_finite(d, piece[i].n, piece[i].at, count);
    status = d->op->download(d, &found, count, sizeof found);
    d->op->release(d, count);
    *bad = found > 0;
    return status;
}

spin_status spin_check_parameters(struct spin_trainer *t)
{
    uint64_t hash = SPIN_HASH_BEGIN;
    struct spin_device *d = t->device;
    size_t n_pieces = 0;
    SPIN_FREED struct spin_state_array *piece = NULL;
    void *block = NULL;
    bool bad = false;
    spin_status status;

    SPIN_TRY_OUT(spin_state_arrays(t, NULL, &piece, &n_pieces));
    SPIN_TRY_OUT(find_nonfinite(t, piece, n_pieces, &bad));
    for (int f = 0; f < t->n_frames && !bad; f++)
        t->frame[f].checked = t->frame[f].steps;
    if (!bad && spin_n_ranks() == 1)
        goto out;
    /* Download the parameters, to find the array that is not finite, or to compare the ranks. */
    SPIN_TRY_OUT(spin_alloc(PORTION, sizeof(float), &block));
    for (size_t i = 0; i < n_pieces; i++) {
        if (!spin_state_is_parameter(&piece[i]))
            continue;
        for (size_t first = 0; first < piece[i].n; first += PORTION) {
            size_t n = piece[i].n - first < PORTION ? piece[i].n - first : PORTION;

            SPIN_TRY_OUT(d->op->download(d, block, piece[i].at + first, n * sizeof(float)));
            SPIN_TRY_OUT(check_values(t, piece[i].name, first, block, n));
            if (t->n_ranks > 1)
                spin_hash(&hash, block, n * sizeof(float));
        }
    }
    status = compare_ranks(t, hash);
out:
    free(block);
    return t->n_ranks > 1 ? spin_ranks_agree(status) : status;
}

spin_status spin_read_device_values(struct spin_trainer *t, const char *name,
                                    const float SPIN_DEV *at, size_t first, size_t n, float *to)
{
    SPIN_TRY(t->device->op->download(t->device, to, at + first, n * sizeof(float)));
    return check_values(t, name, first, to, n);
}

spin_status spin_write_device_array(struct spin_trainer *t, struct spin_zip_writer *w,
                                    const char *name, int n_dims, const uint64_t *shape,
                                    const float SPIN_DEV *at, size_t n)
{
    SPIN_FREED void *block = NULL;

    SPIN_TRY(spin_npz_write_begin(w, name, "<f4", n_dims, shape));
    SPIN_TRY(spin_alloc(PORTION, sizeof(float), &block));
    for (size_t first = 0; first < n; first += PORTION) {
        size_t floats = n - first < PORTION ? n - first : PORTION;

        SPIN_TRY(spin_read_device_values(t, name, at, first, floats, block));
        SPIN_TRY(spin_zip_member_write(w, block, floats * sizeof(float)));
    }
    return spin_zip_member_end(w);
}

/* Checks an array of kind TRACK or PLACE of a frame. The track of a splat must exist, must not
 * occur twice, and must be of the kind that the frame's sizes prescribe for the row of the splat.
 * The rows in the output must be a permutation. */
static spin_status check_numbers(const struct spin_trainer *t, const struct spin_state_array *piece,
                                 const uint32_t *number)
{
    const struct spin_frame_size *size = &t->frame[piece->frame].size;
    bool track = piece->kind == SPIN_STATE_TRACK;
    size_t most = track ? t->n_tracks : size->n;
    SPIN_FREED uint8_t *taken = NULL;
    bool wrong = false;

    SPIN_TRY(spin_alloc(most + 1, 1, (void **)&taken));
    for (size_t i = 0; i < size->n && !wrong; i++) {
        bool none = track && number[i] == SPIN_NO_TRACK;

        wrong = !none && (number[i] >= most || taken[number[i]]);
        wrong |= track && none != (i < size->n_free);
        wrong |= track && (none || number[i] < t->n_moving) != (i < size->n_pos);
        wrong |= track && (none || number[i] < t->n_varying) != (i < size->n_residual);
        if (!wrong && !none)
            taken[number[i]] = 1;
    }
    return wrong ? spin_malformed(
                       "array '%s' contradicts the numbers of tracks and splats in state.json",
                       piece->name)
                 : SPIN_OK;
}

static void to_numbers(const struct spin_array *a, size_t first, size_t n, uint32_t *number)
{
    for (size_t i = 0; i < n; i++) {
        int64_t wide;

        spin_array_to_i64(a, first + i, 1, &wide);
        number[i] = (uint32_t)wide;
    }
}

static spin_status save_numbers(struct spin_trainer *t, struct spin_zip_writer *w,
                                const struct spin_state_array *piece)
{
    struct spin_device *d = t->device;
    uint64_t shape[1] = {piece->n};
    SPIN_FREED void *block = NULL;

    if (piece->host)
        return spin_npz_write(w, piece->name, "<u4", 1, shape, piece->host);
    SPIN_TRY(spin_alloc(piece->n + 1, sizeof(uint32_t), &block));
    SPIN_TRY(d->op->download(d, block, piece->at, piece->n * sizeof(uint32_t)));
    return spin_npz_write(w, piece->name, "<u4", 1, shape, block);
}

static spin_status save_pieces(const struct spin_checkpoint *c, struct spin_trainer *t,
                               struct spin_zip_writer *w)
{
    SPIN_FREED struct spin_state_array *piece = NULL;
    size_t n = 0;

    SPIN_TRY(spin_state_arrays(t, c->permutation, &piece, &n));
    for (size_t i = 0; i < n; i++) {
        uint64_t shape[1] = {piece[i].n};

        if (piece[i].host && piece[i].kind == SPIN_STATE_VALUES)
            SPIN_TRY(spin_npz_write(w, piece[i].name, "<f4", 1, shape, piece[i].host));
        else
            SPIN_TRY(piece[i].kind >= SPIN_STATE_SEEN
                         ? save_numbers(t, w, &piece[i])
                         : spin_write_device_array(t, w, piece[i].name, 1, shape, piece[i].at,
                                                   piece[i].n));
    }
    return SPIN_OK;
}

static spin_status write_text(struct spin_zip_writer *w, const char *name, const char *text)
{
    size_t n = strlen(text);

    SPIN_TRY(spin_zip_member_begin(w, name, n));
    SPIN_TRY(spin_zip_member_write(w, text, n));
    return spin_zip_member_end(w);
}

static void sizes_to_json(const struct spin_trainer *t, spin_json *j)
{
    spin_json *sizes = spin_json_array();

    for (int f = 0; f < t->n_frames; f++) {
        spin_json_push_number(sizes, (double)t->frame[f].size.n);
        spin_json_push_number(sizes, (double)t->frame[f].size.n_free);
        spin_json_push_number(sizes, (double)t->frame[f].size.n_pos);
        spin_json_push_number(sizes, (double)t->frame[f].size.n_residual);
    }
    spin_json_set(j, "sizes", sizes);
    spin_json_set_integer(j, "tracks", (int64_t)t->n_tracks);
    spin_json_set_integer(j, "moving_tracks", (int64_t)t->n_moving);
    spin_json_set_integer(j, "varying_tracks", (int64_t)t->n_varying);
    spin_json_set_integer(j, "backdrop_tracks", (int64_t)t->n_backdrop);
}

static spin_status write_state(struct spin_checkpoint *c, struct spin_trainer *t,
                               const char *header)
{
    SPIN_LEAVES(spin_zip_writer_abandon) struct spin_zip_writer w = {0};

    /* After a resume, this file is one of the inputs, which must not be overwritten; exempt it from
     * this rule. */
    spin_inputs_own(c->path);
    spin_reserve_set(&c->reserve, c->path, 0);
    SPIN_TRY(spin_zip_writer_open(c->path, true, &w));
    /* Sync the file to disk, so that hours of work survive a power failure. */
    w.out.sync = true;
    SPIN_TRY(write_text(&w, "state.json", header));
    SPIN_TRY(save_pieces(c, t, &w));
    return spin_zip_writer_commit(&w);
}

spin_status spin_checkpoint_save(struct spin_checkpoint *c, struct spin_trainer *t)
{
    spin_json *j = spin_json_object(), *steps = spin_json_array();
    char *text;
    spin_status status;

    for (int f = 0; f < t->n_frames; f++)
        spin_json_push_number(steps, (double)t->frame[f].steps);
    if (t->tracked)
        sizes_to_json(t, j);
    spin_json_set_integer(j, "iteration", t->iteration);
    spin_json_set_number(j, "seconds", spin_checkpoint_seconds(c));
    spin_json_set_number(j, "refine_seconds", c->refine_s);
    spin_json_set_number(j, "loss", c->loss);
    spin_json_set(j, "steps", steps);
    spin_json_set_string(j, "fingerprint", c->fingerprint);
    spin_json_set_string(j, "path", c->simd_paths->all);
    text = spin_json_text(j, true);
    spin_json_free(j);
    status = spin_trainer_join_seen(t);
    spin_trainer_part_seen(t);
    if (status == SPIN_OK && spin_rank() == 0)
        status = text ? write_state(c, t, text)
                      : spin_fail(SPIN_E_MEMORY, "out of memory for state.json of the checkpoint");
    free(text);
    status = spin_ranks_agree(status);
    c->saved_s = spin_now_s();
    c->failed = status != SPIN_OK;
    if (c->failed)
        return spin_fail_context(status, "cannot save the checkpoint");
    c->saved = t->iteration;
    spin_log(1, "saved a checkpoint of iteration %lld to '%s'", (long long)t->iteration, c->path);
    return SPIN_OK;
}

spin_status spin_checkpoint_bytes(const struct spin_checkpoint *c, struct spin_trainer *t,
                                  uint64_t *state, uint64_t *values)
{
    SPIN_FREED struct spin_state_array *piece = NULL;
    size_t n = 0;

    SPIN_TRY(spin_state_arrays(t, c->permutation, &piece, &n));
    *state = HEADER_BYTES + n * PIECE_BYTES + (uint64_t)t->n_frames * FRAME_BYTES;
    *values = 0;
    for (size_t i = 0; i < n; i++) {
        *state += piece[i].n * sizeof(float);
        if (spin_state_is_parameter(&piece[i]) || piece[i].kind >= SPIN_STATE_TRACK)
            *values += piece[i].n * sizeof(float);
    }
    return SPIN_OK;
}

/* Checks the array "table/last" of lazy Adam, the last step of each line of the table: its values
 * are used as indices into a table of the learning rates of all steps so far, so they must not
 * exceed `iteration`. */
static spin_status check_last(const float *last, size_t n, int64_t iteration)
{
    for (size_t i = 0; i < n; i++)
        if (!(last[i] >= 0 && last[i] <= (float)iteration))
            return spin_malformed(
                "array 'table/last': the value in row %zu is not an iteration from 0 to %lld", i,
                (long long)iteration);
    return SPIN_OK;
}

/* Checks an array and copies it to the trainer, to host or device memory. `values` is scratch for
 * floats or 32-bit integers, which have the same size. Statistics are copied on rank 0 only, since
 * the next all-reduce sums them over all ranks. */
static spin_status load_piece(struct spin_trainer *t, const struct spin_state_array *piece,
                              const struct spin_array *a, void *values)
{
    size_t n = piece->n;

    if (piece->kind >= SPIN_STATE_SEEN) {
        to_numbers(a, 0, n, values);
    } else {
        spin_array_to_f32(a, 0, n, values);
        SPIN_TRY(check_values(t, piece->name, 0, values, n));
    }
    if (piece->kind == SPIN_STATE_STEPS)
        SPIN_TRY(check_last(values, n, t->iteration));
    if (piece->kind >= SPIN_STATE_TRACK)
        SPIN_TRY(check_numbers(t, piece, values));
    if (piece->host)
        memcpy(piece->host, values, n * sizeof *piece->host);
    else if ((piece->kind != SPIN_STATE_GRADIENT && piece->kind != SPIN_STATE_SEEN) ||
             spin_rank() == 0)
        t->device->op->upload(t->device, piece->at, values, n * sizeof(float));
    return SPIN_OK;
}

static spin_status load_pieces(const struct spin_checkpoint *c, struct spin_trainer *t,
                               struct spin_npz *npz)
{
    SPIN_FREED struct spin_state_array *piece = NULL;
    size_t n = 0;
    SPIN_FREED void *block = NULL;

    SPIN_TRY(spin_state_arrays(t, c->permutation, &piece, &n));
    for (size_t i = 0; i < n; i++) {
        struct spin_array a;
        int64_t shape[1] = {(int64_t)piece[i].n};

        SPIN_TRY(spin_npz_array_of(npz, piece[i].name, true, 1, shape, &a));
        SPIN_TRY(spin_grow(piece[i].n + 1, sizeof(float), &block));
        SPIN_TRY(load_piece(t, &piece[i], &a, block));
    }
    return SPIN_OK;
}

/* Removes the members of options of earlier versions that have since become constants, if their
 * values equal these constants. */
static void remove_former_options(spin_json *j)
{
    static const struct {
        const char *object, *key, *value;
    } former[] = {{NULL, "normalise_radius", "0"},
                  {NULL, "normalise_centre", "[0,0,0]"},
                  {"options", "base_resolution", "[8,8,8,8]"},
                  {"options", "init_log_scale", "-5"}};

    for (size_t i = 0; i < sizeof former / sizeof *former; i++) {
        spin_json *in = former[i].object ? json_object_get(j, former[i].object) : j;
        SPIN_FREED char *text = spin_json_text(spin_json_get(in, former[i].key), false);

        if (text && strcmp(text, former[i].value) == 0)
            json_object_del(in, former[i].key);
    }
}

bool spin_fingerprint_equal(const char *recorded, const char *own)
{
    SPIN_LEAVES(spin_json_freed) spin_json *j = NULL;
    SPIN_FREED char *text = NULL;

    if (strcmp(recorded, own) == 0)
        return true;
    if (spin_json_parse("fingerprint", recorded, strlen(recorded), &j) != SPIN_OK)
        return false;
    remove_former_options(j);
    text = spin_json_text(j, false);
    return text && strcmp(text, own) == 0;
}

/* Parses state.json. SPIN_E_USAGE if the fingerprint is not c->fingerprint, that is, if the input,
 * the options or the images have changed. The caller frees *out. */
static spin_status read_header(const struct spin_checkpoint *c, struct spin_npz *npz,
                               spin_json **out)
{
    const struct spin_zip_member *member = spin_zip_find(&npz->zip, "state.json");
    const unsigned char *bytes;
    SPIN_FREED void *owned = NULL;
    const char *fingerprint;

    *out = NULL;
    if (!member)
        return spin_malformed(
            "the archive contains no state.json, so it is not a checkpoint of spin-retrain");
    SPIN_TRY(spin_zip_read(&npz->zip, member, true, 1 << 26, &bytes, &owned));
    SPIN_TRY(spin_json_parse("state.json", (const char *)bytes, member->size, out));
    fingerprint = spin_json_string(spin_json_get(*out, "fingerprint"));
    if (!fingerprint || !spin_fingerprint_equal(fingerprint, c->fingerprint))
        return spin_misuse("the input, the options or the images differ from those of the "
                           "checkpoint; give the same ones, or %s to start anew",
                           c->restart);
    return SPIN_OK;
}

static spin_status load_header(struct spin_checkpoint *c, struct spin_trainer *t,
                               struct spin_npz *npz)
{
    SPIN_LEAVES(spin_json_freed) spin_json *j = NULL;
    int64_t iteration, steps;

    SPIN_TRY(read_header(c, npz, &j));
    if (!spin_json_integer(spin_json_get(j, "iteration"), &iteration) || iteration < 0 ||
        iteration > t->rates.iterations)
        return spin_malformed("state.json: 'iteration' is missing or out of range");
    spin_json_number(spin_json_get(j, "seconds"), &c->before_s);
    spin_json_number(spin_json_get(j, "refine_seconds"), &c->refine_s);
    spin_json_number(spin_json_get(j, "loss"), &c->loss);
    t->iteration = iteration;
    spin_simd_paths_add(c->simd_paths, spin_json_string(spin_json_get(j, "path")));
    for (int f = 0; f < t->n_frames; f++) {
        const spin_json *step = spin_json_at(spin_json_get(j, "steps"), (size_t)f);

        if (!spin_json_integer(step, &steps) || steps < 0)
            return spin_malformed("state.json: a value of 'steps' is missing or out of range");
        t->frame[f].steps = steps;
    }
    return SPIN_OK;
}

/* Reads a count from state.json; fails if it is missing, negative or above `most`. */
static spin_status get_count(const spin_json *value, int64_t most, size_t *out)
{
    int64_t n;

    if (!spin_json_integer(value, &n) || n < 0 || n > most)
        return spin_malformed("state.json: 'tracks', 'moving_tracks', 'varying_tracks', "
                              "'backdrop_tracks' or a value of 'sizes' is missing or out of range");
    *out = (size_t)n;
    return SPIN_OK;
}

static spin_status read_sizes(const spin_json *j, struct spin_frame_size *frame,
                              struct spin_trainer_size *size)
{
    const spin_json *sizes = spin_json_get(j, "sizes");
    int64_t n;

    SPIN_TRY(get_count(spin_json_get(j, "tracks"), INT32_MAX, &size->n_tracks));
    n = (int64_t)size->n_tracks;
    SPIN_TRY(get_count(spin_json_get(j, "moving_tracks"), n, &size->n_moving));
    SPIN_TRY(get_count(spin_json_get(j, "varying_tracks"), n, &size->n_varying));
    SPIN_TRY(get_count(spin_json_get(j, "backdrop_tracks"), n, &size->n_backdrop));
    for (int f = 0; f < size->n_frames; f++) {
        size_t at = 4 * (size_t)f;

        SPIN_TRY(get_count(spin_json_at(sizes, at), INT32_MAX, &frame[f].n));
        SPIN_TRY(get_count(spin_json_at(sizes, at + 1), (int64_t)frame[f].n, &frame[f].n_free));
        SPIN_TRY(get_count(spin_json_at(sizes, at + 2), (int64_t)frame[f].n, &frame[f].n_pos));
        SPIN_TRY(get_count(spin_json_at(sizes, at + 3), (int64_t)frame[f].n, &frame[f].n_residual));
    }
    return SPIN_OK;
}

spin_status spin_checkpoint_sizes(const struct spin_checkpoint *c, struct spin_frame_size *frame,
                                  struct spin_trainer_size *size)
{
    SPIN_LEAVES(spin_npz_close) struct spin_npz npz = {0};
    SPIN_LEAVES(spin_json_freed) spin_json *j = NULL;
    spin_status status = spin_npz_open(c->path, &npz);

    if (status == SPIN_OK)
        status = read_header(c, &npz, &j);
    if (status == SPIN_OK)
        status = read_sizes(j, frame, size);
    return spin_fail_context(status, "cannot resume from '%s'", c->path);
}

spin_status spin_checkpoint_load(struct spin_checkpoint *c, struct spin_trainer *t)
{
    SPIN_LEAVES(spin_npz_close) struct spin_npz npz = {0};
    spin_status status = spin_npz_open(c->path, &npz);

    if (status == SPIN_OK)
        status = load_header(c, t, &npz);
    if (status == SPIN_OK && c->gather_end > 0 && t->iteration + 1 >= c->gather_end)
        spin_trainer_drop_statistics(t);
    if (status == SPIN_OK)
        status = spin_average_resume(t);
    if (status == SPIN_OK)
        status = load_pieces(c, t, &npz);
    SPIN_TRY_IN(status, "cannot resume from '%s'", c->path);
    c->saved = t->iteration;
    spin_log(0, "resuming at iteration %lld of %lld", (long long)t->iteration,
             (long long)t->rates.iterations);
    return SPIN_OK;
}

/* ---- Arrays of a checkpoint ------------------------------------------------------------------ */

static struct spin_state_array of_frame(int f, const char *what, const char *array,
                                        float SPIN_DEV *at, size_t n)
{
    struct spin_state_array piece = {.at = at, .n = n, .of_frame = true, .frame = f};

    snprintf(piece.name, sizeof piece.name, "%s/%05d/%s", what, f, array);
    return piece;
}

spin_status spin_state_arrays(struct spin_trainer *t, uint32_t **permutation,
                              struct spin_state_array **out, size_t *n)
{
    enum { N_PARAMS = 4 };
    struct spin_param *param[N_PARAMS] = {&t->table, &t->heads, &t->tracks, &t->exposures.param};
    const char *param_name[N_PARAMS] = {"table", "heads", "tracks", "exposure"};
    const char *part_name[3] = {"p", "m", "v"};
    struct spin_state_array *piece;
    size_t k = 0;

    SPIN_TRY(
        spin_alloc(3 * N_PARAMS + 2 + 14 * (size_t)t->n_frames, sizeof *piece, (void **)&piece));
    for (int i = 0; i < N_PARAMS; i++) {
        float SPIN_DEV *at[3] = {param[i]->p, param[i]->m, param[i]->v};

        for (int j = 0; j < 3; j++, k++) {
            snprintf(piece[k].name, sizeof piece[k].name, "%s/%s", param_name[i], part_name[j]);
            piece[k].at = at[j];
            piece[k].n = param[i]->n;
        }
    }
    if (t->lazy)
        piece[k++] = (struct spin_state_array){.name = "table/last",
                                               .kind = SPIN_STATE_STEPS,
                                               .at = t->lazy->last,
                                               .n = t->lazy->n_lines};
    for (int f = 0; f < t->n_frames; f++) {
        float SPIN_DEV *at[3] = {t->frame[f].pos, t->frame[f].m, t->frame[f].v};

        for (int j = 0; j < 3; j++, k++)
            piece[k] = of_frame(f, "frames", part_name[j], at[j], 3 * t->frame[f].size.n_pos);
    }
    for (int f = 0; f < t->n_frames && t->d_residual; f++) {
        float SPIN_DEV *at[3] = {t->frame[f].residual, t->frame[f].residual_m,
                                 t->frame[f].residual_v};

        for (int j = 0; j < 3; j++, k++)
            piece[k] = of_frame(f, "residual", part_name[j], at[j],
                                SPIN_RESIDUAL * t->frame[f].size.n_residual);
    }
    for (int f = 0; f < t->n_frames && t->d_sh; f++) {
        float SPIN_DEV *at[3] = {t->frame[f].sh, t->frame[f].sh_m, t->frame[f].sh_v};

        for (int j = 0; j < 3; j++, k++)
            piece[k] =
                of_frame(f, "sh", part_name[j], at[j], t->frame[f].sh_width * t->frame[f].size.n);
    }
    for (int f = 0; f < t->n_frames && t->tracked; f++) {
        const struct spin_train_frame *frame = &t->frame[f];
        static const char *const name[] = {"gradient", "seen", "track", "place"};
        float SPIN_DEV *at[] = {frame->gradient, (float SPIN_DEV *)(void SPIN_DEV *)frame->seen,
                                (float SPIN_DEV *)(void SPIN_DEV *)frame->track, NULL};

        for (int j = frame->statistics || frame->size.n == 0 ? 0 : 2; j < 4; j++, k++) {
            piece[k] = of_frame(f, "frames", name[j], at[j], frame->size.n);
            piece[k].kind = SPIN_STATE_GRADIENT + j;
        }
        piece[k - 1].host = permutation ? permutation[f] : NULL;
        if (frame->turn)
            piece[k++] = of_frame(f, "frames", "turn", frame->turn, 4 * frame->size.n_pos);
    }
    if (t->average.n > 0)
        piece[k++] = (struct spin_state_array){.name = "average",
                                               .host = (uint32_t *)(void *)t->average.mean,
                                               .n = t->average.n_values};
    *out = piece;
    *n = k;
    return SPIN_OK;
}

/* Only the names of parameter arrays, such as "table/p", end in p. */
bool spin_state_is_parameter(const struct spin_state_array *array)
{
    return array->name[strlen(array->name) - 1] == 'p';
}

/* ---- Polyak average -------------------------------------------------------------------------- */

enum {
    MOMENTS = 12, /* largest number of averaged iterations */
};

struct spin_average spin_average_of(double share, int64_t until, int64_t iterations)
{
    int64_t first = iterations - (int64_t)(share * (double)iterations);

    first = first > until ? first : until;
    first = first < iterations ? first : iterations - 1;
    return (struct spin_average){.first = first,
                                 .every = (iterations - first + MOMENTS - 1) / MOMENTS};
}

/* Returns how many of the iterations up to `iteration` are averaged. One iteration in a->every is
 * averaged, counted back from the last iteration of the training, which is averaged too. */
static int count_by(const struct spin_average *a, int64_t iterations, int64_t iteration)
{
    int64_t left = iterations - iteration;

    if (a->every == 0 || iteration <= a->first)
        return 0;
    return (int)((iterations - a->first - 1) / a->every + 1 - (left + a->every - 1) / a->every);
}

spin_status spin_average_values(struct spin_trainer *t, size_t *n)
{
    SPIN_FREED struct spin_state_array *array = NULL;
    size_t n_arrays;

    *n = 0;
    SPIN_TRY(spin_state_arrays(t, NULL, &array, &n_arrays));
    for (size_t i = 0; i < n_arrays; i++)
        if (spin_state_is_parameter(&array[i]))
            *n += array[i].n;
    return SPIN_OK;
}

static spin_status reserve_mean(struct spin_trainer *t)
{
    struct spin_average *a = &t->average;

    SPIN_TRY(spin_average_values(t, &a->n_values));
    return spin_pages_reserve_in(t->scratch, (a->n_values + 1) * sizeof *a->mean,
                                 (void **)&a->mean);
}

spin_status spin_average_resume(struct spin_trainer *t)
{
    t->average.n = count_by(&t->average, t->rates.iterations, t->iteration);
    return t->average.n > 0 ? reserve_mean(t) : SPIN_OK;
}

/* Adds sample n to the mean of the first n - 1 samples. */
static void add_sample(float *mean, const float *values, size_t n_values, int n)
{
    float share = 1 / (float)n;

    for (size_t i = 0; i < n_values; i++)
        mean[i] = n == 1 ? values[i] : mean[i] + share * (values[i] - mean[i]);
}

spin_status spin_average_step(struct spin_trainer *t)
{
    struct spin_average *a = &t->average;
    struct spin_device *d = t->device;
    SPIN_FREED struct spin_state_array *array = NULL;
    SPIN_FREED float *portion = NULL;
    size_t n_arrays;
    float *mean;

    if (count_by(a, t->rates.iterations, t->iteration) == a->n)
        return SPIN_OK;
    SPIN_TRY(a->n == 0 ? reserve_mean(t) : SPIN_OK);
    SPIN_TRY(spin_alloc(PORTION, sizeof *portion, (void **)&portion));
    SPIN_TRY(spin_state_arrays(t, NULL, &array, &n_arrays));
    a->n++;
    mean = a->mean;
    for (size_t i = 0; i < n_arrays; i++)
        for (size_t first = 0; spin_state_is_parameter(&array[i]) && first < array[i].n;
             first += PORTION) {
            size_t n = array[i].n - first < PORTION ? array[i].n - first : PORTION;

            SPIN_TRY(d->op->download(d, portion, array[i].at + first, n * sizeof *portion));
            add_sample(mean, portion, n, a->n);
            if (t->iteration == t->rates.iterations)
                d->op->upload(d, array[i].at + first, mean, n * sizeof *mean);
            mean += n;
        }
    return SPIN_OK;
}
