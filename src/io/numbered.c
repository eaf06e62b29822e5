/* Finds the frame number in the names of a sequence, by comparing all names. */
#include "io/numbered.h"

#include <ctype.h>
#include <strings.h>

#include "base/base.h"
#include "io/file.h"
#include "io/numbered_fields.h"

/* How regularly the distinct values of a number are spaced. The more regular, the more likely they
 * are frame numbers. */
enum tier {
    SCATTERED,  /* irregular */
    STEPS,      /* multiples of one step, of which at least half occur; or evenly spaced decimals */
    CONSECUTIVE /* integers without gaps */
};

/* A column of numbers: number `index` of every name. */
struct field {
    size_t index;
    /* varies: this number differs between two names of a group; distinct: it differs between all
     * names of every group. */
    bool varies, distinct;
    bool decimal;
    bool even; /* nearly evenly spaced, as rounded times are */
    enum tier tier;
    enum spin_name_rank rank;
    size_t *order; /* [n] indices of the names, sorted by group and value */
};

struct reader {
    const struct spin_numbering *names;
    struct spin_name_parts *parts; /* [n] */
    struct field *field;           /* [n_fields] the numbers of the names, except those in hashes */
    size_t n_fields;
    bool hashes; /* true: the names contain a hash */
    struct spin_numbers *out;
};

/* ---- Sorting --------------------------------------------------------------------------------- */

int spin_compare_names(const char *a, const char *b)
{
    const char *x = a, *y = b;

    for (; *x && *y; x++, y++) {
        size_t n_x = strspn(x, "0123456789"), n_y = strspn(y, "0123456789");

        if (n_x > 0 && n_y > 0) {
            for (; n_x > 1 && *x == '0'; n_x--)
                x++;
            for (; n_y > 1 && *y == '0'; n_y--)
                y++;
            if (n_x != n_y)
                return n_x < n_y ? -1 : 1;
        }
        if (*x != *y)
            return (unsigned char)*x < (unsigned char)*y ? -1 : 1;
    }
    return *x || *y ? (*x ? 1 : -1) : strcmp(a, b);
}

static _Thread_local const struct reader *sorted;
static _Thread_local size_t sorted_index;

static const struct spin_name_value *value_of(const struct reader *r, size_t name, size_t index)
{
    return &r->parts[name].number[index].value;
}

static int group_of(const struct reader *r, size_t name)
{
    return r->names->group ? r->names->group[name] : 0;
}

static int by_value(const void *a, const void *b)
{
    size_t x = *(const size_t *)a, y = *(const size_t *)b;
    int order =
        spin_compare_values(value_of(sorted, x, sorted_index), value_of(sorted, y, sorted_index));

    return order ? order : (x > y) - (x < y);
}

static int by_group_and_value(const void *a, const void *b)
{
    int x = group_of(sorted, *(const size_t *)a), y = group_of(sorted, *(const size_t *)b);

    return x != y ? (x < y ? -1 : 1) : by_value(a, b);
}

static int by_group_and_name(const void *a, const void *b)
{
    size_t i = *(const size_t *)a, k = *(const size_t *)b;
    int x = group_of(sorted, i), y = group_of(sorted, k);

    return x != y ? (x < y ? -1 : 1)
                  : spin_compare_names(sorted->names->name[i], sorted->names->name[k]);
}

static void sort_order(const struct reader *r, size_t index, size_t *order, size_t n,
                       int (*compare)(const void *, const void *))
{
    sorted = r;
    sorted_index = index;
    qsort(order, n, sizeof *order, compare);
}

/* ---- Words that are hashes ------------------------------------------------------------------- */

/* Set `shape` to word j of a name in lower case, with each run of digits replaced by '#', such as
 * "frame#". Returns whether the word consists of at least 4 hexadecimal digits. */
static bool word_shape(const struct spin_name_parts *parts, size_t j, char shape[64])
{
    const char *at = parts->name + parts->word[j].at, *end = at + parts->word[j].n;
    bool hex = parts->word[j].n >= 4;
    size_t n = 0;

    for (; at < end; at++) {
        char c = isdigit((unsigned char)*at) ? '#' : (char)tolower((unsigned char)*at);

        hex = hex && (isxdigit((unsigned char)*at) != 0);
        if (n < 63 && !(c == '#' && n > 0 && shape[n - 1] == '#'))
            shape[n++] = c;
    }
    shape[n] = '\0';
    return hex;
}

/* Returns whether word j is a hash. It must be hexadecimal in all names, and contain a digit in at
 * least one. If there are several names, its letters or their positions must differ between names;
 * in a single name, its letters and runs of digits must be at least four in all. */
static bool is_hash_word(const struct reader *r, size_t j)
{
    char first[64], shape[64];
    bool hex = word_shape(&r->parts[0], j, first), differs = false, digits = false;

    for (size_t i = 0; i < r->names->n && hex; i++) {
        hex = word_shape(&r->parts[i], j, shape);
        differs = differs || strcmp(shape, first) != 0;
        digits = digits || strchr(shape, '#');
    }
    return hex && digits && (r->names->n == 1 ? strlen(first) > 3 : differs);
}

/* Whether the words from word j on are a UUID in all names. */
static bool is_uuid(const struct reader *r, size_t j)
{
    static const unsigned short length[] = {8, 4, 4, 4, 12};
    bool uuid = r->names->n > 0 && j + 5 <= r->parts[0].n_words;
    char shape[64];

    for (size_t i = 0; i < r->names->n && uuid; i++)
        for (size_t k = 0; k < 5; k++)
            uuid = uuid && r->parts[i].word[j + k].n == length[k] &&
                   word_shape(&r->parts[i], j + k, shape);
    return uuid;
}

/* Removes the numbers of word j from all names. */
static void drop_word(struct reader *r, size_t j)
{
    for (size_t i = 0; i < r->names->n; i++) {
        struct spin_name_parts *parts = &r->parts[i];
        size_t kept = 0;

        for (size_t k = 0; k < parts->n_numbers; k++)
            if (parts->number[k].word != j)
                parts->number[kept++] = parts->number[k];
        parts->n_numbers = kept;
    }
}

static void drop_hashes(struct reader *r)
{
    for (size_t i = 1; i < r->names->n; i++)
        if (r->parts[i].n_words != r->parts[0].n_words)
            return;
    for (size_t j = 0; r->names->n > 0 && j < r->parts[0].n_words; j++) {
        size_t n = is_uuid(r, j) ? 5 : is_hash_word(r, j) ? 1 : 0;

        r->hashes = r->hashes || n > 0;
        for (; n > 0; n--, j += n > 0)
            drop_word(r, j);
    }
}

/* ---- Decimals -------------------------------------------------------------------------------- */

/* Returns the number of decimals of a number, as written. */
static size_t count_decimals(const struct spin_name_parts *parts, size_t index)
{
    const struct spin_name_number *x = &parts->number[index];
    const char *dot = memchr(parts->name + x->at, '.', x->n);

    return dot ? (size_t)(parts->name + x->at + x->n - dot - 1) : 0;
}

static uint64_t decimals_value(const struct spin_name_parts *parts, size_t index)
{
    const struct spin_name_number *x = &parts->number[index];

    return strtoull(parts->name + x->at + x->n - count_decimals(parts, index), NULL, 10);
}

/* Whether the digits after the dot are a separate number, as in "shot1.9" and "shot1.10", and not
 * decimals. The digits before the dot must be equal in all names. The digits after the dot must be
 * consecutive numbers, or numbers of different lengths some of which end with 0, as decimals seldom
 * do. */
static bool is_dotted(const struct reader *r, size_t index)
{
    size_t n = r->names->n, digits = count_decimals(&r->parts[0], index);
    uint64_t least = UINT64_MAX, most = 0;
    bool widths = false, zero = false;

    for (size_t i = 0; i < n; i++) {
        const struct spin_name_value *v = value_of(r, i, index), *first = value_of(r, 0, index);
        uint64_t decimals = decimals_value(&r->parts[i], index);

        if (count_decimals(&r->parts[i], index) == 0 || v->part[1] != first->part[1])
            return false;
        least = decimals < least ? decimals : least;
        most = decimals > most ? decimals : most;
        widths = widths || count_decimals(&r->parts[i], index) != digits;
        zero = zero || (decimals > 0 && decimals % 10 == 0);
    }
    if (n > 1 && spin_name_rank(&r->parts[0], index) != SPIN_RANK_TIME && most - least == n - 1)
        return true;
    return n == 1 ? digits >= 3 : widths && zero;
}

/* Replaces number `index` of all names by the digits after its dot. */
static void use_decimals(struct reader *r, size_t index)
{
    for (size_t i = 0; i < r->names->n; i++) {
        struct spin_name_number *x = &r->parts[i].number[index];
        size_t digits = count_decimals(&r->parts[i], index);

        x->value = (struct spin_name_value){.part = {0, decimals_value(&r->parts[i], index), 0}};
        x->at = (unsigned short)(x->at + x->n - digits);
        x->n = (unsigned short)digits;
    }
}

/* ---- Fields ---------------------------------------------------------------------------------- */

static uint64_t gcd(uint64_t a, uint64_t b) { return b ? gcd(b, a % b) : a; }

/* Returns the value of a number as an integer, in units of 1e-6 if the field is decimal. 2^62 is
 * added so that negative numbers sort correctly. */
static uint64_t ticks_of(const struct spin_name_value *v, bool decimal)
{
    uint64_t size = v->part[1] % UINT64_C(1000000000000);

    if (decimal)
        size = size * 1000000 + v->part[2] / UINT64_C(1000000000000);
    return v->negative ? (UINT64_C(1) << 62) - size : (UINT64_C(1) << 62) + size;
}

/* Lists the distinct values of a field in ascending order. */
static spin_status list_values(const struct reader *r, const struct field *f, uint64_t **out,
                               size_t *n)
{
    SPIN_FREED size_t *order = NULL;

    *n = 0;
    SPIN_TRY(spin_alloc(r->names->n, sizeof **out, (void **)out));
    SPIN_TRY(spin_alloc(r->names->n, sizeof *order, (void **)&order));
    memcpy(order, f->order, r->names->n * sizeof *order);
    sort_order(r, f->index, order, r->names->n, by_value);
    for (size_t i = 0; i < r->names->n; i++) {
        const struct spin_name_value *v = value_of(r, order[i], f->index);

        if (i == 0 || spin_compare_values(v, value_of(r, order[i - 1], f->index)) != 0)
            (*out)[(*n)++] = ticks_of(v, f->decimal);
    }
    return SPIN_OK;
}

static spin_status find_tier(const struct reader *r, struct field *f)
{
    SPIN_FREED uint64_t *value = NULL;
    uint64_t step = 0, least = UINT64_MAX, most = 0, span;
    size_t n;

    SPIN_TRY(list_values(r, f, &value, &n));
    for (size_t i = 1; i < n; i++) {
        uint64_t here = value[i] - value[i - 1];

        step = gcd(step, here);
        least = here < least ? here : least;
        most = here > most ? here : most;
    }
    span = n > 1 ? (value[n - 1] - value[0]) / (step ? step : 1) : 0;
    f->even = n > 2 && most - least <= most / 10 + 1 && least > 2;
    if (n > 1 && !f->decimal && step == 1 && span == n - 1)
        f->tier = CONSECUTIVE;
    else if (n > 2 && (span + 1 <= 2 * n || (f->decimal && most - least <= most / 10 + 1)))
        f->tier = STEPS;
    return SPIN_OK;
}

static spin_status fill_field(const struct reader *r, size_t index, struct field *f)
{
    size_t n = r->names->n;

    *f = (struct field){.index = index, .distinct = true, .rank = SPIN_RANK_FRAME};
    SPIN_TRY(spin_alloc(n, sizeof *f->order, (void **)&f->order));
    for (size_t i = 0; i < n; i++) {
        enum spin_name_rank rank = spin_name_rank(&r->parts[i], index);

        f->order[i] = i;
        f->decimal = f->decimal || value_of(r, i, index)->part[2] != 0;
        f->rank = rank < f->rank ? rank : f->rank;
    }
    sort_order(r, index, f->order, n, by_group_and_value);
    for (size_t k = 1; k < n; k++) {
        size_t here = f->order[k], before = f->order[k - 1];
        bool same = spin_compare_values(value_of(r, here, index), value_of(r, before, index)) == 0;

        if (group_of(r, here) != group_of(r, before))
            continue;
        f->varies = f->varies || !same;
        f->distinct = f->distinct && !same;
    }
    return find_tier(r, f);
}

static spin_status fail_mixed(const struct reader *r, size_t a, size_t b)
{
    const struct spin_name_parts *fewer = &r->parts[a], *more = &r->parts[b];

    if (fewer->n_numbers == 0)
        return spin_malformed(
            "'%s' has no frame number in its name, but '%s' has one: remove the files "
            "that are not frames, or select the frames with --pattern",
            fewer->name, more->name);
    return spin_malformed(
        "cannot find the frame number: '%s' and '%s' differ in how many numbers they "
        "contain; choose the number with a pattern such as --pattern 'frame_%%04d*'",
        fewer->name, more->name);
}

/* Fails if names differ in how many numbers they contain. */
static spin_status check_counts(const struct reader *r)
{
    size_t fewest = 0, most = 0;

    for (size_t i = 1; i < r->names->n; i++) {
        fewest = r->parts[i].n_numbers < r->parts[fewest].n_numbers ? i : fewest;
        most = r->parts[i].n_numbers > r->parts[most].n_numbers ? i : most;
    }
    return r->parts[fewest].n_numbers < r->parts[most].n_numbers ? fail_mixed(r, fewest, most)
                                                                 : SPIN_OK;
}

static spin_status find_fields(struct reader *r)
{
    drop_hashes(r);
    SPIN_TRY(check_counts(r));
    for (size_t i = 0; i < r->parts[0].n_numbers; i++) {
        if (is_dotted(r, i))
            use_decimals(r, i);
        spin_name_merge_stamp(r->parts, r->names->n, i);
        SPIN_TRY(spin_grow(i + 1, sizeof *r->field, (void **)&r->field));
        r->field[i].order = NULL;
        r->n_fields++;
        SPIN_TRY(fill_field(r, i, &r->field[i]));
    }
    return SPIN_OK;
}

/* ---- Choosing -------------------------------------------------------------------------------- */

/* Formats the argument of --pattern that selects a field: the first name, with %d or %0Nd in place
 * of this number, and '*' in place of the other numbers that vary. */
static void write_pattern(const struct reader *r, const struct field *chosen, char *out, size_t n)
{
    const struct spin_name_parts *parts = &r->parts[0];
    size_t used = 0, at = 0;

    *out = '\0';
    for (size_t i = 0; i < r->n_fields && used < n; i++) {
        const struct spin_name_number *x = &parts->number[i];
        bool padded = parts->name[x->at] == '0' && x->n > 1 && x->n < 10;

        if (&r->field[i] != chosen && !r->field[i].varies)
            continue;
        used += (size_t)snprintf(out + used, n - used, "%.*s", (int)(x->at - at), parts->name + at);
        at = (size_t)x->at + x->n;
        if (used < n && &r->field[i] != chosen)
            used += (size_t)snprintf(out + used, n - used, "*");
        else if (used < n)
            used += (size_t)snprintf(out + used, n - used, padded ? "%%0%dd" : "%%d", (int)x->n);
    }
    if (used < n)
        snprintf(out + used, n - used, "%s", r->hashes ? "*" : parts->name + at);
}

static spin_status fail_two(const struct reader *r, const struct field *a, const struct field *b)
{
    char first[256], second[256];

    write_pattern(r, a, first, sizeof first);
    write_pattern(r, b, second, sizeof second);
    return spin_malformed(
        "cannot find the frame number in names such as '%s', since either of two numbers "
        "may be it: give either --pattern '%s' or --pattern '%s'",
        r->parts[0].name, first, second);
}

static spin_status fail_same(const struct reader *r, const struct field *f)
{
    for (size_t k = 1; k < r->names->n; k++) {
        size_t a = f->order[k - 1], b = f->order[k];
        const struct spin_name_number *x = &r->parts[b].number[f->index];
        const char *text = r->parts[b].name + x->at;
        int skipped = 0;

        while (skipped + 1 < x->n && text[skipped] == '0')
            skipped++;
        if (group_of(r, a) == group_of(r, b) &&
            spin_compare_values(value_of(r, a, f->index), value_of(r, b, f->index)) == 0)
            return spin_malformed("'%s' and '%s' are both frame %.*s: rename one of the files",
                                  r->parts[a].name, r->parts[b].name, x->n - skipped,
                                  text + skipped);
    }
    return SPIN_OK;
}

static spin_status fail_never(const struct reader *r, const struct field *f)
{
    char pattern[256];

    write_pattern(r, f, pattern, sizeof pattern);
    return spin_malformed(
        "cannot find a frame number in names such as '%s': the number that varies "
        "seems to be a score, a count or an iteration; to use it, give "
        "--pattern '%s'",
        r->parts[0].name, pattern);
}

static bool same_order(const struct reader *r, const struct field *a, const struct field *b)
{
    return memcmp(a->order, b->order, r->names->n * sizeof *a->order) == 0;
}

static bool same_values(const struct reader *r, const struct field *a, const struct field *b)
{
    for (size_t i = 0; i < r->names->n; i++)
        if (spin_compare_values(value_of(r, i, a->index), value_of(r, i, b->index)) != 0)
            return false;
    return true;
}

/* Returns whether the irregular number a may be the frame number although number b is regular. For
 * example, in "x1_y1, x2_y2, x3_y9", the second number may count the frames of a sequence with
 * gaps. Returns false for numbers of 1000 and more, which probably count splats; for rounded times;
 * and for numbers that sort the names in a different order than b. */
static bool may_count(const struct reader *r, const struct field *a, const struct field *b)
{
    const struct spin_name_value *first = value_of(r, a->order[0], a->index);
    bool count = first->part[0] > 0 || first->part[1] >= 1000;

    return a->rank == b->rank && !a->decimal && !a->even && !count &&
           (r->names->n == 2 || same_order(r, a, b));
}

/* Whether field b, if it may be the frame number, excludes the varying field a as the frame number.
 * The words around the numbers decide first (rank), then whether the values identify every name
 * (distinct), then how regular they are (tier).
 */
static bool yields(const struct reader *r, const struct field *a, const struct field *b)
{
    if (a->rank < SPIN_RANK_PLAIN && b->rank >= SPIN_RANK_PLAIN)
        return b->distinct || !a->distinct;
    if (!b->distinct)
        return false;
    if (!a->distinct || same_values(r, a, b))
        return a->rank < SPIN_RANK_FRAME && (b->tier > SCATTERED || b->rank == SPIN_RANK_FRAME);
    if (b->rank == SPIN_RANK_FRAME && a->rank < b->rank)
        return same_order(r, a, b) || a->tier == SCATTERED || b->tier > a->tier;
    if (a->rank == SPIN_RANK_FRAME && b->rank < a->rank)
        return false;
    if (a->tier == SCATTERED)
        return b->tier > SCATTERED && !may_count(r, a, b);
    return same_order(r, a, b) && (a->decimal || a->rank != b->rank) &&
           (a->tier < b->tier || (a->tier == b->tier && a->rank < b->rank));
}

/* Returns a varying field other than `of` that may be the frame number as well; NULL if there is
 * none. */
static const struct field *find_rival(const struct reader *r, const struct field *of)
{
    for (size_t i = 0; i < r->n_fields; i++)
        if (r->field[i].varies && &r->field[i] != of && !yields(r, &r->field[i], of))
            return &r->field[i];
    return NULL;
}

/* Sets *out to the field with the frame number, or to NULL if no number varies. */
static spin_status choose_field(const struct reader *r, const struct field **out)
{
    const struct field *best = NULL, *rival = NULL;

    for (size_t i = 0; i < r->n_fields; i++) {
        const struct field *f = &r->field[i];

        if (!f->varies || (best && !rival && f->rank <= best->rank))
            continue;
        if (!best || !find_rival(r, f)) {
            best = f;
            rival = find_rival(r, f);
        }
    }
    *out = best;
    if (rival)
        return fail_two(r, best, rival);
    return best && best->rank == SPIN_RANK_NEVER ? fail_never(r, best) : SPIN_OK;
}

/* Returns the last number that may be a frame number, or NULL. This is for groups that consist of
 * one name, in which no number varies. */
static const struct field *last_field(const struct reader *r)
{
    const struct field *best = NULL;

    for (size_t i = 0; i < r->n_fields; i++)
        if (r->field[i].distinct && r->field[i].rank >= SPIN_RANK_PLAIN &&
            (!best || r->field[i].rank >= best->rank))
            best = &r->field[i];
    return best;
}

/* ---- The result ------------------------------------------------------------------------------ */

/* Sets the frame numbers. If any value is not an integer from 0 to INT_MAX, all stay -1, and the
 * values only define the order. */
static void set_numbers(const struct reader *r, size_t index)
{
    for (size_t i = 0; i < r->out->n_frames; i++) {
        const struct spin_name_value *v = value_of(r, i, index);

        if (v->negative || v->part[0] > 0 || v->part[1] > INT_MAX || v->part[2] > 0)
            return;
    }
    for (size_t i = 0; i < r->out->n_frames; i++)
        r->out->number[i] = (int)value_of(r, i, index)->part[1];
}

static spin_status use_field(const struct reader *r, const struct field *f)
{
    if (!f->distinct)
        return fail_same(r, f);
    memcpy(r->out->order, f->order, r->names->n * sizeof *f->order);
    r->out->numbered = true;
    set_numbers(r, f->index);
    return SPIN_OK;
}

static spin_status use_names(const struct reader *r)
{
    if (r->hashes && r->names->n > 1)
        return spin_malformed(
            "cannot order the frames: '%s' and the other file names contain hashes "
            "instead of frame numbers; rename the files so that their names contain frame numbers",
            r->parts[0].name);
    sort_order(r, 0, r->out->order, r->names->n, by_group_and_name);
    return SPIN_OK;
}

static spin_status read_names(struct reader *r)
{
    const struct field *chosen;

    for (size_t i = 0; i < r->names->n; i++)
        SPIN_TRY(spin_name_split(r->names->name[i], r->names->folders, &r->parts[i]));
    if (r->names->n == 0)
        return SPIN_OK;
    SPIN_TRY(find_fields(r));
    SPIN_TRY(choose_field(r, &chosen));
    if (!chosen)
        chosen = last_field(r);
    return chosen ? use_field(r, chosen) : use_names(r);
}

/* Splits a name, and keeps only one of its numbers: the one at `at`, which matches the number field
 * of the pattern. */
static spin_status take_number(const char *name, const char *at, struct spin_name_parts *out)
{
    size_t first = 0;

    SPIN_TRY(spin_name_split(name, true, out));
    while (first + 1 < out->n_numbers && name + out->number[first].at + out->number[first].n <= at)
        first++;
    if (out->n_numbers == 0)
        return spin_malformed("'%s' has no frame number in its name", name);
    out->number[0] = out->number[first];
    out->number[0].value = (struct spin_name_value){.negative = *at == '-'};
    out->number[0].value.part[1] = strtoull(at + (*at == '-'), NULL, 10);
    out->n_numbers = 1;
    return SPIN_OK;
}

/* The names that match the pattern. */
struct matches {
    const char **name;
    const char **digits; /* position of the number in each name */
    int *group;
    size_t *index; /* index in the list of all names */
    size_t n;
};

static spin_status find_matches(const struct spin_numbering *names, struct matches *out)
{
    struct spin_pattern pattern;

    SPIN_TRY(spin_pattern_parse(names->pattern, &pattern));
    SPIN_TRY(spin_alloc(names->n, sizeof *out->name, (void **)&out->name));
    SPIN_TRY(spin_alloc(names->n, sizeof *out->digits, (void **)&out->digits));
    SPIN_TRY(spin_alloc(names->n, sizeof *out->group, (void **)&out->group));
    SPIN_TRY(spin_alloc(names->n, sizeof *out->index, (void **)&out->index));
    for (size_t i = 0; i < names->n; i++) {
        if (!spin_pattern_match(&pattern, names->name[i], &out->digits[out->n]))
            continue;
        out->name[out->n] = names->name[i];
        out->group[out->n] = names->group ? names->group[i] : 0;
        out->index[out->n++] = i;
    }
    if (out->n == 0 && names->n > 0)
        return spin_not_found("no file name matches --pattern '%s'; the first name is '%s'",
                              names->pattern, names->name[0]);
    return SPIN_OK;
}

static void free_matches(struct matches *m)
{
    free(m->name);
    free(m->digits);
    free(m->group);
    free(m->index);
}

static spin_status read_matches(struct reader *r, const struct matches *m)
{
    for (size_t i = 0; i < m->n; i++)
        SPIN_TRY(take_number(m->name[i], m->digits[i], &r->parts[i]));
    SPIN_TRY(spin_alloc(1, sizeof *r->field, (void **)&r->field));
    r->n_fields = 1;
    SPIN_TRY(fill_field(r, 0, &r->field[0]));
    return use_field(r, &r->field[0]);
}

/* Converts the result from indices of matching names to indices of all names. */
static spin_status spread_matches(const struct spin_numbering *names, const struct matches *m,
                                  struct spin_numbers *out)
{
    int *number = NULL;

    SPIN_TRY(spin_alloc(names->n, sizeof *number, (void **)&number));
    for (size_t i = 0; i < names->n; i++)
        number[i] = -1;
    for (size_t i = 0; i < m->n; i++) {
        number[m->index[i]] = out->number[i];
        out->order[i] = m->index[out->order[i]];
    }
    free(out->number);
    out->number = number;
    return SPIN_OK;
}

/* ---- Reading --------------------------------------------------------------------------------- */

static void free_reader(struct reader *r)
{
    for (size_t i = 0; r->parts && i < r->names->n; i++)
        spin_name_parts_free(&r->parts[i]);
    for (size_t i = 0; i < r->n_fields; i++)
        free(r->field[i].order);
    free(r->parts);
    free(r->field);
}

static spin_status begin_reader(struct reader *r)
{
    size_t n = r->names->n;

    *r->out = (struct spin_numbers){.n_frames = n};
    SPIN_TRY(spin_alloc(n, sizeof *r->out->number, (void **)&r->out->number));
    SPIN_TRY(spin_alloc(n, sizeof *r->out->order, (void **)&r->out->order));
    for (size_t i = 0; i < n; i++) {
        r->out->number[i] = -1;
        r->out->order[i] = i;
    }
    return spin_alloc(n, sizeof *r->parts, (void **)&r->parts);
}

spin_status spin_numbered_read(const struct spin_numbering *names, struct spin_numbers *out)
{
    SPIN_LEAVES(free_matches) struct matches m = {0};
    struct spin_numbering chosen;
    SPIN_LEAVES(free_reader) struct reader r = {.names = names, .out = out};
    spin_status status;

    *out = (struct spin_numbers){0};
    if (names->pattern && names->n > 0) {
        SPIN_TRY(find_matches(names, &m));
        chosen = (struct spin_numbering){.name = m.name, .n = m.n, .group = m.group};
        r.names = &chosen;
    }
    status = begin_reader(&r);
    if (status == SPIN_OK)
        status = r.names == names ? read_names(&r) : read_matches(&r, &m);
    if (status == SPIN_OK && r.names != names)
        status = spread_matches(names, &m, out);
    if (status != SPIN_OK)
        spin_numbers_free(out);
    return status;
}

void spin_numbers_free(struct spin_numbers *numbers)
{
    free(numbers->number);
    free(numbers->order);
    *numbers = (struct spin_numbers){0};
}

bool spin_name_has_number(const char *name)
{
    const char *dot = strrchr(name, '.');

    return strcspn(name, "0123456789") < (dot && dot > name ? (size_t)(dot - name) : strlen(name));
}

/* ---- Cameras --------------------------------------------------------------------------------- */

/* Returns the number after the word "cam" or "camera" in the first n bytes of a name, or -1. */
static int camera_in(const char *name, size_t n)
{
    for (size_t i = 0; i + 3 < n; i++) {
        size_t at = i + (strncasecmp(name + i, "camera", 6) == 0 ? 6 : 3), n_digits;
        bool inside = i > 0 && (isalnum((unsigned char)name[i - 1]) || (name[i - 1] & 0x80));

        if (inside || strncasecmp(name + i, "cam", 3) != 0 || at >= n)
            continue;
        at += strchr("_- .", name[at]) != NULL;
        n_digits = strspn(name + at, "0123456789");
        if (n_digits > 0 && n_digits <= 9)
            return atoi(name + at);
    }
    return -1;
}

int spin_camera_number(const char *path)
{
    const char *end = path + strlen(path);

    while (end > path) {
        const char *name = end;
        int camera;

        while (name > path && name[-1] != '/')
            name--;
        camera = camera_in(name, (size_t)(end - name));
        if (camera >= 0)
            return camera;
        end = name > path ? name - 1 : path;
    }
    return -1;
}
