#include "formats/gs_ply.h"

#include <math.h>
#include <string.h>

#include "math/sh.h"

/* ---- The list of columns --------------------------------------------------------------------- */

enum { MAX_REST = 45, MAX_COLUMNS = 3 + 3 + 3 + MAX_REST + 1 + 3 + 4 };

struct column {
    char name[16];
    /* The column of struct spin_splats that receives the property, a value of enum spin_column; 0
     * for normals, which are not read. */
    unsigned part;
    int place; /* index of the property within a row of this column */
};

static struct column *add_columns(struct column *c, const char *const *names, const char *prefix,
                                  int n, unsigned part)
{
    for (int i = 0; i < n; i++, c++) {
        *c = (struct column){.part = part, .place = i};
        if (names)
            snprintf(c->name, sizeof c->name, "%s", names[i]);
        else
            snprintf(c->name, sizeof c->name, "%s%d", prefix, i);
    }
    return c;
}

/* Adds the properties f_rest_* of the degrees up to sh_degree. n_rest: number of properties
 * f_rest_* in the file, which may have a higher degree. */
static struct column *add_rest(struct column *c, int n_rest, int sh_degree)
{
    int kept = spin_sh_count(sh_degree) - 1;

    for (int i = 0; i < 3 * kept; i++, c++) {
        int channel = i / kept, k = i % kept;

        *c = (struct column){.part = SPIN_COL_SH, .place = 3 * (k + 1) + channel};
        snprintf(c->name, sizeof c->name, "f_rest_%d", channel * (n_rest / 3) + k);
    }
    return c;
}

/* Lists all properties in the order in which they are written. Returns their number. */
static size_t list_columns(int n_rest, int sh_degree, struct column out[MAX_COLUMNS])
{
    static const char *const places[] = {"x", "y", "z"}, *const normals[] = {"nx", "ny", "nz"};
    static const char *const opacity[] = {"opacity"};
    struct column *c = out;

    c = add_columns(c, places, NULL, 3, SPIN_COL_MEANS);
    c = add_columns(c, normals, NULL, 3, 0);
    c = add_columns(c, NULL, "f_dc_", 3, SPIN_COL_SH);
    c = add_rest(c, n_rest, sh_degree);
    c = add_columns(c, opacity, NULL, 1, SPIN_COL_LOGIT_OPACITIES);
    c = add_columns(c, NULL, "scale_", 3, SPIN_COL_LOG_SCALES);
    c = add_columns(c, NULL, "rot_", 4, SPIN_COL_QUATS);
    return (size_t)(c - out);
}

/* ---- Writing --------------------------------------------------------------------------------- */

size_t spin_gs_ply_row(int sh_degree) { return (17 + spin_n_rest(sh_degree)) * sizeof(float); }

size_t spin_gs_ply_header(int sh_degree, size_t n, const char *comments,
                          char text[SPIN_GS_PLY_MAX_HEADER])
{
    const size_t room = SPIN_GS_PLY_MAX_HEADER;
    struct column column[MAX_COLUMNS];
    size_t n_columns = list_columns((int)spin_n_rest(sh_degree), sh_degree, column);
    size_t at = (size_t)snprintf(
        text, room, "ply\nformat binary_little_endian 1.0\n%selement vertex %zu\n", comments, n);

    for (size_t i = 0; i < n_columns; i++)
        at += (size_t)snprintf(text + at, room - at, "property float %s\n", column[i].name);
    return at + (size_t)snprintf(text + at, room - at, "end_header\n");
}

void spin_gs_ply_code(const struct spin_gs_ply_row *row, int sh_degree, unsigned char *to)
{
    int n_to = spin_sh_count(sh_degree), n = row->n_sh < n_to ? row->n_sh : n_to;
    float *out = (float *)(void *)to;

    memcpy(out, row->place, sizeof row->place);
    memset(out + 3, 0, 3 * sizeof *out); /* normals are 0 */
    memcpy(out + 6, row->sh, 3 * sizeof *out);
    out += 9;
    for (int c = 0; c < 3; c++) {
        for (int k = 1; k < n; k++)
            *out++ = row->sh[3 * k + c];
        for (int k = n; k < n_to; k++)
            *out++ = 0.0f;
    }
    out[0] = row->logit;
    memcpy(out + 1, row->log_scale, 3 * sizeof *out);
    memcpy(out + 4, row->rotation, sizeof row->rotation);
    spin_little_endian(to, spin_gs_ply_row(sh_degree) / 4);
}

/* ---- Parsing the header ---------------------------------------------------------------------- */

bool spin_ply_has(const struct spin_ply_element *e, const char *name)
{
    return spin_ply_find(e, name) >= 0;
}

bool spin_ply_has_prefix(const struct spin_ply_element *e, const char *prefix)
{
    for (size_t i = 0; i < e->n_properties; i++) {
        if (strncmp(e->property[i].name, prefix, strlen(prefix)) == 0)
            return true;
    }
    return false;
}

bool spin_ply_has_colours(const struct spin_ply_element *e)
{
    return spin_ply_has(e, "red") && spin_ply_has(e, "green") && spin_ply_has(e, "blue");
}

bool spin_gs_ply_any(const struct spin_ply_element *vertex)
{
    struct column column[MAX_COLUMNS];
    size_t n = list_columns(0, 0, column);

    for (size_t i = 0; i < n; i++) {
        if (column[i].part && column[i].part != SPIN_COL_MEANS &&
            spin_ply_has(vertex, column[i].name))
            return true;
    }
    return spin_ply_has_prefix(vertex, "f_rest_");
}

spin_status spin_gs_ply_degree(const struct spin_ply *ply, const struct spin_ply_element *e,
                               int *sh_degree, int *n_rest)
{
    *n_rest = 0;
    for (size_t i = 0; e && i < e->n_properties; i++)
        *n_rest += strncmp(e->property[i].name, "f_rest_", 7) == 0;
    for (int i = 0; i < *n_rest; i++) {
        char name[32];

        snprintf(name, sizeof name, "f_rest_%d", i);
        if (!spin_ply_has(e, name))
            return spin_malformed("'%s': there are %d properties f_rest_*, but no '%s'", ply->path,
                                  *n_rest, name);
    }
    for (int d = 0; d <= 4; d++) {
        if (*n_rest == (int)spin_n_rest(d)) {
            *sh_degree = d < 3 ? d : 3;
            return SPIN_OK;
        }
    }
    return spin_malformed(
        "'%s': there are %d properties f_rest_*, expected 0, 9, 24, 45 or 72 (SH degree 0 to 4)",
        ply->path, *n_rest);
}

static bool is_third_scale(const struct spin_gs_ply *file, const struct column *c)
{
    return file->flat && c->part == SPIN_COL_LOG_SCALES && c->place == 2;
}

spin_status spin_gs_ply_find(const struct spin_ply *ply, struct spin_gs_ply *out)
{
    const struct spin_ply_element *e;
    struct column column[MAX_COLUMNS];
    size_t n = list_columns(0, 0, column);

    SPIN_TRY(spin_ply_vertices(ply, &e));
    *out = (struct spin_gs_ply){.ply = ply, .vertex = e};
    out->flat =
        spin_ply_has(e, "scale_0") && spin_ply_has(e, "scale_1") && !spin_ply_has(e, "scale_2");
    for (size_t i = 0; i < n; i++) {
        if (column[i].part == 0 || spin_ply_has(e, column[i].name) ||
            is_third_scale(out, column + i))
            continue;
        out->colours = column[i].part == SPIN_COL_SH && spin_ply_has_colours(e);
        if (!out->colours)
            return spin_malformed(
                "'%s': element 'vertex' has no property '%s', which Gaussians need%s", ply->path,
                column[i].name,
                column[i].part == SPIN_COL_SH ? ", and no 'red', 'green', 'blue' either" : "");
    }
    return spin_gs_ply_degree(ply, e, &out->sh_degree, &out->n_rest);
}

/* ---- Reading --------------------------------------------------------------------------------- */

static void read_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                         const struct column *column, size_t n, float *const part_row[5],
                         const size_t step[5])
{
    struct spin_ply_target target[MAX_COLUMNS];
    size_t n_targets = 0;

    for (size_t i = 0; i < n; i++) {
        for (int p = 0; p < 5; p++) {
            if (column[i].part == 1u << p && part_row[p])
                target[n_targets++] = (struct spin_ply_target){
                    spin_ply_find(e, column[i].name), part_row[p] + column[i].place, step[p]};
        }
    }
    spin_ply_columns(ply, e, target, n_targets);
}

spin_status spin_ply_places(const struct spin_ply *ply, const struct spin_ply_element *e,
                            float *out)
{
    float *const part_row[5] = {out};
    static const size_t step[5] = {3};
    struct column column[MAX_COLUMNS];

    read_columns(ply, e, column, list_columns(0, 0, column), part_row, step);
    return spin_fail_context(spin_check_finite("x, y, z", out, (size_t)e->count, 3), "'%s'",
                             ply->path);
}

void spin_ply_colours(const struct spin_ply *ply, const struct spin_ply_element *e, float *out,
                      size_t step)
{
    static const char *const name[] = {"red", "green", "blue"};
    float largest = 0, whole = 1;

    for (int c = 0; c < 3; c++) {
        int p = spin_ply_find(e, name[c]);

        spin_ply_column(ply, e, p, out + c, step);
        if (e->property[p].type == SPIN_PLY_U8)
            whole = 255;
        else if (e->property[p].type == SPIN_PLY_U16)
            whole = 65535;
        for (uint64_t i = 0; i < e->count; i++)
            largest = fmaxf(largest, out[i * step + (size_t)c]);
    }
    if (whole == 1 && largest > 1)
        whole = 255;
    for (uint64_t i = 0; i < e->count; i++) {
        for (int c = 0; c < 3; c++)
            out[i * step + (size_t)c] /= whole;
    }
}

void spin_gs_ply_rest(const struct spin_ply *ply, const struct spin_ply_element *e, int n_rest,
                      int sh_degree, float *sh, size_t step)
{
    float *const part_row[5] = {[4] = sh};
    const size_t steps[5] = {[4] = step};
    struct column column[MAX_COLUMNS];
    size_t n = (size_t)(add_rest(column, n_rest, sh_degree) - column);

    read_columns(ply, e, column, n, part_row, steps);
}

spin_status spin_ply_check(const struct spin_ply *ply, unsigned columns, size_t first, size_t n,
                           const struct spin_splats *s)
{
    static const char *const what[5] = {"x, y, z", "rot_*", "scale_*", "opacity",
                                        "f_dc_*, f_rest_*"};

    return spin_fail_context(spin_check_columns(what, columns, first, n, s), "'%s'", ply->path);
}

/* The third standard deviation of a flat splat, as a fraction of the smaller of the first two. */
#define THIN 1e-3f

static void finish_scales(const struct spin_gs_ply *file, float *log_scale, size_t n)
{
    for (size_t i = 0; i < n; i++, log_scale += 3) {
        for (size_t c = 0; c < 3; c++)
            log_scale[c] = spin_finite_log_scale(log_scale[c]);
        if (file->flat)
            log_scale[2] = fminf(log_scale[0], log_scale[1]) + logf(THIN);
    }
}

void spin_gs_ply_load(const struct spin_gs_ply *file, unsigned columns, size_t first,
                      struct spin_splats *out)
{
    const size_t step[5] = {3, 4, 3, 1, 3 * (size_t)spin_sh_count(out->sh_degree)};
    float *const all[5] = {out->means, out->quats, out->log_scales, out->logit_opacities, out->sh};
    size_t n = (size_t)file->vertex->count, n_columns;
    struct column column[MAX_COLUMNS];
    float *part_row[5] = {0}, *sh;

    for (int p = 0; p < 5 && n > 0; p++)
        if (columns & 1u << p)
            part_row[p] = all[p] + first * step[p];
    sh = part_row[4];
    if (sh && file->sh_degree < out->sh_degree)
        memset(sh, 0, n * step[4] * sizeof *sh);
    n_columns = list_columns(file->n_rest, file->sh_degree, column);
    for (size_t i = 0; i < n_columns; i++)
        if ((file->colours && column[i].part == SPIN_COL_SH && column[i].place < 3) ||
            is_third_scale(file, &column[i]))
            column[i].part = 0;
    read_columns(file->ply, file->vertex, column, n_columns, part_row, step);
    if (sh && file->colours) {
        spin_ply_colours(file->ply, file->vertex, sh, step[4]);
        for (size_t i = 0; i < n; i++)
            for (size_t c = 0; c < 3; c++)
                sh[i * step[4] + c] = (float)((sh[i * step[4] + c] - 0.5) / SPIN_SH_C0);
    }
    for (size_t i = 0; part_row[3] && i < n; i++)
        part_row[3][i] = spin_finite_logit(part_row[3][i]);
    if (part_row[2])
        finish_scales(file, part_row[2], n);
}

spin_status spin_gs_ply_read(const struct spin_gs_ply *file, unsigned columns, size_t first,
                             struct spin_splats *out)
{
    spin_gs_ply_load(file, columns, first, out);
    return spin_ply_check(file->ply, columns, first, (size_t)file->vertex->count, out);
}
