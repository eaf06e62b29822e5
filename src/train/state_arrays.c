#include "train/state_arrays.h"

#include "base/base.h"

static struct spin_state_array of_frame(int f, const char *what, const char *array,
                                        float SPIN_DEV *at, size_t n)
{
    struct spin_state_array piece = {.at = at, .n = n, .frame = f};

    snprintf(piece.name, sizeof piece.name, "%s/%05d/%s", what, f, array);
    return piece;
}

spin_status spin_state_arrays(struct spin_trainer *t, uint32_t **permutation,
                              struct spin_state_array **out, size_t *n)
{
    enum { N_PARAMS = 4 };
    struct spin_param *param[N_PARAMS] = {&t->table, &t->heads, &t->tracks, &t->exposures.param};
    const char *param_name[N_PARAMS] = {"table", "heads", "tracks", "exposure"};
    const char *part_name[3] = {"p", "m", "v"};
    struct spin_state_array *piece;
    size_t k = 0;

    SPIN_TRY(
        spin_alloc(3 * N_PARAMS + 2 + 14 * (size_t)t->n_frames, sizeof *piece, (void **)&piece));
    for (int i = 0; i < N_PARAMS; i++) {
        float SPIN_DEV *at[3] = {param[i]->p, param[i]->m, param[i]->v};

        for (int j = 0; j < 3; j++, k++) {
            snprintf(piece[k].name, sizeof piece[k].name, "%s/%s", param_name[i], part_name[j]);
            piece[k].at = at[j];
            piece[k].n = param[i]->n;
        }
    }
    if (t->lazy)
        piece[k++] = (struct spin_state_array){.name = "table/last",
                                               .kind = SPIN_STATE_STEPS,
                                               .at = t->lazy->last,
                                               .n = t->lazy->n_lines};
    for (int f = 0; f < t->n_frames; f++) {
        float SPIN_DEV *at[3] = {t->frame[f].pos, t->frame[f].m, t->frame[f].v};

        for (int j = 0; j < 3; j++, k++)
            piece[k] = of_frame(f, "frames", part_name[j], at[j], 3 * t->frame[f].size.n_pos);
    }
    for (int f = 0; f < t->n_frames && t->d_residual; f++) {
        float SPIN_DEV *at[3] = {t->frame[f].residual, t->frame[f].residual_m,
                                 t->frame[f].residual_v};

        for (int j = 0; j < 3; j++, k++)
            piece[k] = of_frame(f, "residual", part_name[j], at[j],
                                SPIN_RESIDUAL * t->frame[f].size.n_residual);
    }
    for (int f = 0; f < t->n_frames && t->d_sh; f++) {
        float SPIN_DEV *at[3] = {t->frame[f].sh, t->frame[f].sh_m, t->frame[f].sh_v};

        for (int j = 0; j < 3; j++, k++)
            piece[k] =
                of_frame(f, "sh", part_name[j], at[j], t->frame[f].sh_width * t->frame[f].size.n);
    }
    for (int f = 0; f < t->n_frames && t->tracked; f++) {
        const struct spin_train_frame *frame = &t->frame[f];
        static const char *const name[] = {"gradient", "seen", "track", "place"};
        float SPIN_DEV *at[] = {frame->gradient, (float SPIN_DEV *)(void SPIN_DEV *)frame->seen,
                                (float SPIN_DEV *)(void SPIN_DEV *)frame->track, NULL};

        for (int j = 0; j < 4; j++, k++) {
            piece[k] = of_frame(f, "frames", name[j], at[j], frame->size.n);
            piece[k].kind = SPIN_STATE_GRADIENT + j;
        }
        piece[k - 1].host = permutation ? permutation[f] : NULL;
        if (frame->turn)
            piece[k++] = of_frame(f, "frames", "turn", frame->turn, 4 * frame->size.n_pos);
    }
    if (t->average.n > 0)
        piece[k++] = (struct spin_state_array){.name = "average",
                                               .host = (uint32_t *)(void *)t->average.mean,
                                               .n = t->average.n_values};
    *out = piece;
    *n = k;
    return SPIN_OK;
}

/* The names of parameters, such as "table/p", end in p; those of other arrays do not. */
bool spin_state_is_parameter(const struct spin_state_array *array)
{
    return array->name[strlen(array->name) - 1] == 'p';
}
