#include "exporters/lib/path_file.h"

#include "base/base.h"
#include "io/file.h"
#include "io/json.h"

/* Tolerance of the length of an axis, and of the cosine between two axes: large enough for matrices
 * that are rounded to three digits. */
#define CROOKED 2e-3

enum { MOST_POSES = 10000000, MOST_SIDE = 16384 };

/* ---- Matrices -------------------------------------------------------------------------------- */

static double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Inverts a camera-to-world matrix (3 x 4) into w2c. A `sign` of -1 negates the y and z axes of the
 * camera. The axes are orthonormalised: the third keeps its direction, and the second is made
 * perpendicular to the third. Returns false if the matrix is not a rotation and a translation. */
static bool invert_matrix(const double m[12], double sign, double w2c[12])
{
    double axis[3][3], length[3], across[3], det;

    for (int c = 0; c < 3; c++)
        for (int r = 0; r < 3; r++)
            axis[c][r] = (c == 0 ? 1 : sign) * m[4 * r + c];
    for (int c = 0; c < 3; c++) {
        length[c] = sqrt(dot(axis[c], axis[c]));
        if (!(fabs(length[c] - 1) < CROOKED))
            return false;
    }
    if (!(fabs(dot(axis[0], axis[1])) < CROOKED && fabs(dot(axis[0], axis[2])) < CROOKED &&
          fabs(dot(axis[1], axis[2])) < CROOKED))
        return false;
    for (int r = 0; r < 3; r++)
        axis[2][r] /= length[2];
    length[1] = dot(axis[1], axis[2]);
    for (int r = 0; r < 3; r++)
        axis[1][r] -= length[1] * axis[2][r];
    length[1] = sqrt(dot(axis[1], axis[1]));
    for (int r = 0; r < 3; r++)
        axis[1][r] /= length[1];
    for (int r = 0; r < 3; r++)
        across[r] = axis[1][(r + 1) % 3] * axis[2][(r + 2) % 3] -
                    axis[1][(r + 2) % 3] * axis[2][(r + 1) % 3];
    det = dot(axis[0], across);
    memcpy(axis[0], across, sizeof across);
    for (int c = 0; c < 3; c++) {
        memcpy(w2c + 4 * c, axis[c], sizeof axis[c]);
        w2c[4 * c + 3] = -(axis[c][0] * m[3] + axis[c][1] * m[7] + axis[c][2] * m[11]);
    }
    return det > 0;
}

/* Adds a matrix. Fails unless n, the number of its values, is 12 or 16; n = 0 means that a value
 * was not a number. */
static spin_status add_matrix(struct spin_path_file *f, size_t *room, const double *m, size_t n,
                              double sign, double fovy_deg)
{
    struct spin_path_pose pose = {.fovy_deg = fovy_deg};

    if (n == 0)
        return spin_malformed("matrix %zu has values that are not numbers", f->n + 1);
    if (n != 12 && n != 16)
        return spin_malformed("matrix %zu has %zu numbers, expected 12 or 16", f->n + 1, n);
    for (size_t k = 0; k < n; k++)
        if (!(fabs(m[k]) <= 1e15))
            return spin_malformed("matrix %zu has a value that is not finite or too large",
                                  f->n + 1);
    if (n == 16 && (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1))
        return spin_malformed("matrix %zu ends in %g %g %g %g, expected 0 0 0 1", f->n + 1, m[12],
                              m[13], m[14], m[15]);
    if (!invert_matrix(m, sign, pose.w2c))
        return spin_malformed(
            "matrix %zu is not a rotation and a translation from a camera to the world", f->n + 1);
    if (f->n == MOST_POSES)
        return spin_unsupported("more than %d matrices", MOST_POSES);
    SPIN_TRY(spin_array_grow(f->n, room, sizeof *f->pose, (void **)&f->pose));
    f->pose[f->n++] = pose;
    return SPIN_OK;
}

/* ---- JSON ------------------------------------------------------------------------------------ */

/* Reads the numbers of a list and of nested lists into m[17]. Returns their count, at most 17, or 0
 * if the list contains anything else. */
static size_t numbers_of(const spin_json *j, double *m)
{
    size_t n = 0;

    for (size_t i = 0; i < spin_json_length(j) && n < 17; i++) {
        const spin_json *row = spin_json_at(j, i);

        if (!spin_json_is_array(row)) {
            if (!spin_json_number(row, &m[n++]))
                return 0;
            continue;
        }
        for (size_t k = 0; k < spin_json_length(row) && n < 17; k++)
            if (!spin_json_number(spin_json_at(row, k), &m[n++]))
                return 0;
    }
    return n;
}

static spin_status read_list(const spin_json *list, struct spin_path_file *out)
{
    double m[17];
    size_t room = 0;

    for (size_t i = 0; i < spin_json_length(list); i++)
        SPIN_TRY(add_matrix(out, &room, m, numbers_of(spin_json_at(list, i), m), 1, 0));
    return SPIN_OK;
}

static spin_status read_size(const spin_json *root, struct spin_path_file *out)
{
    const spin_json *width = spin_json_get(root, "render_width");
    const spin_json *height = spin_json_get(root, "render_height");
    int64_t size[2] = {0, 0};

    if (!width && !height)
        return SPIN_OK;
    if (!spin_json_integer(width, &size[0]) || !spin_json_integer(height, &size[1]))
        return spin_malformed(
            "'render_width' and 'render_height': expected two integers, or neither");
    if (size[0] < 16 || size[1] < 16 || size[0] > MOST_SIDE || size[1] > MOST_SIDE)
        return spin_unsupported(
            "'render_width' and 'render_height' are %lld and %lld, expected 16 to %d",
            (long long)size[0], (long long)size[1], MOST_SIDE);
    out->width = (int)size[0];
    out->height = (int)size[1];
    return SPIN_OK;
}

static spin_status read_nerfstudio(const spin_json *root, struct spin_path_file *out)
{
    const spin_json *list = spin_json_get(root, "camera_path");
    const char *type = spin_json_string(spin_json_get(root, "camera_type"));
    double m[17];
    size_t room = 0;

    if (!spin_json_is_array(list))
        return spin_malformed("the list 'camera_path' is missing");
    if (type && strcmp(type, "perspective") != 0)
        return spin_unsupported("'camera_type' is '%s', but only perspective is supported", type);
    SPIN_TRY(read_size(root, out));
    if (!spin_json_number(spin_json_get(root, "fps"), &out->fps) ||
        !(out->fps >= 0.01 && out->fps <= 1000))
        out->fps = 0;
    for (size_t i = 0; i < spin_json_length(list); i++) {
        const spin_json *camera = spin_json_at(list, i);
        double fovy = 0;

        if (spin_json_number(spin_json_get(camera, "fov"), &fovy) && !(fovy > 0.1 && fovy < 179))
            return spin_unsupported(
                "camera %zu has a field of view of %g degrees, expected 0.1 to 179", i + 1, fovy);
        SPIN_TRY(add_matrix(out, &room, m, numbers_of(spin_json_get(camera, "camera_to_world"), m),
                            -1, fovy));
    }
    return SPIN_OK;
}

static spin_status read_json(const char *path, const struct spin_map *map,
                             struct spin_path_file *out)
{
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;

    SPIN_TRY(spin_json_parse(path, (const char *)map->data, map->size, &root));
    return spin_json_is_array(root) ? read_list(root, out) : read_nerfstudio(root, out);
}

/* ---- Text ------------------------------------------------------------------------------------ */

/* Reads a text with one matrix per line. "#" begins a comment. */
static spin_status read_text(char *text, struct spin_path_file *out)
{
    size_t room = 0;

    for (char *line = text, *next; line; line = next) {
        double m[17];
        size_t n = 0;
        char *at = line, *end;

        next = strchr(line, '\n');
        if (next)
            *next++ = '\0';
        line[strcspn(line, "#")] = '\0';
        for (; n < 17; at = end + strspn(end, ", \t\r")) {
            m[n] = strtod(at, &end);
            if (end == at)
                break;
            n++;
        }
        if (at[strspn(at, " \t\r")] && n < 17)
            return spin_malformed("'%.20s' is not a number", at);
        if (n > 0)
            SPIN_TRY(add_matrix(out, &room, m, n, 1, 0));
    }
    return SPIN_OK;
}

static spin_status read_file(const char *path, const struct spin_map *map,
                             struct spin_path_file *out)
{
    size_t first = 0;
    SPIN_FREED char *text = NULL;

    while (first < map->size && memchr(" \t\r\n", map->data[first], 4))
        first++;
    if (first < map->size && (map->data[first] == '{' || map->data[first] == '['))
        return read_json(path, map, out);
    SPIN_TRY(spin_alloc(map->size + 1, 1, (void **)&text));
    memcpy(text, map->data, map->size);
    return read_text(text, out);
}

spin_status spin_path_file_open(const char *path, struct spin_path_file *out)
{
    struct spin_map map;
    spin_status status;

    *out = (struct spin_path_file){0};
    SPIN_TRY(spin_map_open(path, &map));
    status = read_file(path, &map, out);
    spin_map_close(&map);
    if (status == SPIN_OK && out->n == 0)
        status = spin_malformed("the file contains no cameras");
    if (status == SPIN_OK)
        return SPIN_OK;
    spin_path_file_close(out);
    return spin_fail_context(status, "camera path '%s'", path);
}

void spin_path_file_close(struct spin_path_file *file)
{
    free(file->pose);
    *file = (struct spin_path_file){0};
}
