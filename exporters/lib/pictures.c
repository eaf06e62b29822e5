#include "exporters/lib/pictures.h"

#include "base/base.h"
#include "io/webp.h"

spin_status spin_picture_blank(struct spin_picture *p, int width, int height)
{
    size_t n = (size_t)width * (size_t)height;

    SPIN_TRY(spin_grow(n + 1, 4, (void **)&p->rgba));
    p->width = width;
    p->height = height;
    for (size_t i = 0; i < n; i++)
        memcpy(p->rgba + 4 * i, "\0\0\0\377", 4);
    return SPIN_OK;
}

struct packing {
    struct spin_picture *picture;
    int level;
};

static void pack_task(void *context, int task)
{
    const struct packing *x = context;
    struct spin_picture *p = &x->picture[task];

    if (p->width == 0)
        return;
    p->status = spin_webp_write(p->rgba, p->width, p->height, x->level, &p->file, &p->n_file);
    if (p->status != SPIN_OK)
        snprintf(p->why, sizeof p->why, "%s", spin_last_error());
}

void spin_pictures_pack(struct spin_picture *p, int n, int level, struct spin_pool *pool)
{
    struct packing packing = {p, level};

    spin_pool_run(pool, n, pack_task, &packing);
}

spin_status spin_pictures_write(const struct spin_picture *p, int n, struct spin_zip_writer *zip)
{
    for (const struct spin_picture *end = p + n; p < end; p++) {
        if (p->width == 0)
            continue;
        if (p->status != SPIN_OK)
            return spin_fail(p->status, "%s: %s", p->name, p->why);
        SPIN_TRY(spin_zip_member_whole(zip, p->name, p->file, p->n_file, NULL, 0));
    }
    return SPIN_OK;
}

void spin_pictures_free(struct spin_picture *p, int n, bool all)
{
    for (const struct spin_picture *end = p ? p + n : p; p < end; p++) {
        free(p->file);
        p->file = NULL;
        if (all)
            free(p->rgba);
    }
}
