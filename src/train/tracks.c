/* Finds tracks, and numbers them along a space-filling curve so that neighbouring tracks share
 * cache lines. */
#include "train/tracks.h"

#include "base/base.h"
#include "geometry/neighbours.h"
#include "train/track_matching.h"

/* Limits for the standard deviation of a row's position over time, relative to the extent of the
 * cameras. Up to UNSEEN, motion is invisible in images; up to NOISE, it may be noise. */
static const double UNSEEN = 1e-4, NOISE = 1e-2;
enum { NOISE_FRAMES = 8 }; /* with fewer frames, noise cannot be distinguished from motion */

/* A candidate for a track: a row of a source with persistent ids, a position that splats of several
 * frames may share, or a track built by matching. The position of a candidate is that of its first
 * splat. */
struct place {
    float at[3];
    uint32_t n_frames; /* number of frames in which it has a splat */
    int last_frame;    /* last frame in which it has a splat; -1: none */
    bool moves; /* true if it is dynamic: a track built by matching, or a row that is not static */
};

/* Motion of a row of a source with persistent ids, relative to its position in the first frame. */
struct motion {
    float last[3]; /* position in the previous frame */
    /* Sums over the frames. sum: offset from the position in the first frame. square: squared
     * offset. step: squared distance between consecutive frames. */
    double sum[3], square, step;
};

struct places {
    struct place *place; /* [n] candidates, in the order in which they were found */
    size_t n, room;
    /* [n_slots] hash table that maps a position, by its bits, to the index of its candidate;
     * UINT32_MAX: the slot is empty. */
    uint32_t *slot;
    size_t n_slots;
    struct motion *motion; /* [n] motion of each row; NULL if the source has no persistent ids */
};

static uint32_t hash_of(const float at[3])
{
    uint32_t bits[3], h = 2166136261u;

    memcpy(bits, at, sizeof bits);
    for (int c = 0; c < 3; c++) {
        h = (h ^ bits[c]) * 0x9e3779b1u;
        h ^= h >> 15;
    }
    return h;
}

static void close_places(struct places *p)
{
    free(p->place);
    free(p->slot);
    free(p->motion);
    memset(p, 0, sizeof *p);
}

/* Returns the slot of this position or, if the table does not contain it, the empty slot in which
 * to store it. */
static size_t slot_of(const struct places *p, const float at[3])
{
    size_t k = hash_of(at) & (p->n_slots - 1);

    while (p->slot[k] != UINT32_MAX && memcmp(p->place[p->slot[k]].at, at, 3 * sizeof *at) != 0)
        k = (k + 1) & (p->n_slots - 1);
    return k;
}

/* Ensures capacity for n more candidates. */
static spin_status reserve_places(struct places *p, size_t n)
{
    size_t room = 2 * (p->n + n), n_slots = 1024;

    if (p->n + n > p->room) {
        SPIN_TRY(spin_grow(room, sizeof *p->place, (void **)&p->place));
        p->room = room;
    }
    while (n_slots < 2 * (p->n + n))
        n_slots *= 2;
    if (n_slots <= p->n_slots)
        return SPIN_OK;
    SPIN_TRY(spin_grow(n_slots, sizeof *p->slot, (void **)&p->slot));
    p->n_slots = n_slots;
    memset(p->slot, 0xff, n_slots * sizeof *p->slot);
    for (size_t i = 0; i < p->n; i++)
        p->slot[slot_of(p, p->place[i].at)] = (uint32_t)i;
    return SPIN_OK;
}

static uint32_t add_place(struct places *p, const float at[3])
{
    struct place *place = &p->place[p->n];

    *place = (struct place){.at = {at[0], at[1], at[2]}, .last_frame = -1};
    return (uint32_t)p->n++;
}

/* ---- The passes ------------------------------------------------------------------------------ */

static void add_motion(struct motion *m, const float first[3], const float at[3], bool is_first)
{
    for (int c = 0; c < 3; c++) {
        double offset = (double)at[c] - first[c], step = (double)at[c] - m->last[c];

        m->sum[c] += offset;
        m->square += offset * offset;
        m->step += is_first ? 0 : step * step;
        m->last[c] = at[c];
    }
}

/* For sources with persistent ids: assigns row i of a frame to candidate i, and records its motion.
 */
static spin_status add_rows(struct places *p, int frame, const struct spin_splats *s, uint32_t *of)
{
    if (frame == 0) {

        SPIN_TRY(reserve_places(p, s->n));
        for (size_t i = 0; i < s->n; i++)
            add_place(p, s->means + 3 * i);
        SPIN_TRY(spin_alloc(s->n + 1, sizeof *p->motion, (void **)&p->motion));
    }
    for (size_t i = 0; i < s->n; i++) {
        p->place[i].n_frames++;
        add_motion(&p->motion[i], p->place[i].at, s->means + 3 * i, frame == 0);
        of[i] = (uint32_t)i;
    }
    return SPIN_OK;
}

/* True if the motion of a row is invisible, or is noise, which occurs in static regions of sources.
 * Motion is invisible if its variance is small enough. It is noise if the variance is moderate and
 * the mean squared distance between consecutive frames is at least the variance: for white noise,
 * this distance is twice the variance (von Neumann's ratio), for real motion much less. */
static bool is_static(const struct motion *m, int n_frames, double extent)
{
    double n = n_frames, variance = m->square / n;

    for (int c = 0; c < 3; c++)
        variance -= m->sum[c] * m->sum[c] / (n * n);
    if (variance <= pow(UNSEEN * extent, 2))
        return true;
    return n_frames >= NOISE_FRAMES && m->step / (n - 1) >= variance &&
           variance <= pow(NOISE * extent, 2);
}

/* Decides which rows are static, and sets the position of static rows to the mean over all frames.
 */
static void classify_rows(struct places *p, int n_frames, double extent)
{
    for (size_t i = 0; p->motion && i < p->n; i++) {
        const struct motion *m = &p->motion[i];

        p->place[i].moves = !is_static(m, n_frames, extent);
        for (int c = 0; c < 3 && !p->place[i].moves; c++)
            p->place[i].at[c] = (float)(p->place[i].at[c] + m->sum[c] / n_frames);
    }
}

/* For sources without persistent ids: assigns the splats of a frame to the candidates at their
 * positions. If a frame has several splats at a position, only the first one is assigned. */
static spin_status add_places(struct places *p, int frame, const struct spin_splats *s,
                              uint32_t *of)
{
    SPIN_TRY(reserve_places(p, s->n));
    for (size_t i = 0; i < s->n; i++) {
        size_t k = slot_of(p, s->means + 3 * i);
        struct place *place;

        if (p->slot[k] == UINT32_MAX)
            p->slot[k] = add_place(p, s->means + 3 * i);
        place = &p->place[p->slot[k]];
        of[i] = place->last_frame == frame ? SPIN_NO_TRACK : p->slot[k];
        place->n_frames += place->last_frame != frame;
        place->last_frame = frame;
    }
    return SPIN_OK;
}

static bool rows_keep_identity(const struct spin_plan *plan)
{
    for (int f = 1; f < plan->clip.n_frames; f++)
        if (plan->counts[f] != plan->counts[0])
            return false;
    return plan->clip.bundle.meta.identity;
}

static spin_status read_frames(struct spin_tracks *tracks, struct spin_plan *plan,
                               struct places *places)
{
    SPIN_LEAVES(spin_splats_free) struct spin_splats splats = {0};

    for (int f = 0; f < tracks->n_frames; f++) {

        SPIN_TRY(spin_alloc(plan->counts[f] + 1, sizeof(uint32_t), (void **)&tracks->of[f]));
        SPIN_TRY(spin_bundle_frame(&plan->clip.bundle, spin_plan_index(plan, f), SPIN_COL_MEANS,
                                   &splats));
        SPIN_TRY(spin_plan_check_means(plan, f, false, &splats));
        SPIN_TRY(tracks->identity ? add_rows(places, f, &splats, tracks->of[f])
                                  : add_places(places, f, &splats, tracks->of[f]));
    }
    return SPIN_OK;
}

static bool is_track(const struct spin_tracks *tracks, const struct place *place)
{
    return place->moves || tracks->identity || 2 * place->n_frames > (uint32_t)tracks->n_frames;
}

/* Matches the splats whose positions occur in at most half of the frames, and adds each track built
 * by matching as a dynamic candidate. */
static spin_status add_chains(struct spin_tracks *tracks, struct spin_plan *plan, struct places *p)
{
    SPIN_LEAVES(spin_track_matching_close) struct spin_track_matching chains = {0};
    size_t first = p->n;

    for (int f = 0; f < tracks->n_frames; f++)
        for (size_t i = 0; i < plan->counts[f]; i++) {
            uint32_t *of = &tracks->of[f][i];

            if (*of != SPIN_NO_TRACK && !is_track(tracks, &p->place[*of]))
                *of = SPIN_NO_TRACK;
        }
    SPIN_TRY(spin_track_matching_find(&chains, plan, tracks->of, (uint32_t)first));
    SPIN_TRY(reserve_places(p, chains.n));
    for (size_t k = 0; k < chains.n; k++)
        p->place[add_place(p, chains.place + 3 * k)].moves = true;
    return SPIN_OK;
}

/* ---- Numbering ------------------------------------------------------------------------------- */

/* Sets order [*n] to the candidates that are tracks, by their indices, sorted along a space-filling
 * curve. */
static spin_status order_places(const struct spin_tracks *tracks, const struct places *p,
                                uint32_t *order, size_t *n)
{
    SPIN_FREED float *at = NULL;

    *n = 0;
    SPIN_TRY(spin_alloc(p->n + 1, 3 * sizeof *at, (void **)&at));
    for (size_t i = 0; i < p->n; i++)
        memcpy(at + 3 * i, p->place[i].at, 3 * sizeof *at);
    SPIN_TRY(spin_morton_order(p->n, at, order));
    for (size_t i = 0; i < p->n; i++)
        if (is_track(tracks, &p->place[order[i]]))
            order[(*n)++] = order[i];
    return SPIN_OK;
}

/* Numbers the tracks: first dynamic tracks, then varying tracks, then the other static tracks. Sets
 * number [places] to the track of each candidate, or to SPIN_NO_TRACK if it is not a track. order
 * [tracks] and varies [tracks] are the results of order_places() and find_varying(). */
static spin_status number_tracks(struct spin_tracks *tracks, const struct places *p,
                                 const uint32_t *order, const uint8_t *varies, uint32_t *number)
{
    uint32_t n = 0;

    SPIN_TRY(spin_alloc(tracks->n + 1, 3 * sizeof *tracks->place, (void **)&tracks->place));
    memset(number, 0xff, p->n * sizeof *number);
    for (int kind = 0; kind < 3; kind++) {
        for (size_t i = 0; i < tracks->n; i++) {
            const struct place *place = &p->place[order[i]];

            if ((place->moves ? 0 : varies[i] ? 1 : 2) != kind)
                continue;
            memcpy(tracks->place + 3 * n, place->at, sizeof place->at);
            number[order[i]] = n++;
        }
        if (kind == 0)
            tracks->n_moving = n;
        if (kind == 1)
            tracks->n_varying = n;
    }
    return SPIN_OK;
}

/* Sets varies [tracks] to 1 for tracks whose appearance varies over time, otherwise to 0, in the
 * order of order_places(). The values of dynamic tracks are not used. */
static spin_status find_varying(const struct spin_tracks *tracks, const struct spin_plan *plan,
                                struct spin_photos *photos, const struct places *p,
                                const uint32_t *order, uint8_t *varies)
{
    SPIN_FREED float *at = NULL;

    SPIN_TRY(spin_alloc(tracks->n + 1, 3 * sizeof *at, (void **)&at));
    for (size_t i = 0; i < tracks->n; i++)
        memcpy(at + 3 * i, p->place[order[i]].at, 3 * sizeof *at);
    return spin_appearance_varies(plan, photos, tracks->n, at, varies);
}

spin_status spin_tracks_find(struct spin_tracks *tracks, struct spin_plan *plan,
                             struct spin_photos *photos)
{
    SPIN_LEAVES(close_places) struct places places = {0};
    SPIN_FREED uint32_t *number = NULL;
    uint32_t *order;
    uint8_t *varies;

    tracks->identity = rows_keep_identity(plan);
    SPIN_TRY(spin_alloc((size_t)plan->clip.n_frames, sizeof *tracks->of, (void **)&tracks->of));
    tracks->n_frames = plan->clip.n_frames;
    SPIN_TRY(read_frames(tracks, plan, &places));
    classify_rows(&places, tracks->n_frames, plan->extent);
    if (!tracks->identity)
        SPIN_TRY(add_chains(tracks, plan, &places));
    SPIN_TRY(spin_alloc(places.n + 1, 2 * sizeof *number + 1, (void **)&number));
    order = number + places.n;
    varies = (uint8_t *)(order + places.n);
    memset(varies, 0, places.n);
    SPIN_TRY(order_places(tracks, &places, order, &tracks->n));
    if (photos)
        SPIN_TRY(find_varying(tracks, plan, photos, &places, order, varies));
    SPIN_TRY(number_tracks(tracks, &places, order, varies, number));
    for (int f = 0; f < tracks->n_frames; f++)
        for (size_t i = 0; i < plan->counts[f]; i++)
            if (tracks->of[f][i] != SPIN_NO_TRACK)
                tracks->of[f][i] = number[tracks->of[f][i]];
    if (!photos)
        tracks->n_varying = 0;
    return SPIN_OK;
}

void spin_tracks_close(struct spin_tracks *tracks)
{
    for (int f = 0; f < tracks->n_frames; f++)
        free(tracks->of[f]);
    free(tracks->of);
    free(tracks->place);
    memset(tracks, 0, sizeof *tracks);
}

/* ---- A frame --------------------------------------------------------------------------------- */

struct spin_frame_size spin_tracks_size(const struct spin_tracks *tracks, int frame, size_t n)
{
    struct spin_frame_size size = {.n = n};

    for (size_t i = 0; i < n; i++) {
        uint32_t track = tracks->of[frame][i];

        size.n_free += track == SPIN_NO_TRACK;
        size.n_pos += track == SPIN_NO_TRACK || track < tracks->n_moving;
        size.n_residual += track == SPIN_NO_TRACK || track < tracks->n_varying;
    }
    return size;
}

struct row {
    uint32_t track, row;
};

static int compare_rows(const void *a, const void *b)
{
    const struct row *x = a, *y = b;

    return (x->track > y->track) - (x->track < y->track);
}

spin_status spin_tracks_sort(const struct spin_tracks *tracks, int frame, size_t n,
                             uint32_t *permutation)
{
    SPIN_FREED struct row *row = NULL;
    size_t n_rows = 0, to = 0;

    SPIN_TRY(spin_alloc(n + 1, sizeof *row, (void **)&row));
    for (size_t i = 0; i < n; i++) {
        uint32_t track = tracks->of[frame][permutation[i]];

        if (track == SPIN_NO_TRACK)
            permutation[to++] = permutation[i];
        else
            row[n_rows++] = (struct row){track, permutation[i]};
    }
    qsort(row, n_rows, sizeof *row, compare_rows);
    for (size_t i = 0; i < n_rows; i++)
        permutation[to++] = row[i].row;
    return SPIN_OK;
}

/* ---- Tracks whose appearance varies ---------------------------------------------------------- */

enum {
    FRAMES = 32, /* largest number of examined frames, evenly spaced over the clip */
    /* A brightness, 0..255, deviates if it differs from the median by more than this. Noise and
       JPEG artefacts change a mean of 3 x 3 pixels by less. */
    THRESHOLD = 5,
    CAMERAS = 2,      /* least number of cameras in which the brightness must deviate */
    NONE = UINT8_MAX, /* value in place of a brightness if the point is outside the image */
};

struct appearance {
    const struct spin_plan *plan;
    struct spin_photos *photos;
    size_t n;
    const float *place;
    int n_frames;    /* number of examined frames */
    uint8_t *image;  /* [max pixels][3] */
    uint8_t *bright; /* [n][n_frames] brightness of each point in the current camera */
    /* [n][n_frames] numbers of cameras, at most 255. seen: cameras whose image contains the point.
     * changed: cameras in which the brightness of the point deviates. */
    uint8_t *seen, *changed;
};

/* Returns the mean brightness, 0 to 254, of the 3 x 3 pixels around the projection of a point; NONE
 * if any of these pixels is outside the image. */
static uint8_t brightness(const struct spin_camera *camera, const uint8_t *image, const float at[3])
{
    double p[3];
    int x, y, sum = 0;

    if (!spin_camera_project(camera, at, p))
        return NONE;
    p[0] = floor(p[0]);
    p[1] = floor(p[1]);
    if (!(p[0] >= 1 && p[1] >= 1 && p[0] < camera->width - 1 && p[1] < camera->height - 1))
        return NONE;
    x = (int)p[0];
    y = (int)p[1];
    for (int j = -1; j <= 1; j++) {
        const uint8_t *row =
            image + 3 * ((size_t)(y + j) * (size_t)camera->width + (size_t)(x - 1));

        for (int i = 0; i < 9; i += 3)
            sum += row[i] + 2 * row[i + 1] + row[i + 2];
    }
    return (uint8_t)(sum / 36 < NONE ? sum / 36 : NONE - 1);
}

static int compare_bytes(const void *a, const void *b)
{
    return *(const uint8_t *)a - *(const uint8_t *)b;
}

/* Returns the median brightness of a point over the frames in which it is inside the image; NONE if
 * there is no such frame. */
static uint8_t median_of(const uint8_t *bright, int n_frames)
{
    uint8_t value[FRAMES];
    size_t n = 0;

    for (int f = 0; f < n_frames; f++)
        if (bright[f] != NONE)
            value[n++] = bright[f];
    if (n == 0)
        return NONE;
    qsort(value, n, 1, compare_bytes);
    return value[n / 2];
}

/* Returns the index of a frame among the examined frames; -1 if it is not examined. */
static int examined_index(const struct appearance *l, int frame)
{
    int64_t all = l->plan->clip.n_frames, k = (int64_t)frame * l->n_frames / all;

    return (k * all + l->n_frames - 1) / l->n_frames == frame ? (int)k : -1;
}

/* Returns the first training pair from index v on whose image shows an examined frame of a camera;
 * n_train if there is none. */
static size_t find_examined(const struct appearance *l, int camera_id, size_t v)
{
    const struct spin_plan *plan = l->plan;

    while (v < plan->n_train &&
           (plan->clip.views.view[plan->train[v].view].camera_id != camera_id ||
            examined_index(l, plan->train[v].frame) < 0))
        v++;
    return v;
}

/* Adds a camera to the counts `seen` and `changed` of all points and frames. */
static spin_status count_camera(struct appearance *l, int camera_id)
{
    struct spin_image_cache *cache = &l->photos->cache;
    size_t n_frames = (size_t)l->n_frames, n_announced = 0, n_read = 0;
    size_t next = find_examined(l, camera_id, 0); /* the next pair to announce */

    memset(l->bright, NONE, l->n * n_frames);
    for (size_t v = find_examined(l, camera_id, 0); v < l->plan->n_train;
         v = find_examined(l, camera_id, v + 1)) {
        const struct spin_pair *pair = &l->plan->train[v];
        const struct spin_view *view = &l->plan->clip.views.view[pair->view];
        int f = examined_index(l, pair->frame);

        if (spin_cancelled())
            return spin_fail_cancelled();
        for (n_read++;
             n_announced < n_read + spin_image_cache_ahead(cache) && next < l->plan->n_train;
             next = find_examined(l, camera_id, next + 1), n_announced++)
            spin_image_cache_announce(cache, l->plan->train[next].view);
        SPIN_TRY(spin_image_cache_get_rgb8(cache, pair->view, l->image));
        for (size_t i = 0; i < l->n; i++)
            l->bright[i * n_frames + (size_t)f] =
                brightness(&view->camera, l->image, l->place + 3 * i);
    }
    for (size_t i = 0; i < l->n; i++) {
        uint8_t *bright = l->bright + i * n_frames, median = median_of(bright, l->n_frames);

        for (size_t k = i * n_frames; k < (i + 1) * n_frames; k++) {
            bool sees = l->bright[k] != NONE && l->seen[k] < UINT8_MAX;

            l->seen[k] = (uint8_t)(l->seen[k] + sees);
            l->changed[k] =
                (uint8_t)(l->changed[k] + (sees && abs(l->bright[k] - median) > THRESHOLD));
        }
    }
    return SPIN_OK;
}

double spin_tracks_pixels(const struct spin_plan *plan)
{
    int frames = plan->clip.n_frames < FRAMES ? plan->clip.n_frames : FRAMES;

    return plan->o->dynamic_residual ? (double)frames * plan->n_cameras * (double)plan->max_pixels
                                     : 0;
}

spin_status spin_appearance_varies(const struct spin_plan *plan, struct spin_photos *photos,
                                   size_t n, const float *place, uint8_t *varies)
{
    struct appearance l = {.plan = plan, .photos = photos, .n = n, .place = place};
    SPIN_FREED void *block = NULL;
    size_t cells;

    l.n_frames = plan->clip.n_frames < FRAMES ? plan->clip.n_frames : FRAMES;
    cells = n * (size_t)l.n_frames;
    SPIN_TRY(spin_alloc(cells + plan->max_pixels + 1, 3, &block));
    l.image = block;
    l.bright = l.image + 3 * plan->max_pixels;
    l.seen = l.bright + cells;
    l.changed = l.seen + cells;
    memset(l.seen, 0, 2 * cells);
    for (int c = 0; c < plan->n_cameras; c++)
        SPIN_TRY(count_camera(&l, plan->camera[c]));
    memset(varies, 0, n);
    for (size_t k = 0; k < cells; k++)
        varies[k / (size_t)l.n_frames] |= l.changed[k] >= CAMERAS && 2 * l.changed[k] > l.seen[k];
    return SPIN_OK;
}
