/* PyTorch checkpoints: one object in six containers, malformed files, and what is not read.
 * K: io torch hostile */
#include "base/err.h"
#include "base/log.h"
#include "io/torch.h"
#include "tests/check.h"
#include "tests/tap.h"

static char path[1024];

static const char *in(const char *folder, const char *name)
{
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

/* A file of ours; the folder is one, the names are used again. */
static const char *ours(const char *name)
{
    static const char *folder;
    static char file[512];

    if (!folder)
        folder = check_folder();
    snprintf(file, sizeof file, "%.400s/%.40s", folder, name);
    return file;
}

/* ---- The same object in every container ------------------------------------------------------ */

/* "nested/list/1/0" from the root on. */
static const struct spin_value *follow(const struct spin_value *v, const char *keys)
{
    char key[64];

    while (*keys && v) {
        size_t n = strcspn(keys, "/");
        char *end;
        unsigned long index;

        snprintf(key, sizeof key, "%.*s", (int)n, keys);
        index = strtoul(key, &end, 10);
        v = v->kind == SPIN_VALUE_DICT ? spin_value_get(v, key)
            : *end == '\0'             ? spin_value_at(v, index)
                                       : NULL;
        keys += n + (keys[n] == '/');
    }
    return v;
}

/* The bits of bfloat16 as the float they stand for. */
static double widened(double bits)
{
    uint32_t wide = (uint32_t)bits << 16;
    float value;

    memcpy(&value, &wide, 4);
    return value;
}

static void compare_tensor(struct spin_torch *torch, struct spin_npz *npz, const char *key,
                           const spin_json *meta, const char *file)
{
    const struct spin_value *v = follow(torch->root, key);
    const spin_json *strides = spin_json_get(meta, "stride");
    struct spin_array t;
    struct spin_array info;
    char flat[64], what[200];
    int64_t stride = 0;
    double *want;
    float *got;

    snprintf(flat, sizeof flat, "%s", key);
    for (char *c = flat; *c; c++)
        *c = *c == '/' ? '.' : *c;
    snprintf(what, sizeof what, "%s: %s", file, key);
    if (!ok(spin_torch_tensor(torch, v, key, &t) == SPIN_OK, "%s: is a tensor", what)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    want = check_load(npz, flat, &info);
    if (!want)
        return;
    ok(t.n_dims == info.n_dims && t.count == info.count &&
           memcmp(t.shape, info.shape, (size_t)t.n_dims * sizeof *t.shape) == 0,
       "%s: has its shape", what);
    for (size_t d = 0; d < spin_json_length(strides); d++)
        ok(spin_json_integer(spin_json_at(strides, d), &stride) && t.stride[d] == stride,
           "%s: stride %zu", what, d);
    got = malloc(t.count * sizeof *got + 1);
    spin_array_to_f32(&t, 0, t.count, got);
    for (uint64_t i = 0; i < info.count; i++)
        want[i] = t.kind == 'B' ? widened(want[i]) : (double)(float)want[i];
    check_close(got, want, (size_t)t.count, 0, 0, what);
    if (t.count > 0 && spin_array_f32(&t))
        check_same_bits(spin_array_f32(&t), got, (size_t)t.count * sizeof *got,
                        "the same in place");
    if (t.kind == 'i' && t.count > 0) {
        int64_t last = 0;

        spin_array_to_i64(&t, t.count - 1, 1, &last);
        ok((float)last == got[t.count - 1], "%s: as integers too", what);
    }
    free(got);
    free(want);
}

static void test_plain(const struct spin_value *root, const char *file)
{
    const struct spin_value *plain = spin_value_get(root, "plain");
    const struct spin_value *numpy = spin_value_get(root, "numpy");
    const struct spin_value *bytes = spin_value_get(plain, "bytes");
    double n = 0;

#define NUMBER(from, key, want)                                                                    \
    ok(spin_value_number(spin_value_get(from, key), &n) && n == (want), "%s: %s", file, key)
    NUMBER(plain, "int", 5);
    NUMBER(plain, "neg", -7);
    NUMBER(plain, "mid", 70000);
    NUMBER(plain, "big", 0x1p70);
    NUMBER(plain, "float", 0.1);
    NUMBER(plain, "inf", INFINITY);
    NUMBER(plain, "t", 1);
    NUMBER(numpy, "f32", 1.5);
    NUMBER(numpy, "f64", -2.25);
    NUMBER(numpy, "i64", 9);
    ok(spin_value_number(spin_value_get(plain, "nan"), &n) && isnan(n), "%s: nan", file);
    is_text(spin_value_text(spin_value_get(plain, "str")),
            "Gr\xc3\xbc\xc3\x9f"
            "e \xe2\x98\x83",
            "text is UTF-8");
    ok(bytes && bytes->n == 5 &&
           memcmp(bytes->text,
                  "\x00\xff\x80"
                  "ab",
                  5) == 0,
       "%s: bytes", file);
}

static void test_good(const char *folder)
{
    static const char *const files[] = {"zip_torch113.pth",    "zip_deflated.pth",
                                        "zip_force_zip64.pth", "zip_newer_entries.pth",
                                        "zip_proto4.pth",      "legacy_raw.pth"};
    static const char *const keys[] = {"f32",
                                       "f64",
                                       "f16",
                                       "bf16",
                                       "i64",
                                       "i32",
                                       "i16",
                                       "i8",
                                       "u8",
                                       "bool",
                                       "scalar",
                                       "empty",
                                       "empty_2d",
                                       "transposed",
                                       "view_rows",
                                       "view_cols",
                                       "view_step",
                                       "expanded",
                                       "param",
                                       "same_as_f32",
                                       "nested/list/0",
                                       "nested/list/1/0",
                                       "nested/deep/0/0/0/0/x",
                                       "state_dict/weight",
                                       "state_dict/bias",
                                       "numpy/arr",
                                       "numpy/arr_f",
                                       "numpy/arr_f16"};
    spin_json *manifest = NULL;
    struct spin_npz npz;

    if (spin_json_load(in(folder, "manifest.json"), &manifest) != SPIN_OK ||
        spin_npz_open(in(folder, "expected.npz"), &npz) != SPIN_OK) {
        ok(0, "has manifest.json and expected.npz");
        return;
    }
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        const spin_json *tensors = spin_json_get(manifest, "tensors");
        struct spin_torch torch;

        if (!ok(spin_torch_open(in(folder, files[i]), &torch) == SPIN_OK, "%s opens", files[i])) {
            printf("#   %s\n", spin_last_error());
            continue;
        }
        for (size_t k = 0; k < sizeof keys / sizeof *keys; k++)
            compare_tensor(&torch, &npz, keys[k], spin_json_get(tensors, keys[k]), files[i]);
        test_plain(torch.root, files[i]);
        spin_torch_close(&torch);
    }
    spin_json_free(manifest);
    spin_npz_close(&npz);
}

static void test_wanted(const char *folder)
{
    const int64_t any[] = {-1, 3}, wrong[] = {7, 4}, flat[] = {-1};
    struct spin_torch torch;
    struct spin_array t;
    float *values = NULL;

    if (spin_torch_open(in(folder, "zip_torch113.pth"), &torch) != SPIN_OK)
        exit(1);
    ok(spin_torch_tensor_of(&torch, spin_value_get(torch.root, "f32"), "f32", 2, any, &t) ==
           SPIN_OK,
       "a shape with -1 fits");
    ok(spin_torch_tensor_of(&torch, spin_value_get(torch.root, "f32"), "f32", 2, wrong, &t) ==
               SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "tensor 'f32' has shape [7, 3], expected [7, 4]"),
       "another shape is named");
    ok(spin_torch_tensor_of(&torch, spin_value_get(torch.root, "f32"), "f32", 1, flat, &t) !=
               SPIN_OK &&
           strstr(spin_last_error(), "expected [*]"),
       "so is another number of dimensions");
    ok(spin_torch_tensor(&torch, NULL, "nothing", &t) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "no 'nothing'"),
       "a tensor that is not there is named");
    ok(spin_torch_tensor(&torch, spin_value_get(torch.root, "plain"), "plain", &t) != SPIN_OK &&
           strstr(spin_last_error(), "'plain' is not a tensor"),
       "and what is no tensor");
    ok(spin_torch_floats(&torch, spin_value_get(torch.root, "transposed"), "transposed", 3,
                         (const int64_t[]){6, -1, 5}, &t, &values) == SPIN_OK,
       "floats of a transposed tensor");
    free(values);
    ok(spin_torch_floats(&torch, spin_value_get(torch.root, "i64"), "i64", 2,
                         (const int64_t[]){-1, -1}, NULL, &values) == SPIN_E_UNSUPPORTED &&
           !values,
       "integers are not floats");
    spin_torch_close(&torch);
}

/* ---- Malformed files ------------------------------------------------------------------------- */

/* Opening, or binding the tensor that is its root, fails. */
static spin_status read_root(const char *file, struct spin_array *t)
{
    struct spin_torch torch;
    spin_status status = spin_torch_open(file, &torch);

    if (status != SPIN_OK)
        return status;
    status = spin_torch_tensor(&torch, torch.root, "it", t);
    spin_torch_close(&torch);
    return status;
}

static void test_malformed(const char *folder)
{
    static const struct {
        const char *file, *word;
    } says[] = {{"evil_os_system.pth", "'os.system'"},
                {"evil_posix_nested.pth", "'posix.system'"},
                {"evil_stack_global.pth", "'builtins.eval'"},
                {"evil_unused.pth", "'subprocess.Popen'"},
                {"legacy_evil.pth", "'os.system'"},
                {"lfs_pointer.pth", "Git LFS"},
                {"html_page.pth", "HTML"},
                {"bomb_deflated.pth", "50331648 bytes"},
                {"missing_storage.pth", "'data/7' is missing"},
                {"numel_too_big.pth", "expected 2400"}};
    const spin_json *cases;
    spin_json *manifest = NULL;
    struct spin_array t;
    size_t before = spin_memory_peak();

    if (spin_json_load(in(folder, "manifest.json"), &manifest) != SPIN_OK)
        return;
    cases = spin_json_get(manifest, "cases");
    for (size_t i = 0; i < spin_json_length(cases); i++) {
        const spin_json *c = spin_json_at(cases, i);
        const char *file = spin_json_string(spin_json_get(c, "file"));
        bool must = strcmp(spin_json_string(spin_json_get(c, "expect")), "reject") == 0;
        spin_status status = read_root(in(folder, file), &t);

        ok(status != SPIN_OK ? strstr(spin_last_error(), file) != NULL : !must, "%s: %s", file,
           spin_json_string(spin_json_get(c, "why")));
    }
    for (size_t i = 0; i < sizeof says / sizeof *says; i++)
        ok(read_root(in(folder, says[i].file), &t) != SPIN_OK &&
               strstr(spin_last_error(), says[i].word),
           "%s says %s", says[i].file, says[i].word);
    near((double)((spin_memory_peak() - before) >> 20), 0, 64, "none takes memory (MiB)");
    spin_json_free(manifest);
}

static void test_big_endian(const char *folder)
{
    struct spin_torch torch;
    struct spin_array t;
    float values[6];

    if (!ok(spin_torch_open(in(folder, "zip_big_endian.pth"), &torch) == SPIN_OK &&
                spin_torch_tensor(&torch, torch.root, "it", &t) == SPIN_OK && t.count == 6,
            "a big-endian file is read"))
        return;
    spin_array_to_f32(&t, 0, 6, values);
    for (int i = 0; i < 6; i++)
        near(values[i], i, 0, "its values are turned");
    spin_torch_close(&torch);
}

static void test_truncations(const char *folder, const char *name)
{
    struct spin_map map;
    struct spin_array t;
    int n_good = 0;
    size_t size;

    if (spin_map_open(in(folder, name), &map) != SPIN_OK)
        exit(1);
    size = map.size;
    spin_map_close(&map);
    for (size_t n = 0; n < size; n += n < 1500 || n + 200 > size ? 1 : 37) {
        const char *cut = check_truncated(in(folder, name), n);

        n_good += read_root(cut, &t) == SPIN_OK;
        remove(cut);
    }
    ok(n_good == 0, "no truncation of %s can be read", name);
}

/* ---- What is not read ------------------------------------------------------------------------ */

static void member(struct spin_zip_writer *w, const char *name, const void *data, size_t n)
{
    if (spin_zip_member_begin(w, name, n) != SPIN_OK ||
        spin_zip_member_write(w, data, n) != SPIN_OK || spin_zip_member_end(w) != SPIN_OK)
        exit(1);
}

/* A tensor of 1000 floats, and one of n_large beside it. */
static const char *make_file(const char *top, const void *extra_name, uint32_t n_large)
{
    static const char head[] = "\x80\x02(";
    static const char *const name[] = {"0", "1"};
    const char *file = ours("x.pth");
    char pkl[1024], entry[64];
    size_t n = sizeof head - 1;
    float *large = calloc(n_large > 1000 ? n_large : 1000, sizeof *large);
    struct spin_zip_writer w;

    memcpy(pkl, head, n);
    for (int i = 0; i < 2; i++) {
        uint32_t count = i ? n_large : 1000;
        char tensor[] = "ctorch._utils\n_rebuild_tensor_v2\n((X\x07\0\0\0storagectorch\n"
                        "FloatStorage\nX\x01\0\0\0"
                        "0X\x03\0\0\0"
                        "cpuJ....tQK\0J....\x85K\x01\x85"
                        "\x89NtR";
        char *at = tensor;

        for (int k = 0; k < 2; k++) {
            at = memmem(at, sizeof tensor - (size_t)(at - tensor), "J....", 5);
            memcpy(at + 1, &count, 4);
        }
        *(char *)memmem(tensor, sizeof tensor,
                        "\x01\0\0\0"
                        "0X",
                        6) = 1;
        ((char *)memmem(tensor, sizeof tensor,
                        "\x01\0\0\0"
                        "0X",
                        6))[4] = name[i][0];
        memcpy(pkl + n, tensor, sizeof tensor - 1);
        n += sizeof tensor - 1;
    }
    memcpy(pkl + n, "t.", 2);
    if (spin_zip_writer_open(file, true, &w) != SPIN_OK)
        exit(1);
    snprintf(entry, sizeof entry, "%s/data.pkl", top);
    member(&w, entry, pkl, n + 2);
    snprintf(entry, sizeof entry, "%s/data/0", top);
    member(&w, entry, large, 4000);
    snprintf(entry, sizeof entry, "%s/data/1", top);
    member(&w, entry, large, 4 * (size_t)n_large);
    if (extra_name)
        member(&w, extra_name, "3\n", 2);
    free(large);
    if (spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    return file;
}

/* Bytes that this process got by read() and its kin; -1 when the system does not say. */
static double bytes_read(void)
{
    double bytes = -1;
    FILE *f = fopen("/proc/self/io", "r");

    if (f && fscanf(f, "rchar: %lf", &bytes) != 1)
        bytes = -1;
    if (f)
        fclose(f);
    return bytes;
}

static void test_untouched(void)
{
    const char *file = make_file("chkpnt", NULL, 16u << 20);
    size_t before = spin_memory_peak();
    struct spin_torch torch;
    struct spin_array t;
    double start = bytes_read();

    /* The peak counts mapped pages that were touched: the large storage is 64 MiB of them. */
    ok(spin_torch_open(file, &torch) == SPIN_OK &&
           spin_torch_tensor(&torch, spin_value_at(torch.root, 0), "it", &t) == SPIN_OK,
       "one tensor of a large file is read");
    ok(t.data && (uintptr_t)t.data % 64 == 0 && spin_array_f32(&t), "in place");
    near((double)((spin_memory_peak() - before) >> 20), 0, 8,
         "and the other's storage was not touched (MiB)");
    if (start < 0)
        skip("nor was it read", "no /proc/self/io");
    else
        ok(bytes_read() - start < 1 << 20, "nor was it read: %.0f bytes were",
           bytes_read() - start);
    spin_torch_close(&torch);
}

static void refuses(const char *file, const char *word, const char *what)
{
    struct spin_array t;
    bool good = read_root(file, &t) != SPIN_OK && strstr(spin_last_error(), word) &&
                strstr(spin_last_error(), file);

    ok(good, "%s", what);
    if (!good)
        printf("#   '%s'\n", spin_last_error());
}

static const char *make_bytes(const void *bytes, size_t n)
{
    static const char *folder;
    static char file[512];
    FILE *f;

    if (!folder)
        folder = check_folder();
    snprintf(file, sizeof file, "%s/other.pth", folder);
    f = fopen(file, "wb");
    if (!f || fwrite(bytes, 1, n, f) != n || fclose(f) != 0)
        exit(1);
    return file;
}

static void test_foreign(void)
{
    char tar[512] = {0};

    memcpy(tar + 257, "ustar", 5);
    refuses(make_bytes("", 0), "empty", "an empty file");
    refuses(make_bytes("\xfd"
                       "7zXZ\0more",
                       10),
            "xz file", "an xz file");
    refuses(make_bytes("\x08\0\0\0\0\0\0\0{\"a\":1}  ", 17), "safetensors", "safetensors");
    refuses(make_bytes("\x08\0\0\0\0\0\0\0[1,2,3]  ", 17), "it is not a PyTorch checkpoint",
            "a length before what is no object");
    refuses(make_bytes("\x80\x04\x95\x01\0\0\0\0\0\0\0N.", 13), "bare pickle", "a bare pickle");
    refuses(make_bytes(tar, sizeof tar), "tar file", "a tar file");
    refuses(make_bytes("ply\nformat", 10), "not a PyTorch checkpoint", "anything else");
    refuses(make_file("x", "x/constants.pkl", 4), "TorchScript", "a TorchScript program");
    refuses(make_file("x", "x/code/a.py", 4), "TorchScript", "by its code too");
    refuses(make_file("x", "y/data.pkl", 4), "two checkpoints", "two checkpoints in one file");
    refuses(make_file("x/y", NULL, 4), "without 'data.pkl'", "a pickle in a deeper folder");
    refuses(make_file("x", "x/byteorder", 4), "byte order", "a byte order that is none");
    refuses("no/such.pth", "no such file", "a missing file");
}

TAP_MAIN
{
    const char *root = check_fixture("torch_container");
    char good[512], bad[512];

    spin_log_set_level(-2);
    test_foreign();
    test_untouched();
    if (!root) {
        skip("torch_container fixtures", "there are none here");
        return;
    }
    snprintf(good, sizeof good, "%s/good", root);
    snprintf(bad, sizeof bad, "%s/malformed", root);
    test_good(good);
    test_wanted(good);
    test_malformed(bad);
    test_big_endian(bad);
    test_truncations(good, "legacy_raw.pth");
    test_truncations(good, "zip_deflated.pth");
}
