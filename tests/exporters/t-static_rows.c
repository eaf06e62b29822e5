/* A clip in one GLB: rows that all frames share are stored once.
 * K: gltf glb export still */
#include "base/log.h"
#include "formats/glb.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_gltf;

enum { SHARED = 6000, ALIKE = 3, FRAMES = 4 };

static void copy_row(struct spin_splats *to, size_t i, const struct spin_splats *from, size_t j)
{
    memcpy(to->means + 3 * i, from->means + 3 * j, 3 * sizeof(float));
    memcpy(to->quats + 4 * i, from->quats + 4 * j, 4 * sizeof(float));
    memcpy(to->log_scales + 3 * i, from->log_scales + 3 * j, 3 * sizeof(float));
    to->logit_opacities[i] = from->logit_opacities[j];
    memcpy(to->sh + 12 * i, from->sh + 12 * j, 12 * sizeof(float));
}

/* Rows 0.. are `shared`, from another place on in each frame, the first of them ALIKE times; frame
 * 2 has one of the copies more. The next differs in its last SH coefficient from frame to frame;
 * the others are the frame's own. at[k]: where shared row k is. */
static void make_shared(int f, const struct spin_splats *shared, struct spin_splats *s, size_t *at)
{
    size_t n_own = 5 + (size_t)f, n = SHARED + 1 + n_own;

    make_frame(s, n, 1, 900 + (uint32_t)f);
    for (size_t k = 0; k <= SHARED; k++) {
        size_t i = (k + 1000 * (size_t)f) % n;

        copy_row(s, i, shared, k);
        if (k < SHARED)
            at[k] = i;
        else
            s->sh[12 * i + 11] = (float)f;
    }
    if (f == 2)
        copy_row(s, (SHARED + 1 + 2000) % n, shared, 0);
}

struct clip {
    struct spin_splats shared, now;
    size_t at[SHARED];
    bool lies; /* the last frame is another one when it is asked for first */
};

static spin_status give(void *context, int f, const struct spin_splats **out)
{
    struct clip *c = context;

    make_shared(f, &c->shared, &c->now, c->at);
    if (c->lies && f == FRAMES - 1)
        copy_row(&c->now, c->at[7], &c->shared, 8);
    *out = &c->now;
    return SPIN_OK;
}

static spin_status export_shared(const struct spin_export_job *job, struct clip *c)
{
    const struct spin_splats *s;
    void *self = NULL;

    SPIN_TRY(spin_exporter_gltf.begin(job, &self));
    for (int f = 0; f < FRAMES; f++) {
        struct spin_frame_info info = {.number = f, .time = f};
        spin_status status;

        give(c, f, &s);
        if (c->lies && f == FRAMES - 1)
            c->now.logit_opacities[c->at[9]] = 0.25f;
        status = spin_exporter_gltf.frame(self, f, &info, s);
        if (status != SPIN_OK) {
            spin_exporter_gltf.abort(self);
            return status;
        }
    }
    return spin_exporter_gltf.end(self);
}

static int rows_are_same(const struct spin_splats *a, size_t i, const struct spin_splats *b,
                         size_t j)
{
    return memcmp(a->means + 3 * i, b->means + 3 * j, 12) == 0 &&
           memcmp(a->sh + 12 * i, b->sh + 12 * j, 48) == 0 &&
           fabsf(a->log_scales[3 * i] - b->log_scales[3 * j]) < 1e-5f &&
           fabsf(a->logit_opacities[i] - b->logit_opacities[j]) < 1e-4f;
}

/* The frame's own rows in their order, then the shared rows in the order of the first frame. */
static int frame_is_right(const struct spin_splats *back, const struct clip *c, int f)
{
    const struct spin_splats *s = &c->now;
    static unsigned char shared[SHARED + 100];
    size_t n = 0;
    int good = back->n == s->n && back->sh_degree == 1;

    memset(shared, 0, sizeof shared);
    for (size_t k = 0; k < SHARED; k++)
        shared[c->at[k]] = 1;
    /* Among equal copies any one may be shared. */
    for (size_t i = 0; good && i < s->n; i++)
        if (!shared[i] && !(f == 2 && rows_are_same(s, i, &c->shared, 0)))
            good &= rows_are_same(back, n++, s, i);
    n += f == 2;
    for (size_t k = 0; good && k < SHARED; k++)
        good &= rows_are_same(back, n++, &c->shared, k);
    return good && n == s->n;
}

static const spin_json *node_of(const struct spin_gs_glb_scene *scene, size_t i)
{
    return spin_json_at(spin_json_get(scene->file.json, "nodes"), i);
}

static void check_nodes(const struct spin_gs_glb_scene *scene)
{
    const spin_json *a = spin_json_at(spin_json_get(scene->file.json, "animations"), 0);
    const spin_json *list = spin_json_get(scene->file.json, "scenes");
    int64_t first = -1;
    int good = scene->n_pieces == FRAMES + 1 && scene->piece[FRAMES].points.n == SHARED;

    for (size_t f = 0; good && f < FRAMES; f++)
        good &= scene->piece[f].points.n == 6 + f && scene->frame[f].n_shown == 2;
    ok(good, "what is the same in all frames lies in a node of its own, once");
    spin_json_integer(spin_json_at(spin_json_get(spin_json_at(list, 0), "nodes"), 0), &first);
    ok(first == FRAMES && spin_json_length(spin_json_get(a, "channels")) == FRAMES &&
           !spin_json_get(node_of(scene, FRAMES), "scale") &&
           !spin_json_get(node_of(scene, FRAMES), "extensions"),
       "that nothing switches, first in the scene");
}

static void check_file(const char *path, struct clip *c)
{
    struct spin_gs_glb_scene scene = {0};
    struct spin_splats back = {0};
    struct spin_map map = {0};
    const struct spin_splats *s;
    int good = 1;

    if (!ok(spin_map_open(path, &map) == SPIN_OK &&
                spin_gs_glb_scene_open(map.data, map.size, &scene) == SPIN_OK &&
                scene.n_frames == FRAMES,
            "the reader of scenes finds the frames"))
        return;
    check_nodes(&scene);
    for (int f = 0; f < FRAMES; f++) {
        give(c, f, &s);
        good &= spin_gs_glb_scene_read(&scene, (size_t)f, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                                       &back) == SPIN_OK;
        good &= scene.frame[f].number == f && frame_is_right(&back, c, f);
    }
    ok(good, "it reads the same frames: what moves, then what is shared, each copy as often");
    spin_gs_glb_scene_close(&scene);
    spin_splats_free(&back);
    spin_map_close(&map);
}

static void test_shared(const char *switched)
{
    const char *pairs[] = {"axes", "source", "still-apart", "1", switched, "1", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_report report = {0};
    struct clip c = {0};
    char name[32];
    snprintf(name, sizeof name, "shared-%s.glb", switched ? switched : "plain");
    struct spin_export_job job = {.output = in_folder(name),
                                  .n_frames = FRAMES,
                                  .sh_degree = 1,
                                  .values = &values,
                                  .again = give,
                                  .report = &report,
                                  .context = &c};

    make_frame(&c.shared, SHARED + 1, 1, 77);
    for (size_t k = 1; k < ALIKE; k++)
        copy_row(&c.shared, k, &c.shared, 0);
    ok(export_shared(&job, &c) == SPIN_OK, "writes a clip (%s)", switched ? switched : "by itself");
    check_file(job.output, &c);
    spin_splats_free(&c.shared);
    spin_splats_free(&c.now);
}

static void test_shared_edges(void)
{
    static const char *const pairs[] = {"still-apart", "1", NULL};
    struct spin_plugin_values values = {pairs};
    struct clip c = {0};
    struct spin_export_job job = {.output = in_folder("lies.glb"),
                                  .n_frames = FRAMES,
                                  .sh_degree = 1,
                                  .values = &values,
                                  .again = give,
                                  .context = &c};
    struct spin_gs_glb_scene scene = {0};
    struct spin_map map = {0};
    void *self = NULL;

    make_frame(&c.shared, SHARED + 1, 1, 78);
    c.lies = true;
    ok(export_shared(&job, &c) == SPIN_E_IO && strstr(spin_last_error(), "frame 3") &&
           !spin_path_exists(job.output),
       "a frame that is another one the second time: refused, and nothing is written");
    c.lies = false;
    job.values = NULL;
    job.output = in_folder("whole.glb");
    ok(export_shared(&job, &c) == SPIN_OK && spin_map_open(job.output, &map) == SPIN_OK &&
           spin_gs_glb_scene_open(map.data, map.size, &scene) == SPIN_OK &&
           scene.n_pieces == FRAMES && scene.piece[0].points.n == SHARED + 6,
       "without --still-apart each frame has all");
    spin_gs_glb_scene_close(&scene);
    spin_map_close(&map);
    job.values = &values;
    job.output = in_folder("whole");
    ok(spin_exporter_gltf.begin(&job, &self) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "still-apart"),
       "refuses --still-apart for a file per frame");
    spin_splats_free(&c.shared);
    spin_splats_free(&c.now);
}

int main(void)
{
    spin_log_set_level(-2);
    test_shared(NULL);
    test_shared("visibility");
    test_shared_edges();
    return tap_done();
}
