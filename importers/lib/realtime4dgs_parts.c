/* Finding the parts of a checkpoint of Realtime-4DGS. */
#include "importers/lib/realtime4dgs_parts.h"

#include <stdio.h>
#include <string.h>

#include "importers/lib/chkpnt.h"

static bool is_kind(const struct spin_value *v, enum spin_value_kind kind)
{
    return v && v->kind == kind;
}

static void take_common(const struct spin_value *m, struct realtime4dgs_parts *p)
{
    p->active = spin_value_at(m, 0);
    p->xyz = spin_value_at(m, 1);
    p->dc = spin_value_at(m, 2);
    p->rest = spin_value_at(m, 3);
    p->scaling = spin_value_at(m, 4);
    p->rotation = spin_value_at(m, 5);
    p->opacity = spin_value_at(m, 6);
}

void spin_realtime4dgs_items(const struct spin_value *m, struct realtime4dgs_parts *p)
{
    take_common(m, p);
    p->moving = true;
    p->optimizer = spin_value_at(m, 11);
    p->t = spin_value_at(m, 13);
    p->scaling_t = spin_value_at(m, 14);
    p->rotation_r = spin_value_at(m, 15);
    p->rot_4d = spin_value_at(m, 16);
    p->env_map = spin_value_at(m, 17);
    p->active_t = spin_value_at(m, 18);
}

static spin_status take_tuple(const struct spin_value *m, struct realtime4dgs_parts *p)
{
    p->masked = m->n == 20 || m->n == 13;
    if (m->n == 12 || m->n == 13) {
        take_common(m, p);
        p->optimizer = spin_value_at(m, 10);
        return SPIN_OK;
    }
    if (m->n != 19 && m->n != 20)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "the model has %zu items and Realtime-4DGS has 19 (or 12): it is one of "
                         "%s",
                         m->n, spin_chkpnt_maker(m->n));
    spin_realtime4dgs_items(m, p);
    return SPIN_OK;
}

/* A fork's dict, with the attribute names of the class. */
static void take_attributes(const struct spin_value *m, struct realtime4dgs_parts *p)
{
    double dim = 4;

    spin_value_number(spin_value_get(m, "gaussian_dim"), &dim);
    p->active = spin_value_get(m, "active_sh_degree");
    p->xyz = spin_value_get(m, "_xyz");
    p->dc = spin_value_get(m, "_features_dc");
    p->rest = spin_value_get(m, "_features_rest");
    p->scaling = spin_value_get(m, "_scaling");
    p->rotation = spin_value_get(m, "_rotation");
    p->opacity = spin_value_get(m, "_opacity");
    p->t = spin_value_get(m, "_t");
    p->scaling_t = spin_value_get(m, "_scaling_t");
    p->rotation_r = spin_value_get(m, "_rotation_r");
    p->rot_4d = spin_value_get(m, "rot_4d");
    p->env_map = spin_value_get(m, "env_map");
    p->active_t = spin_value_get(m, "active_sh_degree_t");
    p->moving = dim == 4;
}

static const struct spin_value *get_prefixed(const struct spin_value *dict, const char *prefix,
                                             const char *key)
{
    char name[64];

    snprintf(name, sizeof name, "%s%s", prefix, key);
    return spin_value_get(dict, name);
}

void spin_realtime4dgs_loaded(const struct spin_value *dict, const char *prefix,
                              struct realtime4dgs_parts *p)
{
    p->xyz = get_prefixed(dict, prefix, "xyz");
    p->dc = get_prefixed(dict, prefix, "features_dc");
    p->rest = get_prefixed(dict, prefix, "features_rest");
    p->scaling = get_prefixed(dict, prefix, "scaling");
    p->rotation = get_prefixed(dict, prefix, "rotation");
    p->opacity = get_prefixed(dict, prefix, "opacity");
    p->t = get_prefixed(dict, prefix, "t");
    p->scaling_t = get_prefixed(dict, prefix, "scaling_t");
    p->rotation_r = get_prefixed(dict, prefix, "rotation_r");
    p->swapped = true;
}

spin_status spin_realtime4dgs_parts(const struct spin_value *root, struct realtime4dgs_parts *p)
{
    const struct spin_value *m = spin_value_at(root, 0);

    p->iteration = -1;
    if (is_kind(root, SPIN_VALUE_DICT) && spin_value_get(root, "xyz") &&
        spin_value_get(root, "scaling_t")) {
        if (spin_value_get(root, "static_xyz"))
            return spin_fail(SPIN_E_UNSUPPORTED, "a dict with static_xyz is one of %s",
                             spin_chkpnt_maker(28));
        spin_realtime4dgs_loaded(root, "", p);
        p->moving = true;
        return SPIN_OK;
    }
    if (!is_kind(root, SPIN_VALUE_TUPLE) || root->n != 2)
        return spin_fail(SPIN_E_MALFORMED, "the checkpoint holds %s, expected (model, iteration)",
                         spin_chkpnt_kind(root));
    spin_value_number(spin_value_at(root, 1), &p->iteration);
    if (is_kind(m, SPIN_VALUE_DICT) && spin_value_get(m, "_xyz")) {
        take_attributes(m, p);
        return SPIN_OK;
    }
    if (!is_kind(m, SPIN_VALUE_TUPLE) || !is_kind(spin_value_at(root, 1), SPIN_VALUE_INT))
        return spin_fail(SPIN_E_MALFORMED,
                         "the checkpoint holds %s and %s, expected a tuple and an int",
                         spin_chkpnt_kind(m), spin_chkpnt_kind(spin_value_at(root, 1)));
    return take_tuple(m, p);
}

bool spin_realtime4dgs_is_stale(const struct realtime4dgs_parts *p)
{
    const struct spin_value *groups = spin_value_get(p->optimizer, "param_groups");

    for (size_t i = 0; groups && i < groups->n; i++) {
        const char *name = spin_value_text(spin_value_get(spin_value_at(groups, i), "name"));

        if (name && (strcmp(name, "f_static") == 0 || strcmp(name, "f_view") == 0))
            return true;
    }
    return false;
}
