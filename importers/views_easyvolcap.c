/* Data sets of EasyVolcap, and others with the same layout (EasyMocap, SelfCap, Mobile-Stage):
 * cameras in OpenCV's YAML, and images.
 *
 *     intri.yml                       names; for each camera NN: K_NN, H_NN, W_NN, D_NN or dist_NN,
 *                                     ccm_NN
 *     extri.yml                       R_NN (rotation vector) or Rot_NN, T_NN
 *     images/<camera>/000000.jpg ...  the frames
 *     masks/<camera>/ ...             foreground masks; the folder may also be called mask or msk,
 *                                     or be missing
 *     cameras/<camera>/{intri,extri}.yml
 *                                     for moving cameras, instead of the first two files: an entry
 *                                     per frame
 *
 * A pose is w2c = [R | T] in OpenCV's axes. Distortion is refused: EasyVolcap undistorts images and
 * then uses another K, which the files do not contain. The data set does not state held-out
 * cameras.
 *
 * Frame k of n is at time k/(n-1), as in trainings of FreeTimeGS on these data sets. EasyVolcap
 * itself uses k/n. */
#include "importers/lib/views_rig.h"
#include "io/numbered.h"
#include "io/text_file.h"
#include "math/covariance.h"

static int probe(const struct spin_peek *peek)
{
    char *folder = NULL, **names = NULL, name[300];
    size_t n = 0;
    bool holds = spin_peek_has(peek, "intri.yml") && spin_peek_has(peek, "extri.yml");

    if (!holds && spin_peek_has(peek, "cameras") && spin_peek_has(peek, "images") &&
        spin_path_join(peek->path, "cameras", &folder) == SPIN_OK)
        (void)spin_folder_list(folder, &names, &n);
    for (size_t i = 0; i < n && !holds; i++) {
        snprintf(name, sizeof name, "%s/extri.yml", names[i]);
        holds = spin_model_holds(folder, name);
    }
    spin_folder_list_free(names);
    free(folder);
    return holds ? 75 : 0;
}

/* ---- YAML ------------------------------------------------------------------------------------ */

/* State of parsing the subset of YAML that OpenCV's FileStorage writes for cameras. The file is
 * converted to a JSON object, whose members are numbers, arrays for lists of texts, and, for
 * matrices, objects with the members rows, cols and data. */
struct reader {
    spin_json *top, *value; /* the whole object; the member to which lines below a key belong */
    bool open;              /* the data of a matrix continue in the next line */
};

static spin_status set_value(spin_json *object, const char *key, spin_json *value)
{
    if (spin_json_get(object, key)) {
        spin_json_free(value);
        return spin_malformed("key '%.40s' occurs twice", key);
    }
    return spin_json_set(object, key, value) == 0
               ? SPIN_OK
               : spin_malformed("entry '%.40s' is not valid UTF-8, or there is not enough memory",
                                key);
}

/* Returns the text without its quotes, or "" if the quotes do not match. */
static const char *plain_text(char *text)
{
    size_t n = strlen(text);

    if (*text != '"')
        return text;
    if (n < 2 || text[n - 1] != '"')
        return "";
    text[n - 1] = '\0';
    return text + 1;
}

static spin_status take_numbers(struct reader *r, const char *at)
{
    spin_json *data = spin_json_get(r->value, "data");

    for (at += strspn(at, " ,"); *at && *at != ']'; at += strspn(at, " ,")) {
        char *end;
        double value = strtod(at, &end);

        if (end == at || !strchr(" ,]", *end) || !isfinite(value))
            return spin_malformed("'%.40s' is not a number", at);
        if (spin_json_push_number(data, value) != 0)
            return spin_fail(SPIN_E_MEMORY, "not enough memory");
        at = end;
    }
    r->open = *at != ']';
    return SPIN_OK;
}

/* Reads a line below a key: "- text" in a list, or an entry such as "rows: 3" in a matrix. */
static spin_status take_below(struct reader *r, char *line)
{
    char *value;
    double number;

    if (*line == '-' && spin_json_is_array(r->value))
        return spin_json_push_string(r->value, plain_text(line + 1 + strspn(line + 1, " "))) == 0
                   ? SPIN_OK
                   : spin_fail(SPIN_E_MEMORY, "not enough memory");
    value = strchr(line, ':');
    if (!value || !spin_json_is_object(r->value))
        return spin_malformed("'%.40s' does not belong to a list or a matrix", line);
    *value++ = '\0';
    value += strspn(value, " ");
    if (strcmp(line, "data") == 0 && *value == '[') {
        SPIN_TRY(set_value(r->value, line, spin_json_array()));
        return take_numbers(r, value + 1);
    }
    if (strcmp(line, "dt") == 0 && (strcmp(value, "d") == 0 || strcmp(value, "f") == 0))
        return SPIN_OK;
    if ((strcmp(line, "rows") != 0 && strcmp(line, "cols") != 0) ||
        !spin_views_is_number(value, &number))
        return spin_malformed(
            "'%.40s: %.40s' is not an entry of a matrix, expected rows, cols, dt (d or f) or data",
            line, value);
    return set_value(r->value, line, spin_json_number_value(number));
}

static spin_status take_key(struct reader *r, char *line)
{
    char *value = strchr(line, ':');
    double number;

    if (!value)
        return spin_malformed("'%.40s' is not a key with a value, expected 'key: value'", line);
    *value++ = '\0';
    value += strspn(value, " ");
    r->value = NULL;
    if (spin_views_is_number(value, &number))
        return set_value(r->top, line, spin_json_number_value(number));
    if (*value == '"')
        return set_value(r->top, line, spin_json_text_value(plain_text(value)));
    if (*value && strcmp(value, "!!opencv-matrix") != 0)
        return spin_unsupported(
            "'%.40s' is '%.40s', expected a number, a list of strings or !!opencv-matrix", line,
            value);
    SPIN_TRY(set_value(r->top, line, *value ? spin_json_object() : spin_json_array()));
    r->value = spin_json_get(r->top, line);
    return SPIN_OK;
}

static spin_status take_line(struct reader *r, char *line)
{
    char *words = line + strspn(line, " ");

    if (*words == '\0' || *words == '#')
        return SPIN_OK;
    if (r->open)
        return take_numbers(r, words);
    return *line == ' ' || *line == '-' ? take_below(r, words) : take_key(r, line);
}

/* Parses the text of a file, which is split in place. */
static spin_status parse_yaml(struct reader *r, char *text)
{
    char *line;

    for (int number = 1; (line = strsep(&text, "\n")); number++) {
        if (number == 1 && strcmp(line, "%YAML:1.0") != 0 && strcmp(line, "%YAML 1.0") != 0)
            return spin_malformed("the first line is not '%%YAML:1.0'");
        if (number > 1 && strcmp(line, "---") != 0)
            SPIN_TRY_IN(take_line(r, line), "line %d", number);
    }
    return r->open ? spin_malformed("the file is cut short") : SPIN_OK;
}

struct file {
    const char *path;
    spin_json *json; /* freed by the caller, also on failure */
};

static spin_status load_yaml(struct spin_model *m, const char *folder, const char *name,
                             struct file *out)
{
    struct reader r = {.top = out->json = spin_json_object()};
    SPIN_LEAVES(spin_text_file_close) struct spin_text_file file = {0};

    SPIN_TRY(spin_model_join(m, &out->path, folder, "%s", name));
    SPIN_TRY(spin_text_file_open(out->path, &file));
    return spin_fail_context(parse_yaml(&r, file.text), "cannot read '%s'", out->path);
}

/* ---- Values ---------------------------------------------------------------------------------- */

static const spin_json *find_member(const spin_json *file, const char *key, const char *name)
{
    char text[300];

    snprintf(text, sizeof text, "%s_%s", key, name);
    return spin_json_get(file, text);
}

/* Reads the matrix <key>_<name>, which must have the given numbers of rows and columns. */
static spin_status read_matrix(const spin_json *file, const char *key, const char *name, int rows,
                               int cols, double *out)
{
    const spin_json *m = find_member(file, key, name), *data = spin_json_get(m, "data");
    size_t n = (size_t)(rows * cols);
    double has_rows = 0, has_cols = 0;

    if (!m)
        return spin_malformed("there is no matrix '%s_%s'", key, name);
    spin_json_number(spin_json_get(m, "rows"), &has_rows);
    spin_json_number(spin_json_get(m, "cols"), &has_cols);
    if (has_rows != rows || has_cols != cols || spin_json_length(data) != n)
        return spin_malformed("'%s_%s' is %g x %g with %zu numbers, expected %d x %d with %zu", key,
                              name, has_rows, has_cols, spin_json_length(data), rows, cols, n);
    for (size_t i = 0; i < n; i++)
        spin_json_number(spin_json_at(data, i), &out[i]);
    return SPIN_OK;
}

/* Checks that the distortion D_<name> or dist_<name>, if there is one, is 0. Its coefficients are
 * k1 k2 p1 p2 k3. */
static spin_status check_distortion(const spin_json *intri, const char *name)
{
    const char *key = find_member(intri, "D", name) ? "D" : "dist";
    double lens[5];

    if (!find_member(intri, key, name))
        return SPIN_OK;
    SPIN_TRY(read_matrix(intri, key, name, 5, 1, lens));
    for (int i = 0; i < 5; i++) {
        if (lens[i] != 0)
            return spin_unsupported("'%s_%s' has a distortion of %g: undistort the images and use "
                                    "the resulting matrices K",
                                    key, name, lens[i]);
    }
    return SPIN_OK;
}

/* Computes the matrix of the rotation about the axis r by the angle |r|. */
static void rotation_of(const double r[3], double out[9])
{
    double angle = sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
    double s = angle > 0 ? sin(angle / 2) / angle : 0.5;

    spin_matrix_of_quat((const double[4]){cos(angle / 2), s * r[0], s * r[1], s * r[2]}, out);
}

static spin_status read_pose(const spin_json *extri, const char *name, double w2c[12])
{
    double r[9], t[3];

    if (find_member(extri, "R", name) || !find_member(extri, "Rot", name)) {
        SPIN_TRY(read_matrix(extri, "R", name, 3, 1, t));
        rotation_of(t, r);
    } else {
        SPIN_TRY(read_matrix(extri, "Rot", name, 3, 3, r));
    }
    SPIN_TRY(read_matrix(extri, "T", name, 3, 1, t));
    for (int i = 0; i < 3; i++) {
        memcpy(w2c + 4 * i, r + 3 * i, 3 * sizeof *w2c);
        w2c[4 * i + 3] = t[i];
    }
    return spin_views_check_pose(w2c, "the pose");
}

/* Reads the image size from H_<name> and W_<name> or, if both are missing, from the image. */
static spin_status read_size(const spin_json *intri, const char *name, const char *picture,
                             struct spin_camera *out)
{
    const spin_json *h = find_member(intri, "H", name), *w = find_member(intri, "W", name);
    double width, height;
    int channels;

    if (!h && !w)
        return spin_image_size(picture, &out->width, &out->height, &channels);
    if (!spin_json_number(h, &height) || !spin_json_number(w, &width))
        return spin_malformed("'H_%s' and 'W_%s' must both be numbers, or both be missing", name,
                              name);
    return spin_views_size(width, height, out);
}

static spin_status read_lens(const spin_json *intri, const char *name, const char *picture,
                             struct spin_camera *out)
{
    double k[9];

    SPIN_TRY(read_size(intri, name, picture, out));
    SPIN_TRY(read_matrix(intri, "K", name, 3, 3, k));
    SPIN_TRY(spin_views_intrinsics(k, "K", out));
    return check_distortion(intri, name);
}

/* The files intri.yml and extri.yml of a folder. */
struct pair {
    struct file intri, extri;
};

static spin_status read_camera(const struct pair *p, const char *name, const char *picture,
                               struct spin_camera *out)
{
    const char *path = p->intri.path;
    spin_status status = read_lens(p->intri.json, name, picture, out);

    if (status == SPIN_OK) {
        path = p->extri.path;
        status = read_pose(p->extri.json, name, out->w2c);
    }
    return spin_fail_context(status, "cannot read '%s': '%s'", path, name);
}

/* ---- Cameras --------------------------------------------------------------------------------- */

/* A data set: its folder and its cameras. */
struct set {
    struct spin_model base; /* base.path: the folder of the data set */
    struct spin_rig_camera *camera;
    size_t n;
    bool coloured; /* at least one camera has a colour matrix ccm */
};

static spin_status find_pictures(struct set *set, struct spin_rig_camera *c)
{
    static const char *const masks[] = {"masks", "mask", "msk"};
    const char *folder;

    if (!spin_views_is_safe_name(c->name))
        return spin_malformed("a camera is called '%.80s', expected a folder's name", c->name);
    for (int i = 0; i < 3 && !c->masks; i++)
        SPIN_TRY(
            spin_model_find(&set->base, &c->masks, set->base.path, "%s/%s", masks[i], c->name));
    SPIN_TRY(spin_model_join(&set->base, &folder, set->base.path, "images/%s", c->name));
    return spin_rig_pictures(&set->base, c, folder);
}

static spin_status read_names(const struct pair *p, const spin_json **names, size_t *n)
{
    const spin_json *other = spin_json_get(p->extri.json, "names");

    *names = spin_json_get(p->intri.json, "names");
    *n = spin_json_length(*names);
    if (!spin_json_is_array(*names) || *n == 0)
        return spin_malformed("list 'names' of '%s' is missing or empty", p->intri.path);
    if (other && spin_json_length(other) != *n)
        return spin_malformed(
            "'%s' has %zu entries in 'names', but '%s' has %zu, expected the same number",
            p->intri.path, *n, p->extri.path, spin_json_length(other));
    return SPIN_OK;
}

/* Reads static cameras; one pair of files contains all of them. */
static spin_status read_still(struct set *set, const struct pair *p)
{
    const spin_json *names;

    SPIN_TRY(read_names(p, &names, &set->n));
    SPIN_TRY(spin_model_alloc(&set->base, set->n, sizeof *set->camera, (void **)&set->camera));
    for (size_t i = 0; i < set->n; i++)
        SPIN_TRY(spin_model_text(&set->base, &set->camera[i].name, "%s",
                                 spin_json_string(spin_json_at(names, i))));
    SPIN_TRY(spin_rig_sort(p->intri.path, set->camera, set->n));
    for (size_t i = 0; i < set->n; i++) {
        struct spin_rig_camera *c = &set->camera[i];

        SPIN_TRY(find_pictures(set, c));
        SPIN_TRY(read_camera(p, c->name, c->frames.frame[0].path, &c->camera));
        set->coloured = set->coloured || find_member(p->intri.json, "ccm", c->name);
    }
    return SPIN_OK;
}

/* Adds each entry of a moving camera to name_of: the key is the frame number as text, the value is
 * the name of the entry. */
static spin_status read_entries(struct set *set, const spin_json *names, size_t n,
                                spin_json *name_of)
{
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    const char **name;
    char key[24];

    SPIN_TRY(spin_model_alloc(&set->base, n, sizeof *name, (void **)&name));
    for (size_t i = 0; i < n; i++) {
        name[i] = spin_json_string(spin_json_at(names, i));
        if (!name[i])
            return spin_malformed("list 'names' has an entry that is not a string");
    }
    SPIN_TRY(spin_numbered_read(&(struct spin_numbering){.name = name, .n = n, .folders = true},
                                &numbers));
    for (size_t i = 0; i < n; i++) {
        snprintf(key, sizeof key, "%d", numbers.number[i]);
        SPIN_TRY(set_value(name_of, key, spin_json_text_value(name[i])));
    }
    return SPIN_OK;
}

/* Reads a moving camera. The camera's files contain an entry for each frame, which is named by the
 * frame number. */
static spin_status read_moving(struct set *set, const struct pair *p, struct spin_rig_camera *c,
                               spin_json *name_of)
{
    const spin_json *names;
    char key[24];
    size_t n;

    SPIN_TRY(read_names(p, &names, &n));
    SPIN_TRY(find_pictures(set, c));
    SPIN_TRY(
        spin_model_alloc(&set->base, c->frames.n_frames, sizeof *c->moving, (void **)&c->moving));
    SPIN_TRY(read_entries(set, names, n, name_of));
    for (size_t k = 0; k < c->frames.n_frames; k++) {
        const struct spin_file_frame *frame = &c->frames.frame[k];
        const char *name;

        snprintf(key, sizeof key, "%d", frame->number);
        name = spin_json_string(spin_json_get(name_of, key));
        if (!name || frame->number < 0)
            return spin_malformed("'%s' has no entry for image '%s'", p->intri.path, frame->path);
        SPIN_TRY(read_camera(p, name, frame->path, &c->moving[k]));
        set->coloured = set->coloured || find_member(p->intri.json, "ccm", name);
    }
    return SPIN_OK;
}

/* ---- The files ------------------------------------------------------------------------------- */

/* Reads intri.yml and extri.yml of a folder. The files describe the moving camera c or, if c is
 * NULL, all static cameras. */
static spin_status read_files(struct set *set, const char *folder, struct spin_rig_camera *c)
{
    spin_json *name_of = spin_json_object();
    struct pair p = {0};
    spin_status status;

    SPIN_TRY_OUT(load_yaml(&set->base, folder, "intri.yml", &p.intri));
    SPIN_TRY_OUT(load_yaml(&set->base, folder, "extri.yml", &p.extri));
    status = c ? read_moving(set, &p, c, name_of) : read_still(set, &p);
out:
    spin_json_free(name_of);
    spin_json_free(p.intri.json);
    spin_json_free(p.extri.json);
    return status;
}

static spin_status read_folders(struct set *set, const char *cameras)
{
    char **names;
    size_t n;

    SPIN_TRY(spin_model_names(&set->base, cameras, &names, &n));
    SPIN_TRY(spin_model_alloc(&set->base, n, sizeof *set->camera, (void **)&set->camera));
    for (size_t i = 0; i < n; i++) {
        const char *folder;

        if (names[i][0] == '.')
            continue;
        set->camera[set->n].name = names[i];
        SPIN_TRY(spin_model_join(&set->base, &folder, cameras, "%s", names[i]));
        SPIN_TRY(read_files(set, folder, &set->camera[set->n++]));
    }
    return set->n > 0 ? SPIN_OK : spin_not_found("folder '%s' is empty", cameras);
}

static spin_status read_set(struct set *set, struct spin_views *out)
{
    const char *cameras;

    SPIN_TRY(spin_model_join(&set->base, &cameras, set->base.path, "cameras"));
    SPIN_TRY(spin_model_holds(set->base.path, "intri.yml") || !spin_path_is_folder(cameras)
                 ? read_files(set, set->base.path, NULL)
                 : read_folders(set, cameras));
    SPIN_TRY(spin_rig_views(&set->base, set->camera, set->n, out));
    spin_rig_note(&set->base, NULL, out);
    spin_note(
        out, "for such data sets FreeTimeGS uses times i/(n-1), which is the default, but "
             "EasyVolcap uses i/n: for a run of EasyVolcap give --data-from easyvolcap:time=count");
    if (set->coloured)
        spin_note(out, "the colour matrices 'ccm' of the cameras are not applied");
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {SPIN_RIG_OPTIONS, {NULL, NULL, NULL, NULL}};

SPIN_VIEWS_IMPORTER(
    views_easyvolcap, "easyvolcap", struct set, read_set,
    .summary = "views: cameras and images of EasyVolcap and similar sets (intri.yml, extri.yml)",
    .upstream = "zju3dv/EasyVolcap 4cb3c00", .options = options, .probe = probe)
