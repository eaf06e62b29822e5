/* Splits names into words and numbers, and recognises time stamps. */
#include <ctype.h>
#include <strings.h>

#include "base/base.h"
#include "io/numbered_fields.h"

enum { MAX_NAME = 1024, MAX_DIGITS = 36 };

int spin_compare_values(const struct spin_name_value *a, const struct spin_name_value *b)
{
    if (a->negative != b->negative)
        return a->negative ? -1 : 1;
    for (int i = 0; i < 3; i++)
        if (a->part[i] != b->part[i])
            return (a->part[i] < b->part[i]) != a->negative ? -1 : 1;
    return 0;
}

static bool is_digit(char c) { return c >= '0' && c <= '9'; }
/* Bytes of UTF-8 sequences count as letters. */
static bool is_word(char c) { return isalnum((unsigned char)c) || (unsigned char)c >= 0x80; }

static size_t count_digits(const char *at, const char *end)
{
    size_t n = 0;

    while (at + n < end && is_digit(at[n]))
        n++;
    return n;
}

/* Returns the length of the name without its extension: the last dot and up to 8 characters after
 * it. Digits after the dot, with or without the unit "s" ("0.25s"), are decimals instead. */
static size_t stem_length(const char *name, bool folder)
{
    const char *dot = strrchr(name, '.');
    size_t n = strlen(name), n_digits;

    if (folder || !dot || dot == name || strlen(dot) > 9)
        return n;
    n_digits = count_digits(dot + 1, name + n);
    if (!dot[1 + n_digits] || strcmp(dot + 1 + n_digits, "s") == 0)
        return n;
    return (size_t)(dot - name);
}

/* ---- Numbers --------------------------------------------------------------------------------- */

/* Appends n decimal digits to the integer that part[0] (the high digits) and part[1] (the low 18
 * digits) form together. */
static void add_digits(struct spin_name_value *v, const char *digits, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        v->part[0] = v->part[0] * 10 + v->part[1] / UINT64_C(100000000000000000);
        v->part[1] = v->part[1] % UINT64_C(100000000000000000) * 10 + (uint64_t)(digits[i] - '0');
    }
}

static void set_fraction(struct spin_name_value *v, const char *digits, size_t n)
{
    v->part[2] = 0;
    for (size_t i = 0; i < 18; i++)
        v->part[2] = v->part[2] * 10 + (i < n ? (uint64_t)(digits[i] - '0') : 0);
}

/* Returns the length of the dot and decimals of a number; 0 if there are none, or if the number is
 * part of a list such as "1.2.3". */
static size_t decimals_length(const char *name, const char *at, const char *dot, const char *end)
{
    size_t n = dot < end && *dot == '.' ? count_digits(dot + 1, end) : 0;
    const char *after = dot + 1 + n;

    if (n == 0 || (at > name + 1 && at[-1] == '.' && is_digit(at[-2])))
        return 0;
    return after + 1 < end && *after == '.' && is_digit(after[1]) ? 0 : n + 1;
}

/* Reads the number whose digits begin at `at`. A '-' before it is a minus sign unless a letter or
 * digit precedes the '-'. Returns the length from `at` on. */
static size_t read_number(const char *name, const char *at, const char *end,
                          struct spin_name_number *out)
{
    size_t n = count_digits(at, end), decimals = decimals_length(name, at, at + n, end);

    *out = (struct spin_name_number){.at = (unsigned short)(at - name)};
    if (at > name && at[-1] == '-' && (at == name + 1 || !is_word(at[-2]))) {
        out->value.negative = true;
        out->at--;
    }
    if (n <= MAX_DIGITS)
        add_digits(&out->value, at, n);
    if (decimals > 0)
        set_fraction(&out->value, at + n + 1, decimals - 1);
    if (out->value.part[0] == 0 && out->value.part[1] == 0 && out->value.part[2] == 0)
        out->value.negative = false;
    out->n = (unsigned short)(n + decimals + (size_t)(at - name) - out->at);
    return n + decimals;
}

void spin_name_parts_free(struct spin_name_parts *parts)
{
    free(parts->number);
    free(parts->word);
    *parts = (struct spin_name_parts){0};
}

static spin_status add_number(struct spin_name_parts *parts, const struct spin_name_number *number)
{
    SPIN_TRY(spin_grow(parts->n_numbers + 1, sizeof *parts->number, (void **)&parts->number));
    parts->number[parts->n_numbers] = *number;
    parts->number[parts->n_numbers++].word = (unsigned short)(parts->n_words - 1);
    return SPIN_OK;
}

spin_status spin_name_split(const char *name, bool folder, struct spin_name_parts *out)
{
    const char *end = name + stem_length(name, folder), *at = name;

    *out = (struct spin_name_parts){.name = name};
    if (end - name > MAX_NAME)
        return spin_malformed(
            "the file name '%.40s...' is too long: at most %d characters are supported", name,
            MAX_NAME);
    while (at < end) {
        struct spin_name_number number;
        const char *start;

        if (!is_word(*at)) {
            at++;
            continue;
        }
        SPIN_TRY(spin_grow(out->n_words + 1, sizeof *out->word, (void **)&out->word));
        out->n_words++;
        for (start = at; at < end && is_word(*at);) {
            size_t n = is_digit(*at) ? read_number(name, at, end, &number) : 1;

            if (is_digit(*at))
                SPIN_TRY(add_number(out, &number));
            at += n;
        }
        out->word[out->n_words - 1].at = (unsigned short)(start - name);
        out->word[out->n_words - 1].n = (unsigned short)(at - start);
    }
    return SPIN_OK;
}

/* ---- Words ----------------------------------------------------------------------------------- */

static bool is_listed(const char *const *list, const char *text, size_t n)
{
    for (; n > 0 && *list; list++)
        if (strlen(*list) == n && strncasecmp(*list, text, n) == 0)
            return true;
    return false;
}

static const char *const frame_words[] = {"frame", "frames", "frm", "fr", "f", "frameno", NULL};
static const char *const time_words[] = {"t", "ts", "time", "timestep", "timestamp", NULL};
static const char *const never_words[] = {
    "psnr", "ssim", "lpips", "loss",      "score",      "err",   "error", "mse",
    "mae",  "iter", "iters", "iteration", "iterations", "epoch", "ckpt",  "checkpoint",
    "crc",  "hash", "md5",   "sha",       "it",         NULL};
static const char *const other_words[] = {
    "n",   "num",   "count", "v",   "ver",  "version", "sh",   "fps", "hz",   "cam", "camera",
    "lod", "level", "seed",  "gpu", "rank", "crf",     "size", "bit", "bits", "q",   NULL};
static const char *const never_units[] = {"pts", "points", "splats", "gaussians", "gs", "k",
                                          "kb",  "mb",     "db",     "iters",     NULL};
static const char *const other_units[] = {"fps", "hz", "bit", "bits", "px", "p", "x", NULL};

static enum spin_name_rank rank_of_word(const char *text, size_t n)
{
    return is_listed(never_words, text, n)   ? SPIN_RANK_NEVER
           : is_listed(other_words, text, n) ? SPIN_RANK_OTHER
           : is_listed(frame_words, text, n) ? SPIN_RANK_FRAME
           : is_listed(time_words, text, n)  ? SPIN_RANK_TIME
                                             : SPIN_RANK_PLAIN;
}

/* Returns the rank according to the letters between the number and the end of its word, such as
 * "fps". */
static enum spin_name_rank rank_by_unit(const struct spin_name_parts *parts,
                                        const struct spin_name_number *of)
{
    const char *unit = parts->name + of->at + of->n;
    const char *end = parts->name + parts->word[of->word].at + parts->word[of->word].n;
    size_t n = unit < end ? (size_t)(end - unit) : 0;

    return is_listed(never_units, unit, n)   ? SPIN_RANK_NEVER
           : is_listed(other_units, unit, n) ? SPIN_RANK_OTHER
                                             : SPIN_RANK_PLAIN;
}

/* The letters directly after the number determine its rank if they are a known unit; otherwise the
 * letters directly before it do. If the number begins its word, the letters before it are the last
 * letters of the previous word. If these follow a digit, they are the unit of that other number,
 * and do not lower the rank. */
enum spin_name_rank spin_name_rank(const struct spin_name_parts *parts, size_t number)
{
    const struct spin_name_number *of = &parts->number[number];
    const char *end = parts->name + of->at, *first;
    enum spin_name_rank rank = rank_by_unit(parts, of);
    bool other_word;

    if (rank != SPIN_RANK_PLAIN)
        return rank;
    while (end > parts->name && !is_word(end[-1]))
        end--;
    other_word = end < parts->name + of->at;
    for (first = end; first > parts->name && isalpha((unsigned char)first[-1]);)
        first--;
    rank = rank_of_word(first, (size_t)(end - first));
    return rank < SPIN_RANK_PLAIN && other_word && first > parts->name && is_digit(first[-1])
               ? SPIN_RANK_PLAIN
               : rank;
}

/* ---- Time stamps ----------------------------------------------------------------------------- */

/* One number of a time stamp: its number of digits, smallest and largest value. */
struct unit {
    size_t digits;
    uint64_t least, most;
};
static const struct unit dates[] = {{4, 1900, 2199}, {2, 1, 12}, {2, 1, 31}};
static const struct unit whole_date[] = {{8, 19000101, 21991231}};
static const struct unit times[] = {{2, 0, 23}, {2, 0, 59}, {2, 0, 60}};
static const struct unit whole_time[] = {{6, 0, 235960}};

/* Returns the number of digits before the decimal point. */
static size_t whole_digits(const struct spin_name_parts *parts, const struct spin_name_number *x)
{
    return count_digits(parts->name + x->at, parts->name + x->at + x->n);
}

static bool is_unit(const struct spin_name_parts *parts, size_t i, const struct unit *unit)
{
    const struct spin_name_number *x = &parts->number[i];

    return i < parts->n_numbers && whole_digits(parts, x) == unit->digits && !x->value.negative &&
           x->value.part[1] >= unit->least && x->value.part[1] <= unit->most &&
           (unit->digits != 6 ||
            (x->value.part[1] / 100 % 100 < 60 && x->value.part[1] % 100 < 61));
}

/* Whether, in all names, the numbers from number i on match these units, one number per unit. */
static bool are_units(const struct spin_name_parts *parts, size_t n, size_t i,
                      const struct unit *unit, size_t n_units)
{
    for (size_t k = 0; k < n; k++)
        for (size_t u = 0; u < n_units; u++)
            if (!is_unit(&parts[k], i + u, &unit[u]))
                return false;
    return true;
}

/* Whether number i of all names is a fraction of a second: 3 or 6 digits. */
static bool are_fractions(const struct spin_name_parts *parts, size_t n, size_t i)
{
    static const struct unit milli = {3, 0, 999}, micro = {6, 0, 999999};

    for (size_t k = 0; k < n; k++)
        if (!is_unit(&parts[k], i, &milli) && !is_unit(&parts[k], i, &micro))
            return false;
    return true;
}

/* Appends the digits of number i + 1 to number i of a name, as decimals if `fraction` is set. */
static void append_number(struct spin_name_parts *parts, size_t i, bool fraction)
{
    struct spin_name_number *to = &parts->number[i], *from = &parts->number[i + 1];
    size_t n = whole_digits(parts, from);

    if (fraction)
        set_fraction(&to->value, parts->name + from->at, n);
    else
        add_digits(&to->value, parts->name + from->at, n);
    if (!fraction)
        to->value.part[2] = from->value.part[2];
    to->n = (unsigned short)(from->at + from->n - to->at);
    memmove(from, from + 1, (parts->n_numbers - i - 2) * sizeof *from);
    parts->n_numbers--;
}

static void append_all(struct spin_name_parts *parts, size_t n, size_t i, size_t times_to_append,
                       bool fraction)
{
    for (size_t k = 0; k < n; k++)
        for (size_t j = 0; j < times_to_append; j++)
            append_number(&parts[k], i, fraction);
}

static bool all_equal(const struct spin_name_parts *parts, size_t n, size_t i)
{
    for (size_t k = 1; k < n; k++)
        if (spin_compare_values(&parts[k].number[i].value, &parts[0].number[i].value) != 0)
            return false;
    return true;
}

/* Whether '-', ':', '.', 'h' or 'm' follows each of the first two numbers of a time. */
static bool is_clock(const struct spin_name_parts *parts, size_t i)
{
    for (size_t u = 0; u < 2; u++) {
        const struct spin_name_number *x = &parts->number[i + u];

        if (!strchr("-:.hm", parts->name[x->at + x->n]))
            return false;
    }
    return true;
}

/* Returns how many consecutive numbers, starting with number i, form a time stamp in every name.
 * Sets *date to how many of these numbers belong to the date. */
static size_t count_stamp(const struct spin_name_parts *parts, size_t n, size_t i, size_t *date)
{
    size_t time;

    *date = are_units(parts, n, i, dates, 3) ? 3 : are_units(parts, n, i, whole_date, 1) ? 1 : 0;
    time = are_units(parts, n, i + *date, times, 3)                     ? 3
           : *date > 0 && are_units(parts, n, i + *date, whole_time, 1) ? 1
                                                                        : 0;
    if (*date == 0 && time > 0 && !is_clock(&parts[0], i))
        time = 0;
    return *date + time;
}

size_t spin_name_merge_stamp(struct spin_name_parts *parts, size_t n, size_t i)
{
    size_t date, n_stamp = count_stamp(parts, n, i, &date), first_varying = 0;
    bool fraction = n_stamp > date && are_fractions(parts, n, i + n_stamp);

    while (first_varying < n_stamp && all_equal(parts, n, i + first_varying))
        first_varying++;
    /* If only the last number varies, leave it separate: it orders the names as the whole time
     * stamp would and, after a date, may be a frame number of six digits. */
    if (n_stamp < 2 || (first_varying + 1 >= n_stamp && !fraction && (n_stamp - date) != 3))
        return 1;
    if (date == 0 && first_varying + 1 >= n_stamp && !fraction)
        return 1;
    append_all(parts, n, i, n_stamp - 1, false);
    if (fraction)
        append_all(parts, n, i, 1, true);
    return n_stamp + fraction;
}
