/* K: splats plain */
#include "spin.h"
#include "tests/tap.h"

#define ALL (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)

/* Every column of the mask can be written to its last row. */
static int fill(struct spin_splats *s)
{
    size_t side = (size_t)(s->sh_degree + 1);

    for (size_t i = 0; i < s->n; i++) {
        s->means[3 * i + 2] = s->quats[4 * i + 3] = s->log_scales[3 * i + 2] = 1;
        s->logit_opacities[i] = s->sh[3 * side * side * (i + 1) - 1] = 1;
    }
    return 1;
}

static void test_reserve(void)
{
    struct spin_splats s = {0};

    ok(spin_splats_reserve(&s, 10, SPIN_COL_MEANS, -1) == SPIN_OK && s.n == 10 && s.means &&
           !s.quats && !s.sh && !s.rgb && s.sh_degree == -1 && s.capacity >= 10,
       "makes only the wanted columns");
    ok(spin_splats_reserve(&s, 7, ALL, 3) == SPIN_OK && s.n == 7 && s.sh && s.quats && fill(&s),
       "makes more of them later");
    ok(spin_splats_reserve(&s, 1000, SPIN_COL_MEANS, 3) == SPIN_OK && s.n == 1000 && fill(&s),
       "columns of an earlier call hold all rows too");
    ok(s.capacity >= 1000, "capacity counts rows in every column");
    float *means = s.means;
    ok(spin_splats_reserve(&s, 900, ALL, 2) == SPIN_OK && s.means == means && s.n == 900 &&
           s.sh_degree == 2 && fill(&s),
       "shrinks without giving memory back");
    ok(spin_splats_reserve(&s, 1500, ALL, 3) == SPIN_OK && fill(&s), "grows again");
    spin_splats_free(&s);
    ok(!s.means && !s.sh && s.n == 0, "is zero when freed");
    spin_splats_free(&s);
}

static void test_limits(void)
{
    struct spin_splats s = {0};

    ok(spin_splats_reserve(&s, 0, ALL, 0) == SPIN_OK && s.n == 0 && s.means && s.sh,
       "an empty frame has its columns");
    ok(spin_splats_reserve(&s, SIZE_MAX / 2, ALL, 3) == SPIN_E_MEMORY && s.n == 0,
       "a size that overflows is an error");
    ok(spin_splats_reserve(&s, 5, ALL, 1) == SPIN_OK && s.n == 5 && fill(&s),
       "and can be used after it");
    ok(spin_splats_reserve(&s, 5, ALL, 4) == SPIN_E_UNSUPPORTED &&
           spin_splats_reserve(&s, 5, ALL, -1) == SPIN_E_UNSUPPORTED,
       "refuses other SH degrees");
    spin_splats_free(&s);
}

static void test_views(void)
{
    struct spin_views views = {0};
    char path[] = "ims/0/000001.jpg";
    struct spin_view v = {
        .camera = {.width = 64}, .dataset_frame = 3, .camera_id = 7, .path = path};
    int good = 1;

    for (int i = 0; i < 200; i++) {
        v.number = i;
        good &= spin_views_add(&views, &v) == SPIN_OK;
    }
    path[0] = 'X';
    ok(good && views.n == 200 && views.view[199].number == 199 && views.view[0].camera_id == 7,
       "keeps views in order");
    is_text(views.view[150].path, "ims/0/000001.jpg", "copies the path");
    ok(views.n_dataset_frames == 4, "counts rows");
    spin_views_free(&views);
    ok(!views.view && views.n == 0, "is zero when freed");
}

static void test_values(void)
{
    static const char *const pairs[] = {"sh", "1", "compare", "", "sh", "2", NULL};
    struct spin_plugin_values v = {pairs}, none = {NULL};

    is_text(spin_plugin_value(&v, "sh", "keep"), "2", "the last value counts");
    is_text(spin_plugin_value(&v, "1", "no"), "no", "a value is no key");
    ok(spin_plugin_value(&v, "compare", NULL) != NULL, "a switch is there");
    is_text(spin_plugin_value(&v, "pattern", "p"), "p", "else the fallback");
    ok(spin_plugin_value(NULL, "a", NULL) == NULL && spin_plugin_value(&none, "a", NULL) == NULL,
       "no values at all");
}

TAP_MAIN
{
    test_reserve();
    test_limits();
    test_views();
    test_values();
}
