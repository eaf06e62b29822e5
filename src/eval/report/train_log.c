/* Reads the log of a training and averages the loss for a chart. A resumed run appends to the same
 * file and may repeat iterations; the values of the last repetition are used. */
#include "eval/report/report.h"

#include "base/base.h"
#include "io/file.h"
#include "io/json.h"

static spin_status grow_columns(double **column[], int n_columns, size_t n, size_t *room)
{
    size_t more = *room ? 2 * *room : 256;

    if (n < *room)
        return SPIN_OK;
    for (int i = 0; i < n_columns; i++)
        SPIN_TRY(spin_grow(more, sizeof(double), (void **)column[i]));
    *room = more;
    return SPIN_OK;
}

static spin_status add_line(struct spin_train_log *h, const spin_json *j)
{
    double **steps[] = {&h->step, &h->loss},
           **tests[] = {&h->test, &h->seconds, &h->psnr, &h->ssim};
    double iteration, value, seconds = 0, ssim = 0;

    if (!spin_json_number(spin_json_get(j, "iteration"), &iteration))
        return spin_malformed("'iteration' is missing");
    if (spin_json_number(spin_json_get(j, "seconds"), &seconds))
        h->total_seconds = seconds;
    if (spin_json_number(spin_json_get(j, "loss"), &value)) {
        while (h->n_steps && h->step[h->n_steps - 1] >= iteration)
            h->n_steps--;
        SPIN_TRY(grow_columns(steps, 2, h->n_steps, &h->room_steps));
        h->step[h->n_steps] = iteration;
        h->loss[h->n_steps++] = value;
    }
    if (spin_json_number(spin_json_get(j, "test_psnr"), &value)) {
        while (h->n_tests && h->test[h->n_tests - 1] >= iteration)
            h->n_tests--;
        SPIN_TRY(grow_columns(tests, 4, h->n_tests, &h->room_tests));
        spin_json_number(spin_json_get(j, "test_ssim"), &ssim);
        h->test[h->n_tests] = iteration;
        h->seconds[h->n_tests] = seconds;
        h->psnr[h->n_tests] = value;
        h->ssim[h->n_tests++] = ssim;
    }
    return SPIN_OK;
}

static spin_status read_lines(const char *path, const struct spin_map *map,
                              struct spin_train_log *h)
{
    const char *at = (const char *)map->data, *end = at + map->size;
    char name[64];

    for (int number = 1; at < end; number++) {
        const char *stop = memchr(at, '\n', (size_t)(end - at));
        SPIN_LEAVES(spin_json_freed) spin_json *j = NULL;
        spin_status status;

        if (!stop)
            break; /* incomplete last line: spin-retrain is still running, or was killed */
        snprintf(name, sizeof name, "line %d", number);
        status = spin_json_parse(name, at, (size_t)(stop - at), &j);
        if (status == SPIN_OK)
            status = add_line(h, j);
        SPIN_TRY_IN(status, "cannot read the log '%s', line %d", path, number);
        at = stop + 1;
    }
    return SPIN_OK;
}

/* Averages the loss over intervals with the same number of entries; the last interval may have
 * fewer. */
static void average_loss(struct spin_train_log *h, size_t most)
{
    size_t each = (h->n_steps + most - 1) / most, k = 0;

    for (size_t i = 0; i < h->n_steps; i += each, k++) {
        size_t n = h->n_steps - i < each ? h->n_steps - i : each;
        double sum = 0;

        for (size_t j = 0; j < n; j++)
            sum += h->loss[i + j];
        h->step[k] = h->step[i + n - 1];
        h->loss[k] = sum / (double)n;
    }
    h->n_steps = k;
}

spin_status spin_train_log_read(const char *path, size_t most, struct spin_train_log *out)
{
    struct spin_map map;
    spin_status status;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_map_open(path, &map));
    status = read_lines(path, &map, out);
    spin_map_close(&map);
    if (status == SPIN_OK && out->n_steps > most)
        average_loss(out, most);
    if (status != SPIN_OK)
        spin_train_log_free(out);
    return status;
}

void spin_train_log_free(struct spin_train_log *h)
{
    free(h->step);
    free(h->loss);
    free(h->test);
    free(h->seconds);
    free(h->psnr);
    free(h->ssim);
    memset(h, 0, sizeof *h);
}
