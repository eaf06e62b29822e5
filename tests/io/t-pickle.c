/* Pickles as data: every opcode that is known, code that is refused by name, and malformed
 * streams.
 * K: io pickle torch hostile */
#include "base/err.h"
#include "io/torch.h"
#include "tests/check.h"
#include "tests/tap.h"

static struct spin_pickle pickle;

/* Parse what stands behind the protocol number, in an exactly sized block. */
static spin_status parse(const char *body, size_t n)
{
    unsigned char *bytes = malloc(n + 2);
    spin_status status;

    spin_pickle_free(&pickle);
    memcpy(bytes, "\x80\x02", 2);
    memcpy(bytes + 2, body, n);
    status = spin_pickle_parse("x", bytes, n + 2, &pickle);
    if (status == SPIN_OK && pickle.used != n + 2)
        ok(0, "uses all bytes");
    free(bytes); /* values keep nothing of it */
    return status;
}

/* The text is a literal, zeros included. */
#define PARSE(text) parse(text, sizeof(text) - 1)

static void refuses(spin_status status, const char *word, const char *what)
{
    bool good = status != SPIN_OK && strstr(spin_last_error(), word);

    ok(good, "refuses %s", what);
    if (!good)
        printf("#   status %d, '%s'\n", status, status ? spin_last_error() : "");
}

#define REFUSES(text, word, what) refuses(PARSE(text), word, what)

/* ---- Values ---------------------------------------------------------------------------------- */

static void is_int(spin_status status, int64_t integer, double number, const char *what)
{
    ok(status == SPIN_OK && pickle.root->kind == SPIN_VALUE_INT &&
           pickle.root->integer == integer && pickle.root->number == number,
       "%s", what);
}

static void test_numbers(void)
{
    double number;

    is_int(PARSE("K\xff."), 255, 255, "BININT1 is unsigned");
    is_int(PARSE("M\xff\xff."), 65535, 65535, "BININT2 is unsigned");
    is_int(PARSE("J\xfe\xff\xff\xff."), -2, -2, "BININT is signed");
    is_int(PARSE("\x8a\x00."), 0, 0, "LONG1 of no bytes is 0");
    is_int(PARSE("\x8a\x01\xff."), -1, -1, "LONG1 is two's complement");
    is_int(PARSE("\x8a\x02\x00\x80."), -32768, -32768, "of any length");
    is_int(PARSE("\x8a\x09\xff\xff\xff\xff\xff\xff\xff\x7f\x00."), INT64_MAX, 0x1p63,
           "a zero byte more changes nothing");
    is_int(PARSE("\x8a\x09\x00\x00\x00\x00\x00\x00\x00\x00\x40."), INT64_MAX, 0x1p70,
           "what is too big is the limit, with its magnitude");
    is_int(PARSE("\x8a\x09\x00\x00\x00\x00\x00\x00\x00\x00\xc0."), INT64_MIN, -0x1p70,
           "on both sides");
    is_int(PARSE("\x8b\x02\x00\x00\x00\x10\x27."), 10000, 10000, "LONG4");
    ok(PARSE("G\xc0\x02\x00\x00\x00\x00\x00\x00.") == SPIN_OK && pickle.root->number == -2.25 &&
           pickle.root->kind == SPIN_VALUE_FLOAT,
       "BINFLOAT is big-endian");
    ok(PARSE("\x88.") == SPIN_OK && spin_value_number(pickle.root, &number) && number == 1,
       "True is 1");
    ok(PARSE("N.") == SPIN_OK && pickle.root->kind == SPIN_VALUE_NONE &&
           !spin_value_number(pickle.root, &number),
       "None is no number");
}

static void test_texts(void)
{
    ok(PARSE("X\x03\x00\x00\x00"
             "a\0b.") == SPIN_OK &&
           pickle.root->n == 3 && memcmp(pickle.root->text, "a\0b", 4) == 0,
       "text keeps its zeros and ends with one");
    ok(PARSE("\x8c\x02hi.") == SPIN_OK, "SHORT_BINUNICODE");
    is_text(spin_value_text(pickle.root), "hi", "and its text");
    ok(PARSE("\x8d\x01\x00\x00\x00\x00\x00\x00\x00z.") == SPIN_OK, "BINUNICODE8");
    ok(PARSE("C\x02\xff\x00.") == SPIN_OK && pickle.root->kind == SPIN_VALUE_BYTES &&
           pickle.root->n == 2,
       "bytes of protocol 3");
    ok(PARSE("c_codecs\nencode\nX\x05\x00\x00\x00"
             "a\xc3\xbf\xc2\x80X\x06\x00\x00\x00latin1\x86R.") == SPIN_OK &&
           pickle.root->n == 3 && memcmp(pickle.root->text, "a\xff\x80", 3) == 0,
       "bytes of protocol 2, which travel as text");
    REFUSES("c_codecs\nencode\nX\x02\x00\x00\x00\xc4\x80X\x06\x00\x00\x00latin1\x86R.", "Latin-1",
            "bytes beyond 255");
    REFUSES("c_codecs\nencode\nX\x01\x00\x00\x00"
            "aX\x05\x00\x00\x00rot13\x86R.",
            "encoding", "any other codec");
}

static void test_containers(void)
{
    const struct spin_value *v;

    ok(PARSE("(K\x01K\x02K\x03K\x04t.") == SPIN_OK && pickle.root->kind == SPIN_VALUE_TUPLE &&
           pickle.root->n == 4 && spin_value_at(pickle.root, 3)->integer == 4,
       "tuples");
    ok(!spin_value_at(pickle.root, 4) && !spin_value_at(NULL, 0),
       "there is nothing behind the last");
    ok(PARSE("](K\x01K\x02"
             "eK\x03"
             "a.") == SPIN_OK &&
           pickle.root->kind == SPIN_VALUE_LIST && pickle.root->n == 3 &&
           spin_value_at(pickle.root, 2)->integer == 3,
       "lists grow");
    ok(PARSE("}(\x8c\x01"
             "aK\x01\x8c\x01"
             "bK\x02u\x8c\x01"
             "aK\x03s.") == SPIN_OK &&
           pickle.root->kind == SPIN_VALUE_DICT && pickle.root->n == 3 &&
           spin_value_get(pickle.root, "a")->integer == 3 && !spin_value_get(pickle.root, "c"),
       "dicts, of two equal keys the later counts");
    ok(PARSE("}(K\x01N\x8c\x01"
             "1K\x07u.") == SPIN_OK &&
           spin_value_get(pickle.root, "1")->integer == 7,
       "keys that are numbers are kept, and are not text");
    ok(PARSE("ccollections\nOrderedDict\n)R\x8c\x01"
             "aK\x05s}\x8c\x09_metadataNsb.") == SPIN_OK &&
           pickle.root->n == 1 && spin_value_get(pickle.root, "a")->integer == 5,
       "an OrderedDict, filled later, its state dropped");
    ok(PARSE("ccollections\nOrderedDict\n]]\x8c\x01kK\x09"
             "e\x85R.") != SPIN_OK,
       "needs a mark");
    ok(PARSE("ccollections\nOrderedDict\n](\x8c\x01kK\x09\x86"
             "e\x85R.") == SPIN_OK &&
           spin_value_get(pickle.root, "k")->integer == 9,
       "an OrderedDict of pairs");
    ok(PARSE("ctorch\nSize\n(K\x02K\x03t\x85R.") == SPIN_OK && pickle.root->n == 2, "torch.Size");
    ok(PARSE("]q\x00h\x00"
             "a.") == SPIN_OK &&
           spin_value_at(pickle.root, 0) == pickle.root,
       "a list may hold itself");
    ok(PARSE("K\x05q\x00"
             "0h\x00.") == SPIN_OK &&
           pickle.root->integer == 5,
       "memo, POP and BINGET");
    ok(PARSE("K\x05\x94K\x06\x94"
             "00h\x01.") == SPIN_OK &&
           pickle.root->integer == 6,
       "MEMOIZE counts by itself");
    ok(PARSE("(K\x01K\x02"
             "1K\x03.") == SPIN_OK &&
           pickle.root->integer == 3,
       "POP_MARK");
    ok(PARSE("K\x02"
             "2\x86.") == SPIN_OK &&
           pickle.root->n == 2,
       "DUP");
    ok(PARSE("\x8f(K\x01K\x02\x90.") == SPIN_OK && pickle.root->n == 2, "a set is a list");
    ok(PARSE("\x95\x02\x00\x00\x00\x00\x00\x00\x00N.") == SPIN_OK, "FRAME");
    ok(PARSE("cargparse\nNamespace\n)\x81}\x8c\x01"
             "aK\x04sb.") == SPIN_OK &&
           pickle.root->kind == SPIN_VALUE_OBJECT,
       "argparse.Namespace");
    is_text(pickle.root->text, "argparse.Namespace", "has its name");
    v = pickle.root->n == 1 ? spin_value_get(pickle.root->item[0], "a") : NULL;
    ok(v && v->integer == 4, "and its state");
}

/* ---- Tensors --------------------------------------------------------------------------------- */

#define STORAGE(type, key, n)                                                                      \
    "(\x8c\x07storagectorch\n" type "\n\x8c\x01" key "\x8c\x03"                                    \
    "cpuK" n "tQ"
#define TENSOR(type, n, offset, sizes, strides)                                                    \
    "ctorch._utils\n_rebuild_tensor_v2\n(" STORAGE(type, "0",                                      \
                                                   n) "K" offset "(" sizes "t(" strides "t\x89"    \
                                                      "ccollections\nOrderedDict\n)RtR."

static void test_tensors(void)
{
    const struct spin_array *t;
    struct spin_array bound;
    float values[6];
    static const float storage[6] = {0, 1, 2, 3, 4, 5};

    ok(PARSE(TENSOR("FloatStorage", "\x06", "\x01", "K\x02K\x02", "K\x01K\x02")) == SPIN_OK &&
           pickle.root->kind == SPIN_VALUE_TENSOR,
       "a tensor");
    t = &pickle.root->tensor;
    ok(t->kind == 'f' && t->item_size == 4 && t->n_dims == 2 && t->count == 4 && t->offset == 1 &&
           t->stride[1] == 2 && t->storage_count == 6 && strcmp(t->storage, "0") == 0 && !t->data,
       "is described, not read");
    ok(pickle.n_storages == 1 && pickle.storage[0].count == 6 &&
           spin_pickle_storage(&pickle, "0") == pickle.storage &&
           !spin_pickle_storage(&pickle, "1"),
       "and its storage is listed");
    bound = *t;
    bound.data = (const unsigned char *)storage;
    spin_array_to_f32(&bound, 0, 4, values);
    ok(values[0] == 1 && values[1] == 3 && values[2] == 2 && values[3] == 4,
       "elements follow the strides");
    spin_array_to_f32(&bound, 3, 1, values);
    ok(values[0] == 4, "from any index on");
    ok(!spin_array_f32(&bound), "and are not in place");
    ok(PARSE(TENSOR("FloatStorage", "\x02", "\x00", "K\x02K\x05", "K\x01K\x00")) == SPIN_OK &&
           pickle.root->tensor.count == 10,
       "a stride of 0 repeats");
    ok(PARSE(TENSOR("FloatStorage", "\x00", "\x00", "K\x00K\x05", "K\x05K\x01")) == SPIN_OK &&
           pickle.root->tensor.count == 0,
       "an empty tensor");
    ok(PARSE(TENSOR("FloatStorage", "\x01", "\x00", "", "")) == SPIN_OK &&
           pickle.root->tensor.count == 1 && pickle.root->tensor.n_dims == 0,
       "a scalar tensor");
    REFUSES(TENSOR("FloatStorage", "\x06", "\x00", "K\x02K\x03", "K\x03K\x02"),
            "beyond its storage", "strides past the end");
    REFUSES(TENSOR("FloatStorage", "\x06", "\x06", "K\x01", "K\x01"), "beyond its storage",
            "an offset past the end");
    REFUSES(TENSOR("FloatStorage", "\x06", "\x00", "K\x02K\x03", "K\x03"), "do not match",
            "strides of another number");
    REFUSES(TENSOR("FloatStorage", "\x06", "\x00", "K\x02", "J\xff\xff\xff\xff"), "invalid shape",
            "negative strides");
    REFUSES(
        TENSOR("FloatStorage", "\x01", "\x00", "J\xff\xff\xff\x7fJ\xff\xff\xff\x7f", "K\x00K\x00"),
        "too often", "2^62 copies of one number");
    REFUSES(TENSOR("FloatStorage", "\x01", "\x00",
                   "J\xff\xff\xff\x7fJ\xff\xff\xff\x7fJ\xff\xff\xff\x7f", "K\x00K\x00K\x00"),
            "overflows", "more than 2^64");
    REFUSES(TENSOR("OrderedDict", "\x01", "\x00", "", ""), "torch.OrderedDict",
            "a storage type that is none");
    REFUSES("(\x8c\x06modulectorch\nFloatStorage\n\x8c\x01"
            "0\x8c\x03"
            "cpuK\x01tQ.",
            "persistent id", "saved source code");
    REFUSES("(\x8c\x07storagectorch\nFloatStorage\n\x8c\x02../\x8c\x03"
            "cpuK\x01tQ.",
            "", "a key that is a path");
    REFUSES("(" STORAGE("FloatStorage", "0", "\x01") STORAGE("HalfStorage", "0", "\x01") "t.",
            "different types", "a storage of two types");
}

static void test_arrays(void)
{
    int64_t values[6];
    double number;

#define DTYPE(code, order)                                                                         \
    "cnumpy\ndtype\n\x8c\x02" code "\x89\x88\x87R(K\x03\x8c\x01" order                             \
    "NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
#define ARRAY(shape, dtype, fortran, raw)                                                          \
    "cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85"                             \
    "C\x01"                                                                                        \
    "b\x87R(K\x01(" shape "t" dtype fortran raw "tb."
    ok(PARSE(ARRAY("K\x02K\x03", DTYPE("i2", "<"), "\x89",
                   "C\x0c\x01\0\x02\0\x03\0\x04\0\x05\0\x06\0")) == SPIN_OK &&
           pickle.root->tensor.count == 6,
       "a numpy array");
    spin_array_to_i64(&pickle.root->tensor, 0, 6, values);
    ok(values[0] == 1 && values[1] == 2 && values[5] == 6, "and its values");
    ok(PARSE(ARRAY("K\x02K\x03", DTYPE("i2", ">"), "\x88",
                   "C\x0c\0\x01\0\x02\0\x03\0\x04\0\x05\0\x06")) == SPIN_OK,
       "in Fortran's order and the other byte order");
    spin_array_to_i64(&pickle.root->tensor, 0, 6, values);
    ok(values[0] == 1 && values[1] == 3 && values[2] == 5 && values[5] == 6, "and its values");
    REFUSES(ARRAY("K\x02K\x03", DTYPE("i2", "<"), "\x89", "C\x02\x01\0"), "", "an array cut short");
    REFUSES(ARRAY("K\x01", DTYPE("i2", "<"), "\x89", "C\x04\x01\0\x01\0"), "fit its bytes",
            "an array with bytes left over");
    REFUSES(ARRAY("K\x01", DTYPE("O8", "|"), "\x89", "C\x08\0\0\0\0\0\0\0\0"), "'O8'",
            "an array of objects");
    ok(PARSE("cnumpy._core.multiarray\nscalar\n" DTYPE("f4", "<") "C\x04\0\0\xc0\x3f\x86R.") ==
               SPIN_OK &&
           spin_value_number(pickle.root, &number) && number == 1.5,
       "a numpy scalar, by its newer name");
    ok(PARSE("cnumpy.core.multiarray\nscalar\n" DTYPE("b1", "|") "C\x01\x01\x86R.") == SPIN_OK &&
           pickle.root->kind == SPIN_VALUE_BOOL,
       "a numpy bool");
    ok(PARSE("cnumpy.core.numeric\n_frombuffer\n(\x96\x04\0\0\0\0\0\0\0\x01\x02\x03\x04" DTYPE(
           "u1", "|") "K\x04\x85\x8c\x01"
                      "CtR.") == SPIN_OK &&
           pickle.root->tensor.count == 4,
       "an array of protocol 5");
}

static void test_kinds(void)
{
    static const unsigned char bf16[] = {0x80, 0x3f, 0x20, 0xc0};
    static const unsigned char half[] = {0x01, 0x00, 0x00, 0x7c, 0x00, 0x3c};
    struct spin_array t = {
        .n_dims = 1, .shape = {2}, .stride = {1}, .count = 2, .storage_count = 2};
    float f[3];
    int64_t i[2];

    t.kind = 'B';
    t.item_size = 2;
    t.data = bf16;
    spin_array_to_f32(&t, 0, 2, f);
    ok(f[0] == 1 && f[1] == -2.5f, "bfloat16");
    t.kind = 'f';
    t.data = half;
    t.shape[0] = t.count = 3;
    spin_array_to_f32(&t, 0, 3, f);
    ok(f[0] == 0x1p-24f && isinf(f[1]) && f[2] == 1,
       "half precision, with subnormals and infinity");
    t.shape[0] = t.count = 2;
    spin_array_to_i64(&t, 1, 1, i);
    ok(i[0] == INT64_MAX, "infinity as an integer is the limit");
}

/* ---- What is refused ------------------------------------------------------------------------- */

static void test_code(void)
{
    REFUSES("cos\nsystem\n\x8c\x02id\x85R.", "'os.system'", "os.system");
    REFUSES("c__builtin__\neval\n0N.", "'__builtin__.eval'", "a global that is never called");
    REFUSES("\x8c\x08"
            "builtins\x8c\x04"
            "exec\x93.",
            "'builtins.exec'", "STACK_GLOBAL");
    REFUSES("ctorch\nload\n.", "'torch.load'", "functions of torch that are not data");
    REFUSES("c__main__\nModel\n)\x81.", "state_dict", "a whole model object, with advice");
    REFUSES("ctorch._utils\n_rebuild_sparse_tensor\n.", "sparse", "sparse tensors, saying so");
    REFUSES("ctorch.jit._pickle\nbuild_intlist\n.", "TorchScript", "TorchScript");
    REFUSES("ca\x1b[31mb\nc\n.", "'a?[31mb.c'",
            "a name with control characters, which are not shown");
    REFUSES("ccollections\nOrderedDict\n)\x81.", "unsupported class", "NEWOBJ of what is no class");
    REFUSES("ctorch\nFloatStorage\nK\x05\x85R.", "'torch.FloatStorage' is called",
            "a storage call");
    REFUSES("K\x01)R.", "not a function", "a call of a number");
    REFUSES("}K\x01"
            "b.",
            "state", "a state for a dict");
    REFUSES("(cos\nsystem\no.", "'os.system'", "OBJ");
    REFUSES("(i__main__\nA\n.", "opcode 0x69", "INST");
    REFUSES("I5\n.", "opcode 0x49", "text opcodes of protocol 0");
    REFUSES("\x82\x01.", "opcode 0x82", "extension codes");
    REFUSES("P5\n.", "opcode 0x50", "PERSID");
}

static void test_damage(void)
{
    static char deep[6000], wide[70000];
    unsigned char none[1] = {0};
    size_t n = 0;

    refuses(spin_pickle_parse("x", none, 0, &pickle), "cut short", "no bytes");
    refuses(spin_pickle_parse("x", (const unsigned char *)"I1\n.", 4, &pickle), "protocol",
            "protocol 0");
    refuses(spin_pickle_parse("x", (const unsigned char *)"\x80\x06N.", 4, &pickle), "protocol",
            "a protocol of the future");
    REFUSES("", "cut short", "an end before STOP");
    REFUSES(".", "one value", "no value");
    REFUSES("NN.", "one value", "two values");
    REFUSES("N(.", "one value", "a mark left over");
    REFUSES("0.", "mark", "POP of nothing");
    REFUSES("t.", "mark", "TUPLE without a mark");
    REFUSES("K\x01\x86.", "stack", "TUPLE2 of one");
    REFUSES("](K\x01u.", "not a dict", "SETITEMS of a list");
    REFUSES("}(K\x01u.", "without a value", "half an item");
    REFUSES("(K\x01"
            "e.",
            "not a list", "APPENDS of nothing");
    REFUSES("h\x05.", "never set", "a memo slot never set");
    REFUSES("Nr\xff\xff\xff\xff.", "out of range", "a memo slot at 4 billion");
    REFUSES("X\xff\xff\xff\xff"
            "a.",
            "larger than the rest", "a text of 4 GB");
    REFUSES("\x8d\xff\xff\xff\xff\xff\xff\xff\xff"
            "a.",
            "larger than the rest", "a text of 2^64");
    REFUSES("\x95\xff\xff\xff\xff\xff\xff\xff\xffN.", "a frame that is longer", "a frame of 2^64");
    REFUSES("\x8b\xff\xff\xff\x7fN.", "larger than the rest", "an integer of 2 GB");
    REFUSES("cos", "cut short", "a name without an end");
    for (n = 0; n < sizeof deep - 2; n++)
        deep[n] = n ? '\x85' : 'N';
    deep[n++] = '.';
    refuses(parse(deep, n), "nested", "6000 tuples in one another");
    deep[257] = '.';
    ok(parse(deep, 258) == SPIN_OK, "256 tuples in one another");
    memcpy(deep + 257, "\x85.", 2);
    refuses(parse(deep, 259), "nested", "257 tuples");
    n = 0;
    wide[n++] = '(';
    while (n < sizeof wide - 2)
        wide[n++] = ']';
    memcpy(wide + n, "t.", 2);
    ok(parse(wide, n + 2) == SPIN_OK && pickle.root->n == sizeof wide - 3,
       "a very wide one is read");
}

/* 24 million empty lists would be 1.4 GB. */
static void test_budget(void)
{
    size_t n = 24u << 20, before = spin_memory_peak();
    char *bomb = malloc(n);

    memset(bomb, ']', n);
    bomb[0] = '(';
    memcpy(bomb + n - 2, "t.", 2);
    refuses(parse(bomb, n), "memory", "24 million lists");
    free(bomb);
    /* Two copies of the input, what the values may take (32 MiB and as much as the input), slack.
     */
    near((double)((spin_memory_peak() - before) >> 20), 0, 2 * 24 + 32 + 24 + 32,
         "within its budget of memory (MiB)");
}

static void test_truncations(void)
{
    static const char whole[] = "}(\x8c\x01"
                                "aG@\x02\x00\x00\x00\x00\x00\x00\x8c\x01"
                                "b" TENSOR("FloatStorage", "\x06", "\x00", "K\x02", "K\x01");
    int n_good = 0;

    for (size_t n = 0; n < sizeof whole - 1; n++)
        n_good += parse(whole, n) == SPIN_OK;
    ok(n_good == 0, "no truncation can be read");
}

TAP_MAIN
{
    test_numbers();
    test_texts();
    test_containers();
    test_tensors();
    test_arrays();
    test_kinds();
    test_code();
    test_damage();
    test_truncations();
    test_budget();
    spin_pickle_free(&pickle);
}
