/* Copying rows, and host memory for transfers, on the CPU and on a strict device.
 * K: device ranks rows */
#include "tests/device/strict.h"
#include "tests/device/verbs.h"

enum { N = 700, FROM = 9, TO = 13, WIDTH = 5 };

static void check_rows(struct spin_device *d, const char *name)
{
    static float from[N * FROM], to[N * TO];
    struct loans l = {.d = d};
    float SPIN_DEV *rows;
    float SPIN_DEV *result;
    int wrong = 0;

    for (size_t i = 0; i < N * FROM; i++)
        from[i] = (float)i;
    for (size_t i = 0; i < N * TO; i++)
        to[i] = -1;
    rows = lend(&l, from, sizeof from);
    result = lend_both(&l, to, sizeof to);
    d->op->copy_rows(d, N, WIDTH, rows + 2, FROM, result + 3, TO);
    d->op->copy_rows(d, 0, WIDTH, rows, FROM, result, TO);
    settle(&l);
    for (size_t i = 0; i < N; i++)
        for (size_t c = 0; c < TO; c++) {
            bool inside = c >= 3 && c < 3 + WIDTH;
            float want = inside ? from[i * FROM + 2 + c - 3] : -1;

            wrong += to[i * TO + c] != want;
        }
    ok(wrong == 0, "%s: rows are copied between strides (%d are wrong)", name, wrong);
}

static void check_host_memory(struct spin_device *d, const char *name)
{
    enum { BYTES = 100000 };
    struct spin_host_memory memory = {0};
    struct loans l = {.d = d};
    char *back = calloc(1, BYTES);
    void SPIN_DEV *at = lend(&l, back, BYTES);
    int wrong = 0;

    if (!ok(d->op->host_reserve(d, BYTES, &memory) == SPIN_OK && (uintptr_t)memory.at % 64 == 0,
            "%s: host memory, aligned", name))
        return;
    ok(memory.bytes == BYTES && memory.pinned == !check_device_is_cpu(), "%s: page-locked: %d",
       name, memory.pinned);
    memset(memory.at, 7, BYTES);
    d->op->upload(d, at, memory.at, BYTES);
    ok(d->op->wait(d) == SPIN_OK, "%s: waits for an upload from it", name);
    memset(memory.at, 8, BYTES);
    ok(d->op->download(d, back, at, BYTES) == SPIN_OK, "%s: downloads", name);
    for (size_t i = 0; i < BYTES; i++)
        wrong += back[i] != 7;
    ok(wrong == 0, "%s: what is written there after wait() is not uploaded", name);
    d->op->host_release(d, &memory);
    ok(!memory.at && memory.bytes == 0, "%s: gives it back", name);
    settle(&l);
    free(back);
}

TAP_MAIN
{
    struct spin_device *d = check_device(2), *late = strict_open(check_device(2), 2, 1);
    int complaints = strict_complaints();

    check_rows(d, check_device_name());
    check_rows(late, "strict");
    check_host_memory(d, check_device_name());
    check_host_memory(late, "strict");
    ok(strict_complaints() == complaints, "without a complaint of the strict device");
    setenv("SPIN_EMU_PINNED", "0", 1);
    if (!check_device_is_cpu()) {
        struct spin_host_memory memory = {0};

        ok(d->op->host_reserve(d, 1000, &memory) == SPIN_OK && memory.at &&
               (!check_device_is_emulated() || !memory.pinned),
           "ordinary memory where none can be page-locked");
        d->op->host_release(d, &memory);
    }
    check_device_free(d);
    strict_close(late);
}
