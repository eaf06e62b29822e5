/* Frames handed from the thread that reads them to one that writes them, so that a clip takes as long as
 * the slower half, not as both. Two frames are in memory at a time, whatever the clip. */
#ifndef SPIN_RUN_FRAME_QUEUE_H
#define SPIN_RUN_FRAME_QUEUE_H

#include <pthread.h>

#include "spin.h"

/* Called in the other thread, in the order in which frames were sent. */
typedef spin_status (*spin_frame_queue_fn)(void *context, int frame,
                                           const struct spin_splats *splats);

struct spin_frame_queue {
    struct spin_splats splats[2];
    int frame[2];
    unsigned sent, written; /* counts; the slot of frame k is k % 2 */
    bool closing;
    spin_status status; /* of the other thread */
    char error[1024];   /* its trail */
    spin_frame_queue_fn write;
    void *context;
    pthread_t thread;
    pthread_mutex_t mutex;
    pthread_cond_t changed;
    bool open;
};

spin_status spin_frame_queue_open(struct spin_frame_queue *relay, spin_frame_queue_fn write,
                                  void *context);
/* Where to put the next frame: waits until there is room. A failure of the writer comes out here. */
spin_status spin_frame_queue_slot(struct spin_frame_queue *relay, struct spin_splats **out);
/* Hand over what is in the slot. */
void spin_frame_queue_send(struct spin_frame_queue *relay, int frame);
/* Wait until all that was sent is written, and say how it went. Nothing can be sent after that. */
spin_status spin_frame_queue_finish(struct spin_frame_queue *relay);
/* Free the queue, also after a failure; a failure of the writer is dropped. Call it once, always. */
void spin_frame_queue_close(struct spin_frame_queue *relay);

#endif
