/* .4dgs files written by the words of the format, apart from its reader.
 * K: 4dgs formats import */
#include <zlib.h>

#include "formats/4dgs.h"
#include "io/compress.h"
#include "io/file.h"
#include "tests/formats/splats.h"

enum { N = 23, FIRST = 14, N_WINDOWS = 3 }; /* splats; of the first of two chunks */
enum { POSITION, SCALE, LARGEST, ROTATION, COLOUR, OPACITY, MOTION, MU, SIGMA, FLAGS, WINDOW };

static const int channels[11] = {3, 3, 1, 3, 3, 1, 3, 1, 1, 1, 1};
static const double origin[3] = {-1.5, 2, 0.25};
enum { S_POSITION, S_SCALE, S_ROTATION, S_COLOUR, S_OPACITY, S_MOTION, S_TIME, S_SIGMA };
static const double steps[8] = {0.002, 0.04, 0.004, 0.008, 0.008, 0.005, 0.004, 0.25};
static const double windows[N_WINDOWS][2] = {{0, 1.1}, {1.1, 2.5}, {-1e300, 1e300}};
static const double intervals[2][2] = {{0, 2}, {0.5, 2.5}};
static double cutoff = 0.02;

/* What a file is made wrong by. */
static struct {
    int window, largest, code; /* of the last row; 0: as they are */
    int again;                 /* a record that comes twice */
    int left_out;              /* one that does not come */
    int n_more;                /* splats that the header says besides */
    bool delta, track;
} wrong;

/* The sounds of a file, and what they are made wrong by. */
static struct {
    int n;
    int without_data; /* the source whose data do not come, from 1 */
    bool twice, old, late, declared;
    double length, gain, turn, time; /* of the last: duration, gain, w of its rotation; keyframe */
    const char *how;                 /* its interpolation */
    const char *metadata;            /* value of sound_start */
} sounds;

static int step_of(int a, int row, int c)
{
    switch (a) {
    case POSITION:
        return 1000 * (row % 7) - 333 * c - 70000 * (row == 5);
    case SCALE:
        return -60 - row - 7 * c;
    case LARGEST:
        return row == N - 1 && wrong.largest ? wrong.largest : row % 4;
    case ROTATION:
        return (37 * row + 50 * c) % 240 - 120;
    case COLOUR: /* green, and red and blue less green */
        return c == 0 ? 10 * (row % 14) : 9 * row - 100 * c;
    case OPACITY:
        return 6 * row - 3;
    case MOTION:
        return 20 * c - row;
    case MU:
        return 90 * (row % 6);
    case SIGMA: /* from a thousandth of a second to minutes */
        return row - 28 + 20 * (row % 2);
    case FLAGS:
        return row % 5 == 0 ? 1 : row % 3 == 0 ? 2 : 0;
    default:
        return row == N - 1 && wrong.window ? wrong.window
               : row < 3                    ? row
               : row < FIRST                ? 0
                                            : row % 3;
    }
}

static int code_of(int row, int band, int m, int c)
{
    return row == N - 1 && wrong.code ? wrong.code : (50 * row + 31 * band + 7 * m + 90 * c) % 256;
}

struct bytes {
    unsigned char at[1 << 15];
    size_t n;
};

static void append(struct bytes *b, const void *data, size_t n)
{
    memcpy(b->at + b->n, data, n);
    b->n += n;
}

static void put_number(struct bytes *b, uint64_t v, int n)
{
    for (int k = 0; k < n; k++)
        b->at[b->n++] = (unsigned char)(v >> 8 * k);
}

static void put_reals(struct bytes *b, const double *v, int n)
{
    for (int k = 0; k < n; k++) {
        uint64_t bits;

        memcpy(&bits, &v[k], 8);
        put_number(b, bits, 8);
    }
}

static void put_text(struct bytes *b, const char *text)
{
    put_number(b, strlen(text), 4);
    append(b, text, strlen(text));
}

static void put_packed(struct bytes *b, int codec, const unsigned char *data, size_t n)
{
    unsigned char *out = NULL, small[1 << 13];
    size_t n_room = 0, n_out = 0;
    uLongf n_small = sizeof small;

    if (codec ? spin_zstd_write(data, n, 1, &out, &n_room, &n_out) != SPIN_OK
              : compress(small, &n_small, data, n) != Z_OK)
        exit(1);
    put_number(b, codec ? n_out : n_small, 8);
    append(b, codec ? out : small, codec ? n_out : n_small);
    free(out);
}

static uint32_t zigzag(int v) { return v < 0 ? (uint32_t)(-2 * v - 1) : (uint32_t)(2 * v); }

/* Values [n][width]; a mode that is constant takes the first row. */
static void put_stream(struct bytes *b, int a, int symbol, int mode, int codec, int width,
                       const int *values, int n)
{
    unsigned char planes[1 << 13];
    size_t n_symbols = (size_t)(width * (mode == 2 ? 1 : n));

    for (size_t i = 0; i < n_symbols; i++) {
        int before = mode == 1 && i >= (size_t)width ? values[i - (size_t)width] : 0;

        for (int k = 0; k < symbol; k++)
            planes[(size_t)k * n_symbols + i] =
                (unsigned char)(zigzag(values[i] - before) >> 8 * k);
    }
    put_number(b, (uint64_t)a, 1);
    put_number(b, (uint64_t)symbol, 1);
    put_number(b, (uint64_t)mode, 1);
    put_number(b, (uint64_t)codec, 1);
    put_number(b, (uint64_t)width, 1);
    put_number(b, (uint64_t)n, 4);
    put_packed(b, codec, planes, n_symbols * (size_t)symbol);
}

static void put_record(struct bytes *b, int opcode, const struct bytes *content)
{
    if (wrong.left_out == opcode)
        return;
    for (int k = 0; k < (wrong.again == opcode ? 2 : 1); k++) {
        put_number(b, (uint64_t)opcode, 1);
        put_number(b, content->n, 8);
        append(b, content->at, content->n);
    }
}

/* Streams from the last attribute to the first, and two that are to be passed over. */
static void put_chunk(struct bytes *b, int chunk)
{
    static const int symbol[11] = {4, 1, 1, 2, 2, 2, 2, 2, 1, 1, 1};
    static struct bytes content, streams;
    int first = chunk ? FIRST : 0, last = chunk ? N : FIRST, values[15 * N];

    streams.n = content.n = 0;
    for (int a = 10; a >= 0; a--) {
        int w = channels[a], mode = a == WINDOW && !chunk && !wrong.window ? 0 : a % 2;

        for (int i = first; i < last; i++)
            for (int c = 0; c < w; c++)
                values[w * (i - first) + c] = step_of(a, i, c);
        put_stream(&streams, a, mode == 1 && symbol[a] == 1 ? 2 : symbol[a], mode, (a + chunk) % 2,
                   w, values, last - first);
    }
    memset(values, 0, sizeof values);
    put_stream(&streams, 12, 4, 2, 0, 1, values, last - first);
    streams.at[streams.n] = 200;
    memset(streams.at + streams.n + 1, 77, 8);
    streams.n += 9;
    put_number(&streams, 3, 8);
    append(&streams, "abc", 3);

    put_reals(&content, intervals[chunk], 2);
    put_number(&content, 0, 4);
    put_number(&content, (uint64_t)(last - first), 4);
    put_text(&content, chunk ? "zstd" : "");
    put_number(&content, streams.n, 8);
    if (chunk)
        put_packed(&content, 1, streams.at, streams.n);
    else {
        put_number(&content, streams.n, 8);
        append(&content, streams.at, streams.n);
    }
    put_record(b, 5, &content);
    for (int band = 2; band >= 1; band--) {
        int w = 2 * band + 1;

        content.n = 0;
        for (int i = first; i < last; i++)
            for (int k = 0; k < 3 * w; k++)
                values[3 * w * (i - first) + k] = code_of(i, band, k % w, k / w);
        put_number(&content, (uint64_t)band, 1);
        put_stream(&content, 7, 2, 0, 0, 3 * w, values, last - first);
        put_record(b, 7, &content);
    }
}

/* A sound with a place in the scene if `at` is set. */
static void put_source(struct bytes *b, int id, bool at)
{
    const double pose[7] = {1, 2, 3, 0, 0, 0, sounds.turn};
    const double when[3] = {0.5, sounds.length, sounds.gain}, times[2] = {0, sounds.time};
    struct bytes content = {.n = 0};

    put_number(&content, (uint64_t)id, 4);
    put_text(&content, id == 1 ? "one" : "two");
    put_text(&content, "flac");
    put_text(&content, "mono");
    put_number(&content, 5, 8);
    put_reals(&content, when, 3);
    put_number(&content, at ? 1 : 2, 1);
    put_reals(&content, pose, 7);
    put_number(&content, at ? 2 : 0, 4);
    for (int k = 0; at && k < 2; k++) {
        put_reals(&content, &times[k], 1);
        put_reals(&content, pose, 7);
    }
    put_text(&content, sounds.how);
    put_record(b, 0x11, &content);
}

static void put_sounds(struct bytes *b)
{
    for (int id = 1; id <= sounds.n; id++) {
        struct bytes content = {.n = 0};

        put_source(b, id, id == 1);
        put_number(&content, (uint64_t)id, 4);
        put_number(&content, 5, 8);
        append(&content, id == 1 ? "fLaC1" : "fLaC2", 5);
        for (int k = 0; k < 1 + sounds.twice && id != sounds.without_data; k++)
            put_record(b, 0x12, &content);
    }
    if (sounds.old)
        put_record(b, 9, &(struct bytes){.n = 0});
}

static void put_metadata(struct bytes *b, const char *value)
{
    struct bytes content = {.n = 0}, map = {.n = 0};

    put_text(&map, "sound_start");
    put_text(&map, value);
    put_text(&content, "spin4d");
    put_number(&content, map.n, 4);
    append(&content, map.at, map.n);
    put_record(b, 0x0b, &content);
}

static struct bytes *make(void)
{
    static struct bytes b;
    struct bytes content = {.n = 0};
    const double duration = 2.5, box[6] = {0};
    size_t index;

    b.n = 0;
    append(&b,
           "\x89"
           "4DGS1\r\n",
           8);
    put_text(&content, "");
    put_text(&content, "");
    put_reals(&content, &duration, 1);
    put_number(&content, (uint64_t)(N + wrong.n_more), 8);
    put_reals(&content, &cutoff, 1);
    put_text(&content, "gaussian-birth");
    put_reals(&content, box, 6);
    put_number(&content, 2, 1);
    put_number(&content, sounds.declared, 1);
    append(&content, "\0\0\0\0more of a later writer", 27);
    put_record(&b, 1, &content);

    content.n = 0;
    put_text(&content, "uniform-v1");
    put_reals(&content, origin, 3);
    put_reals(&content, steps, 8);
    append(&content, "\1\0\0\0\0", 5);
    put_record(&b, 3, &content);

    content.n = 0;
    put_number(&content, N_WINDOWS, 4);
    put_reals(&content, windows[0], 2 * N_WINDOWS);
    put_record(&b, 4, &content);
    content.n = 0;
    put_number(&content, 0, 8);
    put_record(&b, 0x80, &content);
    if (sounds.metadata)
        put_metadata(&b, sounds.metadata);
    if (!sounds.late)
        put_sounds(&b);
    content.n = 0;
    put_number(&content, 1, 4);
    put_number(&content, 0, 1);
    put_number(&content, wrong.track, 4);
    put_record(&b, 0x25, &content);
    put_chunk(&b, 0);
    put_chunk(&b, 1);
    if (sounds.late)
        put_sounds(&b);
    if (wrong.delta)
        put_record(&b, 0x10, &content);
    index = b.n;
    put_record(&b, 8, &content); /* not read, but checked */
    content.n = 0;
    put_number(&content, index, 8);
    put_number(&content, 0, 8);
    put_number(&content, spin_crc32(0, b.at + index, b.n - index), 4);
    put_record(&b, 2, &content);
    append(&b,
           "\x89"
           "4DGS1\r\n",
           8);
    return &b;
}

/* ---- What is read ------------------------------------------------------------------------------
 */

static double bounded(double x, double least, double most) { return fmin(fmax(x, least), most); }

/* The largest differences of a row, and whether it is cut where it should be. */
static bool compare_row(const struct spin_splats_4d *s, int i, double *worst)
{
    const double *w = windows[step_of(WINDOW, i, 0)], *in = intervals[i >= FIRST];
    double sigma = exp(step_of(SIGMA, i, 0) * steps[S_SIGMA]), k = sqrt(-2 * log(cutoff));
    bool never = step_of(FLAGS, i, 0) == 1;
    double life = bounded(never ? w[1] - w[0] : k * sigma, 0.02, 2);
    double velocity = steps[S_MOTION] / pow(2, bounded(ceil(log2(life / 0.5)), -4, 2));
    double fine = never ? 0 : bounded(floor(log2(fmin(1, 0.05 * sigma / steps[S_TIME]))), -10, 0);
    double green = step_of(COLOUR, i, 0), sum = 0, q[4] = {0}, length = 0, dot = 0;
    double first = fmax(w[0], in[0]), end = fmin(w[1], in[1]);
    int largest = step_of(LARGEST, i, 0);

    for (int c = 0, at = 0; c < 4; c++)
        if (c != largest) {
            q[c] = bounded(step_of(ROTATION, i, at++) * steps[S_ROTATION], -1, 1);
            sum += q[c] * q[c];
        }
    q[largest] = sqrt(fmax(1 - sum, 0));
    for (int c = 0; c < 4; c++) {
        length += q[c] * q[c];
        dot += q[c] * s->quats[4 * i + (c + 1) % 4];
    }
    worst[0] = larger(worst[0], fabs(dot / sqrt(length) - 1));
    for (int c = 0; c < 3; c++) {
        double colour = green + (c == 1 ? 0 : step_of(COLOUR, i, c == 0 ? 1 : 2));
        const float *sh = s->sh + 27 * i;

        worst[1] = larger(worst[1], fabs(s->centres[3 * i + c] - origin[c] -
                                         step_of(POSITION, i, c) * steps[S_POSITION]));
        worst[2] = larger(worst[2],
                          fabs(s->log_scales[3 * i + c] - step_of(SCALE, i, c) * steps[S_SCALE]));
        worst[3] = larger(worst[3], fabs(0.5 + 0.28209479177387814 * sh[c] -
                                         bounded(colour * steps[S_COLOUR], 0, 1)));
        worst[4] = larger(worst[4], fabs(s->paths[3 * i + c] - step_of(MOTION, i, c) * velocity));
        for (int band = 1; band <= 2; band++)
            for (int m = 0; m <= 2 * band; m++)
                worst[5] = larger(worst[5], fabs(sh[3 * (band * band + m) + c] + 4 -
                                                 8 * code_of(i, band, m, c) / 255.0));
    }
    worst[6] = larger(worst[6], fabs(1 / (1 + exp(-(double)s->logit_opacities[i])) -
                                     bounded(step_of(OPACITY, i, 0) * steps[S_OPACITY], 0, 1)));
    worst[7] =
        larger(worst[7], fabs(s->times[i] - step_of(MU, i, 0) * steps[S_TIME] * pow(2, fine)));
    return (never ? s->sigmas[i] == SPIN_FOREVER : fabs(s->sigmas[i] / sigma - 1) < 1e-6) &&
           (double)s->cuts[2 * i] <= first && first - (double)s->cuts[2 * i] < 1e-6 &&
           (double)s->cuts[2 * i + 1] <= end && end - (double)s->cuts[2 * i + 1] < 1e-6;
}

static spin_status read_file(const unsigned char *bytes, size_t n, struct spin_4dgs *info,
                             struct spin_splats_4d *out)
{
    spin_status status = spin_4dgs_read(bytes, n, info, out);
    size_t n_dropped;

    return status == SPIN_OK ? spin_splats_4d_finish(out, &n_dropped, NULL) : status;
}

static void test_values(void)
{
    static const char *const what[8] = {"rotations", "centres",     "log scales", "colours",
                                        "paths",     "SH of bands", "opacities",  "own times"};
    double worst[8] = {0};
    struct spin_splats_4d s = {0};
    struct spin_4dgs info;
    struct bytes *b = make();
    int n_windows = 0;

    if (!ok(read_file(b->at, b->n, &info, &s) == SPIN_OK && s.n == N && s.degree == 1 &&
                s.sh_degree == 2 && info.duration == 2.5 && info.cutoff == cutoff &&
                s.least_weight == cutoff && !info.sound.data && !*info.sound_notes && !info.camera,
            "all splats are read, with a cutoff of %g", cutoff))
        printf("#   %s\n", spin_last_error());
    for (int i = 0; i < N && s.n == N; i++)
        n_windows += compare_row(&s, i, worst);
    for (int k = 0; k < 8; k++)
        near(worst[k], 0, k == 1 ? 1e-5 : 2e-6, what[k]);
    ok(n_windows == N, "windows and sigmas of all rows");
    spin_splats_4d_free(&s);
}

/* ---- What is refused ---------------------------------------------------------------------------
 */

static void refused(struct bytes *b, const char *word, const char *what)
{
    unsigned char *copy = malloc(b->n);
    struct spin_splats_4d s = {0};
    struct spin_4dgs info;

    memcpy(copy, b->at, b->n);
    if (!ok(read_file(copy, b->n, &info, &s) != SPIN_OK && strstr(spin_last_error(), word), "%s",
            what))
        printf("#   %s\n", spin_last_error());
    spin_splats_4d_free(&s);
    free(copy);
    memset(&wrong, 0, sizeof wrong);
}

/* The content of a record. */
static unsigned char *content_of(struct bytes *b, int opcode)
{
    size_t at = 8;

    while (b->at[at] != opcode)
        at += 9 + spin_u32_at(b->at + at + 1);
    return b->at + at + 9;
}

static void test_lies(void)
{
    static const struct {
        int record;
        size_t at;
        uint64_t value;
        int n;
        const char *word, *what;
    } lies[] = {
        {1, 8, 0, 8, "the duration is 0,", "no duration"},
        {1, 24, 0, 8, "the cutoff is 0,", "a cutoff of 0"},
        {1, 24, 0x4000000000000000, 8, "the cutoff is 2,", "one above 1"},
        {1, 36, 'k', 1, "temporal model 'kaussian-birth'", "another temporal model, by name"},
        {1, 98, 4, 1, "the SH degree is 4", "SH degree 4"},
        {1, 98, 3, 1, "an SH band is missing, expected bands 1 to 3",
         "a degree whose bands are missing"},
        {1, 98, 1, 1, "SH band 2 occurs twice, precedes all chunks, or is above",
         "and one with more bands"},
        {1, 4, 0xffffff, 4, "record 01 at byte 8 is too short", "text that ends behind its record"},
        {3, 4, 'x', 1, "quantization: scheme 'xniform-v1'", "another quantization, by name"},
        {3, 14, 0x7ff0000000000000, 8, "origin or a step is not finite", "an infinite origin"},
        {3, 94, 0x7ff8000000000000, 8, "origin or a step is not finite",
         "a step that is not a number"},
        {4, 0, 0, 4, "no splat is visible", "no window"},
        {4, 0, 9, 4, "9 windows do not fit into 48 bytes", "more windows than bytes"},
        {4, 4, 0x7ff8000000000000, 8, "window 0", "a window that is not a number"},
        {5, 0, 0x7ff8000000000000, 8, "chunk 0: the start or end of the interval",
         "an interval that is not a number"},
        {5, 8, 0x7ff8000000000000, 8, "chunk 0: the start or end of the interval",
         "an end that is not one"},
        {5, 20, 15, 4, "chunks contain 24 splats, the header declares 23",
         "other numbers of splats"},
        {5, 28, 9, 8, "cannot unpack to 9 bytes", "another length of the streams"},
        {5, 44, 9, 1, "chunk 0: stream 'flags' occurs twice", "an attribute twice"},
        {5, 44, 99, 1, "chunk 0: stream 'window_index' is missing", "and one that is missing"},
        {5, 45, 3, 1, "'window_index': symbols of 3 bytes", "symbols of 3 bytes"},
        {5, 46, 3, 1, "'window_index': symbols of 1 bytes and mode 3", "another mode"},
        {5, 47, 2, 1, "'window_index': codec 2 is not supported", "another codec, by name"},
        {5, 48, 2, 1, "'window_index': 14 splats with 2 values each, expected 14 with 1 each",
         "other channels"},
        {5, 49, 13, 4, "'window_index': 13 splats with 1 values each",
         "another number of elements"},
        {5, 53, 0xffffff, 4, "chunk 0: a stream extends beyond the chunk",
         "a stream that ends behind it"},
        {5, 61, 0xff, 1, "'window_index': the zlib", "a damaged stream"},
        {7, 0, 3, 1, "SH band 3", "another band"},
        {7, 0, 1, 1, "SH band 1: 14 splats with 15 values each, expected 14 with 9 each",
         "a band as another"},
        {2, 16, 1, 4, "the checksum of the index", "a wrong checksum"},
        {2, 0, 0xffffff, 4, "the checksum of the index", "an index behind the file"},
    };
    static const struct {
        int again, left_out;
        const char *word;
    } records[] = {{1, 0, "record 01 occurs twice"},
                   {3, 0, "record 03 occurs twice"},
                   {4, 0, "record 04 occurs twice"},
                   {2, 0, "record 02 occurs twice"},
                   {0, 1, "precedes the header"},
                   {0, 3, "record 'quantization' is missing"},
                   {0, 4, "record 'window table' is missing"},
                   {0, 2, "is not a footer"}};
    struct bytes *b;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        struct bytes to = {.n = 0};

        b = make();
        put_number(&to, lies[i].value, lies[i].n);
        memcpy(content_of(b, lies[i].record) + lies[i].at, to.at, to.n);
        refused(b, lies[i].word, lies[i].what);
    }
    for (size_t i = 0; i < sizeof records / sizeof *records; i++) {
        wrong.again = records[i].again;
        wrong.left_out = records[i].left_out;
        refused(make(), records[i].word, records[i].word);
    }
    wrong.window = N_WINDOWS;
    refused(make(), "'window_index' is 3 in row 8, but there are 3", "a window outside the table");
    wrong.window = -1;
    refused(make(), "'window_index' is -1", "and one below it");
    wrong.largest = 4;
    refused(make(), "'rotation_index' is 4 in row 8", "a component that rotations do not have");
    wrong.code = 256;
    refused(make(), "chunk 1: SH band 2: code 256 in row 8", "an SH code above a byte");
    wrong.n_more = 1;
    refused(make(), "chunks contain 23 splats, the header declares 24",
            "splats that are not there");
    wrong.delta = true;
    refused(make(), "is a delta chunk", "a delta chunk in a birth file");
    wrong.track = true;
    refused(make(), "object tracks", "tracks of objects, by name");
    b = make();
    b->at[5] = '2';
    refused(b, "not a .4dgs of version 1", "another version");
}

/* A chunk of four thousand million splats, all of them alike. */
static void test_bomb(void)
{
    struct bytes *b = make();

    memset(content_of(b, 5) + 20, 0xff, 4);
    memset(content_of(b, 1) + 16, 0, 8);
    memcpy(content_of(b, 1) + 16, "\x08\0\0\0\1", 5);
    refused(b, "cannot contain 4294967304 splats", "a bomb");
}

static spin_status read_slice(const unsigned char *bytes, size_t n, struct spin_splats *out)
{
    struct spin_splats_4d s = {0};
    struct spin_4dgs info;
    spin_status status = read_file(bytes, n, &info, &s);

    if (status == SPIN_OK)
        status = spin_splats_4d_slice(&s, 0.5, ALL, out);
    spin_splats_4d_free(&s);
    return status;
}

static void no_sounds(void)
{
    memset(&sounds, 0, sizeof sounds);
    sounds.declared = true;
    sounds.length = sounds.gain = sounds.turn = sounds.time = 1;
    sounds.how = "linear";
}

static struct spin_4dgs read_sounds(void)
{
    struct spin_splats_4d s = {0};
    struct spin_4dgs info = {0};
    struct bytes *b = make();

    if (!ok(read_file(b->at, b->n, &info, &s) == SPIN_OK, "a file with %d sounds", sounds.n))
        printf("#   %s\n", spin_last_error());
    spin_splats_4d_free(&s);
    return info;
}

static bool is_sound(const struct spin_4dgs *info, const char *name, const char *data, double start)
{
    const struct spin_sound *s = &info->sound;

    return s->data && s->size == 5 && memcmp(s->data, data, 5) == 0 && !strcmp(s->name, name) &&
           !strcmp(s->type, "flac") && s->start == start;
}

static void test_sounds(void)
{
    struct spin_4dgs info;

    no_sounds();
    sounds.n = 1;
    sounds.gain = 0.25;
    info = read_sounds();
    ok(is_sound(&info, "one", "fLaC1", 0.5) && info.sound.gain == 0.25 &&
           strstr(info.sound_notes, "the sound 'one' is imported without its position") ==
               info.sound_notes &&
           !strstr(info.sound_notes, "repeats"),
       "a sound in a place");
    sounds.n = 2;
    sounds.metadata = "-1.5";
    info = read_sounds();
    ok(is_sound(&info, "two", "fLaC2", -1.5) && strstr(info.sound_notes, "has 2 sounds") &&
           strstr(info.sound_notes, "only once") && !strstr(info.sound_notes, "position"),
       "of two, the one without a place, which begins before the clip: %s", info.sound_notes);
    sounds.late = true;
    sounds.declared = false;
    sounds.metadata = "1.5";
    info = read_sounds();
    ok(is_sound(&info, "two", "fLaC2", 0.5) &&
           strstr(info.sound_notes, "follows the first chunk") &&
           strstr(info.sound_notes, "declares no sound"),
       "sound that the header denies, after the splats");
    no_sounds();
    info = read_sounds();
    ok(!info.sound.data && strstr(info.sound_notes, "but the file has none"), "no sound at all");
    sounds.old = true;
    info = read_sounds();
    ok(!info.sound.data && strstr(info.sound_notes, "record 09"), "sound of the older form");
}

static void test_bad_sounds(void)
{
    no_sounds();
    sounds.n = 1;
    sounds.old = true;
    refused(make(), "record 09 and in record 11", "two forms of sound");
    sounds.old = false;
    sounds.without_data = 1;
    refused(make(), "sound 1 has no data", "a source alone");
    sounds.without_data = 0;
    sounds.twice = true;
    refused(make(), "data twice", "data that come twice");
    sounds.twice = false;
    sounds.length = 0;
    refused(make(), "duration of 0 s", "a sound of no length");
    sounds.length = 1;
    sounds.gain = -1;
    refused(make(), "gain is -1", "a negative gain");
    sounds.gain = 1;
    sounds.turn = 0.5;
    refused(make(), "invalid position or rotation", "a rotation that is none");
    sounds.turn = 1;
    sounds.time = 2.6;
    refused(make(), "not in ascending order within the clip", "a keyframe after the clip");
    sounds.time = 1;
    sounds.how = "cubic";
    refused(make(), "neither linear nor step", "an unknown interpolation");
}

TAP_MAIN
{
    struct bytes *b;

    if (spin_zstd_need() != SPIN_OK) {
        skip("4dgs", spin_last_error());
        return;
    }
    sounds.how = "linear";
    test_values();
    cutoff = 0.5;
    test_values();
    test_lies();
    test_bomb();
    b = make();
    check_hostile(read_slice, b->at, b->n, 0);
    test_sounds();
    test_bad_sounds();
}
