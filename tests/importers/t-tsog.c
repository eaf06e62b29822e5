/* TSOG and .sogst: every fixture compared with its format's own decoder, the profile's cases of
 * meta.json, and malformed archives, images and ranges.
 * K: tsog sogst import */
#include "io/webp.h"
#include "tests/importers/slices.h"

/* ---- Fixtures: tolerances of their manifests */

static void compare_column(struct spin_npz *npz, const char *key, const float *got, size_t n,
                           double abs, double rel, const char *name)
{
    compare(&(struct expected){npz, abs, rel, name}, key, 0, n, got);
}

/* SH above degree 0, channel by channel as in the manifest: [n][3][k - 1]. */
static float *by_colour(const float *sh, size_t n, int degree)
{
    size_t k = (size_t)(degree + 1) * (size_t)(degree + 1);
    float *got = malloc(3 * n * k * sizeof *got);

    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 3; c++)
            for (size_t j = 1; j < k; j++)
                got[(i * 3 + c) * (k - 1) + j - 1] = sh[(i * k + j) * 3 + c];
    return got;
}

static void compare_rest(struct spin_npz *npz, const float *sh, size_t n, int degree,
                         const char *name)
{
    size_t width = 3 * (size_t)(degree * (degree + 2));
    float *got = by_colour(sh, n, degree);

    compare_column(npz, "f_rest", got, n * width, 1e-7, 1e-6, name);
    free(got);
}

/* Opacities and SH of a frame. */
static void compare_appearance(struct spin_npz *npz, const struct spin_splats *s, const size_t *row,
                               const char *name)
{
    struct table alpha = table_load(npz, "alpha", 0), dc = table_load(npz, "f_dc", 0);
    size_t width = 3 * (size_t)(s->sh_degree * (s->sh_degree + 2));

    compare_opacities(&alpha, 0, row, s, 2e-6, name);
    compare_rows(&dc, 0, row, s->n, s->sh, 3 + width, 1e-7, 1e-6, name);
    if (ok(spin_npz_has(npz, "f_rest") == (width > 0), "%s: SH of degree %d", name, s->sh_degree) &&
        width > 0) {
        struct table rest = table_load(npz, "f_rest", 0);
        float *got = by_colour(s->sh, s->n, s->sh_degree);

        compare_rows(&rest, 0, row, s->n, got, width, 1e-7, 1e-6, name);
        free(got);
        free(rest.value);
    }
    free(alpha.value);
    free(dc.value);
}

/* Compares the columns of a slice with rows of expected.npz. */
static void compare_slice(struct spin_npz *npz, const struct spin_splats *s, const size_t *row,
                          size_t block, const char *place, bool opacity, const char *name)
{
    struct table mean = table_load(npz, place, strcmp(place, "xyz") == 0);
    struct table cov = table_load(npz, "cov6", 0), alpha = table_load(npz, "opacity", 1);

    bounds_of = "/"; /* no manifest: the bounds of compare_covariances() */
    compare_rows(&mean, strcmp(place, "xyz") == 0 ? block : 0, row, s->n, s->means, 3, 3e-6, 3e-6,
                 name);
    compare_covariances(&cov, 0, row, s, name);
    if (opacity)
        compare_opacities(&alpha, block, row, s, 2e-6, name);
    check_sane(s, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, name);
    free(mean.value);
    free(cov.value);
    free(alpha.value);
}

/* Every time: all visible splats, and no others. */
static void compare_times(struct run *run, struct spin_npz *npz, const struct spin_splats_4d *s4,
                          const char *name)
{
    struct table times = table_load(npz, "times", 0), alpha = table_load(npz, "opacity", 1);
    size_t *row = malloc((s4->n + 1) * sizeof *row);
    struct spin_splats s = {0};

    for (size_t k = 0; k < times.n_rows; k++) {
        size_t n = 0;

        for (size_t i = 0; i < s4->n; i++)
            if (alpha.value[k * s4->n + i] >= 1 / 255.0)
                row[n++] = i;
        ok(run->importer->frame(run->self, 0, times.value[k], run->sequence.columns, &s) ==
                   SPIN_OK &&
               s.n == n,
           "%s: %zu splats at %g, %zu expected", name, s.n, times.value[k], n);
        if (s.n == n)
            compare_slice(npz, &s, row, k, "xyz", true, name);
    }
    spin_splats_free(&s);
    free(row);
    free(times.value);
    free(alpha.value);
}

static void compare_4d(struct run *run, struct spin_npz *npz, const struct spin_splats_4d *s,
                       const char *name)
{
    struct spin_array info;
    double *accel = spin_npz_has(npz, "accel") ? check_load(npz, "accel", &info) : NULL;
    size_t step = 3 * (size_t)s->degree;
    float *v = calloc(3 * s->n, sizeof *v), *a = calloc(3 * s->n, sizeof *a);
    float *dc = malloc(3 * s->n * sizeof *dc),
          *alpha = map_values(s->logit_opacities, s->n, sigmoid);
    float *scale = map_values(s->log_scales, 3 * s->n, exp);
    size_t n_sh = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));

    for (size_t i = 0; i < s->n; i++)
        for (size_t c = 0; c < 3; c++) {
            v[3 * i + c] = s->degree > 0 ? s->paths[step * i + c] : 0;
            a[3 * i + c] = s->degree > 1 ? s->paths[step * i + 3 + c] : 0;
            dc[3 * i + c] = s->sh[n_sh * i + c];
        }
    compare_column(npz, "centre", s->centres, 3 * s->n, 3e-6, 3e-6, name);
    compare_column(npz, "velocity", v, 3 * s->n, 2e-6, 2e-6, name);
    compare_column(npz, "t_center", s->times, s->n, 1e-6, 0, name);
    compare_column(npz, "t_sigma", s->sigmas, s->n, 1e-6, 0, name);
    compare_column(npz, "f_dc", dc, 3 * s->n, 1e-7, 1e-6, name);
    compare_column(npz, "scale", scale, 3 * s->n, 0, 1e-6, name);
    compare_column(npz, spin_npz_has(npz, "alpha") ? "alpha" : "peak_alpha", alpha, s->n, 1.1e-5, 0,
                   name);
    ok((s->degree > 1) == (accel != NULL), "%s: degree %d", name, s->degree);
    if (accel)
        check_close(a, accel, 3 * s->n, 2e-6, 2e-6, "accel");
    if (s->sh_degree > 0)
        compare_rest(npz, s->sh, s->n, s->sh_degree, name);
    compare_times(run, npz, s, name);
    free(accel);
    free(v);
    free(a);
    free(dc);
    free(alpha);
    free(scale);
}

/* Discrete and static splats: all rows of each frame. */
static void compare_frames(struct run *run, struct spin_npz *npz, const char *name)
{
    bool still = !spin_npz_has(npz, "frame");
    struct table frame = table_load(npz, still ? "alpha" : "frame", 0);
    size_t *row = malloc((frame.n_rows + 1) * sizeof *row), all = 0;
    struct spin_splats s = {0};

    for (int f = 0; f < run->sequence.n_frames; f++) {
        size_t n = 0;

        for (size_t i = 0; i < frame.n_rows; i++)
            if (still || frame.value[i] == f)
                row[n++] = i;
        if (ok(run->importer->frame(run->self, f, f, run->sequence.columns, &s) == SPIN_OK &&
                   s.n == n && run->sequence.counts[f] == n,
               "%s: frame %d has %zu splats", name, f, n)) {
            compare_slice(npz, &s, row, 0, "centre", false, name);
            compare_appearance(npz, &s, row, name);
        }
        all += n;
    }
    ok(all == frame.n_rows, "%s: a frame for every splat", name);
    spin_splats_free(&s);
    free(row);
    free(frame.value);
}

static double number_at(const spin_json *j, const char *a, const char *b)
{
    double v = NAN;

    spin_json_number(spin_json_get(spin_json_get(j, a), b), &v);
    return v;
}

/* The sound of an input: all of the file that the manifest names. */
static void check_sound(const struct run *run, const spin_json *audio, const char *name)
{
    const struct spin_sound *s = run->sequence.sound;
    double volume = 1;

    spin_json_number(spin_json_get(audio, "volume"), &volume);
    ok((s != NULL) == spin_json_is_object(audio), "%s: sound, where there is some", name);
    ok(!s || (strcmp(s->name, "tone") == 0 && strcmp(s->type, "wav") == 0 && s->size == 8044 &&
              s->gain == volume && s->start == 0),
       "%s: with its name and volume", name);
}

static void compare_fixture(const char *folder, const char *file, const char *from)
{
    const char *name = spin_path_name(folder);
    spin_json *manifest = load_manifest(folder);
    const char *kind = spin_json_string(spin_json_get(manifest, "timeline"));
    const struct spin_splats_4d *s = NULL;
    struct spin_npz npz;
    struct run run;

    if (!ok(run_open(NULL, path_in(folder, file), &run) == SPIN_OK &&
                !strcmp(run.importer->name, from) &&
                spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK,
            "%s: is recognised and opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    ok(run.importer->splats_4d(run.self, &s) == SPIN_OK && s &&
           run.sequence.continuous == (!kind || !strcmp(kind, "continuous")),
       "%s: is 4D splats, for any time when it is continuous", name);
    s = run.sequence.continuous ? s : NULL;
    if (s && kind)
        ok(run.sequence.time_first == 0 && run.sequence.time_last == 1 &&
               run.sequence.n_clip_frames == number_at(manifest, "playback", "nFrames") &&
               run.sequence.fps == number_at(manifest, "playback", "fps"),
           "%s: %d frames from 0 to 1", name, run.sequence.n_clip_frames);
    else if (s)
        ok(run.sequence.time_first == number_at(manifest, "time", "min") &&
               run.sequence.time_last == number_at(manifest, "time", "max") &&
               run.sequence.fps == number_at(manifest, "time", "fps") &&
               run.sequence.n_clip_frames ==
                   1 + (int)(0.5 +
                             run.sequence.fps * (run.sequence.time_last - run.sequence.time_first)),
           "%s: %d frames in seconds", name, run.sequence.n_clip_frames);
    else
        ok(run.sequence.n_frames == number_at(manifest, "playback", "nFrames") &&
               (run.sequence.n_frames == 1 ||
                run.sequence.fps == number_at(manifest, "playback", "fps")),
           "%s: %d frames", name, run.sequence.n_frames);
    check_sound(&run, spin_json_get(manifest, "audio"), name);
    ok((strstr(run.sequence.notes, "cov2d") != NULL) ==
               spin_json_is_array(spin_json_get(manifest, "cov2d_scale")) &&
           (!s || (s->cov2d[0] > 0) == (strstr(run.sequence.notes, "cov2d") != NULL)),
       "%s: and of a factor on covariances", name);
    if (s)
        compare_4d(&run, &npz, s, name);
    else
        compare_frames(&run, &npz, name);
    spin_npz_close(&npz);
    run_close(&run);
    spin_json_free(manifest);
    ok(read_truncations(from, path_in(folder, file)) == 0, "%s: no truncation can be read", name);
}

static void test_fixtures(const char *format, const char *file)
{
    const char *root = check_fixture(format);
    const char **names = root ? check_cases(format, file) : NULL;

    if (!root)
        skip(format, "no such fixtures");
    for (size_t i = 0; root && names[i]; i++)
        if (spin_path_exists(path_in(path_in(root, names[i]), "expected.npz")))
            compare_fixture(path_in(root, names[i]), file, format);
    free(names);
}

/* ---- Files that are made -----------------------------------------------------------------------
 */

static const char *work;

struct member {
    const char *name;
    const void *data;
    size_t n;
};

static const char *write_zip(const struct member *m, size_t n)
{
    const char *path = path_in(work, "made.zip");
    struct spin_zip_writer w;

    if (spin_zip_writer_open(path, true, &w) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++)
        if (spin_zip_member_whole(&w, m[i].name, m[i].data, m[i].n, NULL, 0) != SPIN_OK)
            exit(1);
    if (spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    return path;
}

/* Sets "a.b.c" of an object; NULL deletes it. */
static void set_at(spin_json *j, const char *path, spin_json *value)
{
    char key[64];
    const char *dot;

    while ((dot = strchr(path, '.')) != NULL) {
        snprintf(key, sizeof key, "%.*s", (int)(dot - path), path);
        j = spin_json_is_array(j) ? spin_json_at(j, (size_t)atoi(key)) : spin_json_get(j, key);
        path = dot + 1;
    }
    if (spin_json_is_array(j))
        json_array_set_new(j, (size_t)atoi(path), value);
    else if (value)
        spin_json_set(j, path, value);
    else
        json_object_del(j, path);
}

static size_t add_names(const spin_json *j, struct member *m, size_t n, const struct member *like)
{
    const char *key;
    spin_json *value;

    json_object_foreach((json_t *)(uintptr_t)j, key, value)
    {
        for (size_t i = 0; i < spin_json_length(value) + (json_is_string(value) ? 1 : 0); i++) {
            const char *name =
                spin_json_string(json_is_string(value) ? value : spin_json_at(value, i));
            bool known = !name || (strcmp(key, "files") != 0 && strcmp(key, "file") != 0);

            for (size_t k = 0; k < n; k++)
                known = known || strcmp(m[k].name, name) == 0;
            if (!known && *name && n < 32)
                m[n++] = (struct member){name, like->data, like->n};
        }
        n = add_names(value, m, n, like);
    }
    return n;
}

/* The profile's own cases: edits of a meta.json of one splat. */
static void test_cases(void)
{
    const char *file = check_fixture("tsog/conformance/metadata-cases.json");
    const uint8_t pixel[4] = {0, 0, 0, 252};
    unsigned char *picture;
    size_t n_picture, n_cases;
    spin_json *all;

    if (!file || spin_json_load(file, &all) != SPIN_OK ||
        spin_webp_write(pixel, 1, 1, 3, &picture, &n_picture) != SPIN_OK) {
        skip("the profile's cases", "no such fixture");
        return;
    }
    n_cases = spin_json_length(spin_json_get(all, "cases"));
    ok(n_cases >= 50, "%zu cases of meta.json", n_cases);
    for (size_t i = 0; i < n_cases; i++) {
        const spin_json *one = spin_json_at(spin_json_get(all, "cases"), i);
        const spin_json *edits = spin_json_get(one, "edits");
        spin_json *meta = json_deep_copy(spin_json_get(all, "base"));
        const struct member like = {"", picture, n_picture};
        struct member m[32];
        bool valid = false;
        spin_status status;
        char *text;

        spin_json_bool(spin_json_get(one, "valid"), &valid);
        for (size_t e = 0; e < spin_json_length(edits); e++)
            set_at(meta, spin_json_string(spin_json_at(spin_json_at(edits, e), 0)),
                   json_incref(spin_json_at(spin_json_at(edits, e), 1)));
        text = spin_json_text(meta, false);
        m[0] = (struct member){"meta.json", text, strlen(text)};
        status = read_all("tsog", write_zip(m, add_names(meta, m, 1, &like)));
        ok((status == SPIN_OK) == valid && (valid || (strstr(spin_last_error(), "TSOG") &&
                                                      !strstr(spin_last_error(), "it is missing"))),
           "%s: %s", spin_json_string(spin_json_get(one, "name")), valid ? "accepted" : "refused");
        if ((status == SPIN_OK) != valid)
            printf("#   %s\n", status == SPIN_OK ? "" : spin_last_error());
        free(text);
        spin_json_free(meta);
    }
    spin_json_free(all);
    free(picture);
}

/* Whether n numbers equal those of a list, from `first` on. */
static bool are_listed(const spin_json *all, const char *key, size_t first, const float *got,
                       size_t n)
{
    const spin_json *list = spin_json_get(spin_json_get(all, "expected"), key);
    double tolerance = NAN, v;

    spin_json_number(spin_json_get(all, "tolerance"), &tolerance);
    for (size_t i = 0; i < n; i++)
        if (!spin_json_number(spin_json_at(list, first + i), &v) ||
            !(fabs((double)got[i] - v) <= tolerance * fmax(1, fabs(v))))
            return false;
    return true;
}

/* The profile's own file of two splats, compared with its player. */
static void test_vector(void)
{
    const char *file = check_fixture("tsog/conformance/decode-vector.json");
    const char *path = check_fixture("tsog/conformance/decode-vector.tsog");
    const struct spin_splats_4d *s = NULL;
    const spin_json *playback;
    struct spin_splats at = {0};
    struct run run;
    spin_json *all;

    if (!file || !path || spin_json_load(file, &all) != SPIN_OK) {
        skip("the profile's file", "no such fixture");
        return;
    }
    ok(run_open(NULL, path, &run) == SPIN_OK && run.importer->splats_4d(run.self, &s) == SPIN_OK &&
           s && s->n == 2 && s->sh_degree == 1 && s->degree == 1,
       "the profile's file opens");
    playback = spin_json_get(all, "expected");
    ok(run.sequence.n_clip_frames == number_at(playback, "playback", "nFrames") &&
           run.sequence.fps == number_at(playback, "playback", "fps"),
       "the profile's file: frames and their rate");
    for (size_t i = 0; s && i < 2; i++) {
        float alpha = (float)sigmoid((double)s->logit_opacities[i]);

        ok(are_listed(all, "positionTime", 4 * i, s->centres + 3 * i, 3) &&
               are_listed(all, "positionTime", 4 * i + 3, s->times + i, 1),
           "splat %zu: place and time", i);
        ok(are_listed(all, "velocityDuration", 4 * i, s->paths + 3 * i, 3) &&
               are_listed(all, "velocityDuration", 4 * i + 3, s->sigmas + i, 1),
           "splat %zu: velocity and sigma", i);
        ok(s->log_scales[3 * i] == 0 && s->log_scales[3 * i + 1] == 0 &&
               s->log_scales[3 * i + 2] == 0,
           "splat %zu: scales", i);
        ok(are_listed(all, "alpha", i, &alpha, 1), "splat %zu: opacity", i);
        for (size_t k = 0; k < 4; k++)
            ok(are_listed(all, "sh", 16 * i + 4 * k, s->sh + 12 * i + 3 * k, 3),
               "splat %zu: SH %zu", i, k);
    }
    if (ok(run.importer->frame(run.self, 0, 0, run.sequence.columns, &at) == SPIN_OK && at.n == 2,
           "both are seen at time 0"))
        for (size_t i = 0; i < 2; i++) {
            float alpha = (float)sigmoid((double)at.logit_opacities[i]);

            ok(are_listed(all, "positionsAtTimeZero", 3 * i, at.means + 3 * i, 3) &&
                   are_listed(all, "opacityAtTimeZero", i, &alpha, 1),
               "splat %zu: place and opacity at time 0", i);
        }
    spin_splats_free(&at);
    run_close(&run);
    spin_json_free(all);
}

/* A copy of a fixture with an edit of meta.json and of a member: "-" omits it, otherwise its
 * bytes change. */
struct change {
    const char *at, *json; /* "a.b", its text; NULL: no edit */
    const char *member;    /* or NULL */
    int offset,
        byte; /* offset -1: omitted; -2: an extra byte; -3: twice; -4: another member's image */
    const char *word, *what;
};

static const char *changed(const char *fixture, const struct change *c)
{
    struct member m[512] = {0};
    void *owned[512];
    struct spin_zip zip;
    size_t n = 0, n_twice = 0;
    void *twice = NULL;
    const char *path;

    if (spin_zip_open(fixture, &zip) != SPIN_OK || zip.n > 500)
        exit(1);
    for (size_t i = 0; i < zip.n; i++) {
        const unsigned char *data;
        void *unpacked;
        size_t size = (size_t)zip.member[i].size;
        char *copy;

        if (spin_zip_read(&zip, &zip.member[i], true, 1 << 24, &data, &unpacked) != SPIN_OK)
            exit(1);
        copy = calloc(size + 1, 1);
        memcpy(copy, data, size);
        free(unpacked);
        if (c->at && strcmp(zip.member[i].name, "meta.json") == 0) {
            spin_json *meta, *value = NULL;

            if (spin_json_parse("meta.json", copy, size, &meta) != SPIN_OK ||
                (c->json && !(value = json_loads(c->json, JSON_DECODE_ANY, NULL))))
                exit(1);
            set_at(meta, c->at, value);
            free(copy);
            copy = spin_json_text(meta, false);
            size = strlen(copy);
            spin_json_free(meta);
        }
        owned[n] = copy;
        if (c->member && strcmp(zip.member[i].name, c->member) == 0) {
            if (c->offset >= 0)
                copy[c->offset] = (char)c->byte;
            if (c->offset == -1) {
                free(copy);
                continue;
            }
            if (c->offset == -3) {
                twice = memcpy(malloc(size), copy, size);
                n_twice = size;
            }
            size += c->offset == -2;
            if (c->offset == -4) {
                uint8_t *wide = calloc(4, 64 * 60);
                unsigned char *out;

                if (spin_webp_write(wide, 64, 60, 3, &out, &size) != SPIN_OK)
                    exit(1);
                free(wide);
                free(copy);
                owned[n] = copy = (char *)out;
            }
        }
        m[n] = (struct member){zip.member[i].name, copy, size};
        n++;
    }
    if (twice) {
        owned[n] = twice;
        m[n++] = (struct member){c->member, twice, n_twice};
    }
    path = write_zip(m, n);
    while (n > 0)
        free(owned[--n]);
    spin_zip_close(&zip);
    return path;
}

static void test_changes(const char *from, const char *fixture, const struct change *c, size_t n)
{
    fixture = check_fixture(fixture);
    if (!fixture) {
        skip(from, "no such fixture");
        return;
    }
    ok(read_all(from, changed(fixture, &(struct change){0})) == SPIN_OK, "%s: a copy opens", from);
    for (size_t i = 0; i < n; i++)
        fails(from, changed(fixture, &c[i]), c[i].word, c[i].what);
    survive_flips(from, fixture);
}

static const struct change tsog_changes[] = {
    {.member = "pl",
     .offset = -1,
     .word = "TSOG: image 'pl': the file is missing",
     .what = "no picture"},
    {.member = "pl", .offset = -2, .word = "header states", .what = "a byte behind a picture"},
    {.member = "pl", .offset = -3, .word = "member 'pl' occurs twice", .what = "a member twice"},
    {.member = "pl", .offset = -4, .word = "pixels", .what = "a picture of another size"},
    {.member = "q", .offset = -4, .word = "pixels", .what = "the same of rotations"},
    {.member = "pl", .offset = 15, .byte = ' ', .word = "'VP8 '", .what = "a lossy picture"},
    {.member = "pl", .offset = 15, .byte = 'X', .word = "WebP", .what = "a picture without pixels"},
    {.member = "pl", .offset = 24, .byte = 0x30, .word = "WebP", .what = "another version of VP8L"},
    {.member = "palette", .offset = -4, .word = "'palette'", .what = "a palette of another width"},
    {.at = "count", .json = "3", .word = "pixels", .what = "more splats than pixels"},
    {.at = "count", .json = "200000000", .word = "bytes", .what = "more splats than bytes"},
    {.at = "sh0.codebook",
     .json = "[0,1]",
     .word = "index 2 in a codebook of 2",
     .what = "an entry behind its book"},
    {.at = "shN.codebook",
     .json = "[0,1]",
     .word = "the palette has index 2 in a codebook of 2",
     .what = "the same of SH"},
    {.at = "means.maxs", .json = "[1e9,1,1]", .word = "not finite", .what = "places out of range"},
    {.at = "quats.files",
     .json = "[\"dc\"]",
     .word = "mode byte 128",
     .what = "colours for rotations"},
    {.at = "shN.bands", .json = "4", .word = "bands", .what = "SH of degree 4"},
    {.at = "timeline.files", .json = "[\"tl\"]", .word = "timeline", .what = "half of the times"},
};

static const struct change sogst_changes[] = {
    {.at = "version", .json = "2", .word = "'version' is 2", .what = "version 2"},
    {.at = "format", .json = "\"omg4\"", .word = "'omg4'", .what = "another format"},
    {.at = "time", .word = "time.min", .what = "no times"},
    {.at = "time.fps", .word = "time.fps", .what = "no frames a second"},
    {.at = "time.fps", .json = "0", .word = "0 frames per second", .what = "0 frames a second"},
    {.at = "time.max", .json = "-1", .word = "to -1 s", .what = "times backwards"},
    {.at = "time",
     .json = "{\"min\": 0, \"max\": 999999, \"fps\": 9999}",
     .word = "9998990002 frames",
     .what = "more frames than an int counts"},
    {.at = "motion.degree", .json = "2", .word = "'accel' is missing", .what = "no accelerations"},
    {.at = "motion.degree", .json = "3", .word = "motion.degree", .what = "paths of degree 3"},
    {.at = "accel", .json = "{}", .word = "'accel' is present", .what = "too many accelerations"},
    {.at = "trbf.sigma.codebook.0", .json = "0", .word = "trbf.sigma", .what = "a sigma of 0"},
    {.at = "scales.codebook", .json = "[1]", .word = "1 numbers", .what = "a short book"},
    {.at = "cov2d_scale", .json = "[1]", .word = "cov2d_scale", .what = "one factor"},
    {.at = "segments.persistent", .json = "[0,1]", .word = "range", .what = "a gap in the ranges"},
    {.at = "segments.list.0.range",
     .json = "[0,99999]",
     .word = "range",
     .what = "a range too long"},
    {.at = "streams.segments", .json = "[]", .word = "streams", .what = "no streams of segments"},
    {.at = "streams.persistent",
     .json = "\"../x\"",
     .word = "no valid folder",
     .what = "a stream elsewhere"},
    {.at = "streams.persistent",
     .json = "\"elsewhere\"",
     .word = "the file is missing",
     .what = "a stream that is not there"},
    {.at = "segments", .word = "'segments' is missing", .what = "streams of no segments"},
    {.member = "persistent/trbf.webp",
     .offset = -4,
     .word = "pixels",
     .what = "a picture of another size"},
};

/* Edits of a real file: local headers that contradict the directory. */
static void test_headers(void)
{
    static const struct {
        long at;
        unsigned char byte;
        const char *word, *what;
    } cases[] = {{14, 0x5a, "differs from the directory", "a CRC in a header alone"},
                 {18, 0x5a, "differs from the directory", "a size in a header alone"},
                 {6, 8, "differs from the directory", "a header that promises a descriptor"},
                 {8, 8, "differs from the directory", "another method in a header"},
                 {60, 0x01, "CRC", "damage in meta.json"}};
    const char *fixture = check_fixture("tsog/conformance/decode-vector.tsog");
    const char *path = path_in(work, "bytes.tsog");
    unsigned char bytes[8192];
    size_t n;
    FILE *f;

    if (!fixture || !(f = fopen(fixture, "rb"))) {
        skip("headers", "no such fixture");
        return;
    }
    n = fread(bytes, 1, sizeof bytes, f);
    fclose(f);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        unsigned char keep = bytes[cases[i].at];

        bytes[cases[i].at] = cases[i].byte;
        f = fopen(path, "wb");
        if (!f || fwrite(bytes, 1, n, f) != n || fclose(f) != 0)
            exit(1);
        bytes[cases[i].at] = keep;
        fails("tsog", path, cases[i].word, cases[i].what);
    }
}

/* ---- The PLY for exchange ----------------------------------------------------------------------
 */

static const char *write_ply(const char *comments, const char *more, int n_more)
{
    static const char *const names[] = {"x",       "y",      "z",        "rot_0",   "rot_1",
                                        "rot_2",   "rot_3",  "scale_0",  "scale_1", "scale_2",
                                        "opacity", "f_dc_0", "f_dc_1",   "f_dc_2",  "vx",
                                        "vy",      "vz",     "t_center", "t_sigma"};
    const char *path = path_in(work, "x.ply");
    FILE *f = fopen(path, "wb");

    fprintf(f, "ply\nformat ascii 1.0\n%selement vertex 2\n", comments);
    for (size_t i = 0; i < 19; i++)
        fprintf(f, "property float %s\n", names[i]);
    fprintf(f, "%send_header\n", more);
    for (int row = 0; row < 2; row++) {
        for (int i = 0; i < 19 + n_more; i++)
            fprintf(f, "%g ", i == 18 ? 0.5 : i == 3 ? 1 : i == 10 ? 2 : 0.125 * i + row);
        fprintf(f, "\n");
    }
    fclose(f);
    return path;
}

#define TIMES "comment sogst.time_min 1.0\ncomment sogst.time_max 3.0\ncomment sogst.fps 24\n"
#define ACCEL "property float ax\nproperty float ay\nproperty float az\n"

static void test_ply(void)
{
    const struct spin_splats_4d *s = NULL;
    const struct spin_importer *found = NULL;
    const char *sidecar = path_in(work, "x.sogst.json");
    struct run run;
    FILE *f;

    ok(run_open(NULL, write_ply(TIMES "comment sogst.cov2d_scale 1.5 0.5\n", ACCEL, 3), &run) ==
               SPIN_OK &&
           !strcmp(run.importer->name, "sogst") &&
           run.importer->splats_4d(run.self, &s) == SPIN_OK && s->n == 2 && s->degree == 2,
       "the PLY is recognised");
    ok(s && s->paths[0] == 1.75f && s->paths[2] == 2 && s->paths[3] == 2.375f &&
           s->times[0] == 2.125f && s->times[1] == 3.125f && s->sigmas[1] == 0.5f &&
           s->centres[1] == 0.125f && s->sh[0] == 1.375f && s->cov2d[0] == 1.5 &&
           s->cov2d[1] == 0.5 && run.sequence.time_first == 1 && run.sequence.time_last == 3 &&
           run.sequence.n_clip_frames == 49,
       "and all of it is read");
    run_close(&run);
    fails("sogst", write_ply("", "", 0), "comment sogst.time_min, sogst.time_max or sogst.fps",
          "no comments");
    fails("sogst",
          write_ply("comment sogst.time_min 0\ncomment sogst.time_max 999999\ncomment sogst.fps "
                    "9999\n",
                    "", 0),
          "9998990002 frames", "more frames than an int counts");
    fails("sogst", write_ply("comment sogst.time_min 1.0\ncomment sogst.time_max 3.0\n", "", 0),
          "sogst.fps is missing", "no frames a second");
    fails("sogst", write_ply(TIMES "comment sogst.motion_degree 2\n", "", 0),
          "sogst.motion_degree is 2", "a degree that is not there");
    fails("sogst", write_ply(TIMES, "property float ax\n", 1), "'ay'", "a part of accelerations");
    fails("sogst", write_ply(TIMES "comment sogst.cov2d_scale 1\n", "", 0), "cov2d", "one factor");
    fails("ply", write_ply(TIMES, "", 0), "use --from sogst", "it is no still");
    ok(spin_importer_find(write_ply(TIMES, "", 0), NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "sogst"),
       "and is recognised without degree 2");
    f = fopen(sidecar, "wb");
    fprintf(f, "{\"time_min\": 0, \"fps\": 10}");
    fclose(f);
    ok(run_open("sogst", write_ply(TIMES, "", 0), &run) == SPIN_OK &&
           run.sequence.time_first == 0 && run.sequence.time_last == 3 && run.sequence.fps == 10,
       "the sidecar wins");
    run_close(&run);
    unlink(sidecar);
}

static void test_own_plys(void)
{
    static const char *const plys[] = {"parabola_d2_sh3/parabola.ply", "from_realtime4dgs/rt.ply",
                                       "sh1_by_splat_transform/b1.ply"};

    for (size_t i = 0; i < sizeof plys / sizeof *plys; i++) {
        const char *path = check_fixture(path_in("sogst", plys[i]));
        const struct spin_splats_4d *s = NULL;
        struct run run;

        if (!path) {
            skip(plys[i], "no such fixture");
            continue;
        }
        ok(run_open(NULL, path, &run) == SPIN_OK && !strcmp(run.importer->name, "sogst") &&
               run.importer->splats_4d(run.self, &s) == SPIN_OK && s->n > 400,
           "%s: is recognised and opens", plys[i]);
        run_close(&run);
    }
    if (check_fixture("sogst/sh1_by_splat_transform/b1.ply"))
        ok(read_truncations("sogst", check_fixture("sogst/sh1_by_splat_transform/b1.ply")) == 0,
           "no truncation can be read");
}

TAP_MAIN
{
    spin_log_set_level(-2);
    if (spin_webp_need() != SPIN_OK) {
        skip("TSOG and .sogst", "no libwebp");
        return;
    }
    work = new_folder();
    PART(test_fixtures, "tsog", "scene.tsog");
    PART(test_fixtures, "sogst", "scene.sogst");
    PART(test_cases);
    PART(test_vector);
    PART(test_changes, "tsog", "tsog/conformance/decode-vector.tsog", tsog_changes,
         sizeof tsog_changes / sizeof *tsog_changes);
    PART(test_changes, "sogst", "sogst/sh1_by_splat_transform/scene.sogst", sogst_changes,
         sizeof sogst_changes / sizeof *sogst_changes);
    PART(test_headers);
    PART(test_ply);
    PART(test_own_plys);
}
