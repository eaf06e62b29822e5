/* Frames from one thread to another: order, both ends waiting, and errors from the far side.
 * K: threads relay import */
#include <unistd.h>

#include "run/frame_queue.h"
#include "tests/tap.h"

enum { N = 40 };

struct seen {
    int n, wrong;
    int fail_at; /* -1: never */
    int slow;    /* every so many frames, wait */
};

static spin_status take(void *context, int frame, const struct spin_splats *splats)
{
    struct seen *seen = context;

    if (seen->slow && frame % seen->slow == 0)
        usleep(2000);
    if (frame == seen->fail_at)
        return spin_fail(SPIN_E_IO, "cannot write frame %d", frame);
    seen->wrong += frame != seen->n++ || splats->n != (size_t)frame + 1;
    for (size_t i = 0; i < splats->n * 3; i++)
        seen->wrong += splats->means[i] != (float)frame;
    return SPIN_OK;
}

/* Send N frames, the reader slow at times, too; how many were sent before a failure came out. */
static int send_all(struct spin_frame_queue *relay, int slow, spin_status *status)
{
    for (int f = 0; f < N; f++) {
        struct spin_splats *slot;

        *status = spin_frame_queue_slot(relay, &slot);
        if (*status != SPIN_OK)
            return f;
        if (slow && f % slow == 0)
            usleep(1500);
        if (spin_splats_reserve(slot, (size_t)f + 1, SPIN_COL_MEANS, 0) != SPIN_OK)
            exit(1);
        for (size_t i = 0; i < slot->n * 3; i++)
            slot->means[i] = (float)f;
        spin_frame_queue_send(relay, f);
    }
    *status = spin_frame_queue_finish(relay);
    return N;
}

static void test_order(int slow_reader, int slow_writer, const char *what)
{
    struct spin_frame_queue relay;
    struct seen seen = {.fail_at = -1, .slow = slow_writer};
    spin_status status;

    if (!ok(spin_frame_queue_open(&relay, take, &seen) == SPIN_OK, "%s: opens", what))
        return;
    ok(send_all(&relay, slow_reader, &status) == N && status == SPIN_OK, "%s: all are sent", what);
    ok(seen.n == N && seen.wrong == 0, "%s: all arrive, whole and in their order", what);
    spin_frame_queue_close(&relay);
}

static void test_failure(void)
{
    struct spin_frame_queue relay;
    struct seen seen = {.fail_at = 7};
    spin_status status;
    int sent;

    if (spin_frame_queue_open(&relay, take, &seen) != SPIN_OK)
        exit(1);
    sent = send_all(&relay, 0, &status);
    ok(status == SPIN_E_IO && sent >= 8 && sent <= 11, "a failure comes out soon");
    is_text(spin_last_error(), "cannot write frame 7", "in the words of the thread that failed");
    ok(seen.n == 7, "and nothing is written after it");
    spin_frame_queue_close(&relay);

    seen = (struct seen){.fail_at = N - 1};
    if (spin_frame_queue_open(&relay, take, &seen) != SPIN_OK)
        exit(1);
    ok(send_all(&relay, 0, &status) == N && status == SPIN_E_IO,
       "a failure of the last frame, too");
    spin_frame_queue_close(&relay);

    if (spin_frame_queue_open(&relay, take, &seen) != SPIN_OK)
        exit(1);
    spin_frame_queue_close(&relay);
    ok(1, "closing without a frame");
}

TAP_MAIN
{
    test_order(0, 0, "both at once");
    test_order(3, 0, "a slow reader");
    test_order(0, 3, "a slow writer");
    test_failure();
}
