/* Two slots, one lock, one condition: the reader waits while both are full, the writer while both are
 * empty. Error trails belong to threads, so the writer's is carried over as text. */
#include "run/frame_queue.h"

#include <stdio.h>
#include <string.h>

static void *work(void *context)
{
    struct spin_frame_queue *r = context;

    pthread_mutex_lock(&r->mutex);
    for (;;) {
        unsigned slot = r->written % 2;
        spin_status status;

        while (r->sent == r->written && !r->closing)
            pthread_cond_wait(&r->changed, &r->mutex);
        if (r->sent == r->written)
            break;
        pthread_mutex_unlock(&r->mutex);
        status = r->write(r->context, r->frame[slot], &r->splats[slot]);
        pthread_mutex_lock(&r->mutex);
        r->written++;
        if (status != SPIN_OK) {
            r->status = status;
            snprintf(r->error, sizeof r->error, "%s", spin_last_error());
            r->closing = true; /* what is still sent is not written */
            r->written = r->sent;
        }
        pthread_cond_broadcast(&r->changed);
        if (status != SPIN_OK)
            break;
    }
    pthread_mutex_unlock(&r->mutex);
    return NULL;
}

spin_status spin_frame_queue_open(struct spin_frame_queue *relay, spin_frame_queue_fn write,
                                  void *context)
{
    memset(relay, 0, sizeof *relay);
    relay->write = write;
    relay->context = context;
    pthread_mutex_init(&relay->mutex, NULL);
    pthread_cond_init(&relay->changed, NULL);
    if (pthread_create(&relay->thread, NULL, work, relay) != 0) {
        pthread_mutex_destroy(&relay->mutex);
        pthread_cond_destroy(&relay->changed);
        return spin_fail(SPIN_E_MEMORY, "cannot start a thread to write with");
    }
    relay->open = true;
    return SPIN_OK;
}

spin_status spin_frame_queue_slot(struct spin_frame_queue *relay, struct spin_splats **out)
{
    spin_status status;

    pthread_mutex_lock(&relay->mutex);
    while (relay->sent - relay->written == 2 && relay->status == SPIN_OK)
        pthread_cond_wait(&relay->changed, &relay->mutex);
    status = relay->status;
    *out = &relay->splats[relay->sent % 2];
    pthread_mutex_unlock(&relay->mutex);
    return status == SPIN_OK ? SPIN_OK : spin_fail(status, "%s", relay->error);
}

void spin_frame_queue_send(struct spin_frame_queue *relay, int frame)
{
    pthread_mutex_lock(&relay->mutex);
    relay->frame[relay->sent % 2] = frame;
    relay->sent++;
    pthread_cond_broadcast(&relay->changed);
    pthread_mutex_unlock(&relay->mutex);
}

/* End the thread once it has written what it has. */
static void join(struct spin_frame_queue *relay)
{
    if (!relay->open)
        return;
    pthread_mutex_lock(&relay->mutex);
    relay->closing = true;
    pthread_cond_broadcast(&relay->changed);
    pthread_mutex_unlock(&relay->mutex);
    pthread_join(relay->thread, NULL);
    pthread_mutex_destroy(&relay->mutex);
    pthread_cond_destroy(&relay->changed);
    relay->open = false;
}

spin_status spin_frame_queue_finish(struct spin_frame_queue *relay)
{
    join(relay);
    return relay->status == SPIN_OK ? SPIN_OK : spin_fail(relay->status, "%s", relay->error);
}

void spin_frame_queue_close(struct spin_frame_queue *relay)
{
    join(relay);
    spin_splats_free(&relay->splats[0]);
    spin_splats_free(&relay->splats[1]);
}
