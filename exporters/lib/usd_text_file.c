/* Writes a clip as one text file (.usda). The text contains all samples of one attribute, then
 * those of the next, whereas frames arrive with all attributes of one time. The clip is therefore
 * first written as a crate (usd_file.c), from which this file makes the text. */
#include <stdlib.h>

#include "base/base.h"
#include "exporters/lib/usd_export.h"
#include "math/sh.h"

#define MASK 0xffffffffffffull /* the offset in the word of an array */
#define TUPLES 4096            /* number of tuples that a task prints */
#define TASKS 8

/* Prints the arrays of a crate as text. */
struct printer {
    struct spin_usd_export *x;
    const unsigned char *crate;
    struct spin_out out;
    /* The array that is being written. */
    const unsigned char *data;
    size_t n, first; /* number of tuples, and index of the first tuple of the current tasks */
    size_t width;    /* number of values of a tuple */
    char *text;      /* [TASKS] text of each task, `stride` bytes */
    size_t n_text[TASKS], stride;
};

static spin_status write_text(struct printer *p, const char *text)
{
    return spin_out_write(&p->out, text, strlen(text));
}

/* Prints value k of the current array. */
static char *print_value(const struct printer *p, size_t k, char *to)
{
    uint16_t half;
    float v;

    if (spin_usd_is_half(p->x)) {
        memcpy(&half, p->data + k * sizeof half, sizeof half);
        return to + sprintf(to, "%s", p->x->halves[half]);
    }
    memcpy(&v, p->data + k * sizeof v, sizeof v);
    return to + sprintf(to, "%.9g", (double)v);
}

/* Prints the tuples of a task, separated by commas. Quaternions are x y z w in a crate, and w x y z
 * in text. */
static void print_tuples(void *context, int task)
{
    struct printer *p = context;
    size_t i = p->first + (size_t)task * TUPLES, end = i + TUPLES < p->n ? i + TUPLES : p->n;
    char *begin = p->text + (size_t)task * p->stride, *to = begin;

    for (; i < end; i++) {
        if (i > 0)
            *to++ = ',';
        if (p->width > 1)
            *to++ = '(';
        for (size_t c = 0; c < p->width; c++) {
            if (c > 0)
                *to++ = ',';
            to = print_value(p, p->width * i + (p->width == 4 ? (c + 3) % 4 : c), to);
        }
        if (p->width > 1)
            *to++ = ')';
    }
    p->n_text[task] = (size_t)(to - begin);
}

/* Writes the array that a word of the crate refers to. */
static spin_status write_array(struct printer *p, uint64_t word)
{
    uint64_t n = 0;

    p->data = p->crate + (word & MASK) + sizeof n;
    if (word & MASK)
        memcpy(&n, p->data - sizeof n, sizeof n);
    p->n = (size_t)n;
    SPIN_TRY(write_text(p, "["));
    for (p->first = 0; p->first < p->n; p->first += TASKS * TUPLES) {
        size_t n_tasks = (p->n - p->first + TUPLES - 1) / TUPLES;

        n_tasks = n_tasks < TASKS ? n_tasks : TASKS;
        spin_pool_run(p->x->frames.rows.pool, (int)n_tasks, print_tuples, p);
        for (size_t k = 0; k < n_tasks; k++)
            SPIN_TRY(spin_out_write(&p->out, p->text + k * p->stride, p->n_text[k]));
    }
    return write_text(p, "]");
}

/* Writes an attribute with the samples value[n] or, if `changes` is false, with the first of them
 * as its only value. */
static spin_status write_attribute(struct printer *p, const char *type, const char *name,
                                   const uint64_t *value, bool changes)
{
    const struct spin_usd_file *f = &p->x->file;
    char line[160];

    snprintf(line, sizeof line, "    %s %s%s", type, name, changes ? ".timeSamples = {\n" : " = ");
    SPIN_TRY(write_text(p, line));
    for (size_t k = 0; k < (changes ? f->n : f->n > 0); k++) {
        snprintf(line, sizeof line, "        %.9g: ", f->time[k]);
        SPIN_TRY(write_text(p, changes ? line : ""));
        SPIN_TRY(write_array(p, value[k]));
        SPIN_TRY(write_text(p, changes ? ",\n" : "\n"));
    }
    return changes ? write_text(p, "    }\n") : SPIN_OK;
}

static spin_status write_attributes(struct printer *p)
{
    static const size_t width[SPIN_USD_COLUMNS] = {3, 4, 3, 1, 3};
    struct spin_usd_export *x = p->x;

    p->width = 3;
    x->attribute = SPIN_USD_POSITIONS; /* no half floats */
    SPIN_TRY(write_attribute(p, "float3[]", "extent", x->file.value[SPIN_USD_COLUMNS], true));
    for (int i = 0; i < SPIN_USD_COLUMNS; i++) {
        enum spin_usd_column a = (enum spin_usd_column)i;

        x->attribute = a;
        p->width = width[a];
        SPIN_TRY(write_attribute(p, spin_usd_type_of(x, a), spin_usd_name_of(x, a),
                                 x->file.value[a], x->file.changes[a]));
    }
    return SPIN_OK;
}

/* Writes the text before the arrays or, if `cameras` is true, the text after them, which contains
 * the cameras. */
static spin_status write_part(struct printer *p, bool cameras)
{
    const struct spin_usd_export *x = p->x;
    const struct spin_usd_file *f = &x->file;
    SPIN_FREED char *text = NULL;
    size_t n;
    spin_status status = SPIN_OK;
    FILE *to = spin_text_open(&text, &n);

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "not enough memory for the text of USD");
    if (cameras) {
        fprintf(to, "}\n");
        status = spin_usd_print_cameras(x, to);
    } else {
        spin_usd_print_head(x, f->n ? (int)f->time[0] : 0, f->n ? (int)f->time[f->n - 1] : 0, to);
        fprintf(to,
                "def " SPIN_USD_TYPE " \"" SPIN_USD_PRIM "\" (\n" SPIN_USD_TEXT_SCHEMAS ")\n{\n");
        spin_usd_print_uniforms(x, to);
    }
    if (fclose(to) != 0)
        status = spin_fail(SPIN_E_MEMORY, "not enough memory for the text of USD");
    SPIN_TRY(status);
    return spin_out_write(&p->out, text, n);
}

static spin_status write_all(struct printer *p)
{
    SPIN_TRY(spin_out_open(p->x->frames.file, p->x->frames.job->force, &p->out));
    p->out.sync = p->x->frames.job->sync;
    p->stride = (size_t)TUPLES * 4 * SPIN_USD_NUMBER;
    SPIN_TRY(spin_alloc(TASKS, p->stride, (void **)&p->text));
    SPIN_TRY(write_part(p, false));
    SPIN_TRY(write_attributes(p));
    SPIN_TRY(write_part(p, true));
    if (p->x->frames.rows.report)
        SPIN_TRY(spin_out_length(&p->out, &p->x->frames.rows.report->bytes));
    return spin_out_commit(&p->out);
}

spin_status spin_usd_write_text(struct spin_usd_export *x)
{
    struct printer p = {.x = x};
    struct spin_map map;
    spin_status status;

    SPIN_TRY(spin_map_open(x->file.out.temporary, &map));
    p.crate = map.data;
    status = write_all(&p);
    spin_out_abandon(&p.out);
    free(p.text);
    spin_map_close(&map);
    return status;
}
