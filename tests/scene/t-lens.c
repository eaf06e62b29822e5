/* Lenses: which cameras share one, what is found again at another scale, JSON there and back, what
 * is refused. K: lens falloff */
#include "scene/lens.h"

#include "tests/tap.h"

static struct spin_view view_of(int width, int height, double fx)
{
    struct spin_view v;

    memset(&v, 0, sizeof v);
    v.camera.width = width;
    v.camera.height = height;
    v.camera.fx = v.camera.fy = fx;
    return v;
}

static void refuses(const char *text, const char *what)
{
    struct spin_lenses lenses;
    spin_json *json;

    ok(spin_json_parse("lenses", text, strlen(text), &json) == SPIN_OK &&
           spin_lenses_from_json(json, 1, &lenses) == SPIN_E_MALFORMED && !lenses.lens,
       "refused: %s", what);
    spin_json_free(json);
}

TAP_MAIN
{
    struct spin_view view[6] = {view_of(640, 360, 600),   view_of(640, 360, 630),
                                view_of(640, 360, 900),   view_of(640, 480, 600),
                                view_of(1280, 720, 1200), view_of(640, 360, 610)};
    struct spin_views views = {.view = view, .n = 6};
    struct spin_pair pairs[6] = {{0, 0}, {0, 1}, {0, 2}, {0, 3}, {0, 4}, {0, 5}};
    struct spin_view half = view_of(320, 180, 450), other = view_of(640, 360, 300);
    struct spin_view kind[3] = {view_of(640, 360, 600), view_of(640, 360, 730),
                                view_of(640, 360, 650)};
    struct spin_views two = {.view = kind, .n = 3};
    struct spin_lenses lenses, again;
    spin_json *json;
    bool same = true;

    ok(spin_lenses_list(&views, pairs, 6, 1, &lenses) == SPIN_OK && lenses.n == 4,
       "of six cameras four kinds: another focal length, shape or size is another");
    ok(spin_lenses_find(&lenses, &view[0].camera) == 0 &&
           spin_lenses_find(&lenses, &view[1].camera) == 0 &&
           spin_lenses_find(&lenses, &view[5].camera) == 0 &&
           spin_lenses_find(&lenses, &view[2].camera) == 1 &&
           spin_lenses_find(&lenses, &view[3].camera) == 2 &&
           spin_lenses_find(&lenses, &view[4].camera) == 3,
       "each camera has its own");
    ok(spin_lenses_find(&lenses, &other.camera) == -1, "a camera like none of them has none");
    ok(spin_lenses_corner(&lenses) == 1,
       "without a falloff the corners are as bright as the middle");
    for (int k = 0; k < 6; k++)
        lenses.lens[1].falloff[k] = -0.01f * (float)(k + 1);
    /* r^2 of the corner is 1 + (9/16)^2 = 1.31640625; mean c1 -0.02, mean c2 -0.05 */
    ok(fabs(spin_lenses_corner(&lenses) -
            (1 - 0.02 * 1.31640625 - 0.05 * 1.31640625 * 1.31640625)) < 1e-6,
       "brightness at the corners: %.6f", spin_lenses_corner(&lenses));
    json = spin_lenses_to_json(&lenses);
    ok(spin_lenses_from_json(json, 0.5, &again) == SPIN_OK && again.n == 4, "JSON and back");
    for (int i = 0; i < 4; i++)
        same &= memcmp(lenses.lens[i].falloff, again.lens[i].falloff,
                       sizeof lenses.lens[i].falloff) == 0;
    ok(same, "to the bit");
    ok(spin_lenses_find(&again, &half.camera) == 1, "found again at half the size");
    spin_json_free(json);
    spin_lenses_free(&again);
    spin_lenses_free(&lenses);
    ok(spin_lenses_list(&two, pairs, 3, 0.5, &lenses) == SPIN_OK && lenses.n == 2 &&
           lenses.lens[0].width == 1280 && lenses.lens[0].height == 720,
       "their sizes are those of whole pictures");
    ok(spin_lenses_find(&lenses, &kind[2].camera) == 0, "of two that are near the nearer one");
    spin_lenses_free(&lenses);
    ok(spin_lenses_from_json(NULL, 1, &again) == SPIN_OK && again.n == 0,
       "a bundle without lenses");
    refuses("[{\"width\": 640, \"height\": 360, \"focal\": 1, \"c1\": [0, 0, 0], \"c2\": [0, 0]}]",
            "a value is missing");
    refuses("[{\"width\": 0, \"height\": 360, \"focal\": 1, \"c1\": [0, 0, 0], \"c2\": [0, 0, 0]}]",
            "no width");
    refuses("[{\"width\": 9, \"height\": 9, \"focal\": 0, \"c1\": [0, 0, 0], \"c2\": [0, 0, 0]}]",
            "no focal length");
    refuses("[{\"width\": 9, \"height\": 9, \"focal\": 1, \"c1\": [0, 0, 1e9], \"c2\": [0, 0, 0]}]",
            "a falloff out of all bounds");
}
