#include "formats/sogst.h"

#include "base/base.h"
#include "formats/gs_ply.h"

enum { VERSION = 1, MOST_SEGMENTS = 65536 };

/* ---- meta.json ------------------------------------------------------------------------------- */

static spin_status check_version(const struct spin_sog_4d *r)
{
    const char *format = spin_json_string(spin_json_get(r->meta, "format"));
    int64_t version = -1;

    if (!spin_json_integer(spin_json_get(r->meta, "version"), &version) || version != VERSION ||
        !format || strcmp(format, "sogst") != 0)
        return spin_unsupported(
            ".sogst: 'version' is %lld and 'format' is '%.60s', expected %d and 'sogst'",
            (long long)version, format ? format : "", VERSION);
    return SPIN_OK;
}

/* Checks that the length and the frame rate of the clip are positive and plausible. */
static spin_status check_times(const struct spin_sogst *s)
{
    if (!(s->last > s->first && s->last - s->first < 1e6 && s->fps > 0 && s->fps < 1e4))
        return spin_malformed(".sogst: invalid time range %g to %g s or %g frames per second",
                              s->first, s->last, s->fps);
    if (!((s->last - s->first) * s->fps + 1.5 < INT_MAX))
        return spin_unsupported(".sogst: %.0f frames in %g s at %g frames per second are too many",
                                (s->last - s->first) * s->fps + 1, s->last - s->first, s->fps);
    return SPIN_OK;
}

static spin_status read_times(const struct spin_sog_4d *r, struct spin_sogst *out)
{
    const spin_json *time = spin_json_get(r->meta, "time");

    SPIN_TRY(spin_sog_4d_number(r, spin_json_get(time, "min"), "time.min", &out->first));
    SPIN_TRY(spin_sog_4d_number(r, spin_json_get(time, "max"), "time.max", &out->last));
    SPIN_TRY(spin_sog_4d_number(r, spin_json_get(time, "fps"), "time.fps", &out->fps));
    return check_times(out);
}

static spin_status read_path(struct spin_sog_4d *r, const char *name, struct spin_sog_range *range,
                             enum spin_sog_4d_picture first)
{
    const spin_json *object = spin_json_get(r->meta, name);

    SPIN_TRY(spin_sog_4d_range(r, spin_json_get(object, "mins"), spin_json_get(object, "maxs"),
                               name, 3, range));
    return spin_sog_4d_files(r, object, name, 2, 2, first);
}

static spin_status read_motion(struct spin_sog_4d *r)
{
    const spin_json *accel = spin_json_get(r->meta, "accel");
    int64_t degree = 0;

    SPIN_TRY(spin_sog_4d_integer(r, spin_json_get(spin_json_get(r->meta, "motion"), "degree"),
                                 "motion.degree", 1, 2, &degree));
    if ((accel != NULL) != (degree == 2))
        return spin_malformed(".sogst: 'motion.degree' is %d, but 'accel' is %s", (int)degree,
                              accel ? "present" : "missing");
    r->degree = (int)degree;
    SPIN_TRY(read_path(r, "motion", &r->motion, SPIN_4D_MOTION));
    return accel ? read_path(r, "accel", &r->accel, SPIN_4D_ACCEL) : SPIN_OK;
}

static spin_status read_trbf(struct spin_sog_4d *r)
{
    const spin_json *trbf = spin_json_get(r->meta, "trbf");
    const spin_json *centre = spin_json_get(trbf, "center"), *sigma = spin_json_get(trbf, "sigma");

    SPIN_TRY(spin_sog_4d_book(r, spin_json_get(centre, "codebook"), "trbf.center", SPIN_CODEBOOK,
                              &r->centre));
    SPIN_TRY(spin_sog_4d_book(r, spin_json_get(sigma, "codebook"), "trbf.sigma", SPIN_CODEBOOK,
                              &r->sigma));
    for (size_t k = 0; k < SPIN_CODEBOOK; k++)
        if (!(r->sigma.value[k] > 0))
            return spin_malformed(".sogst: 'trbf.sigma.codebook' has a value of 0 or below");
    return spin_sog_4d_files(r, trbf, "trbf", 1, 1, SPIN_4D_TIME);
}

static spin_status read_cov2d(const struct spin_sog_4d *r, double cov2d[2])
{
    const spin_json *scale = spin_json_get(r->meta, "cov2d_scale");

    if (!scale)
        return SPIN_OK;
    for (size_t k = 0; k < 2; k++) {
        SPIN_TRY(spin_sog_4d_number(r, spin_json_at(scale, k), "cov2d_scale", &cov2d[k]));
        if (spin_json_length(scale) != 2 || !(cov2d[k] > 0))
            return spin_malformed(".sogst: 'cov2d_scale' is not a list of two positive numbers");
    }
    return SPIN_OK;
}

/* ---- Segments -------------------------------------------------------------------------------- */

/* Reads the next range of splats. It must begin at *end, the end of the previous range. Sets *at to
 * the start and *end to the end of the range. */
static spin_status next_range(const spin_json *range, size_t n, size_t *at, size_t *end)
{
    int64_t first = -1, last = -1;

    if (spin_json_length(range) != 2 || !spin_json_integer(spin_json_at(range, 0), &first) ||
        !spin_json_integer(spin_json_at(range, 1), &last) || first != (int64_t)*end ||
        last < first || last > (int64_t)n)
        return spin_malformed(
            ".sogst: 'segments' has the range %lld to %lld, expected a range from %zu to at most "
            "%zu",
            (long long)first, (long long)last, *end, n);
    *at = *end;
    *end = (size_t)last;
    return SPIN_OK;
}

/* Reads the range of the persistent splats or of a segment and, if splats is not NULL, the images
 * in the folder `name`. */
static spin_status read_group(struct spin_sog_4d *r, const spin_json *range, const spin_json *name,
                              size_t *end, struct spin_splats_4d *splats)
{
    const char *folder = spin_json_string(name);
    size_t at = 0;

    SPIN_TRY(next_range(range, r->n, &at, end));
    if (!splats || at == *end)
        return SPIN_OK;
    if (!folder || !spin_sog_4d_name_is_plain(folder))
        return spin_malformed(".sogst: 'streams' has no valid folder for splats %zu to %zu", at,
                              *end);
    return spin_sog_4d_rows(r, folder, at, *end - at, splats);
}

/* Reads all rows, and checks the ranges of the segments. If meta.json contains 'streams', each
 * segment has its own images. */
static spin_status read_segments(struct spin_sog_4d *r, struct spin_sogst *out,
                                 struct spin_splats_4d *splats)
{
    const spin_json *segments = spin_json_get(r->meta, "segments");
    const spin_json *list = spin_json_get(segments, "list");
    const spin_json *streams = spin_json_get(r->meta, "streams");
    const spin_json *names = spin_json_get(streams, "segments");
    struct spin_splats_4d *to = streams ? splats : NULL;
    size_t end = 0;

    out->n_segments = spin_json_length(list);
    if (!segments && streams)
        return spin_malformed(".sogst: 'streams' is present, but 'segments' is missing");
    if (out->n_segments > MOST_SEGMENTS || (streams && spin_json_length(names) != out->n_segments))
        return spin_malformed(
            ".sogst: 'segments' lists %zu segments and 'streams' %zu, expected equal numbers of at "
            "most %d",
            out->n_segments, spin_json_length(names), MOST_SEGMENTS);
    if (!segments)
        return spin_sog_4d_rows(r, NULL, 0, r->n, splats);
    SPIN_TRY(read_group(r, spin_json_get(segments, "persistent"),
                        spin_json_get(streams, "persistent"), &end, to));
    for (size_t k = 0; k < out->n_segments; k++)
        SPIN_TRY(read_group(r, spin_json_get(spin_json_at(list, k), "range"),
                            spin_json_at(names, k), &end, to));
    if (end != r->n)
        return spin_malformed(".sogst: 'segments' contains %zu splats, 'count' is %zu", end, r->n);
    return streams ? SPIN_OK : spin_sog_4d_rows(r, NULL, 0, r->n, splats);
}

static spin_status read_all(struct spin_sog_4d *r, struct spin_sogst *out,
                            struct spin_splats_4d *splats)
{
    const spin_json *audio = spin_json_get(spin_json_get(r->meta, "asset"), "audio");

    SPIN_TRY(check_version(r));
    SPIN_TRY(read_times(r, out));
    SPIN_TRY(spin_sog_4d_still(r, SPIN_CODEBOOK));
    SPIN_TRY(read_motion(r));
    SPIN_TRY(read_trbf(r));
    SPIN_TRY(read_cov2d(r, splats->cov2d));
    SPIN_TRY(spin_splats_4d_reserve(splats, r->n, r->degree, r->sh_degree, 0));
    splats->antialias = r->antialias;
    if (spin_json_get(audio, SPIN_SOG_4D_OWN))
        SPIN_TRY(spin_sog_4d_sound(r, audio, &out->sound));
    return read_segments(r, out, splats);
}

spin_status spin_sogst_read(const void *file, size_t size, struct spin_sogst *out,
                            struct spin_splats_4d *splats)
{
    SPIN_LEAVES(spin_sog_4d_close) struct spin_sog_4d r = {0};

    *out = (struct spin_sogst){0};
    SPIN_TRY(spin_sog_4d_open(".sogst", file, size, &r));
    return read_all(&r, out, splats);
}

/* ---- The exchange PLY ------------------------------------------------------------------------ */

/* Values from the comments and the sidecar file. A missing value is NaN, or 0 in cov2d. */
struct scalars {
    double first, last, fps, degree, cov2d[2];
};

static void read_comments(const struct spin_ply *ply, struct scalars *out)
{
    const struct {
        const char *key;
        double *to;
    } keys[] = {{"sogst.time_min ", &out->first},
                {"sogst.time_max ", &out->last},
                {"sogst.fps ", &out->fps},
                {"sogst.motion_degree ", &out->degree},
                {"sogst.cov2d_scale ", out->cov2d}};

    for (size_t i = 0; i < ply->n_comments; i++)
        for (size_t k = 0; k < sizeof keys / sizeof *keys; k++) {
            size_t n = strlen(keys[k].key);
            char *end;

            if (strncmp(ply->comment[i], keys[k].key, n) != 0)
                continue;
            *keys[k].to = strtod(ply->comment[i] + n, &end);
            if (keys[k].to == out->cov2d)
                out->cov2d[1] = strtod(end, NULL);
        }
}

/* Reads NAME.sogst.json, the sidecar file of NAME.ply, if it exists. */
static spin_status read_sidecar(const char *path, struct scalars *out)
{
    size_t n = strlen(path);
    const spin_json *scale;
    SPIN_LEAVES(spin_json_freed) spin_json *json = NULL;
    SPIN_FREED char *name = NULL;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(n + 12, 1, (void **)&name));
    n -= n > 4 && strcmp(path + n - 4, ".ply") == 0 ? 4 : 0;
    sprintf(name, "%.*s.sogst.json", (int)n, path);
    if (spin_path_exists(name))
        status = spin_json_load(name, &json);
    spin_json_number(spin_json_get(json, "time_min"), &out->first);
    spin_json_number(spin_json_get(json, "time_max"), &out->last);
    spin_json_number(spin_json_get(json, "fps"), &out->fps);
    spin_json_number(spin_json_get(json, "motion_degree"), &out->degree);
    scale = spin_json_get(json, "cov2d_scale");
    for (size_t k = 0; k < 2; k++)
        spin_json_number(spin_json_at(scale, k), &out->cov2d[k]);
    return status;
}

static spin_status read_scalars(const struct spin_ply *ply, int degree, struct spin_sogst *out,
                                double cov2d[2])
{
    struct scalars s = {(double)NAN, (double)NAN, (double)NAN, (double)NAN, {0, 0}};

    read_comments(ply, &s);
    SPIN_TRY(read_sidecar(ply->path, &s));
    if (isnan(s.first) || isnan(s.last) || isnan(s.fps))
        return spin_malformed("comment sogst.time_min, sogst.time_max or sogst.fps is missing");
    if (!isnan(s.degree) && s.degree != degree)
        return spin_malformed("sogst.motion_degree is %g, but the properties have degree %d",
                              s.degree, degree);
    for (int k = 0; k < 2; k++)
        if (!(s.cov2d[k] >= 0 && (s.cov2d[k] > 0) == (s.cov2d[0] > 0) && s.cov2d[k] < 1e6))
            return spin_malformed("sogst.cov2d_scale is not two positive numbers");
    memcpy(cov2d, s.cov2d, sizeof s.cov2d);
    *out = (struct spin_sogst){.first = s.first, .last = s.last, .fps = s.fps};
    return check_times(out);
}

static spin_status read_vertices(const struct spin_ply *ply, struct spin_sogst *out,
                                 struct spin_splats_4d *splats)
{
    static const char *const names[] = {"t_center", "t_sigma", "vx", "vy", "vz", "ax", "ay", "az"};
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_gs_ply cloud;
    struct spin_splats still;
    int degree;

    SPIN_TRY(spin_gs_ply_find(ply, &cloud));
    degree = spin_ply_has(cloud.vertex, "ax") ? 2 : 1;
    if (cloud.vertex->count == 0)
        return spin_malformed("the file contains no splats");
    SPIN_TRY(read_scalars(ply, degree, out, splats->cov2d));
    SPIN_TRY(
        spin_splats_4d_reserve(splats, (size_t)cloud.vertex->count, degree, cloud.sh_degree, 0));
    splats->antialias = spin_ply_is_antialiased(ply);
    for (size_t k = 0; k < 2 + 3 * (size_t)degree; k++) {
        int property = spin_ply_find(cloud.vertex, names[k]);
        float *to = k == 0 ? splats->times : k == 1 ? splats->sigmas : splats->paths + k - 2;

        if (property < 0)
            return spin_malformed("element 'vertex' has no property '%s'", names[k]);
        spin_ply_column(ply, cloud.vertex, property, to, k < 2 ? 1 : 3 * (size_t)degree);
    }
    still = spin_splats_of_4d(splats);
    return spin_gs_ply_read(&cloud, columns, 0, &still);
}

spin_status spin_sogst_read_ply(const char *path, struct spin_sogst *out,
                                struct spin_splats_4d *splats)
{
    SPIN_LEAVES(spin_ply_close) struct spin_ply ply = {0};

    SPIN_TRY(spin_ply_open(path, &ply));
    return read_vertices(&ply, out, splats);
}
