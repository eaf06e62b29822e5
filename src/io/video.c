/* Reads frames of videos: indexes the videos, keeps decoders open between calls, and seeks to
 * frames. Threads decode different videos at the same time; each video has one decoder. */
#include "io/video.h"

#include <ctype.h>
#include <pthread.h>
#include <strings.h>

#include "base/base.h"
#include "base/shim.h"
#include "io/video_shim.h"

#define MAX_PIXELS ((int64_t)64 << 20)
/* The decoders of several videos stay open up to OPEN_BYTES of memory, since videos are often read
 * alternately. A decoder keeps about six frames of 1.5 bytes per pixel, which are 50 MB for a video
 * of the data set Neural 3D Video; all 21 videos of that data set can stay open. */
#define DECODER_BYTES 9 /* memory of a decoder, per pixel of a frame */
#define OPEN_BYTES ((size_t)1200 << 20)

struct video {
    char *file;
    struct stat was;           /* the file's status when it was indexed */
    struct spin_digest digest; /* digest of the file; its size is 0 if it was not computed yet */
    struct spin_video_index index;
    unsigned long used; /* value of clock_now at the last use */
    int users;          /* number of threads that decode the video or wait for that */
    bool replaced;      /* the file has changed: freed when there are no users */

    pthread_mutex_t decoding;         /* protects the members below while there are users */
    struct spin_video_stream *stream; /* decoder of the video; NULL: closed */
    int64_t at;                       /* frame that the stream decoded last; -1: none */
};

/* Protects all variables below, and of each video all members that its own mutex does not. */
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static const struct spin_video_shim *shim;
/* [n_videos] Each struct is allocated separately, since the stream of a video points to its index.
 */
static struct video **video;
static size_t n_videos;
static unsigned long clock_now;

/* ---- Names ----------------------------------------------------------------------------------- */

static bool is_video(const char *name, size_t n)
{
    static const char *const endings[] = {".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi"};

    for (size_t i = 0; i < sizeof endings / sizeof *endings; i++) {
        size_t n_ending = strlen(endings[i]);

        if (n > n_ending && strncasecmp(name + n - n_ending, endings[i], n_ending) == 0)
            return true;
    }
    return false;
}

bool spin_video_is_name(const char *name) { return name[0] != '.' && is_video(name, strlen(name)); }

bool spin_video_path(const char *path, size_t *n_file, int64_t *frame)
{
    const char *mark = strrchr(path, '#');
    int64_t value = 0;

    if (!mark || !mark[1] || !is_video(path, (size_t)(mark - path)))
        return false;
    for (const char *p = mark + 1; *p; p++) {
        if (!isdigit((unsigned char)*p) || p - mark > 9)
            return false;
        value = 10 * value + (*p - '0');
    }
    *n_file = (size_t)(mark - path);
    *frame = value;
    return true;
}

/* ---- Loading --------------------------------------------------------------------------------- */

static void free_video(struct video *v)
{
    if (!v)
        return;
    if (v->stream)
        shim->close(v->stream);
    pthread_mutex_destroy(&v->decoding);
    free(v->index.entry);
    free(v->file);
    free(v);
}

static void close_all(void)
{
    for (size_t i = 0; i < n_videos; i++)
        free_video(video[i]);
    free(video);
    video = NULL;
    n_videos = 0;
}

spin_status spin_video_start(void)
{
    static struct spin_shim where = {
        .file = "spin-video.so",
        .override = "SPIN_VIDEO_SHIM",
        .symbol = SPIN_VIDEO_SHIM_SYMBOL,
        .abi = SPIN_VIDEO_SHIM_ABI,
        .lacking = "videos cannot be read or written: the shared object",
        .debian = "libavformat-dev, libavcodec-dev and libswscale-dev"};

    return spin_shim_load(&where, (const void **)&shim);
}

spin_status spin_video_shim(const struct spin_video_shim **out)
{
    SPIN_TRY(spin_video_start());
    *out = shim;
    return SPIN_OK;
}

static spin_status fail_video(enum spin_video_result result, const char *file)
{
    spin_status code = result == SPIN_VIDEO_TOO_LARGE   ? SPIN_E_UNSUPPORTED
                       : result == SPIN_VIDEO_NO_MEMORY ? SPIN_E_MEMORY
                                                        : SPIN_E_MALFORMED;

    return spin_fail(code, "cannot read video '%s': %s", file, shim->why());
}

/* ---- Indexed videos ------------------------------------------------------------------------- */

static spin_status add_video(const char *file, struct video **out)
{
    struct video *new = NULL;
    enum spin_video_result result;
    static bool closes;
    struct spin_map map;
    spin_status status;

    if (!closes)
        closes = atexit(close_all) == 0;
    SPIN_TRY(spin_map_open(file, &map)); /* this records the file as an input */
    spin_map_close(&map);
    SPIN_TRY_OUT(spin_grow(n_videos + 1, sizeof *video, (void **)&video));
    SPIN_TRY_OUT(spin_alloc(1, sizeof *new, (void **)&new));
    new->at = -1;
    pthread_mutex_init(&new->decoding, NULL);
    (void)stat(file, &new->was);
    SPIN_TRY_OUT(spin_strdup(file, &new->file));
    result = shim->index(file, MAX_PIXELS, &new->index);
    if (result != SPIN_VIDEO_OK) {
        status = fail_video(result, file);
        goto out;
    }
    *out = video[n_videos++] = new;
    return SPIN_OK;
out:
    free_video(new);
    return status;
}

static bool is_unchanged(const struct video *v)
{
    struct stat now;

    return stat(v->file, &now) == 0 && now.st_dev == v->was.st_dev && now.st_ino == v->was.st_ino &&
           now.st_size == v->was.st_size && now.st_mtim.tv_sec == v->was.st_mtim.tv_sec &&
           now.st_mtim.tv_nsec == v->was.st_mtim.tv_nsec;
}

static spin_status find_video(const char *file, struct video **out)
{
    SPIN_TRY(spin_video_start());
    for (size_t i = 0; i < n_videos; i++) {
        if (strcmp(video[i]->file, file) != 0)
            continue;
        if (is_unchanged(video[i])) {
            *out = video[i];
            return SPIN_OK;
        }
        video[i]->replaced = video[i]->users > 0;
        if (!video[i]->replaced)
            free_video(video[i]);
        video[i] = video[--n_videos];
        break;
    }
    return add_video(file, out);
}

static void close_stream(struct video *v)
{
    shim->close(v->stream);
    v->stream = NULL;
    v->at = -1;
}

static size_t cost_of(const struct video *v)
{
    return (size_t)v->index.width * (size_t)v->index.height * DECODER_BYTES;
}

/* Close the least recently used decoders that have no users, until the memory of the open ones plus
 * `bytes` does not exceed OPEN_BYTES. */
static void limit_open_streams(size_t bytes)
{
    for (;;) {
        struct video *oldest = NULL;
        size_t held = bytes;

        for (size_t i = 0; i < n_videos; i++) {
            if (video[i]->users == 0 && !video[i]->stream)
                continue;
            held += cost_of(video[i]);
            if (video[i]->users > 0)
                continue;
            if (!oldest || video[i]->used < oldest->used)
                oldest = video[i];
        }
        if (!oldest || held <= OPEN_BYTES)
            return;
        close_stream(oldest);
    }
}

/* Finds a video and counts the calling thread among its users. */
static spin_status take_video(const char *file, struct video **out)
{
    spin_status status;

    pthread_mutex_lock(&mutex);
    status = find_video(file, out);
    if (status == SPIN_OK) {
        (*out)->used = ++clock_now;
        if ((*out)->users == 0 && !(*out)->stream)
            limit_open_streams(cost_of(*out));
        (*out)->users++;
    }
    pthread_mutex_unlock(&mutex);
    return status;
}

static void give_video_back(struct video *v)
{
    pthread_mutex_lock(&mutex);
    if (--v->users == 0 && v->replaced)
        free_video(v);
    pthread_mutex_unlock(&mutex);
}

static spin_status open_stream(struct video *v)
{
    enum spin_video_result result;

    if (v->stream)
        return SPIN_OK;
    result = shim->open(v->file, &v->index, &v->stream);
    v->at = -1;
    return result == SPIN_VIDEO_OK ? SPIN_OK : fail_video(result, v->file);
}

static spin_status read_info(const char *file, int *width, int *height, int64_t *n_frames,
                             struct spin_digest *digest)
{
    struct spin_map map;
    struct video *v;

    SPIN_TRY(find_video(file, &v));
    if (digest && v->digest.size == 0) {
        SPIN_TRY(spin_map_open(file, &map));
        v->digest = spin_map_digest(&map);
        spin_map_close(&map);
    }
    *width = v->index.width;
    *height = v->index.height;
    *n_frames = v->index.n;
    if (digest)
        *digest = v->digest;
    return SPIN_OK;
}

spin_status spin_video_info(const char *file, int *width, int *height, int64_t *n_frames,
                            struct spin_digest *digest)
{
    spin_status status;

    pthread_mutex_lock(&mutex);
    status = read_info(file, width, height, n_frames, digest);
    pthread_mutex_unlock(&mutex);
    return status;
}

static spin_status read_times(const char *file, double **times, int64_t *n)
{
    struct video *v;

    SPIN_TRY(find_video(file, &v));
    *n = v->index.n;
    SPIN_TRY(spin_alloc((size_t)*n, sizeof **times, (void **)times));
    for (int64_t i = 0; i < *n; i++)
        (*times)[i] = v->index.unit * (double)(v->index.entry[i].pts - v->index.entry[0].pts);
    return SPIN_OK;
}

spin_status spin_video_times(const char *file, double **times, int64_t *n)
{
    spin_status status;

    pthread_mutex_lock(&mutex);
    status = read_times(file, times, n);
    pthread_mutex_unlock(&mutex);
    return status;
}

/* ---- Decoding -------------------------------------------------------------------------------- */

static int64_t key_before(const struct video *v, int64_t frame)
{
    while (frame > 0 && !v->index.entry[frame].key)
        frame--;
    return frame;
}

static spin_status convert_frame(struct video *v, uint8_t *rgb)
{
    enum spin_video_result result = shim->rgb(v->stream, rgb);

    return result == SPIN_VIDEO_OK ? SPIN_OK : fail_video(result, v->file);
}

/* Decode all frames up to the requested one, starting at the current position or at the last key
 * frame before the requested frame. `rgb` receives the requested frame; until then it is the buffer
 * for frames that are passed to `passer`. */
static spin_status decode_up_to(struct video *v, int64_t frame,
                                const struct spin_video_passer *passer, uint8_t *rgb)
{
    int64_t key = key_before(v, frame);
    enum spin_video_result result = SPIN_VIDEO_OK;

    if (v->at == frame) /* the decoder still has the frame */
        return convert_frame(v, rgb);
    if (v->at < key || v->at > frame) {
        v->at = -1;
        result = shim->seek(v->stream, key);
    }
    while (result == SPIN_VIDEO_OK) {
        int64_t now;

        result = shim->next(v->stream, &now);
        if (result != SPIN_VIDEO_OK)
            break;
        /* Skip a frame that is displayed before the key frame but coded after it: the frames to
         * which it refers may not have been decoded. */
        if (now < key)
            continue;
        v->at = now;
        if (now == frame)
            return convert_frame(v, rgb);
        if (now > frame)
            return spin_malformed("cannot read video '%s': frame %lld cannot be decoded", v->file,
                                  (long long)frame);
        if (passer && passer->is_wanted(passer->context, now)) {
            SPIN_TRY(convert_frame(v, rgb));
            passer->receive_frame(passer->context, now, v->index.width, v->index.height, rgb);
        }
    }
    v->at = -1;
    return fail_video(result, v->file);
}

static spin_status read_frame(struct video *v, int64_t frame,
                              const struct spin_video_passer *passer, int *width, int *height,
                              uint8_t **rgb)
{
    spin_status status;
    size_t pixels;

    if (frame < 0 || frame >= v->index.n)
        return spin_not_found("video '%s' has no frame %lld, only 0 to %lld", v->file,
                              (long long)frame, (long long)v->index.n - 1);
    SPIN_TRY(open_stream(v));
    pixels = (size_t)v->index.width * (size_t)v->index.height;
    SPIN_TRY(spin_alloc(pixels, 3, (void **)rgb));
    status = decode_up_to(v, frame, passer, *rgb);
    if (status != SPIN_OK) {
        free(*rgb);
        *rgb = NULL;
        close_stream(v);
        return status;
    }
    *width = v->index.width;
    *height = v->index.height;
    return SPIN_OK;
}

spin_status spin_video_read(const char *file, int64_t frame, const struct spin_video_passer *passer,
                            int *width, int *height, uint8_t **rgb)
{
    struct video *v;
    spin_status status;

    *rgb = NULL;
    SPIN_TRY(take_video(file, &v));
    pthread_mutex_lock(&v->decoding);
    status = read_frame(v, frame, passer, width, height, rgb);
    pthread_mutex_unlock(&v->decoding);
    give_video_back(v);
    return status;
}
