/* A queue of announced views in slots, which the threads fill in the order of announcement. */
#include "scene/read_ahead.h"

#include <pthread.h>
#include <stdlib.h>

#include "base/mem.h"

enum { MOST_THREADS = 8 };

enum state { FREE, ANNOUNCED, DECODING, DECODED };

struct slot {
    enum state state;
    size_t view;
    uint64_t turn; /* position in the order of announcement */
    uint8_t *rgb;  /* the decoded image; NULL if decoding failed */
};

struct spin_read_ahead {
    spin_decode_fn decode;
    void *context;
    pthread_mutex_t mutex; /* protects everything below */
    pthread_cond_t announced, decoded;
    bool stop;
    int n_threads;
    pthread_t thread[MOST_THREADS];
    uint64_t turns;
    size_t capacity;
    struct slot slot[]; /* [capacity] */
};

/* Returns the slot in this state whose view was announced first; NULL if no slot is in this
 * state. */
static struct slot *find_oldest(struct spin_read_ahead *a, enum state state)
{
    struct slot *oldest = NULL;

    for (size_t i = 0; i < a->capacity; i++) {
        struct slot *s = &a->slot[i];

        if (s->state == state && (!oldest || s->turn < oldest->turn))
            oldest = s;
    }
    return oldest;
}

static struct slot *find_view(struct spin_read_ahead *a, size_t view)
{
    for (size_t i = 0; i < a->capacity; i++)
        if (a->slot[i].state != FREE && a->slot[i].view == view)
            return &a->slot[i];
    return NULL;
}

static void *decode_views(void *context)
{
    struct spin_read_ahead *a = context;

    pthread_mutex_lock(&a->mutex);
    while (!a->stop) {
        struct slot *s = find_oldest(a, ANNOUNCED);
        uint8_t *rgb = NULL;

        if (!s) {
            pthread_cond_wait(&a->announced, &a->mutex);
            continue;
        }
        s->state = DECODING;
        pthread_mutex_unlock(&a->mutex);
        /* An error is ignored here: the caller decodes the image again and reports the error. */
        (void)a->decode(a->context, s->view, &rgb);
        pthread_mutex_lock(&a->mutex);
        s->rgb = rgb;
        s->state = DECODED;
        pthread_cond_broadcast(&a->decoded);
    }
    pthread_mutex_unlock(&a->mutex);
    return NULL;
}

spin_status spin_read_ahead_start(int n_threads, size_t capacity, spin_decode_fn decode,
                                  void *context, struct spin_read_ahead **out)
{
    struct spin_read_ahead *a = NULL;

    *out = NULL;
    SPIN_TRY(spin_alloc(1, sizeof *a + capacity * sizeof *a->slot, (void **)&a));
    a->decode = decode;
    a->context = context;
    a->capacity = capacity;
    pthread_mutex_init(&a->mutex, NULL);
    pthread_cond_init(&a->announced, NULL);
    pthread_cond_init(&a->decoded, NULL);
    while (a->n_threads < n_threads && a->n_threads < MOST_THREADS &&
           pthread_create(&a->thread[a->n_threads], NULL, decode_views, a) == 0)
        a->n_threads++;
    if (a->n_threads == 0) {
        spin_read_ahead_free(a);
        return spin_fail(SPIN_E_MEMORY, "cannot start a thread that reads images");
    }
    *out = a;
    return SPIN_OK;
}

void spin_read_ahead_free(struct spin_read_ahead *a)
{
    if (!a)
        return;
    pthread_mutex_lock(&a->mutex);
    a->stop = true;
    pthread_cond_broadcast(&a->announced);
    pthread_mutex_unlock(&a->mutex);
    for (int i = 0; i < a->n_threads; i++)
        pthread_join(a->thread[i], NULL);
    for (size_t i = 0; i < a->capacity; i++)
        free(a->slot[i].rgb);
    pthread_cond_destroy(&a->decoded);
    pthread_cond_destroy(&a->announced);
    pthread_mutex_destroy(&a->mutex);
    free(a);
}

size_t spin_read_ahead_capacity(const struct spin_read_ahead *a) { return a->capacity; }

static void clear_slot(struct slot *s)
{
    free(s->rgb);
    *s = (struct slot){0};
}

void spin_read_ahead_announce(struct spin_read_ahead *a, size_t view)
{
    pthread_mutex_lock(&a->mutex);
    if (!find_view(a, view)) {
        struct slot *s = find_oldest(a, FREE);

        s = s ? s : find_oldest(a, DECODED);
        if (s) {
            clear_slot(s);
            *s = (struct slot){.state = ANNOUNCED, .view = view, .turn = a->turns++};
            pthread_cond_signal(&a->announced);
        }
    }
    pthread_mutex_unlock(&a->mutex);
}

uint8_t *spin_read_ahead_take(struct spin_read_ahead *a, size_t view)
{
    struct slot *s;
    uint8_t *rgb = NULL;

    pthread_mutex_lock(&a->mutex);
    s = find_view(a, view);
    while (s && s->state == DECODING)
        pthread_cond_wait(&a->decoded, &a->mutex);
    if (s) {
        rgb = s->rgb;
        s->rgb = NULL;
        clear_slot(s);
    }
    pthread_mutex_unlock(&a->mutex);
    return rgb;
}
