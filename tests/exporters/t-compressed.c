/* K: compressed-ply ply export threads */
#include "base/log.h"
#include "io/ply.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_compressed_ply;

static double between(double low, double high, uint32_t step, double n)
{
    return low + (high - low) * step / n;
}

/* Row i as PlayCanvas's reader decodes it. */
static struct want decode(const struct spin_ply *ply, size_t i)
{
    const struct spin_ply_element *chunk = &ply->element[0], *vertex = &ply->element[1];
    float r[18];
    uint32_t word[4];
    struct want w;
    double rest = 1;
    int largest, field = 0;

    memcpy(r, ply->map.data + chunk->data_offset + i / 256 * sizeof r, sizeof r);
    memcpy(word, ply->map.data + vertex->data_offset + i * sizeof word, sizeof word);
    for (int k = 0; k < 3; k++) {
        int shift = k == 0 ? 21 : k == 1 ? 11 : 0;
        uint32_t mask = k == 1 ? 1023 : 2047;

        w.place[k] = between(r[k], r[3 + k], word[0] >> shift & mask, mask);
        w.log_scale[k] = between(r[6 + k], r[9 + k], word[2] >> shift & mask, mask);
        w.dc[k] = (between(r[12 + k], r[15 + k], word[3] >> (24 - 8 * k) & 255, 255) - 0.5) /
                  0.28209479177387814;
    }
    w.opacity = (word[3] & 255) / 255.0;
    largest = (int)(word[1] >> 30);
    for (int k = 0; k < 4; k++) {
        if (k == largest)
            continue;
        w.q[k] = ((word[1] >> (20 - 10 * field++) & 1023) / 1023.0 - 0.5) * sqrt(2);
        rest -= w.q[k] * w.q[k];
    }
    w.q[largest] = sqrt(fmax(rest, 0));
    return w;
}

static size_t nearest(const struct spin_splats *s, const struct want *w)
{
    double best = INFINITY;
    size_t row = 0;

    for (size_t i = 0; i < s->n; i++) {
        double d = 0;

        for (size_t k = 0; k < 3; k++)
            d += (s->means[3 * i + k] - w->place[k]) * (s->means[3 * i + k] - w->place[k]);
        if (d < best) {
            best = d;
            row = i;
        }
    }
    return row;
}

static int rest_is_right(const struct spin_ply *ply, size_t at, const struct spin_splats *s,
                         size_t row, int to)
{
    int n = (to + 1) * (to + 1) - 1, n_from = (s->sh_degree + 1) * (s->sh_degree + 1), good = 1;
    const unsigned char *byte = ply->map.data + ply->element[2].data_offset + at * (size_t)(3 * n);

    for (int j = 0; j < 3 * n; j++) {
        int c = j / n, k = 1 + j % n;
        double want = k < n_from ? s->sh[(row * (size_t)n_from + (size_t)k) * 3 + (size_t)c] : 0;

        good &= fabs((byte[j] + 0.5) * 8 / 256 - 4 - want) < 0.0157;
    }
    return good;
}

/* Names of one element, in order, as one text. */
static void names_of(const struct spin_ply_element *e, char *out, size_t n_out)
{
    size_t at = 0;

    out[0] = '\0';
    for (size_t i = 0; i < e->n_properties && at < n_out; i++)
        at += (size_t)snprintf(out + at, n_out - at, "%s%s", i ? " " : "", e->property[i].name);
}

static void check_header(const struct spin_ply *ply, size_t n, int to)
{
    char text[1024];
    int n_rest = 3 * (to + 1) * (to + 1) - 3;

    ok(ply->n_elements == (to ? 3u : 2u) && strcmp(ply->element[0].name, "chunk") == 0 &&
           strcmp(ply->element[1].name, "vertex") == 0 &&
           ply->element[0].count == (n + 255) / 256 && ply->element[1].count == n &&
           !ply->big_endian && ply->extra_bytes == 0,
       "elements chunk and vertex");
    names_of(&ply->element[0], text, sizeof text);
    is_text(text,
            "min_x min_y min_z max_x max_y max_z min_scale_x min_scale_y min_scale_z max_scale_x "
            "max_scale_y max_scale_z min_r min_g min_b max_r max_g max_b",
            "a chunk's properties");
    names_of(&ply->element[1], text, sizeof text);
    is_text(text, "packed_position packed_rotation packed_scale packed_color",
            "a vertex's properties");
    if (to > 0)
        ok(strcmp(ply->element[2].name, "sh") == 0 && (int)ply->element[2].n_properties == n_rest &&
               ply->element[2].property[0].type == SPIN_PLY_U8 &&
               strcmp(ply->element[2].property[n_rest - 1].name + 7, to == 3   ? "44"
                                                                     : to == 2 ? "23"
                                                                               : "8") == 0,
           "element sh of %d", n_rest);
}

static void test_values(int from, const char *sh, int to, const char *order)
{
    const char *pairs[] = {"sh", sh, "order", order, NULL};
    struct spin_plugin_values values = {pairs};
    char name[64];
    struct spin_splats s = {0};
    struct spin_ply ply;
    int good[6] = {1, 1, 1, 1, 1, 1};
    unsigned char *seen;
    size_t n_seen = 0;

    snprintf(name, sizeof name, "d%d%s%s", from, sh, order);
    struct spin_export_job job = {
        .output = in_folder(name), .n_frames = 1, .sh_degree = from, .values = &values};
    make_frame(&s, 1500, from, 11);
    ok(run(&spin_exporter_compressed_ply, &job, &s, 12) == SPIN_OK, "writes degree %d as %s, %s",
       from, sh, order);
    strcat(name, "/frame_00012.compressed.ply");
    if (!ok(spin_ply_open(in_folder(name), &ply) == SPIN_OK, "opens what it wrote"))
        return;
    check_header(&ply, s.n, to);
    seen = calloc(s.n, 1);
    for (size_t i = 0; i < s.n; i++) {
        struct want got = decode(&ply, i), want;
        size_t row = strcmp(order, "source") ? nearest(&s, &got) : i;

        want = want_of(&s, row);
        n_seen += !seen[row];
        seen[row] = 1;
        for (int k = 0; k < 3; k++) {
            /* Half a quantisation step of the widest possible range: 8, 7 and 1 over C0. */
            good[0] &= fabs(got.place[k] - want.place[k]) < 8 / 1023.0 * 0.501;
            good[1] &= fabs(got.log_scale[k] - want.log_scale[k]) < 7 / 1023.0 * 0.501;
            good[2] &= fabs(got.dc[k] - want.dc[k]) < 0.0071;
        }
        good[3] &= fabs(got.opacity - want.opacity) < 0.00197;
        good[4] &= degrees_between(got.q, want.q) < 0.25;
        good[5] &= to == 0 || rest_is_right(&ply, i, &s, row, to);
    }
    free(seen);
    ok(n_seen == s.n, "every splat is there");
    ok(good[0], "places are within half a step");
    ok(good[1], "log scales are within half a step");
    ok(good[2], "colours are within half a step");
    ok(good[3], "opacities are within half a step");
    ok(good[4], "rotations are within a quarter of a degree");
    ok(good[5], "f_rest is channel-major");
    spin_ply_close(&ply);
    spin_splats_free(&s);
}

/* Neighbours share a chunk: the mean extent of chunks is a fraction of the scene's. */
static void test_morton(void)
{
    struct spin_export_job job = {.output = in_folder("morton"), .n_frames = 1};
    struct spin_splats s = {0};
    struct spin_ply ply;
    float range[6];
    double sum = 0;

    make_frame(&s, 65536, 0, 3);
    ok(run(&spin_exporter_compressed_ply, &job, &s, 0) == SPIN_OK, "writes a large frame");
    if (!ok(spin_ply_open(in_folder("morton/frame_00000.compressed.ply"), &ply) == SPIN_OK,
            "opens it"))
        return;
    for (size_t c = 0; c < 256; c++) {
        memcpy(range, ply.map.data + ply.element[0].data_offset + c * 72, sizeof range);
        for (int k = 0; k < 3; k++)
            sum += (range[3 + k] - range[k]) / 8.0 / (3 * 256);
    }
    ok(sum < 0.3, "a chunk spans %.3f of the scene", sum);
    spin_ply_close(&ply);
    spin_splats_free(&s);
}

static void test_threads(void)
{
    struct spin_splats s = {0};
    struct spin_map one, four;
    struct spin_export_job job = {
        .output = in_folder("one"), .n_frames = 1, .sh_degree = 1, .n_threads = 1};

    make_frame(&s, 20000, 1, 3);
    ok(run(&spin_exporter_compressed_ply, &job, &s, 0) == SPIN_OK, "writes with one thread");
    job.output = in_folder("four");
    job.n_threads = 4;
    ok(run(&spin_exporter_compressed_ply, &job, &s, 0) == SPIN_OK, "and with four");
    if (ok(spin_map_open(in_folder("one/frame_00000.compressed.ply"), &one) == SPIN_OK &&
               spin_map_open(in_folder("four/frame_00000.compressed.ply"), &four) == SPIN_OK,
           "opens both"))
        ok(one.size == four.size && memcmp(one.data, four.data, one.size) == 0, "the same bytes");
    spin_map_close(&one);
    spin_map_close(&four);
    spin_splats_free(&s);
}

static void test_edges(void)
{
    static const size_t counts[] = {0, 1, 255, 256, 257};
    struct spin_splats s = {0};
    struct spin_ply ply;
    struct spin_export_job job = {.output = in_folder("edges"), .n_frames = 1, .force = true};

    for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
        make_frame(&s, counts[i], 0, 1);
        ok(run(&spin_exporter_compressed_ply, &job, &s, 0) == SPIN_OK &&
               spin_ply_open(in_folder("edges/frame_00000.compressed.ply"), &ply) == SPIN_OK &&
               ply.element[1].count == counts[i] && ply.element[0].count == (counts[i] + 255) / 256,
           "writes %zu splats", counts[i]);
        spin_ply_close(&ply);
    }
    make_frame(&s, 14, 1, 2);
    s.logit_opacities[1] = INFINITY;
    for (size_t i = 2; i < 14; i++)
        s.means[3 * i] = 2; /* no extent in x but for two */
    ok(run(&spin_exporter_compressed_ply, &job, &s, 0) == SPIN_OK &&
           spin_ply_open(in_folder("edges/frame_00000.compressed.ply"), &ply) == SPIN_OK &&
           ply.element[1].count == 14,
       "an infinite logit, and hardly any extent in x");
    spin_ply_close(&ply);
    spin_splats_free(&s);
}

TAP_MAIN
{
    static const char *const bad[][2] = {{"order", "size"}, {"sh", "4"}, {"pattern", "%s.ply"}};

    spin_log_set_level(-2);
    test_values(0, "keep", 0, "morton");
    test_values(3, "keep", 3, "morton");
    test_values(2, "keep", 2, "source");
    test_values(3, "1", 1, "source");
    test_values(0, "2", 2, "source");
    test_morton();
    test_threads();
    test_edges();
    check_folder_rules(&spin_exporter_compressed_ply, "frame_00001.compressed.ply", bad,
                       sizeof bad / sizeof bad[0]);
}
