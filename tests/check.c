/* What tests share: fixtures, comparing with golden values, broken copies of files. */
#include "tests/check.h"

#include <errno.h>
#include <ftw.h>
#include <unistd.h>

#include "base/err.h"
#include "scene/bundle.h"
#include "tests/tap.h"

enum { RING = 8, PATH_BYTES = 1024 };

/* A test that cannot have what it needs stops here, as a failure. */
static void give_up(const char *what)
{
    ok(0, "%s: %s", what, spin_last_error());
    exit(tap_done());
}

/* ---- Files --------------------------------------------------------------------------------- */

const char *check_fixture(const char *name)
{
    static char ring[RING][PATH_BYTES];
    static int next;
    const char *root[] = {getenv("SPIN_FIXTURES"), "../shared/fixtures", "fixtures"};

    for (size_t i = 0; i < sizeof root / sizeof root[0]; i++) {
        char *path = ring[next];

        if (!root[i] || !*root[i])
            continue;
        snprintf(path, PATH_BYTES, "%s/%s", root[i], name);
        if (spin_path_exists(path)) {
            next = (next + 1) % RING;
            return path;
        }
    }
    return NULL;
}

static char folders[RING][64];
static int n_folders;

static int remove_entry(const char *path, const struct stat *st, int type, struct FTW *ftw)
{
    (void)st;
    (void)type;
    (void)ftw;
    return remove(path);
}

static void remove_folders(void)
{
    char command[sizeof folders + 100] = "python3 tests/tools/record.py";

    for (int i = 0; i < n_folders && getenv("SPIN_RECORD"); i++) {
        strcat(command, " ");
        strcat(command, folders[i]);
    }
    fflush(stdout);
    if (getenv("SPIN_RECORD") && system(command) != 0)
        printf("#~ not recorded\n");
    for (int i = 0; i < n_folders; i++)
        nftw(folders[i], remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}

const char *check_folder(void)
{
    const char *base = getenv("TMPDIR");
    char *path;

    if (n_folders == RING) {
        spin_fail(SPIN_E_USAGE, "more than %d temporary folders", RING);
        give_up("check_folder");
    }
    path = folders[n_folders];
    snprintf(path, sizeof folders[0], "%s/spin-test-XXXXXX",
             base && *base && strlen(base) < 40 ? base : "/tmp");
    if (!mkdtemp(path)) {
        spin_fail(SPIN_E_IO, "cannot make '%s': %s", path, strerror(errno));
        give_up("check_folder");
    }
    if (n_folders++ == 0)
        atexit(remove_folders);
    return path;
}

const char *check_truncated(const char *path, size_t n)
{
    static char ring[RING][PATH_BYTES];
    static int next;
    static const char *folder;
    struct spin_map map;
    const char *dot = strrchr(spin_path_name(path), '.');
    char *name = ring[next];
    FILE *file;

    if (!folder)
        folder = check_folder();
    snprintf(name, PATH_BYTES, "%s/truncated-%d%s", folder, next, dot ? dot : "");
    next = (next + 1) % RING;
    if (spin_map_open(path, &map) != SPIN_OK)
        give_up("check_truncated");
    file = fopen(name, "wb");
    if (n > map.size)
        n = map.size;
    if (!file || fwrite(map.data, 1, n, file) != n || fclose(file) != 0) {
        spin_fail(SPIN_E_IO, "cannot write '%s'", name);
        give_up("check_truncated");
    }
    spin_map_close(&map);
    return name;
}

void check_damage(const char *path, bool (*reads)(const char *path))
{
    FILE *file = fopen(path, "r+b");
    long size;
    int n_read = 0;

    if (!file || fseek(file, 0, SEEK_END) != 0 || (size = ftell(file)) <= 0)
        give_up("check_damage");
    for (long i = 0; i < 1000; i++) {
        long at = size * i / 1000;
        int byte;

        fseek(file, at, SEEK_SET);
        byte = fgetc(file);
        for (int flip = 1; flip >= 0; flip--) {
            fseek(file, at, SEEK_SET);
            fputc(byte ^ flip << i % 8, file);
            fflush(file);
            if (flip)
                (void)reads(path);
        }
    }
    ok(reads(path), "flipped bits crash nothing");
    for (long at = size - 1; at >= 0; at -= at > size - 500 || at < 500 ? 1 : 1 + size / 1000) {
        if (ftruncate(fileno(file), at) != 0)
            give_up("check_damage");
        n_read += reads(path);
    }
    ok(n_read == 0, "no truncation can be read");
    fclose(file);
}

/* ---- Golden values ------------------------------------------------------------------------- */

double *check_load(struct spin_npz *npz, const char *key, struct spin_array *info)
{
    struct spin_array a;
    double *values;

    if (spin_npz_array(npz, key, true, &a) != SPIN_OK) {
        ok(0, "loads '%s': %s", key, spin_last_error());
        return NULL;
    }
    values = malloc((size_t)a.count * sizeof *values + 1);
    if (!values)
        give_up("check_load");
    spin_array_to_f64(&a, 0, a.count, values);
    if (info)
        *info = a;
    return values;
}

float *check_load_f32(struct spin_npz *npz, const char *key, struct spin_array *info)
{
    struct spin_array a;
    float *values;

    if (spin_npz_array(npz, key, true, &a) != SPIN_OK) {
        ok(0, "loads '%s': %s", key, spin_last_error());
        return NULL;
    }
    values = malloc((size_t)a.count * sizeof *values + 1);
    if (!values)
        give_up("check_load_f32");
    spin_array_to_f32(&a, 0, a.count, values);
    if (info)
        *info = a;
    return values;
}

void *check_values(struct spin_bundle *bundle, const char *key, size_t *n)
{
    const int64_t any[SPIN_NPY_MAX_DIMS] = {-1, -1, -1, -1, -1, -1, -1, -1};
    const char *slash = strrchr(key, '/');
    bool in_series = slash && slash[1] >= '0' && slash[1] <= '9';
    struct spin_bundle_values v = {0};
    struct spin_array a;
    char series[64];
    void *out = NULL;

    *n = 0;
    snprintf(series, sizeof series, "%.*s", in_series ? (int)(slash - key) : 60, key);
    if (spin_npz_head(&bundle->npz, key, &a) != SPIN_OK ||
        spin_bundle_values_open(bundle, series, in_series ? atoi(slash + 1) : -1,
                                strcmp(series, "trained/track") ? 'f' : 'u',
                                a.n_dims - (a.item_size == 1), any, &v) != SPIN_OK) {
        ok(0, "loads '%s': %s", key, spin_last_error());
        return NULL;
    }
    out = malloc(4 * (size_t)v.count + 1);
    if (!out)
        give_up("check_values");
    spin_bundle_values_get(&v, 0, (size_t)v.count, out);
    *n = (size_t)v.count;
    spin_bundle_values_close(&v);
    return out;
}

/* The manifest that came with core/<file>: two sets of fixtures may both be in use. */
static const spin_json *manifest_of(const char *file)
{
    static struct {
        char path[PATH_BYTES];
        spin_json *json;
    } known[RING];
    char path[PATH_BYTES], name[PATH_BYTES];
    const char *found;
    int i = 0;

    snprintf(name, sizeof name, "core/%s", file);
    found = check_fixture(name);
    if (!found)
        return NULL;
    snprintf(path, sizeof path, "%.*s/manifest.json", (int)(strlen(found) - strlen(file) - 1),
             found);
    while (i < RING && known[i].json && strcmp(known[i].path, path) != 0)
        i++;
    if (i == RING || (!known[i].json && spin_json_load(path, &known[i].json) != SPIN_OK))
        give_up("the manifest of fixtures");
    memcpy(known[i].path, path, sizeof path);
    return known[i].json;
}

static const spin_json *entry_of(const char *file)
{
    return spin_json_get(spin_json_get(manifest_of(file), "files"), file);
}

double check_tolerance(const char *file, const char *key, double fallback)
{
    const spin_json *entry = spin_json_get(entry_of(file), "tolerance");
    double value;

    return spin_json_number(spin_json_get(entry, key), &value) ? value : fallback;
}

const spin_json *check_meta(const char *file) { return spin_json_get(entry_of(file), "meta"); }

double check_setting_or(const char *file, const char *path, double fallback)
{
    const spin_json *at = check_meta(file);
    const char *dot;
    char key[64];
    double value;

    for (; (dot = strchr(path, '.')); path = dot + 1) {
        snprintf(key, sizeof key, "%.*s", (int)(dot - path), path);
        at = spin_json_get(at, key);
    }
    return spin_json_number(spin_json_get(at, path), &value) ? value : fallback;
}

double check_setting(const char *file, const char *path)
{
    double value = check_setting_or(file, path, NAN);

    if (isnan(value)) {
        spin_fail(SPIN_E_MALFORMED, "the manifest has no number meta.%s of %s", path, file);
        give_up("check_setting");
    }
    return value;
}

enum { MOST_NAMES = 64, NAME_BYTES = 64 };

/* Entries of a folder of fixtures: those that hold `file`, or with an ending those of this prefix.
 * One block, texts behind the pointers. */
static const char **entries_of(const char *folder, const char *prefix, const char *ending,
                               const char *file)
{
    const char **found = calloc(MOST_NAMES, sizeof *found + NAME_BYTES);
    const char *root = check_fixture(folder);
    char **names = NULL, path[PATH_BYTES], *text = found ? (char *)(found + MOST_NAMES) : NULL;
    size_t n = 0, n_names = 0;

    if (!found || (root && spin_folder_list(root, &names, &n_names) != SPIN_OK))
        give_up(folder);
    for (size_t i = 0; i < n_names && n + 1 < MOST_NAMES; i++) {
        size_t length = strlen(names[i]), cut = strlen(ending);

        snprintf(path, sizeof path, "%s/%s/%s", root, names[i], file);
        if (length <= cut || length - cut >= NAME_BYTES ||
            strcmp(names[i] + length - cut, ending) != 0 ||
            strncmp(names[i], prefix, strlen(prefix)) != 0 || (*file && !spin_path_exists(path)))
            continue;
        found[n] = memcpy(text + n * NAME_BYTES, names[i], length - cut);
        n++;
    }
    spin_folder_list_free(names);
    ok(n > 0, "there are fixtures %s/%s*", folder, prefix);
    return found;
}

const char **check_files(const char *prefix) { return entries_of("core", prefix, ".npz", ""); }

const char **check_cases(const char *folder, const char *file)
{
    return entries_of(folder, "", "", file);
}

/* ---- Comparing ----------------------------------------------------------------------------- */

/* The element that exceeds its tolerance most; `excess` is |got - want| / tolerance there. */
static size_t worst_of(const float *got, const double *want, size_t n, double abs, double rel,
                       double *excess)
{
    size_t worst = 0;

    *excess = 0;
    for (size_t i = 0; i < n; i++) {
        double error = fabs((double)got[i] - want[i]);
        double tolerance = abs + rel * fabs(want[i]);
        double e = error == 0 && !isnan(got[i]) ? 0 : tolerance > 0 ? error / tolerance : INFINITY;

        if (isnan(e)) /* NaN on either side, or two infinities */
            e = (double)got[i] == want[i] ? 0 : INFINITY;
        if (e > *excess) {
            *excess = e;
            worst = i;
        }
    }
    return worst;
}

static int report(int good, const float *got, const double *want, size_t worst, double excess,
                  const char *what)
{
    ok(good, "%s", what);
    if (!good)
        printf("#   worst at [%zu]: got %.9g, want %.9g, error %.3g, %.3g times the tolerance\n",
               worst, (double)got[worst], want[worst], fabs((double)got[worst] - want[worst]),
               excess);
    return good;
}

int check_close(const float *got, const double *want, size_t n, double abs, double rel,
                const char *what)
{
    double excess;
    size_t worst;

    if (!got || !want)
        return ok(0, "%s: no values", what);
    worst = worst_of(got, want, n, abs, rel, &excess);
    return report(excess <= 1, got, want, worst, excess, what);
}

int check_rel_to_absmax(const float *got, const double *want, size_t n, double tol,
                        const char *what)
{
    double largest = 0, excess;
    size_t worst;

    if (!got || !want)
        return ok(0, "%s: no values", what);
    for (size_t i = 0; i < n; i++)
        largest = fmax(largest, fabs(want[i]));
    worst = worst_of(got, want, n, tol * largest, 0, &excess);
    return report(excess <= 1, got, want, worst, excess, what);
}

int check_same_bits(const void *got, const void *want, size_t bytes, const char *what)
{
    const unsigned char *a = got, *b = want;
    size_t differing = 0, first = 0;

    for (size_t i = bytes; i-- > 0;)
        if (a[i] != b[i]) {
            differing++;
            first = i;
        }
    ok(differing == 0, "%s", what);
    if (differing > 0)
        printf("#   %zu of %zu bytes differ, the first at %zu\n", differing, bytes, first);
    return differing == 0;
}

/* ---- Devices ------------------------------------------------------------------------------- */

struct spin_device *check_device(int n_threads)
{
    struct spin_device *d = calloc(1, sizeof *d);

    if (!d || spin_device_open(check_device_name(), n_threads, d) != SPIN_OK)
        give_up("check_device");
    return d;
}

const char *check_device_name(void)
{
    const char *name = getenv("SPIN_TEST_DEVICE");

    return name && *name ? name : "cpu";
}

const int check_thread_counts[4] = {1, 2, 3, 8};

int check_n_threads(void) { return check_device_is_cpu() ? 4 : 2; }

bool check_device_is_emulated(void)
{
    struct spin_device *d = check_device(1);
    bool is = !d->is_host && !check_device_is_card(d);

    check_device_free(d);
    return is;
}

bool check_device_is_card(const struct spin_device *d)
{
    return !d->is_host && strcmp(d->description, "cuda (emulated)") != 0;
}

bool check_device_is_cpu(void) { return strcmp(check_device_name(), "cpu") == 0; }

int check_same_sums(const float *got, const float *want, size_t n, const char *what)
{
    double *wanted;
    int good;

    if (check_device_is_cpu())
        return check_same_bits(got, want, n * sizeof *got, what);
    wanted = malloc((n + 1) * sizeof *wanted);
    for (size_t i = 0; wanted && i < n; i++)
        wanted[i] = (double)want[i];
    good = wanted ? check_rel_to_absmax(got, wanted, n, 1e-6, what) : ok(0, "out of memory");
    free(wanted);
    return good;
}

void check_device_free(struct spin_device *d)
{
    if (d)
        spin_device_close(d);
    free(d);
}

double check_report(const char *report, const char *path)
{
    spin_json *j = NULL, *at;
    char copy[128], *rest = copy, *key;
    double value = NAN;

    if (!report || spin_json_parse("report", report, strlen(report), &j) != SPIN_OK)
        return NAN;
    snprintf(copy, sizeof copy, "%s", path);
    for (at = j; (key = strsep(&rest, "."));)
        at = spin_json_is_array(at) ? spin_json_at(at, strtoul(key, NULL, 10))
                                    : spin_json_get(at, key);
    if (spin_json_is_array(at))
        value = (double)spin_json_length(at);
    spin_json_number(at, &value);
    spin_json_free(j);
    return value;
}
