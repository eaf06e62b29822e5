/* The points from which a training on a data set starts:
 *
 *     points3D.bin, points3D.txt    COLMAP
 *     init_pt_cld.npz               CMU Panoptic: array data [n][7], x y z red green blue segment
 *     *.ply                         only with --from points: points3D_multipleview.ply, fused.ply
 *
 * One file is a static scene that exists at all times, so that it can be sampled at the times of a
 * data set. Several files, which option `pattern` names, are one frame each. */
#include "importers/lib/colmap.h"
#include "importers/lib/file_sequence.h"
#include "io/npy.h"

struct points {
    struct spin_model base; /* base.canonical: the points of file `loaded` */
    struct spin_file_sequence files;
    int *numbers;
    size_t loaded;   /* index of the file + 1; 0: none */
    double shift[3]; /* subtracted from all positions, see struct spin_sequence_info */
    bool wide;       /* the files store positions as doubles or as text */
};

static int probe(const struct spin_peek *peek)
{
    static const char *const names[] = {"points3D.bin", "points3D.txt", "init_pt_cld.npz"};
    int score = 0;

    for (size_t i = 0; i < 3 && !peek->is_folder; i++)
        if (strcmp(spin_path_name(peek->path), names[i]) == 0)
            score = 95;
    return score;
}

/* ---- Files ----------------------------------------------------------------------------------- */

/* Reserves the columns of n points, as model->canonical. */
static spin_status reserve_points(struct points *m, const char *path, size_t n, bool coloured)
{
    if (n == 0)
        return spin_malformed("'%s' has no points", path);
    return spin_splats_reserve(&m->base.canonical, n,
                               SPIN_COL_MEANS | (coloured ? SPIN_COL_RGB : 0), 0);
}

static spin_status read_colmap(struct points *m, const char *path)
{
    struct spin_colmap_points p = {0};
    struct spin_splats *out = &m->base.canonical;
    spin_status status = spin_colmap_read_points(path, &p);

    m->wide = true;
    if (status == SPIN_OK)
        status = reserve_points(m, path, p.n, true);
    for (size_t i = 0; i < 3 * p.n && status == SPIN_OK; i++) {
        out->means[i] = (float)(p.xyz[i / 3][i % 3] - m->shift[i % 3]);
        out->rgb[i] = p.rgb[i / 3][i % 3] / 255.0f;
    }
    free(p.xyz);
    free(p.rgb);
    return status;
}

/* Copies rows of x y z red green blue. Colours are in 0..1, or in 0..255 if any exceeds 1. */
static void split_rows(const double *row, size_t width, const double shift[3],
                       struct spin_splats *out)
{
    double largest = 1;

    for (size_t i = 0; i < out->n; i++)
        for (int c = 3; c < 6; c++)
            largest = row[i * width + c] > 1 ? 255 : largest;
    for (size_t i = 0; i < out->n; i++)
        for (int c = 0; c < 3; c++) {
            out->means[3 * i + c] = (float)(row[i * width + c] - shift[c]);
            out->rgb[3 * i + c] = (float)(row[i * width + 3 + c] / largest);
        }
}

static spin_status read_npz(struct points *m, const char *path)
{
    SPIN_LEAVES(spin_npz_close) struct spin_npz npz = {0};
    struct spin_array data;
    SPIN_FREED double *row = NULL;

    SPIN_TRY(spin_npz_open(path, &npz));
    SPIN_TRY_IN(spin_npz_array_of(&npz, "data", true, 2, (const int64_t[]){-1, -1}, &data), "'%s'",
                path);
    if (data.shape[1] < 6 || data.kind != 'f')
        return spin_malformed("'%s': array 'data' does not contain x, y, z, red, green, blue",
                              path);
    SPIN_TRY(reserve_points(m, path, data.shape[0], true));
    SPIN_TRY(spin_alloc(data.count, sizeof *row, (void **)&row));
    spin_array_to_f64(&data, 0, data.count, row);
    split_rows(row, data.shape[1], m->shift, &m->base.canonical);
    m->wide = data.item_size > 4;
    return SPIN_OK;
}

static spin_status read_ply(struct points *m, const char *path)
{
    struct spin_ply *ply = &m->base.ply;
    const struct spin_ply_element *e;
    struct spin_splats *out = &m->base.canonical;

    SPIN_TRY(spin_model_vertices(&m->base, path, &e));
    if (spin_gs_ply_any(e))
        return spin_unsupported("'%s' contains Gaussians, not points: use --from ply", path);
    SPIN_TRY(reserve_points(m, path, (size_t)e->count, spin_ply_has_colours(e)));
    m->wide = ply->ascii || e->property[spin_ply_find(e, "x")].type == SPIN_PLY_F64;
    memcpy(ply->shift, m->shift, sizeof ply->shift);
    SPIN_TRY_IN(spin_ply_places(ply, e, out->means), "'%s'", path);
    if (out->rgb)
        spin_ply_colours(ply, e, out->rgb, 3);
    return SPIN_OK;
}

static spin_status load(struct points *m, size_t i)
{
    const char *path = m->files.frame[i].path;
    struct spin_splats *s = &m->base.canonical;
    spin_status status;

    if (m->loaded == i + 1)
        return SPIN_OK;
    m->loaded = 0;
    SPIN_TRY(spin_text_ends_any_case(path, ".npz")   ? read_npz(m, path)
             : spin_text_ends_any_case(path, ".ply") ? read_ply(m, path)
                                                     : read_colmap(m, path));
    status = spin_check_finite("x, y, z", s->means, s->n, 3);
    if (status == SPIN_OK && s->rgb)
        status = spin_check_finite("red, green, blue", s->rgb, s->n, 3);
    SPIN_TRY_IN(status, "'%s'", path);
    m->loaded = i + 1;
    return SPIN_OK;
}

/* ---- Frames ---------------------------------------------------------------------------------- */

/* Lists the files that match option `pattern`, such as "frame%d/points3D.bin" or "points_%d.ply".
 */
static spin_status list_files(struct points *m, const char *folder, const char *pattern)
{
    const char *rest = strchr(pattern, '/'), *path;
    char **names;
    size_t n;

    SPIN_TRY(spin_model_names(&m->base, folder, &names, &n));
    SPIN_TRY(spin_file_sequence_reserve(&m->base, &m->files, n));
    for (size_t i = 0; i < n; i++) {
        SPIN_TRY(spin_model_find(&m->base, &path, folder, "%s%s", names[i], rest ? rest : ""));
        if (path && (rest || strrchr(pattern, '.')) && !spin_path_is_folder(path) &&
            (rest || spin_file_has_suffix(names[i], strrchr(pattern, '.'))))
            spin_file_sequence_add(&m->files, path, names[i]);
    }
    if (m->files.n_frames == 0)
        return spin_not_found("'%s' contains no files that match '%s'", folder, pattern);
    return spin_file_sequence_sort(&m->base, &m->files, rest != NULL, m->base.sequence);
}

static spin_status find_files(struct points *m, const char *path)
{
    const char *pattern = spin_model_option(&m->base, "pattern");

    if (!spin_path_is_folder(path))
        return spin_file_sequence_find(&m->base, path, "", &m->files);
    if (!pattern)
        return spin_unsupported("'%s' is a folder: give a file of points, or the names of the "
                                "files of all frames as option 'pattern'",
                                path);
    return list_files(m, path, pattern);
}

/* Describes one file, which is a static scene. */
static void describe_still(struct spin_sequence_info *sequence)
{
    sequence->continuous = true;
    sequence->identity = true;
    sequence->static_columns = sequence->columns;
    sequence->n_clip_frames = 1;
    sequence->time_last = 1;
    snprintf(sequence->variant, sizeof sequence->variant, "initial points");
}

static spin_status describe_frames(struct points *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    size_t n = m->files.n_frames;

    if (n > INT_MAX)
        return spin_unsupported("there are too many files");
    SPIN_TRY(spin_model_alloc(&m->base, n, sizeof *m->numbers, (void **)&m->numbers));
    for (size_t i = 0; i < n; i++)
        m->numbers[i] = m->files.frame[i].number;
    sequence->n_frames = (int)n;
    sequence->numbers = m->numbers[0] >= 0 ? m->numbers : NULL;
    sequence->time_last = (double)(n - 1);
    snprintf(sequence->variant, sizeof sequence->variant, "points of each frame");
    return SPIN_OK;
}

static spin_status open_points(void *self, const char *path)
{
    struct points *m = self;

    SPIN_TRY(find_files(m, path));
    SPIN_TRY(load(m, 0));
    SPIN_TRY(spin_model_choose_shift(&m->base, m->files.frame[0].path, m->base.canonical.means,
                                     m->base.canonical.n, m->wide, m->shift));
    if (m->shift[0] != 0 || m->shift[1] != 0 || m->shift[2] != 0)
        m->loaded = 0; /* read the file again, with the shift */
    m->base.sequence->columns = SPIN_COL_MEANS | (m->base.canonical.rgb ? SPIN_COL_RGB : 0);
    m->base.sequence->sh_degree = -1;
    if (m->files.n_frames > 1)
        return describe_frames(m);
    describe_still(m->base.sequence);
    return SPIN_OK;
}

static spin_status points_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct points *m = self;
    const struct spin_splats *s = &m->base.canonical;
    size_t i = m->files.n_frames > 1 ? (size_t)frame : 0;

    (void)time;
    if (i >= m->files.n_frames)
        return spin_not_found("there is no frame %d", frame);
    SPIN_TRY(load(m, i));
    columns &= SPIN_COL_MEANS | SPIN_COL_RGB;
    if ((columns & SPIN_COL_RGB) && !s->rgb)
        return spin_malformed("'%s' has no colours, unlike the first file", m->files.frame[i].path);
    SPIN_TRY(spin_splats_reserve(out, s->n, columns, 0));
    if (columns & SPIN_COL_MEANS)
        memcpy(out->means, s->means, 3 * s->n * sizeof *s->means);
    if (columns & SPIN_COL_RGB)
        memcpy(out->rgb, s->rgb, 3 * s->n * sizeof *s->rgb);
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {SPIN_FILE_SEQUENCE_OPTION, {0}};

SPIN_MODEL_IMPORTER(points, struct points, open_points, spin_model_close,
                    .summary = "initial points of a data set: COLMAP's points3D, init_pt_cld.npz",
                    .upstream = "colmap/colmap, JonathonLuiten/Dynamic3DGaussians 7dbbd4d",
                    .options = options, .probe = probe, .frame = points_frame)
