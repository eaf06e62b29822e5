#include "formats/tsog.h"

#include "base/base.h"
#include "io/zip_format.h"

enum { VERSION = 4, PROFILE = 1, MOST_MEMBERS = 1024, STEPS = 65536, FRAMES = 300 };
enum { DESCRIPTOR = 1 << 3 }; /* flag of a zip member: sizes and checksum follow the data */
#define PROFILE_ID "org.opsiclear.tsog-playback"
#define MAX_DIRECTORY (4u << 20)

/* ---- The archive ----------------------------------------------------------------------------- */

static uint32_t u32_at(const unsigned char *p) { return spin_u32_at(p); }

/* Checks that the local header of a zip member has the compression method, checksum and sizes of
 * the central directory. If the DESCRIPTOR flag is set, checksum and sizes must be 0 in the local
 * header and correct in the data descriptor, which follows the data and may begin with a signature.
 */
static bool header_agrees(const struct spin_zip *zip, const struct spin_zip_member *m)
{
    const unsigned char *p = zip->map.data + m->header_offset, *end = zip->map.data + zip->map.size;
    uint32_t expected[3] = {m->crc, (uint32_t)m->packed_size, (uint32_t)m->size};
    bool later = (p[6] & DESCRIPTOR) != 0;

    if ((size_t)(end - p) < LOCAL_BYTES || u32_at(p) != SIG_LOCAL ||
        (p[8] | p[9] << 8) != m->method)
        return false;
    for (int k = 0; k < 3; k++)
        if (u32_at(p + 14 + 4 * k) != (later ? 0 : expected[k]))
            return false;
    if (!later)
        return true;
    p += LOCAL_BYTES + (p[26] | p[27] << 8) + (p[28] | p[29] << 8) + m->packed_size;
    for (int marked = 1; marked >= 0; marked--) {
        const unsigned char *at = p + 4 * marked;

        if (end - at >= 12 && (!marked || u32_at(p) == 0x08074b50) && u32_at(at) == expected[0] &&
            u32_at(at + 4) == expected[1] && u32_at(at + 8) == expected[2])
            return true;
    }
    return false;
}

static int by_name(const void *a, const void *b)
{
    return strcmp(*(const char *const *)a, *(const char *const *)b);
}

static spin_status check_archive(const struct spin_zip *zip)
{
    const char *name[MOST_MEMBERS];
    size_t n_names = 0;

    if (zip->zip64)
        return spin_unsupported("TSOG: ZIP64 archives are not supported");
    if (zip->n > MOST_MEMBERS)
        return spin_malformed("TSOG: the zip has %zu members, expected at most %d", zip->n,
                              MOST_MEMBERS);
    for (size_t i = 0; i < zip->n; i++) {
        const struct spin_zip_member *m = &zip->member[i];

        name[i] = m->name;
        n_names += strlen(m->name) + CENTRAL_BYTES;
        if ((m->method != METHOD_STORED && m->method != METHOD_DEFLATE) || !header_agrees(zip, m))
            return spin_malformed("TSOG: the header of member '%.60s' differs from the directory, "
                                  "or its compression is unknown",
                                  m->name);
    }
    if (n_names > MAX_DIRECTORY)
        return spin_malformed("TSOG: the directory of the zip has %zu bytes, expected at most %u",
                              n_names, MAX_DIRECTORY);
    qsort(name, zip->n, sizeof *name, by_name);
    for (size_t i = 1; i < zip->n; i++)
        if (strcmp(name[i - 1], name[i]) == 0)
            return spin_malformed("TSOG: member '%.60s' occurs twice", name[i]);
    return SPIN_OK;
}

/* ---- meta.json ------------------------------------------------------------------------------- */

static spin_status fail_meta(const char *key, const char *expected)
{
    return spin_malformed("TSOG: '%s' is invalid, expected %s", key, expected);
}

static spin_status check_version(const struct spin_sog_4d *r)
{
    const spin_json *profile = spin_json_get(r->meta, "profile");
    const char *id = spin_json_string(spin_json_get(profile, "id"));
    int64_t version = -1;

    if (!spin_json_integer(spin_json_get(r->meta, "version"), &version) || version != VERSION)
        return spin_unsupported("TSOG: version %lld, expected %d", (long long)version, VERSION);
    version = -1;
    if (profile &&
        (!id || strcmp(id, PROFILE_ID) != 0 ||
         !spin_json_integer(spin_json_get(profile, "version"), &version) || version != PROFILE))
        return spin_unsupported("TSOG: profile '%.60s' version %lld, expected '%s' version %d",
                                id ? id : "", (long long)version, PROFILE_ID, PROFILE);
    return SPIN_OK;
}

/* Reads the keys of the velocities. They are checked even in discrete files, which do not use
 * velocities. */
static spin_status read_motion(struct spin_sog_4d *r, bool timed)
{
    const spin_json *temporal = spin_json_get(r->meta, "temporal");
    const spin_json *means = spin_json_get(temporal, "means"), *mins, *maxs;

    if (!temporal)
        return SPIN_OK;
    if (!timed || !spin_json_is_object(means) || json_object_size(temporal) != 1)
        return fail_meta("temporal", "only the key 'means', in a file with 'timeline'");
    mins = spin_json_get(means, "mins");
    maxs = spin_json_get(means, "maxs");
    if (spin_json_length(mins) != 1 || spin_json_length(maxs) != 1)
        return fail_meta("temporal.means", "'mins' and 'maxs' with one row of numbers each");
    SPIN_TRY(spin_sog_4d_range(r, spin_json_at(mins, 0), spin_json_at(maxs, 0), "temporal.means", 3,
                               &r->motion));
    r->degree = 1;
    r->linear = true;
    return spin_sog_4d_files(r, means, "temporal.means", 1, 2, SPIN_4D_MOTION);
}

static spin_status read_timeline(struct spin_sog_4d *r, struct spin_tsog *out)
{
    const spin_json *timeline = spin_json_get(r->meta, "timeline");
    int64_t type = 0, n = 0, delta = 0;

    SPIN_TRY(read_motion(r, timeline != NULL));
    if (!timeline)
        return SPIN_OK;
    SPIN_TRY(spin_sog_4d_integer(r, spin_json_get(timeline, "type"), "timeline.type", 0, 1, &type));
    SPIN_TRY(spin_sog_4d_files(r, timeline, "timeline", 2, 2, SPIN_4D_TIME));
    if (type == 1) {
        out->time = SPIN_TSOG_CONTINUOUS;
        SPIN_TRY(spin_sog_4d_range(r, spin_json_get(timeline, "mins"),
                                   spin_json_get(timeline, "maxs"), "timeline", 2, &r->time));
        return (float)r->time.mins[1] > 0 ? SPIN_OK : fail_meta("timeline.mins", "a sigma above 0");
    }
    out->time = SPIN_TSOG_DISCRETE;
    r->degree = 0;
    /* With this range, decoding a code returns the code itself. */
    r->time = (struct spin_sog_range){.maxs = {STEPS - 1, STEPS - 1}};
    SPIN_TRY(spin_sog_4d_integer(r, spin_json_get(timeline, "N"), "timeline.N", 1, STEPS, &n));
    SPIN_TRY(spin_sog_4d_integer(r, spin_json_get(timeline, "delta"), "timeline.delta", STEPS / n,
                                 STEPS / n, &delta));
    out->n_frames = (int)n;
    return SPIN_OK;
}

/* Reads an optional number, which must be above 0. If the key is missing, *out stays unchanged. */
static spin_status read_above_0(const spin_json *object, const char *key, double *out)
{
    const spin_json *j = spin_json_get(object, key);

    return !j || (spin_json_number(j, out) && *out > 0) ? SPIN_OK
                                                        : fail_meta(key, "a number above 0");
}

static spin_status read_playback(const struct spin_sog_4d *r, struct spin_tsog *out)
{
    const spin_json *p = spin_json_get(r->meta, "playback"), *loop = spin_json_get(p, "loop");
    double fps = 30, own = 0, rate = 1, frames;

    if (p && !spin_json_is_object(p))
        return fail_meta("playback", "an object");
    SPIN_TRY(read_above_0(r->meta, "fps", &fps));
    SPIN_TRY(read_above_0(p, "fps", &own));
    SPIN_TRY(read_above_0(p, "duration", &out->duration));
    SPIN_TRY(read_above_0(p, "rate", &rate));
    if (rate < 0.25 || rate > 4)
        return fail_meta("playback.rate", "a number from 0.25 to 4");
    if (loop && !json_is_boolean(loop))
        return fail_meta("playback.loop", "true or false");
    fps = own > 0 ? own : fps;
    if (out->time == SPIN_TSOG_STATIC) {
        out->n_frames = 1;
        return SPIN_OK;
    }
    if (out->time == SPIN_TSOG_DISCRETE) {
        double n = out->n_frames;

        if (own > 0 && out->duration > 0 && !(fabs(out->duration * own - n) <= 1e-6 * n))
            return fail_meta("playback.duration", "'timeline.N' divided by 'playback.fps'");
        out->duration = out->duration > 0 ? out->duration : n / fps;
        out->fps = n / out->duration;
        return SPIN_OK;
    }
    frames = out->duration > 0 ? fmax(2, floor(out->duration * fps + 0.5) + 1) : FRAMES;
    if (!(frames <= INT_MAX))
        return fail_meta("playback.duration", "fewer than 2^31 frames");
    out->n_frames = (int)frames;
    out->fps = fps;
    out->duration = out->duration > 0 ? out->duration : (FRAMES - 1) / fps;
    return SPIN_OK;
}

static spin_status read_sound(const struct spin_sog_4d *r, struct spin_tsog *out)
{
    const spin_json *audio = spin_json_get(r->meta, "audio");

    if (audio && out->time == SPIN_TSOG_STATIC && out->duration == 0)
        return fail_meta("playback.duration", "a duration, which a static file with sound needs");
    return spin_sog_4d_sound(r, audio, &out->sound);
}

/* ---- Splats ---------------------------------------------------------------------------------- */

/* Converts the decoded times of a discrete file to frame numbers, and restricts each splat to its
 * frame. */
static void cut_frames(struct spin_splats_4d *s, int n_frames)
{
    int delta = STEPS / n_frames;

    for (size_t i = 0; i < s->n; i++) {
        int frame = (int)s->times[i] / delta;

        s->times[i] = (float)(frame < n_frames ? frame : n_frames - 1);
        s->sigmas[i] = SPIN_FOREVER;
        s->cuts[2 * i] = s->times[i];
        s->cuts[2 * i + 1] = s->times[i] + 1;
    }
}

static spin_status read_all(struct spin_sog_4d *r, struct spin_tsog *out,
                            struct spin_splats_4d *splats)
{
    bool discrete;

    SPIN_TRY(check_archive(&r->zip));
    SPIN_TRY(check_version(r));
    SPIN_TRY(spin_sog_4d_still(r, 1));
    SPIN_TRY(read_timeline(r, out));
    SPIN_TRY(read_playback(r, out));
    SPIN_TRY(read_sound(r, out));
    discrete = out->time == SPIN_TSOG_DISCRETE;
    SPIN_TRY(
        spin_splats_4d_reserve(splats, r->n, r->degree, r->sh_degree, discrete ? SPIN_4D_CUTS : 0));
    splats->antialias = r->antialias;
    SPIN_TRY(spin_sog_4d_rows(r, NULL, 0, r->n, splats));
    if (discrete)
        cut_frames(splats, out->n_frames);
    return SPIN_OK;
}

spin_status spin_tsog_read(const void *file, size_t size, struct spin_tsog *out,
                           struct spin_splats_4d *splats)
{
    SPIN_LEAVES(spin_sog_4d_close) struct spin_sog_4d r = {0};

    *out = (struct spin_tsog){0};
    SPIN_TRY(spin_sog_4d_open("TSOG", file, size, &r));
    return read_all(&r, out, splats);
}
