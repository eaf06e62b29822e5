/* bundle: what was written comes back bit for bit; malformed files are refused.  K: bundle */

#include "base/err.h"
#include "base/log.h"
#include "scene/dataset.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { FRAMES = 3, N = 5 };
static const unsigned all_columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES | SPIN_COL_RGB;

static const char *new_path(void)
{
    static char path[8][300];
    static const char *folder;
    static int count;
    char *now = path[count % 8];

    if (!folder)
        folder = check_folder();
    snprintf(now, sizeof path[0], "%s/clip-%d.spin", folder, count++);
    return now;
}

/* Frame f has N + f splats, or N where columns stand still. */
static void fill(struct spin_splats *s, int f, unsigned columns, bool same_n)
{
    size_t n = N + (same_n ? 0 : (size_t)f);

    if (spin_splats_reserve(s, n, columns, 1) != SPIN_OK)
        exit(1);
    for (unsigned c = 1; c <= SPIN_COL_RGB; c <<= 1) {
        float *out = *spin_column_of(s, c);

        for (size_t i = 0; (columns & c) && i < n * spin_column_width(c, 1); i++)
            out[i] = (float)c + 0.1f * (float)i + (float)(same_n && c != 1 ? 0 : f) * 1e-3f;
    }
}

static void fill_meta(struct spin_bundle_meta *meta, unsigned columns, unsigned still)
{
    memset(meta, 0, sizeof *meta);
    if (spin_bundle_meta_reserve(meta, FRAMES) != SPIN_OK)
        exit(1);
    snprintf(meta->from, sizeof meta->from, "d3dgs");
    snprintf(meta->variant, sizeof meta->variant, "a \"quoted\" variant");
    for (int f = 0; f < FRAMES; f++) {
        meta->frame[f] = (struct spin_frame_info){122 + f, 0.1 * f, N + (still ? 0 : (size_t)f)};
        meta->source_index[f] = 2 * f;
    }
    meta->n_source_frames = 9;
    meta->numbered = true;
    meta->columns = columns;
    meta->static_columns = still;
    meta->sh_degree = columns & SPIN_COL_SH ? 1 : -1;
}

/* Returns the path; `change` may alter meta before it is written. */
static const char *write_clip(unsigned columns, unsigned still,
                              void (*change)(struct spin_bundle_meta *), spin_json *extra)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta;
    struct spin_splats s = {0};
    const char *path = new_path();

    fill_meta(&meta, columns, still);
    if (change)
        change(&meta);
    if (spin_bundle_writer_open(path, false, false, &w) != SPIN_OK)
        exit(1);
    for (int f = 0; f < FRAMES; f++) {
        fill(&s, f, columns, still != 0);
        if (spin_bundle_write_frame(&w, f, columns, still, &s) != SPIN_OK)
            exit(1);
    }
    if (!ok(spin_bundle_writer_finish(&w, &meta, extra) == SPIN_OK, "writes a clip"))
        printf("#   %s\n", spin_last_error());
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
    return path;
}

static void compare_clip(const char *path, unsigned columns, bool same_n, const char *what)
{
    struct spin_splats got = {0}, want = {0};
    struct spin_bundle b;
    char text[100];

    if (!ok(spin_bundle_open(path, &b) == SPIN_OK, "%s: opens", what)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    for (int f = 0; f < FRAMES; f++) {
        fill(&want, f, columns, same_n);
        if (!ok(spin_bundle_frame(&b, f, columns, &got) == SPIN_OK && got.n == want.n,
                "%s: frame %d", what, f))
            continue;
        for (unsigned c = 1; c <= SPIN_COL_RGB; c <<= 1) {
            if (!(columns & c))
                continue;
            snprintf(text, sizeof text, "%s: %s of frame %d", what, spin_column_name(c), f);
            check_same_bits(*spin_column_of(&got, c), *spin_column_of(&want, c),
                            want.n * spin_column_width(c, 1) * sizeof(float), text);
        }
    }
    spin_splats_free(&got);
    spin_splats_free(&want);
    spin_bundle_close(&b);
}

static void test_round_trip(void)
{
    const unsigned still = SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES | SPIN_COL_QUATS |
                           SPIN_COL_SH | SPIN_COL_RGB;
    const char *path = write_clip(all_columns, 0, NULL, NULL);
    struct spin_splats s = {0};
    struct spin_bundle b;

    compare_clip(path, all_columns, false, "all columns");
    compare_clip(write_clip(all_columns, still, NULL, NULL), all_columns, true, "still columns");
    compare_clip(write_clip(SPIN_COL_MEANS, 0, NULL, NULL), SPIN_COL_MEANS, false,
                 "positions only");
    if (!ok(spin_bundle_open(path, &b) == SPIN_OK, "opens again"))
        return;
    is_text(b.meta.from, "d3dgs", "the importer's name comes back");
    is_text(b.meta.variant, "a \"quoted\" variant", "so does the variant");
    ok(b.meta.n_frames == FRAMES && b.meta.frame[2].number == 124 &&
           b.meta.frame[2].time == 0.1 * 2 && b.meta.source_index[2] == 4 &&
           b.meta.n_source_frames == 9 && b.meta.numbered && b.meta.sh_degree == 1,
       "and what is said of the frames, times to the last bit");
    ok(spin_bundle_frame(&b, FRAMES, SPIN_COL_MEANS, &s) == SPIN_E_NOT_FOUND &&
           spin_bundle_frame(&b, -1, SPIN_COL_MEANS, &s) == SPIN_E_NOT_FOUND,
       "there is no frame beyond the last, or before the first");
    spin_bundle_close(&b);
    path = write_clip(SPIN_COL_MEANS, 0, NULL, NULL);
    ok(spin_bundle_open(path, &b) == SPIN_OK &&
           spin_bundle_frame(&b, 0, SPIN_COL_QUATS, &s) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "run spin-retrain"),
       "columns of a clip of positions are not found, with advice");
    spin_bundle_close(&b);
    spin_splats_free(&s);
}

/* Frame f has f + 1 refined splats of two columns. */
static const char *write_refined(const char *frames, bool network)
{
    static const float zeros[12];
    const uint64_t table[2] = {3, 4}, heads[1] = {5}, means[2] = {2, 3};
    const char *path = new_path();
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta;
    struct spin_splats s = {0};
    spin_json *extra = NULL;

    fill_meta(&meta, SPIN_COL_MEANS, 0);
    if (spin_bundle_writer_open(path, false, false, &w) != SPIN_OK)
        exit(1);
    for (int f = 0; f < FRAMES; f++) {
        fill(&s, f, SPIN_COL_MEANS, false);
        meta.frame[f].n = s.n;
        if (spin_bundle_write_frame(&w, f, SPIN_COL_MEANS, 0, &s) != SPIN_OK)
            exit(1);
        fill(&s, f, SPIN_COL_MEANS | SPIN_COL_RGB, false);
        s.n = (size_t)f + 1;
        if (spin_bundle_write_refined(&w, f, SPIN_COL_MEANS | SPIN_COL_RGB, &s) != SPIN_OK)
            exit(1);
    }
    for (int f = 0; network && f < FRAMES; f++) {
        char name[40];

        snprintf(name, sizeof name, "trained/means/%05d", f);
        spin_npz_write(&w.zip, name, "<f4", 2, means, zeros);
    }
    if (network) {
        spin_npz_write(&w.zip, "trained/table", "<f4", 2, table, zeros);
        spin_npz_write(&w.zip, "trained/heads", "<f4", 1, heads, zeros);
    }
    if (spin_json_parse("extra", frames, strlen(frames), &extra) != SPIN_OK ||
        spin_bundle_writer_finish(&w, &meta, extra) != SPIN_OK)
        exit(1);
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
    return path;
}

#define REFINED                                                                                    \
    "\"refined\":{\"columns\":[\"means\",\"rgb\"],\"sh_degree\":-1,"                               \
    "\"frames\":[{\"n\":1},{\"n\":2},{\"n\":3}]}"

static void test_refined(void)
{
    uint32_t sum[3] = {0};
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_RGB;
    struct spin_splats got = {0}, want = {0};
    struct spin_bundle b;

    if (!ok(spin_bundle_open(write_refined("{" REFINED "}", false), &b) == SPIN_OK,
            "refined frames: opens")) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    for (int f = 0; f < FRAMES; f++) {
        fill(&want, f, columns, false);
        ok(spin_bundle_count(&b, f, SPIN_FROM_SOURCE) == want.n &&
               spin_bundle_count(&b, f, SPIN_FROM_REFINED) == (size_t)f + 1 &&
               spin_bundle_count(&b, f, SPIN_FROM_TRAINED) == (size_t)f + 1,
           "refined frame %d has a count of its own, which a network's is too", f);
        if (ok(spin_bundle_refined_frame(&b, f, columns, &got) == SPIN_OK && got.n == (size_t)f + 1,
               "refined frame %d", f))
            ok(memcmp(got.means, want.means, got.n * 3 * sizeof(float)) == 0 &&
                   memcmp(got.rgb, want.rgb, got.n * 3 * sizeof(float)) == 0,
               "comes back bit for bit");
    }
    ok(spin_bundle_frame(&b, 1, SPIN_COL_MEANS, &got) == SPIN_OK && got.n == N + 1,
       "beside the source's");
    ok(spin_bundle_refined_frame(&b, 1, SPIN_COL_SH, &got) == SPIN_E_NOT_FOUND &&
           spin_bundle_refined_frame(&b, FRAMES, columns, &got) == SPIN_E_NOT_FOUND,
       "columns and frames that it has not are not found");
    ok(spin_bundle_checksum(&b, 0, columns, &sum[0]) == SPIN_OK &&
           spin_bundle_checksum(&b, 0, SPIN_COL_MEANS, &sum[1]) == SPIN_OK &&
           spin_bundle_checksum(&b, 1, columns, &sum[2]) == SPIN_OK && sum[0] == sum[1] &&
           sum[0] != sum[2],
       "a checksum is of the source's own columns, and frames differ");
    spin_bundle_close(&b);
    spin_splats_free(&got);
    spin_splats_free(&want);
}

static void with_relative_data(struct spin_bundle_meta *meta)
{
    meta->data_path = strdup("some/../data");
    snprintf(meta->data_from, sizeof meta->data_from, "panoptic");
}

static void with_absolute_data(struct spin_bundle_meta *meta)
{
    meta->data_path = strdup("/no/such/data");
}

static const char *moved_from; /* where the data set was, absolute */

static void with_moved_data(struct spin_bundle_meta *meta)
{
    meta->data_path = strdup(".//..");
    meta->data_absolute = strdup(moved_from);
}

/* The data set of a bundle that was moved to where its relative path leads elsewhere. */
static char *data_of_moved(const char *absolute)
{
    struct spin_bundle b;
    char *data = NULL;

    moved_from = absolute;
    ok(spin_bundle_open(write_clip(SPIN_COL_MEANS, 0, with_moved_data, NULL), &b) == SPIN_OK &&
           spin_bundle_data_path(&b, &data) == SPIN_OK,
       "a bundle that was moved");
    spin_bundle_close(&b);
    return data;
}

static void test_moved_data(void)
{
    char *data, *above = NULL, *folder = NULL, *set = NULL;

    spin_path_folder(check_folder(), &folder);
    spin_path_absolute(folder, &above);
    spin_path_absolute("fixtures/court-mini", &set);
    is_text(data = data_of_moved(set), set, "the absolute path leads to a data set");
    free(data);
    is_text(data = data_of_moved("/no/such"), above, "else the relative one is good enough");
    free(data);
    is_text(data = data_of_moved("/usr"), above, "as it is where neither is a data set");
    free(data);
    free(above);
    free(folder);
    free(set);
}

static void test_data_path(void)
{
    const char *path = write_clip(SPIN_COL_MEANS, 0, with_relative_data, NULL);
    struct spin_bundle b;
    char *data = NULL, *want = NULL, *folder = NULL;

    spin_path_folder(path, &folder);
    spin_path_join(folder, "some/../data", &want);
    ok(spin_bundle_open(path, &b) == SPIN_OK && spin_bundle_data_path(&b, &data) == SPIN_OK,
       "has a data set");
    is_text(data, want, "a relative path counts from the bundle's folder");
    is_text(b.meta.data_from, "panoptic", "its importer comes back");
    spin_bundle_close(&b);
    free(data);
    free(want);
    free(folder);
    ok(spin_bundle_open(write_clip(SPIN_COL_MEANS, 0, with_absolute_data, NULL), &b) == SPIN_OK &&
           spin_bundle_data_path(&b, &data) == SPIN_OK,
       "has another data set");
    is_text(data, "/no/such/data", "an absolute path stays");
    spin_bundle_close(&b);
    free(data);
    ok(spin_bundle_open(write_clip(SPIN_COL_MEANS, 0, NULL, NULL), &b) == SPIN_OK &&
           spin_bundle_data_path(&b, &data) == SPIN_OK && data == NULL,
       "no data set is none");
    spin_bundle_close(&b);
}

/* ---- Lies ------------------------------------------------------------------------------------ */

static void refuses(const char *path, const char *word, const char *what)
{
    struct spin_bundle b;
    spin_status status = spin_bundle_open(path, &b);
    bool good =
        status != SPIN_OK && strstr(spin_last_error(), word) && strstr(spin_last_error(), path);

    ok(good, "%s", what);
    if (!good)
        printf("#   %s\n", status == SPIN_OK ? "it was opened" : spin_last_error());
    if (status == SPIN_OK)
        spin_bundle_close(&b);
}

/* A bundle of two frames of two points whose meta.json is `text` with %s for `frames`. */
static const char *write_meta(const char *text, const char *descr, uint64_t n)
{
    static const double zeros[8];
    struct spin_zip_writer w;
    const char *path = new_path();
    const uint64_t shape[2] = {n, 3};

    if (spin_zip_writer_open(path, false, &w) != SPIN_OK ||
        spin_npz_write(&w, "source/means/00000", descr, 2, shape, zeros) != SPIN_OK ||
        spin_npz_write(&w, "source/means/00001", descr, 2, shape, zeros) != SPIN_OK ||
        spin_zip_member_begin(&w, "meta.json", strlen(text)) != SPIN_OK ||
        spin_zip_member_write(&w, text, strlen(text)) != SPIN_OK ||
        spin_zip_member_end(&w) != SPIN_OK || spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    return path;
}

#define HEAD "{\"format\":\"spin bundle\",\"version\":1,\"from\":\"d3dgs\",\"numbered\":false,"
#define COLUMNS "\"columns\":[\"means\"],\"static_columns\":[],\"sh_degree\":-1,"
#define FRAME(number, time, n, index)                                                              \
    "{\"number\":" number ",\"time\":" time ",\"n\":" n ",\"source_index\":" index "}"
#define GOOD FRAME("0", "0", "2", "0")
#define TAIL(frames) "\"data\":null,\"source_frames\":3,\"frames\":[" frames "]}"

#define CAMERA(width, lens, rotation)                                                              \
    "\"cameras\":[{\"camera\":4,\"width\":" width ",\"height\":9,\"lens\":[" lens                  \
    "],\"w2c\":[" rotation ",0,0,0,0,1,0,0,0,0,1,0]}],"

static void test_lies(void)
{
    static const struct {
        const char *text, *word, *what;
    } cases[] = {
        {"", "meta.json", "an empty meta.json"},
        {"[]", "format", "a list for an object"},
        {"{\"format\":\"other\"}", "format", "another format"},
        {"{\"format\":\"spin bundle\",\"version\":6}", "version 6", "a later version"},
        {"{\"format\":\"spin bundle\",\"version\":1e99}", "version", "an absurd version"},
        {HEAD COLUMNS TAIL(""), "frames", "no frames"},
        {HEAD COLUMNS TAIL("7"), "number", "a frame that is a number"},
        {HEAD COLUMNS TAIL(GOOD "," FRAME("2", "1", "2", "1") "," FRAME("1", "2", "2", "2")),
         "source/means/00002", "a frame too many"},
        {HEAD COLUMNS TAIL(GOOD "," FRAME("1", "1", "2", "1") "," FRAME("0", "2", "2", "2")),
         "two frames have the number 0", "a frame number that is there twice"},
        {HEAD COLUMNS TAIL(FRAME("0", "0", "-1", "0")), "'n'", "a negative count"},
        {HEAD COLUMNS TAIL(FRAME("0", "0", "4000000000", "0")), "shape", "a huge count"},
        {HEAD COLUMNS TAIL(FRAME("0", "0", "9223372036854775807", "0")), "'n'", "an absurd count"},
        {HEAD COLUMNS TAIL(FRAME("0", "0", "1e18", "0")), "'n'", "a count with an exponent"},
        {HEAD COLUMNS TAIL(FRAME("0", "0", "3", "0")), "shape", "a count that the array has not"},
        {HEAD COLUMNS TAIL(FRAME("1.5", "0", "2", "0")), "number", "half a frame number"},
        {HEAD COLUMNS TAIL(FRAME("0", "\"0\"", "2", "0")), "time", "a time that is text"},
        {HEAD COLUMNS TAIL(FRAME("0", "0", "2", "3")), "source_index",
         "a source index past the end"},
        {HEAD "\"columns\":[\"quats\"],\"static_columns\":[],\"sh_degree\":-1," TAIL(GOOD), "means",
         "no positions"},
        {HEAD "\"columns\":[\"means\",\"mass\"],\"static_columns\":[],\"sh_degree\":-1," TAIL(GOOD),
         "mass", "an unknown column"},
        {HEAD "\"columns\":[\"means\"],\"static_columns\":[\"rgb\"],\"sh_degree\":-1," TAIL(GOOD),
         "static_columns", "a still column that is none"},
        {HEAD "\"columns\":[\"means\",\"sh\"],\"static_columns\":[],\"sh_degree\":-1," TAIL(GOOD),
         "sh_degree", "SH without a degree"},
        {HEAD "\"columns\":[\"means\",\"sh\"],\"static_columns\":[],\"sh_degree\":9," TAIL(GOOD),
         "sh_degree", "SH of degree 9"},
        {HEAD "\"columns\":[\"means\",\"rgb\"],\"static_columns\":[],\"sh_degree\":-1," TAIL(GOOD),
         "source/rgb/00000", "a column that is not there"},
        {HEAD COLUMNS "\"trained\":{\"field\":{\"features\":4}}," TAIL(GOOD), "trained/table",
         "a network that is not there"},
        {HEAD COLUMNS "\"trained\":{\"field\":{\"features\":-4}}," TAIL(GOOD), "features",
         "a network of -4 features"},
        {HEAD COLUMNS "\"trained\":3," TAIL(GOOD), "trained", "a training that is a number"},
        {HEAD COLUMNS "\"trained\":{\"field\":null,\"splats\":[-1]}," TAIL(GOOD), "trained.splats",
         "a frame of -1 trained splats"},
        {HEAD COLUMNS "\"cameras\":[7]," TAIL(GOOD), "cameras", "a camera that is a number"},
        {HEAD COLUMNS CAMERA("0", "9,9,8,5", "1") TAIL(GOOD), "cameras", "a camera without pixels"},
        {HEAD COLUMNS CAMERA("16", "9,9,8", "1") TAIL(GOOD), "cameras", "a camera without cy"},
        {HEAD COLUMNS CAMERA("16", "9,-9,8,5", "1") TAIL(GOOD), "cameras", "a focal length of -9"},
        {HEAD COLUMNS CAMERA("16", "9,9,8,1e300", "1") TAIL(GOOD), "cameras", "an absurd cy"},
        {HEAD COLUMNS CAMERA("16", "9,9,8,5", "2") TAIL(GOOD), "cameras", "no rotation"},
        {HEAD COLUMNS CAMERA("16", "9,9,8,5", "-1") TAIL(GOOD), "cameras", "a reflection"},
        {HEAD COLUMNS "\"trained\":{\"sh_degree\":0}," TAIL(GOOD), "trained.field",
         "a training that does not say whether it has a network"},
        {HEAD COLUMNS "\"network\":{\"features\":4}," TAIL(GOOD), "trained/table",
         "a network of before that is not there"},
        {HEAD COLUMNS "\"refined\":[]," TAIL(GOOD), "refined", "refined frames in a list"},
        {HEAD COLUMNS "\"refined\":{\"n\":1}," TAIL(GOOD), "columns",
         "refined frames without columns"},
        {HEAD COLUMNS "\"refined\":{" COLUMNS "\"frames\":[]}," TAIL(GOOD), "one entry per frame",
         "a refined frame too few"},
        {HEAD COLUMNS "\"refined\":{" COLUMNS "\"frames\":[7]}," TAIL(GOOD), "'n'",
         "a refined frame that is a number"},
        {HEAD COLUMNS "\"refined\":{" COLUMNS "\"frames\":[{\"n\":-2}]}," TAIL(GOOD), "'n'",
         "refined frames of a negative count"},
        {HEAD COLUMNS "\"refined\":{" COLUMNS "\"frames\":[{\"n\":2}]}," TAIL(GOOD),
         "refined/means/00000", "refined frames that are not there"},
        {HEAD COLUMNS
         "\"refined\":{\"columns\":[\"rgb\"],\"sh_degree\":-1,\"frames\":[]}," TAIL(GOOD),
         "means", "refined frames without positions"},
    };

    refuses(write_refined("{" REFINED ",\"trained\":{\"field\":{\"features\":4}}}", true),
            "trained/means/00000", "a network with another count than the refined frames");
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        refuses(write_meta(cases[i].text, "<f4", 2), cases[i].word, cases[i].what);
    refuses(write_meta(HEAD COLUMNS TAIL(GOOD), "<f8", 2), "float32", "positions in float64");
    refuses(write_meta(HEAD COLUMNS TAIL(GOOD), "<i4", 2), "float32", "positions in integers");
    refuses(write_meta(HEAD COLUMNS TAIL(GOOD), "<f4", 1), "shape", "a point too few");
    refuses("no/such.spin", "no/such.spin", "a missing file");
}

/* Opens and reads all of it; true when it could be opened. */
static bool read_everything(const char *path)
{
    struct spin_splats s = {0};
    struct spin_bundle b;

    if (spin_bundle_open(path, &b) != SPIN_OK)
        return false;
    for (int f = 0; f < b.meta.n_frames; f++) {
        (void)spin_bundle_frame(&b, f, b.meta.columns, &s);
        if (b.refined.columns)
            (void)spin_bundle_refined_frame(&b, f, b.refined.columns, &s);
    }
    spin_bundle_close(&b);
    spin_splats_free(&s);
    return true;
}

static void test_damage(void)
{
    check_damage(write_clip(all_columns, 0, NULL, NULL), read_everything);
}

static void test_overwrite(void)
{
    const char *path = write_clip(SPIN_COL_MEANS, 0, NULL, NULL);
    struct spin_bundle_writer w;
    struct spin_bundle b;

    ok(spin_bundle_writer_open(path, false, false, &w) == SPIN_E_IO,
       "what exists is not overwritten unasked");
    ok(spin_bundle_writer_open(path, true, false, &w) == SPIN_OK, "but it is when asked");
    spin_bundle_writer_abandon(&w);
    ok(spin_bundle_open(path, &b) == SPIN_OK, "an abandoned writer leaves it as it was");
    spin_bundle_close(&b);
}

static void test_extra(void)
{
    spin_json *extra = spin_json_object();
    struct spin_bundle b;
    double value = 0;

    spin_json_set_number(extra, "made_up", 1.25);
    ok(spin_bundle_open(write_clip(SPIN_COL_MEANS, 0, NULL, extra), &b) == SPIN_OK &&
           spin_json_number(spin_json_get(b.json, "made_up"), &value) && value == 1.25,
       "extra keys are kept at the top of meta.json");
    spin_bundle_close(&b);
}

static void add_sound(struct spin_bundle_meta *meta)
{
    meta->sound = (struct spin_sound){"a \"tone\"", "flac", (const unsigned char *)"fLaC and more",
                                      13,           -2.5,   0.5};
}

static void test_sound(void)
{
    const char *path = write_clip(SPIN_COL_MEANS, 0, add_sound, NULL);
    struct spin_bundle b;

    if (!ok(spin_bundle_open(path, &b) == SPIN_OK, "a clip with sound opens"))
        printf("#   %s\n", spin_last_error());
    ok(b.meta.sound.size == 13 && memcmp(b.meta.sound.data, "fLaC and more", 13) == 0 &&
           strcmp(b.meta.sound.name, "a \"tone\"") == 0 && strcmp(b.meta.sound.type, "flac") == 0 &&
           b.meta.sound.start == -2.5 && b.meta.sound.gain == 0.5,
       "with its name, type, start and gain");
    spin_bundle_close(&b);
    path = write_clip(SPIN_COL_MEANS, 0, NULL, NULL);
    ok(spin_bundle_open(path, &b) == SPIN_OK && !b.meta.sound.data, "others have none");
    spin_bundle_close(&b);
}

static void test_cameras(void)
{
    const char *text = HEAD COLUMNS CAMERA("16", "9,9,8,5", "1") TAIL(GOOD);
    const struct spin_view *v;
    struct spin_bundle b;

    ok(spin_bundle_open(write_meta(text, "<f4", 2), &b) == SPIN_OK && b.meta.cameras.n == 1,
       "a camera that the bundle keeps");
    v = b.meta.cameras.view;
    ok(v && v->camera_id == 4 && v->camera.width == 16 && v->camera.height == 9 && !v->test &&
           v->camera.cx == 8 && v->camera.w2c[5] == 1 && v->dataset_frame == 0 && !v->path,
       "is read");
    spin_bundle_close(&b);
}

/* meta.json describes a sound that does not exist, or in the wrong way. */
static void test_bad_sound(void)
{
    static const char *const wrong[] = {"{\"start\": 0, \"gain\": 1}", "{\"gain\": 1}",
                                        "{\"start\": 0, \"gain\": -1}"};
    struct spin_bundle b;

    for (int i = 0; i < 3; i++) {
        spin_json *extra = spin_json_object(), *sound = NULL;

        if (spin_json_parse("sound", wrong[i], strlen(wrong[i]), &sound) != SPIN_OK)
            exit(1);
        spin_json_set(extra, "sound", sound);
        ok(spin_bundle_open(write_clip(SPIN_COL_MEANS, 0, NULL, extra), &b) == SPIN_E_MALFORMED &&
               strstr(spin_last_error(), "'sound'"),
           "a sound that is not there, %s", wrong[i]);
    }
}

TAP_MAIN
{
    spin_log_set_level(-1);
    test_round_trip();
    test_refined();
    test_data_path();
    test_moved_data();
    test_extra();
    test_overwrite();
    test_lies();
    test_damage();
    test_sound();
    test_bad_sound();
    test_cameras();
}
