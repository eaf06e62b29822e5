/* PLY files of splats that move on straight lines and have a Gaussian window in time, in the
 * layouts of three viewers. The names of the time properties identify the layout:
 *
 *     supersplat4d  trbf_center, trbf_scale  window exp(-(d/s)^2); seconds; a comment has the range
 *     opensplat4d   t, scale_t               window exp(-0.5 (d/s)^2); the unit is not stored
 *     tsog          t, t_scale               the same; times from 0 to 1
 *
 * s is the exponential of the second property, and d the time minus the centre. motion_0..2 are the
 * velocity per unit of time, and colours are SH. A file with trbf_*, motion_0..8 and omega_0..3 is
 * of SpacetimeGaussians, which another importer reads: its f_dc_* are RGB. */
#include "importers/lib/model.h"
#include "math/activate.h"

#define LEAST_OPACITY (1 / 255.0) /* rasterisers do not draw splats with a lower opacity */
#define LEAST_WIDTH 1e-6          /* the viewer of supersplat4d raises s to at least this */
#define MOST_FRAMES 1000000

enum { SUPERSPLAT4D, OPENSPLAT4D, TSOG, N_DIALECTS };

static const struct dialect {
    /* centre, width: names of the properties for centre and width of the Gaussian window. */
    const char *name, *viewer, *centre, *width;
} dialects[N_DIALECTS] = {
    {"supersplat4d", "SuperSplat-4D", "trbf_center", "trbf_scale"},
    {"opensplat4d", "OpenSplat4D", "t", "scale_t"},
    {"tsog", "TSOG columns", "t", "t_scale"},
};

struct model {
    struct spin_model base;
    int dialect;
    /* Start and duration in seconds, and frames per second, from a comment in the PLY; fps is 0 if
     * there is no such comment. */
    double start, duration, fps;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Returns whether a PLY header declares a floating-point property of this name. If `name` does not
 * end with a line feed, it is a prefix of the name. */
static bool declares(const struct spin_peek *peek, const char *name)
{
    static const char *const types[] = {"float", "double", "float32", "float64"};
    char line[64];
    bool found = false;

    for (int i = 0; i < 4; i++) {
        snprintf(line, sizeof line, "property %s %s", types[i], name);
        found = found || spin_peek_contains(peek, line);
    }
    return found;
}

static int probe(const struct spin_peek *peek)
{
    static const char *const others[] = {"omega_", "rot_r_", "xyz_disp_", "t_center",
                                         "motion_xyz_"};
    bool ours = declares(peek, "trbf_center") || declares(peek, "trbf_scale") ||
                declares(peek, "scale_t\n") || declares(peek, "scale_t\r") ||
                declares(peek, "t_scale") || declares(peek, "motion_");

    if (peek->is_folder || peek->n_head < 4 || memcmp(peek->head, "ply", 3) != 0)
        return 0;
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        ours = ours && !declares(peek, others[i]);
    return ours ? 100 : 0;
}

/* ---- The header ------------------------------------------------------------------------------ */

/* Finds "key=value" or "key value" in a comment and sets *out to the value, or to NaN if it is not
 * a number. Returns false if the comment lacks the key. */
static bool find_number(const char *text, const char *key, double *out)
{
    size_t n = strlen(key);

    for (const char *at = strstr(text, key); at; at = strstr(at + 1, key)) {
        const char *value = at + n + strspn(at + n, " =");
        char *end;

        if ((at > text && !strchr(" (,:", at[-1])) || value == at + n)
            continue;
        *out = strtod(value, &end);
        *out = end == value ? NAN : *out;
        return true;
    }
    return false;
}

/* Reads start, duration, frame rate and SH degree from the comment that SuperSplat-4D expects. Sets
 * m->fps to 0 if there is none. */
static spin_status read_comment(struct model *m, int sh_degree)
{
    const struct spin_ply *ply = &m->base.ply;
    double degree = sh_degree;

    for (size_t i = 0; i < ply->n_comments; i++) {
        const char *text = ply->comment[i];

        if (!find_number(text, "fps", &m->fps) || !find_number(text, "duration", &m->duration))
            continue;
        find_number(text, "start", &m->start);
        find_number(text, "sh_degree", &degree);
        if (!(m->fps > 0 && m->duration > 0 && m->duration * m->fps <= MOST_FRAMES) ||
            !(fabs(m->start) < 1e9))
            return spin_malformed("'%s': the comment '%.80s' has start %g, duration %g and fps %g, "
                                  "expected a duration and a frame rate above 0",
                                  ply->path, text, m->start, m->duration, m->fps);
        if (degree != sh_degree)
            spin_warn("'%s': the comment has sh_degree %g, but the properties f_rest_* are those "
                      "of degree %d, which is used",
                      ply->path, degree, sh_degree);
        return SPIN_OK;
    }
    m->fps = 0;
    return SPIN_OK;
}

/* Returns whether the file has a time property of this dialect. If 't' is the only time property,
 * the dialect is opensplat4d. */
static bool has_time(const struct spin_ply_element *e, int dialect)
{
    const struct dialect *d = &dialects[dialect];

    if (spin_ply_has(e, d->width))
        return true;
    return dialect == TSOG ? false
                           : spin_ply_has(e, d->centre) &&
                                 !(dialect == OPENSPLAT4D && spin_ply_has(e, "t_scale"));
}

/* Returns whether the times for SuperSplat-4D and for OpenSplat4D are equal, as in files that
 * spin4d writes for both viewers. */
static bool times_are_equal(const struct spin_ply *ply)
{
    for (size_t i = 0; i < ply->n_comments; i++)
        if (strcmp(ply->comment[i], SPIN_PLY_TWO_VIEWERS) == 0)
            return true;
    return false;
}

/* Sets the dialect to that of option `dialect` or, by default, to the only dialect whose time
 * properties exist. If there are two, but with equal times, the first is used. */
static spin_status choose_dialect(struct model *m, const struct spin_ply_element *e)
{
    int n = 0, asked = -1;

    if (spin_model_option(&m->base, "dialect"))
        SPIN_TRY(
            spin_option_word(m->base.values, "dialect", "supersplat4d|opensplat4d|tsog", &asked));
    for (int i = 0; i < N_DIALECTS; i++) {
        if (!has_time(e, i) || (asked >= 0 && asked != i))
            continue;
        m->dialect = n == 0 ? i : m->dialect;
        n++;
    }
    if (n == 1 || (n == 2 && times_are_equal(&m->base.ply)))
        return SPIN_OK;
    if (n == 0)
        return spin_malformed("'%s' has no time property%s%s", m->base.path,
                              asked >= 0 ? " of dialect " : ": trbf_center, t or t_scale",
                              asked >= 0 ? dialects[asked].name : "");
    return spin_unsupported("'%s' has times for several viewers (%s and %s): choose one with "
                            "--dialect supersplat4d, opensplat4d or tsog",
                            m->base.path, spin_ply_has(e, "trbf_scale") ? "trbf_*" : "t_scale",
                            spin_ply_has(e, "scale_t") ? "scale_t" : "t");
}

/* Refuses models with paths or rotations that these layouts do not have. Sets *moves to whether
 * there are velocities. */
static spin_status check_motion(const struct model *m, const struct spin_ply_element *e,
                                bool *moves)
{
    int n = spin_model_count(e, "motion_");
    bool extra = m->dialect == OPENSPLAT4D && n == 9;
    static const char *const odd[] = {"v_site_", "v_val_", "v_tau_", "v_sh_"};

    if (spin_ply_has(e, "rot_4") || spin_ply_has(e, "scale_3"))
        return spin_unsupported("'%s': property '%s' belongs to splats that rotate in four "
                                "dimensions, which are not supported as PLY",
                                m->base.path, spin_ply_has(e, "rot_4") ? "rot_4" : "scale_3");
    if (n != 3 && !extra && !(m->dialect == OPENSPLAT4D && n == 0))
        return spin_malformed("'%s' has %d properties motion_*, expected motion_0, motion_1 and "
                              "motion_2",
                              m->base.path, n);
    if (extra)
        spin_warn("'%s': motion_3 to motion_8 are ignored, as in OpenSplat4D: if the run is of "
                  "SpacetimeGaussians, its paths become straight lines",
                  m->base.path);
    for (size_t i = 0; i < sizeof odd / sizeof *odd; i++)
        if (spin_ply_has_prefix(e, odd[i]))
            spin_warn("'%s': the properties %s*, an opacity for each direction of view, are "
                      "ignored",
                      m->base.path, odd[i]);
    *moves = n > 0;
    return SPIN_OK;
}

/* ---- The splats ------------------------------------------------------------------------------ */

/* The properties to read from a PLY, and the addresses of their values. */
struct targets {
    const struct spin_ply *ply;
    const struct spin_ply_element *e;
    struct spin_ply_target target[24];
    size_t n;
};

/* Adds the property `name`. A missing property is an error unless `optional`. */
static spin_status add_target(struct targets *t, const char *name, bool optional, float *out,
                              size_t step)
{
    int p = spin_ply_find(t->e, name);

    if (p >= 0)
        t->target[t->n++] = (struct spin_ply_target){p, out, step};
    return p >= 0 || optional
               ? SPIN_OK
               : spin_malformed("'%s': element 'vertex' has no property '%s'", t->ply->path, name);
}

/* Adds the properties <prefix>0, <prefix>1, ... as the first n floats of rows of `step` floats. */
static spin_status add_targets(struct targets *t, const char *prefix, int n, float *out,
                               size_t step)
{
    for (int i = 0; i < n; i++) {
        char name[32];

        snprintf(name, sizeof name, "%s%d", prefix, i);
        SPIN_TRY(add_target(t, name, false, out + i, step));
    }
    return SPIN_OK;
}

static spin_status read_columns(struct model *m, const struct spin_ply_element *e, int n_rest)
{
    struct spin_splats_4d *s = &m->base.splats_4d;
    const struct dialect *d = &dialects[m->dialect];
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    struct targets t = {.ply = &m->base.ply, .e = e};
    bool open = m->dialect ==
                OPENSPLAT4D; /* its viewer accepts files with only one of the two time properties */

    for (size_t c = 0; c < 3; c++)
        SPIN_TRY(add_target(&t, c == 0 ? "x" : c == 1 ? "y" : "z", false, s->centres + c, 3));
    SPIN_TRY(add_targets(&t, "scale_", 3, s->log_scales, 3));
    SPIN_TRY(add_targets(&t, "rot_", 4, s->quats, 4));
    SPIN_TRY(add_targets(&t, "f_dc_", 3, s->sh, width));
    SPIN_TRY(add_targets(&t, "motion_", s->paths ? 3 : 0, s->paths, 3));
    SPIN_TRY(add_target(&t, "opacity", false, s->logit_opacities, 1));
    SPIN_TRY(add_target(&t, d->centre, open, s->times, 1));
    SPIN_TRY(add_target(&t, d->width, open, s->sigmas, 1));
    spin_ply_columns(t.ply, e, t.target, t.n);
    if (n_rest > 0)
        spin_gs_ply_rest(t.ply, e, n_rest, s->sh_degree, s->sh, width);
    return SPIN_OK;
}

/* Converts widths, which are stored as logarithms, to standard deviations. A splat whose width
 * exceeds the range of float is permanent. */
static void convert_widths(const struct model *m, bool given)
{
    const struct spin_splats_4d *s = &m->base.splats_4d;

    for (size_t i = 0; i < s->n; i++) {
        double width = given ? exp((double)s->sigmas[i]) : HUGE_VAL;

        if (m->dialect == SUPERSPLAT4D)
            width = (width < LEAST_WIDTH ? LEAST_WIDTH : width) / sqrt(2);
        if (width < 1e-37)
            width = 1e-37;
        s->sigmas[i] = width > (double)SPIN_FOREVER ? SPIN_FOREVER : (float)width;
        s->logit_opacities[i] = spin_finite_logit(s->logit_opacities[i]);
    }
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Sets the range of times: that of the option, or else of the comment, or else a guess from the
 * splats. */
static spin_status describe(struct model *m, const char *asked, const struct clip_times *guess)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    const struct spin_splats_4d *s = &m->base.splats_4d;

    sequence->time_first = guess->first;
    sequence->time_last = guess->last;
    if (!asked && m->dialect == TSOG) {
        sequence->time_first = 0;
        sequence->time_last = 1;
    } else if (!asked && m->fps > 0) {
        double n = ceil(m->duration * m->fps - 1e-6);

        sequence->fps = m->fps;
        sequence->n_clip_frames = n > 1 ? (int)n : 1;
        sequence->time_first = m->start;
        sequence->time_last = m->start + (sequence->n_clip_frames - 1) / m->fps;
    } else if (!asked) {
        spin_note(sequence,
                  "the file does not contain its range of times: %g to %g, guessed from the "
                  "Gaussians; set it with --time-range",
                  guess->first, guess->last);
    }
    snprintf(sequence->variant, sizeof sequence->variant,
             "STG-lite PLY of %s, %zu Gaussians, SH degree %d", dialects[m->dialect].viewer, s->n,
             s->sh_degree);
    return SPIN_OK;
}

static spin_status read_file(struct model *m, const char *asked)
{
    struct spin_splats_4d *s = &m->base.splats_4d;
    const struct spin_ply_element *e;
    struct clip_times guess;
    int sh_degree, n_rest;
    bool moves = false;

    SPIN_TRY(spin_model_vertices(&m->base, m->base.path, &e));
    SPIN_TRY(choose_dialect(m, e));
    SPIN_TRY(check_motion(m, e, &moves));
    SPIN_TRY(spin_gs_ply_degree(&m->base.ply, e, &sh_degree, &n_rest));
    if (n_rest > (int)spin_n_rest(3))
        return spin_unsupported("'%s' has SH of degree 4 (%d properties f_rest_*), expected 0 to 3",
                                m->base.path, n_rest);
    if (m->dialect == SUPERSPLAT4D)
        SPIN_TRY(read_comment(m, sh_degree));
    SPIN_TRY(spin_splats_4d_reserve(s, (size_t)e->count, moves, sh_degree, 0));
    s->least_opacity = LEAST_OPACITY;
    s->antialias = spin_ply_is_antialiased(&m->base.ply);
    SPIN_TRY(read_columns(m, e, n_rest));
    convert_widths(m, spin_ply_has(e, dialects[m->dialect].width));
    SPIN_TRY(spin_fail_reading(spin_model_finish_4d(&m->base), m->base.path));
    SPIN_TRY(spin_run_config_times(NULL, asked, s->times, s->n, 1, 1, &guess));
    return describe(m, asked, &guess);
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;

    SPIN_TRY(spin_model_text(&m->base, &m->base.path, "%s", path));
    return read_file(m, spin_model_option(&m->base, "time-range"));
}

static const struct spin_plugin_option options[] = {
    {"dialect", "NAME", "supersplat4d, opensplat4d or tsog (default: by the properties)", NULL},
    {"time-range", "A,B", "the clip's first and last time (default: as in the file)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(
    stglite, struct model, open_model, spin_model_close,
    .summary = "PLY of SuperSplat-4D or OpenSplat4D: splats on straight lines (STG-lite)",
    .upstream = "forgrabbit/supersplat4d 1d9bbb1, YuanBaoSMadLab/OpenSplat4D 0.3",
    .options = options, .probe = probe, .frame = spin_model_slice,
    .splats_4d = spin_model_splats_4d)
