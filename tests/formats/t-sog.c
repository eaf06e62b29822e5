/* K: sog formats import
 * SOG by the words of its description, apart from its reader and writer: five Gaussians in all the
 * forms that it has. */
#include <unistd.h>

#include "formats/sog.h"
#include "io/webp.h"
#include "tests/check.h"
#include "tests/formats/splats.h"

enum { N = 5, SIDE = 4, WIDE = 64 * 3, PALETTE = 70 };

static uint8_t pixels[SPIN_SOG_PICTURES][4 * 2 * WIDE];
static const char *const names[SPIN_SOG_PICTURES] = {
    "means_l.webp", "means_u.webp",    "quats.webp",        "scales.webp",
    "sh0.webp",     "shN_labels.webp", "shN_centroids.webp"};
static const double mins[3] = {-3, -0.5, 1}, maxs[3] = {2, 0.75, 1};
static const char *folder;

static const char *path_of(const char *name)
{
    static char path[2][300];
    static int k;

    k = !k;
    snprintf(path[k], sizeof path[k], "%s/%s", folder, name);
    return path[k];
}

static void write_file(const char *name, const void *bytes, size_t n)
{
    FILE *file = fopen(path_of(name), "wb");

    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0)
        exit(1);
}

/* Images with random values in every byte that the format uses. */
static void make_pictures(void)
{
    uint32_t seed = 77;

    for (int p = 0; p < SPIN_SOG_PICTURES; p++) {
        bool wide = p == SPIN_SOG_CENTROIDS;
        unsigned char *packed;
        size_t n;

        for (size_t i = 0; i < sizeof pixels[p]; i++)
            pixels[p][i] = (uint8_t)draw(&seed, 0, 255.99f);
        pixels[p][0] = 0; /* the first of every book */
        for (size_t i = 0; i < N && p == SPIN_SOG_LABELS; i++) {
            pixels[p][4 * i] = (uint8_t)(i == 0 ? 69 : 17 * i);
            pixels[p][4 * i + 1] = 0;
        }
        for (size_t i = 0; i < N && p == SPIN_SOG_QUATS; i++)
            pixels[p][4 * i + 3] = (uint8_t)(252 + i % 4);
        if (spin_webp_write(pixels[p], wide ? WIDE : SIDE, wide ? 2 : SIDE, 3, &packed, &n) !=
            SPIN_OK)
            exit(1);
        write_file(names[p], packed, n);
        free(packed);
    }
}

/* ---- meta.json ------------------------------------------------------------------------------- */

static bool first_is_null; /* of every book: one step below the second, where 255 lie between that
                              and the last */

static double book_of(int which, int k)
{
    return (k == 0 && first_is_null ? -99 - 254 / 255.0 : k - 100) * 0.02 + 0.5 * which;
}

static size_t print_book(char *at, int which, bool null)
{
    char *begin = at;

    at += sprintf(at, "\"codebook\":[");
    for (int k = 0; k < 256; k++)
        at += k == 0 && null ? sprintf(at, "null")
                             : sprintf(at, "%s%.17g", k ? "," : "", book_of(which, k));
    return (size_t)(at + sprintf(at, "],") - begin);
}

static char meta[40000];

static void make_meta(int version, bool sh, bool null)
{
    char *at = meta;

    first_is_null = null;
    at += sprintf(at,
                  version == 2 ? "{\"version\":2,\"count\":%d,\"model\":\"antialiased\",\"means\":{"
                               : "{\"means\":{\"shape\":[%d,3],",
                  N);
    at += sprintf(
        at,
        "\"mins\":[%g,%g,%g],\"maxs\":[%g,%g,%g],\"files\":[\"means_l.webp\",\"means_u.webp\"]}",
        mins[0], mins[1], mins[2], maxs[0], maxs[1], maxs[2]);
    at += sprintf(at, ",\"scales\":{");
    at += version == 2 ? print_book(at, 0, null)
                       : (size_t)sprintf(at, "\"mins\":[-7,-6,-5],\"maxs\":[-1,0,1],");
    at += sprintf(at, "\"files\":[\"scales.webp\"]},\"quats\":{\"encoding\":\"quaternion_packed\","
                      "\"files\":[\"quats.webp\"]},\"sh0\":{");
    at += version == 2 ? print_book(at, 1, null)
                       : (size_t)sprintf(at, "\"mins\":[-1,-2,-3,-4],\"maxs\":[1,2,3,5],");
    at += sprintf(at, "\"files\":[\"sh0.webp\"]}");
    if (sh) {
        at += sprintf(at,
                      version == 2 ? ",\"shN\":{\"bands\":1,\"count\":%d,"
                                   : ",\"shN\":{\"shape\":[5,9],\"mins\":-2,\"maxs\":3,",
                      PALETTE);
        at += version == 2 ? print_book(at, 2, null) : 0;
        at += sprintf(at, "\"files\":[\"shN_centroids.webp\",\"shN_labels.webp\"]}");
    }
    sprintf(at, "}");
}

static spin_status read_loose(const unsigned char *bytes, size_t n, struct spin_splats *out)
{
    return spin_sog_read(bytes, n, folder, ALL, out);
}

static spin_status read_zip(struct spin_splats *out)
{
    struct spin_zip_writer w;
    struct spin_map map;
    spin_status status;

    if (spin_zip_writer_open(path_of("all.sog"), true, &w) != SPIN_OK ||
        spin_zip_member_whole(&w, "meta.json", meta, strlen(meta), NULL, 0) != SPIN_OK)
        exit(1);
    for (int p = 0; p < SPIN_SOG_PICTURES; p++) {
        if (spin_map_open(path_of(names[p]), &map) != SPIN_OK ||
            spin_zip_member_whole(&w, names[p], map.data, map.size, NULL, 0) != SPIN_OK)
            exit(1);
        spin_map_close(&map);
    }
    if (spin_zip_writer_commit(&w) != SPIN_OK || spin_map_open(path_of("all.sog"), &map) != SPIN_OK)
        exit(1);
    status = spin_sog_read(map.data, map.size, NULL, ALL, out);
    spin_map_close(&map);
    return status;
}

/* ---- What it says ------------------------------------------------------------------------------
 */

static double between(double a, double b, int k) { return a + (b - a) * k / 255; }

static void check_decoded(const struct spin_splats *s, int version, bool sh, bool null)
{
    double worst[5] = {0};

    for (size_t i = 0; i < N; i++) {
        const uint8_t *q = pixels[SPIN_SOG_QUATS] + 4 * i, *sh0 = pixels[SPIN_SOG_SH0] + 4 * i;
        size_t label = pixels[SPIN_SOG_LABELS][4 * i];
        double want[4], rest = 1, alpha = sh0[3] / 255.0, logit = between(-4, 5, sh0[3]);
        int from = 0;

        for (size_t c = 0; c < 3; c++) {
            int low = pixels[SPIN_SOG_MEANS_LOW][4 * i + c],
                high = pixels[SPIN_SOG_MEANS_HIGH][4 * i + c];
            int k = pixels[SPIN_SOG_SCALES][4 * i + c], d = sh0[c];
            double v = mins[c] + (maxs[c] - mins[c]) * (low + 256 * high) / 65535;
            double place = (v < 0 ? -1 : 1) * (exp(fabs(v)) - 1);
            double scale =
                version == 2 ? book_of(0, k) : between(-7 + (double)c, -1 + (double)c, k);
            double dc = version == 2 ? book_of(1, d) : between(-1 - (double)c, 1 + (double)c, d);

            worst[0] = larger(worst[0], fabs(place - (double)s->means[3 * i + c]));
            worst[1] = larger(worst[1], fabs(scale - (double)s->log_scales[3 * i + c]));
            worst[2] = larger(worst[2], fabs(dc - (double)s->sh[(sh ? 12 : 3) * i + c]));
            for (size_t k1 = 0; k1 < 3 && sh; k1++) {
                int b =
                    pixels[SPIN_SOG_CENTROIDS][4 * (label / 64 * WIDE + label % 64 * 3 + k1) + c];

                worst[2] =
                    larger(worst[2], fabs((version == 2 ? book_of(2, b) : between(-2, 3, b)) -
                                          (double)s->sh[12 * i + 3 + 3 * k1 + c]));
            }
        }
        for (int k = 0; k < 4; k++) {
            want[k] = k == q[3] - 252 ? 0 : (q[from++] / 255.0 * 2 - 1) / sqrt(2);
            rest -= want[k] * want[k];
        }
        want[q[3] - 252] = sqrt(fmax(rest, 0));
        for (int k = 0; k < 4; k++) /* those that are too long are shortened */
            worst[3] = larger(worst[3], fabs(want[k] / sqrt(fmax(1, 1 - rest)) -
                                             (double)s->quats[4 * i + (size_t)k]));
        worst[4] = larger(
            worst[4], version == 1 ? fabs(logit - (double)s->logit_opacities[i])
                                   : fabs(1 / (1 + exp(-(double)s->logit_opacities[i])) - alpha));
    }
    ok(worst[0] < 2e-6 && worst[1] < 1e-6 && worst[2] < 1e-6 && worst[3] < 1e-6 && worst[4] < 1e-6,
       "version %d%s%s: places %.2g, scales %.2g, colours %.2g, rotations %.2g, opacities %.2g",
       version, sh ? ", SH" : "", null ? ", null in the books" : "", worst[0], worst[1], worst[2],
       worst[3], worst[4]);
    ok(s->antialias == (version == 2), "and how it is drawn");
}

static void test_values(int version, bool sh, bool null)
{
    struct spin_splats s = {0};

    make_meta(version, sh, null);
    if (ok(read_loose((const unsigned char *)meta, strlen(meta), &s) == SPIN_OK && s.n == N &&
               s.sh_degree == sh,
           "version %d in loose files: %s", version, spin_last_error()))
        check_decoded(&s, version, sh, null);
    if (ok(read_zip(&s) == SPIN_OK && s.n == N, "and in a zip: %s", spin_last_error()))
        check_decoded(&s, version, sh, null);
    spin_splats_free(&s);
}

/* ---- What is refused ----------------------------------------------------------------------------
 */

static void replace(const char *from, const char *to)
{
    char *at = strstr(meta, from), rest[sizeof meta];

    if (!at)
        exit(1);
    snprintf(rest, sizeof rest, "%s", at + strlen(from));
    sprintf(at, "%s%s", to, rest);
}

static void test_lies(void)
{
    static const struct {
        int version;
        const char *from, *to, *word;
    } cases[] = {
        {1, "quaternion_packed", "euler", "'quats.encoding' is 'euler'"},
        {1, "\"shape\":[5,3]", "\"shape\":[-1,3]", "'shape'"},
        {1, "\"shape\":[5,3]", "\"shape\":[99999,3]", "pixels"},
        {1, "\"shape\":[5,9]", "\"shape\":[5,10]", "'shN'"},
        {1, "\"shape\":[5,9]", "\"shape\":[5,24]", "centroids"},
        {1, "\"mins\":-2", "\"mins\":null", "'shN'"},
        {1, "\"maxs\":3", "\"maxs\":1e10", "'shN'"},
        {1, "[-7,-6,-5]", "[-7,-6]", "'mins'"},
        {1, "[1,2,3,5]", "[1,2,3]", "'maxs'"},
        {2, "[-3,-0.5,1]", "[-3,-1e10,1]", "'mins'"},
        {2, "\"version\":2", "\"version\":\"2\"", "version"},
        {2, "\"quats.webp\"", "\"../quats.webp\"", "image 'quats.webp' is missing"},
        {2, "\"quats.webp\"", "\"\"", "image 'quats.webp' is missing"},
        {2, "\"quats.webp\"", "\"no.webp\"", "no.webp"},
        {2, "\"quats.webp\"", "\"meta.json\"", "not a WebP"},
        {2, "\"count\":70", "\"count\":69", "SH vector 69, but the palette has only 69 vectors"},
    };
    struct spin_splats s = {0};

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        bool good;

        make_meta(cases[i].version, true, false);
        write_file("meta.json", meta, strlen(meta));
        replace(cases[i].from, cases[i].to);
        good = read_loose((const unsigned char *)meta, strlen(meta), &s) != SPIN_OK &&
               strstr(spin_last_error(), cases[i].word);
        if (!ok(good, "%s for %s", cases[i].to, cases[i].from))
            printf("#   %s\n", spin_last_error());
    }
    spin_splats_free(&s);
}

/* A decompression bomb of a few kilobytes: an image of the largest allowed size, in which every
 * pixel is the same Gaussian. */
static void test_bomb(void)
{
    enum { MANY = 1400 };
    unsigned char *blank = calloc(MANY * MANY, 4), *packed;
    struct spin_splats s = {0};
    size_t n;

    if (!blank || spin_webp_write(blank, MANY, MANY, 0, &packed, &n) != SPIN_OK)
        exit(1);
    write_file("blank.webp", packed, n);
    make_meta(2, false, false);
    replace("\"count\":5", "\"count\":1900000");
    for (int p = 0; p < SPIN_SOG_LABELS; p++)
        replace(names[p], "blank.webp");
    ok(n < 20000 && read_loose((const unsigned char *)meta, strlen(meta), &s) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "cannot contain 1900000 splats"),
       "a bomb of %zu bytes: %s", n, spin_last_error());
    free(blank);
    free(packed);
    spin_splats_free(&s);
}

TAP_MAIN
{
    if (spin_webp_need() != SPIN_OK) {
        skip("sog", spin_last_error());
        return;
    }
    folder = check_folder();
    make_pictures();
    for (int version = 1; version <= 2; version++) {
        test_values(version, false, false);
        test_values(version, true, false);
    }
    test_values(2, true, true);
    test_lies();
    test_bomb();
}
