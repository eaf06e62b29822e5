/* Reads layers of USD in text form (.usda). */
#include "formats/usd_layer.h"

#include <stdlib.h>
#include <string.h>

#include "base/base.h"

enum { MAX_DEPTH = 64, MAX_NUMBER = 63, MAX_ATTRIBUTES = 10000 };

struct reader {
    struct spin_usd_layer *layer; /* NULL: the reader parses a single value */
    const char *begin, *at, *end;
};

static spin_status fail_here(const struct reader *r, const char *what)
{
    size_t line = 1;

    for (const char *c = r->begin; c < r->at && c < r->end; c++)
        line += *c == '\n';
    return spin_malformed(r->layer ? "line %zu: %s" : "line %zu of a value: %s", line, what);
}

/* ---- Characters ------------------------------------------------------------------------------ */

/* Returns the next character without consuming it; '\0' at the end. */
static char peek(const struct reader *r) { return r->at < r->end ? *r->at : '\0'; }

static void skip_blanks(struct reader *r)
{
    while (peek(r) == ' ' || peek(r) == '\t' || peek(r) == '\r')
        r->at++;
}

/* Skips spaces, line feeds and comments. */
static void skip_space(struct reader *r)
{
    for (;;) {
        skip_blanks(r);
        if (peek(r) == '#')
            while (r->at < r->end && *r->at != '\n')
                r->at++;
        if (peek(r) != '\n')
            return;
        r->at++;
    }
}

static bool accept(struct reader *r, char c)
{
    bool found = r->at < r->end && *r->at == c;

    r->at += found;
    return found;
}

static bool begins(const struct reader *r, const char *word)
{
    size_t n = strlen(word);

    return (size_t)(r->end - r->at) >= n && memcmp(r->at, word, n) == 0;
}

struct span {
    const char *at;
    size_t n;
};

static bool is_word(struct span s, const char *word)
{
    return s.n == strlen(word) && memcmp(s.at, word, s.n) == 0;
}

/* Reads a word: the characters up to white space or a delimiter. The result may be empty. */
static struct span read_word(struct reader *r)
{
    struct span word = {r->at, 0};

    while (r->at < r->end && *r->at != '\0' && !strchr(" \t\r\n=(){};,\"'@<>#", *r->at))
        r->at++;
    word.n = (size_t)(r->at - word.at);
    return word;
}

static spin_status keep_text(struct spin_usd_layer *layer, struct span s, const char **out)
{
    char *copy;

    SPIN_TRY(spin_arena_take(&layer->arena, s.n + 1, 1, (void **)&copy));
    memcpy(copy, s.at, s.n);
    *out = copy;
    return SPIN_OK;
}

/* Sets *out to the text up to the next `mark`, and skips the mark. lines: the text may contain line
 * feeds. */
static spin_status read_until(struct reader *r, const char *mark, bool lines, struct span *out)
{
    const char *from = r->at;

    for (; r->at < r->end && !begins(r, mark); r->at++) {
        if (!lines && *r->at == '\n')
            return fail_here(r, "a string does not end on its line");
        if (*r->at == '\\' && *mark != '@' && *mark != '>')
            r->at++;
    }
    if (r->at >= r->end)
        return fail_here(r, "the file ends within a text");
    *out = (struct span){from, (size_t)(r->at - from)};
    r->at += strlen(mark);
    return SPIN_OK;
}

/* Reads a string, an asset path or a prim path, and sets *out to the text between its
 * delimiters. */
static spin_status read_quoted(struct reader *r, struct span *out)
{
    static const char *const marks[][2] = {
        {"\"\"\"", "\"\"\""}, {"'''", "'''"}, {"\"", "\""}, {"'", "'"},
        {"@@@", "@@@"},       {"@", "@"},     {"<", ">"}};

    for (size_t i = 0; i < sizeof marks / sizeof *marks; i++)
        if (begins(r, marks[i][0])) {
            r->at += strlen(marks[i][0]);
            return read_until(r, marks[i][1], i < 2, out);
        }
    return fail_here(r, "expected a text");
}

/* Skips an opening bracket, its contents, and the closing bracket. */
static spin_status skip_brackets(struct reader *r)
{
    char open[MAX_DEPTH];
    int depth = 0;
    struct span text;

    do {
        char c = peek(r);

        if (c == '\0')
            return fail_here(r, "the file ends within brackets");
        if (c == '"' || c == '\'' || c == '@' || c == '<') {
            SPIN_TRY(read_quoted(r, &text));
        } else if (c == '#') {
            skip_space(r);
        } else if (c == '[' || c == '(' || c == '{') {
            if (depth == MAX_DEPTH)
                return fail_here(r, "brackets are nested too deeply");
            open[depth++] = c == '[' ? ']' : c == '(' ? ')' : '}';
            r->at++;
        } else if (c == ']' || c == ')' || c == '}') {
            if (open[--depth] != c)
                return fail_here(
                    r, "a closing bracket is not of the same kind as the opening bracket");
            r->at++;
        } else {
            r->at++;
        }
    } while (depth > 0);
    return SPIN_OK;
}

static bool is_open(char c) { return c == '[' || c == '(' || c == '{'; }
static bool is_quote(char c) { return c == '"' || c == '\'' || c == '@' || c == '<'; }

/* Skips the optional prim path and time offset that follow an asset path in a list of references.
 */
static spin_status skip_reference(struct reader *r)
{
    struct span text;

    skip_blanks(r);
    if (peek(r) == '<')
        SPIN_TRY(read_quoted(r, &text));
    skip_blanks(r);
    return peek(r) == '(' ? skip_brackets(r) : SPIN_OK;
}

static spin_status read_value(struct reader *r, const struct spin_usd_layer *layer,
                              struct spin_usd_value *out)
{
    const char *from = r->at;
    bool asset = peek(r) == '@' || peek(r) == '<';
    struct span text = {NULL, 0};

    if (is_quote(peek(r)))
        SPIN_TRY(read_quoted(r, &text));
    else if (is_open(peek(r)))
        SPIN_TRY(skip_brackets(r));
    else if (text = read_word(r), text.n == 0)
        return fail_here(r, "expected a value");
    *out = (struct spin_usd_value){
        .layer = is_word((struct span){from, (size_t)(r->at - from)}, "None") ? NULL : layer,
        .text = from,
        .n_numbers = SIZE_MAX,
    };
    if (asset)
        SPIN_TRY(skip_reference(r));
    out->n_text = (size_t)(r->at - from);
    return SPIN_OK;
}

/* ---- Statements ------------------------------------------------------------------------------ */

/* The words before the '=' of a statement, such as `uniform token colorSpace:name`. */
struct head {
    struct span first, name; /* the first and the last word */
    int n;
    bool assigned; /* true: a '=' follows the words; it was skipped */
};

static spin_status read_head(struct reader *r, struct head *out)
{
    *out = (struct head){.n = 0};
    for (;;) {
        struct span word = {r->at, 0};

        if (peek(r) == '"' || peek(r) == '\'')
            SPIN_TRY(read_quoted(r, &word));
        else
            word = read_word(r);
        if (r->at == word.at)
            break;
        out->first = out->n == 0 ? word : out->first;
        out->name = word;
        out->n++;
        skip_blanks(r);
    }
    out->assigned = accept(r, '=');
    if (out->n == 0)
        return fail_here(r, "expected a name");
    skip_blanks(r);
    return SPIN_OK;
}

static spin_status add_field(struct reader *r, struct span name, struct spin_usd_field ***tail,
                             struct spin_usd_field **out)
{
    SPIN_TRY(spin_arena_take(&r->layer->arena, 1, sizeof **out, (void **)out));
    SPIN_TRY(keep_text(r->layer, name, &(*out)->name));
    **tail = *out;
    *tail = &(*out)->next;
    return SPIN_OK;
}

/* Reads metadata up to and including the closing bracket. */
static spin_status read_metadata(struct reader *r, struct spin_usd_field **list)
{
    struct spin_usd_field **tail = list, *field;

    for (;;) {
        struct head head;
        struct span doc;

        skip_space(r);
        if (accept(r, ')'))
            return SPIN_OK;
        if (accept(r, ';') || accept(r, ','))
            continue;
        if (peek(r) == '"' || peek(r) == '\'') {
            SPIN_TRY(read_quoted(r, &doc));
            continue;
        }
        SPIN_TRY(read_head(r, &head));
        if (!head.assigned)
            return fail_here(r, "expected '=' in metadata");
        skip_space(r);
        SPIN_TRY(add_field(r, head.name, &tail, &field));
        SPIN_TRY(read_value(r, r->layer, &field->value));
        if (is_word(head.first, "delete") || is_word(head.first, "reorder"))
            field->value.layer = NULL;
    }
}

static spin_status read_number(const struct reader *r, struct span s, double *out)
{
    char text[MAX_NUMBER + 1], *end;

    if (s.n == 0 || s.n > MAX_NUMBER)
        return fail_here(r, "expected a number");
    memcpy(text, s.at, s.n);
    text[s.n] = '\0';
    *out = strtod(text, &end);
    return *end == '\0' && strcspn(text, "xX") == s.n ? SPIN_OK : fail_here(r, "expected a number");
}

static int by_time(const void *a, const void *b)
{
    double x = ((const struct spin_usd_sample *)a)->time;
    double y = ((const struct spin_usd_sample *)b)->time;

    return (x > y) - (x < y);
}

/* Reads one sample, `TIME: VALUE`. */
static spin_status read_sample(struct reader *r, struct spin_usd_sample *out)
{
    struct span time = {r->at, 0};

    while (r->at < r->end && strchr("+-.0123456789eE", *r->at) && *r->at != '\0')
        r->at++;
    time.n = (size_t)(r->at - time.at);
    SPIN_TRY(read_number(r, time, &out->time));
    skip_space(r);
    if (!accept(r, ':'))
        return fail_here(r, "expected ':' after the time of a sample");
    skip_space(r);
    SPIN_TRY(read_value(r, r->layer, &out->value));
    skip_space(r);
    if (!accept(r, ',') && peek(r) != '}')
        return fail_here(r, "expected ',' or '}' after a sample");
    return SPIN_OK;
}

static spin_status read_samples(struct reader *r, struct spin_usd_field *field)
{
    SPIN_FREED struct spin_usd_sample *sample = NULL;
    size_t n = 0, capacity = 0;

    if (!accept(r, '{'))
        return fail_here(r, "expected '{' before samples");
    for (skip_space(r); !accept(r, '}'); skip_space(r)) {
        SPIN_TRY(spin_array_grow(n, &capacity, sizeof *sample, (void **)&sample));
        SPIN_TRY(read_sample(r, &sample[n++]));
    }
    SPIN_TRY(spin_arena_take(&r->layer->arena, n, sizeof *sample, (void **)&field->sample));
    if (n > 0)
        memcpy(field->sample, sample, n * sizeof *sample);
    qsort(field->sample, n, sizeof *sample, by_time);
    field->n_samples = n;
    return SPIN_OK;
}

/* Removes the suffix `ending`, such as ".timeSamples", from the name of an attribute. Returns false
 * if the name has no such suffix. */
static bool cut_name(struct span *name, const char *ending)
{
    size_t n = strlen(ending);

    if (name->n <= n || memcmp(name->at + name->n - n, ending, n) != 0)
        return false;
    name->n -= n;
    return true;
}

/* Sets *out to the attribute of this name, which is appended if it is new. An attribute may occur
 * twice, since its default value and its samples are separate statements. */
static spin_status find_attribute(struct reader *r, struct spin_usd_prim *prim, struct span name,
                                  struct spin_usd_field **out)
{
    struct spin_usd_field **tail = &prim->attribute;
    size_t n = 0;

    for (; *tail; tail = &(*tail)->next, n++)
        if (is_word(name, (*tail)->name)) {
            *out = *tail;
            return SPIN_OK;
        }
    if (n == MAX_ATTRIBUTES)
        return fail_here(r, "the prim has too many attributes");
    return add_field(r, name, &tail, out);
}

static spin_status read_property(struct reader *r, struct spin_usd_prim *prim)
{
    struct spin_usd_field *field;
    struct spin_usd_value ignored;
    struct head head;

    SPIN_TRY(read_head(r, &head));
    if (head.n < 2)
        return fail_here(r, "expected the type and the name of a property");
    if (head.assigned) {
        bool sampled = cut_name(&head.name, ".timeSamples");

        skip_space(r);
        if (is_word(head.first, "variantSet")) {
            r->layer->variants = true;
            return skip_brackets(r);
        }
        if (memchr(head.name.at, '.', head.name.n) || is_word(head.first, "rel"))
            SPIN_TRY(read_value(r, r->layer, &ignored));
        else {
            SPIN_TRY(find_attribute(r, prim, head.name, &field));
            SPIN_TRY(sampled ? read_samples(r, field) : read_value(r, r->layer, &field->value));
        }
        skip_blanks(r);
    }
    return peek(r) == '(' ? skip_brackets(r) : SPIN_OK;
}

static bool is_specifier(const struct reader *r)
{
    return begins(r, "def ") || begins(r, "over ") || begins(r, "class ");
}

static spin_status read_prims(struct reader *r, struct spin_usd_prim *parent, int depth);

/* Reads a prim, from its specifier (such as `def`) to its closing bracket. */
static spin_status read_prim(struct reader *r, struct spin_usd_prim *out, int depth)
{
    struct span type, name;

    out->defined = is_word(read_word(r), "def");
    skip_space(r);
    type = read_word(r);
    skip_space(r);
    if (peek(r) != '"' && peek(r) != '\'')
        return fail_here(r, "expected the name of a prim in quotes");
    SPIN_TRY(read_quoted(r, &name));
    SPIN_TRY(keep_text(r->layer, name, &out->name));
    SPIN_TRY(keep_text(r->layer, type, &out->type));
    skip_space(r);
    if (accept(r, '('))
        SPIN_TRY(read_metadata(r, &out->metadata));
    skip_space(r);
    if (!accept(r, '{'))
        return fail_here(r, "expected '{' after the name of a prim");
    return depth < MAX_DEPTH ? read_prims(r, out, depth + 1)
                             : fail_here(r, "prims are nested too deeply");
}

/* Reads the child prims and properties of a prim up to its closing bracket or, at depth 0, the
 * prims of the file. */
static spin_status read_prims(struct reader *r, struct spin_usd_prim *parent, int depth)
{
    struct spin_usd_prim **tail = &parent->child;

    for (skip_space(r); !(depth == 0 && r->at >= r->end); skip_space(r)) {
        if (depth > 0 && accept(r, '}'))
            return SPIN_OK;
        if (accept(r, ';'))
            continue;
        if (!is_specifier(r)) {
            if (r->at >= r->end)
                return fail_here(r, "the file ends within a prim");
            SPIN_TRY(read_property(r, parent));
            continue;
        }
        SPIN_TRY(spin_arena_take(&r->layer->arena, 1, sizeof **tail, (void **)tail));
        SPIN_TRY(read_prim(r, *tail, depth));
        tail = &(*tail)->next;
    }
    return SPIN_OK;
}

bool spin_usd_text_detect(const void *data, size_t size)
{
    return size >= 9 && memcmp(data, "#usda 1.0", 9) == 0;
}

spin_status spin_usd_text_open(struct spin_usd_layer *out)
{
    const char *text = (const char *)out->data;
    struct reader r = {out, text, text, text + out->size};

    out->root.name = out->root.type = "";
    skip_space(&r);
    if (accept(&r, '('))
        SPIN_TRY(read_metadata(&r, &out->root.metadata));
    return read_prims(&r, &out->root, 0);
}

/* ---- Values ---------------------------------------------------------------------------------- */

static struct reader value_reader(const struct spin_usd_value *v)
{
    return (struct reader){NULL, v->text, v->text, v->text + v->n_text};
}

/* The array that receives the numbers of a value, floats or doubles; if both are NULL, the numbers
 * are only counted. */
struct target {
    float *floats;
    double *doubles;
    size_t n, capacity;
};

/* Stores a number. Floats are parsed with strtof(), since a cast of the result of strtod() would
 * round twice. */
static spin_status put_number(const struct reader *r, struct span s, struct target *to)
{
    char text[MAX_NUMBER + 1], *end;

    if (s.n == 0 || s.n > MAX_NUMBER)
        return fail_here(r, "expected a number");
    if (is_word(s, "true") || is_word(s, "false"))
        s = (struct span){*s.at == 't' ? "1" : "0", 1};
    if (to->floats || to->doubles) {
        memcpy(text, s.at, s.n);
        text[s.n] = '\0';
        if (to->n >= to->capacity)
            return fail_here(r, "too many numbers");
        if (to->floats)
            to->floats[to->n] = strtof(text, &end);
        else
            to->doubles[to->n] = strtod(text, &end);
        if (*end != '\0' || strpbrk(text, "xX"))
            return fail_here(r, "expected a number");
    }
    to->n++;
    return SPIN_OK;
}

/* Reads all numbers of a value, at any depth of brackets. Each outermost tuple must have `width`
 * numbers. */
static spin_status read_numbers(const struct spin_usd_value *v, unsigned width, struct target *to)
{
    struct reader r = value_reader(v);
    size_t before = 0;
    int depth = 0;

    for (;;) {
        skip_space(&r);
        if (r.at >= r.end)
            return depth == 0 ? SPIN_OK : fail_here(&r, "a tuple is not closed");
        if (accept(&r, '[') || accept(&r, ']') || accept(&r, ','))
            continue;
        if (accept(&r, '(')) {
            before = depth++ == 0 ? to->n : before;
        } else if (accept(&r, ')')) {
            if (--depth == 0 && to->n - before != width)
                return fail_here(
                    &r, "the number of values in a tuple does not match the declared type");
        } else {
            struct span word = {r.at, 0};

            while (r.at < r.end && !strchr(" \t\r\n,()[]#", *r.at))
                r.at++;
            word.n = (size_t)(r.at - word.at);
            SPIN_TRY(put_number(&r, word, to));
        }
    }
}

spin_status spin_usd_text_count(const struct spin_usd_value *v, unsigned width, size_t *n)
{
    struct target count = {.n = 0};

    SPIN_TRY(read_numbers(v, width, &count));
    *n = count.n;
    return SPIN_OK;
}

spin_status spin_usd_text_numbers(const struct spin_usd_value *v, unsigned width, size_t n,
                                  float *floats, double *doubles)
{
    struct target to = {floats, doubles, 0, n};

    return read_numbers(v, width, &to);
}

static spin_status copy_span(struct span s, char **out)
{
    SPIN_TRY(spin_alloc(s.n + 1, 1, (void **)out));
    memcpy(*out, s.at, s.n);
    return SPIN_OK;
}

spin_status spin_usd_text_text(const struct spin_usd_value *v, char **out)
{
    struct reader r = value_reader(v);
    struct span s = {v->text, v->n_text};

    if (is_quote(peek(&r)))
        SPIN_TRY(read_quoted(&r, &s));
    return copy_span(s, out);
}

spin_status spin_usd_text_reference(const struct spin_usd_value *v, char **asset, char **path)
{
    struct reader r = value_reader(v);
    struct span a = {"", 0}, p = {"", 0};

    if (peek(&r) == '@')
        SPIN_TRY(read_quoted(&r, &a));
    skip_blanks(&r);
    if (peek(&r) == '<')
        SPIN_TRY(read_quoted(&r, &p));
    SPIN_TRY(copy_span(a, asset));
    return copy_span(p, path);
}

spin_status spin_usd_text_entry(const struct spin_usd_value *dictionary, const char *name,
                                struct spin_usd_value *out)
{
    struct reader r = value_reader(dictionary);

    *out = (struct spin_usd_value){.layer = NULL};
    if (!accept(&r, '{'))
        return fail_here(&r, "expected a dictionary");
    for (skip_space(&r); !accept(&r, '}'); skip_space(&r)) {
        struct head head;

        if (accept(&r, ';') || accept(&r, ','))
            continue;
        SPIN_TRY(read_head(&r, &head));
        if (!head.assigned)
            return fail_here(&r, "expected '=' in a dictionary");
        skip_space(&r);
        SPIN_TRY(read_value(&r, dictionary->layer, out));
        if (!name || is_word(head.name, name))
            return SPIN_OK;
    }
    *out = (struct spin_usd_value){.layer = NULL};
    return SPIN_OK;
}

bool spin_usd_text_next(struct spin_usd_items *items, struct spin_usd_value *out)
{
    struct reader r = value_reader(items->of);
    bool list = peek(&r) == '[';

    if (!list && items->at > 0)
        return false;
    r.at += items->at > 0 ? items->at : (size_t)list;
    for (skip_space(&r); accept(&r, ','); skip_space(&r))
        continue;
    if (r.at >= r.end || peek(&r) == ']' || read_value(&r, items->of->layer, out) != SPIN_OK)
        return false;
    items->at = (size_t)(r.at - items->of->text);
    return true;
}
