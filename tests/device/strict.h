/* A device that defers all work as long as allowed, around another device. Verbs are queued and run
 * when the host requests a result; until then device memory can be neither read nor written. It
 * detects a host that dereferences a device pointer (the process is killed by SIGSEGV), that uses a
 * result it did not request, or that passes a pointer which is not, or no longer, device memory (a
 * complaint). It does not support lazy Adam. */
#ifndef SPIN_TESTS_DEVICE_STRICT_H
#define SPIN_TESTS_DEVICE_STRICT_H

#include "device/device.h"

/* Takes ownership of inner. frames_at_once, views_at_once: preferred batch size. */
struct spin_device *strict_open(struct spin_device *inner, int frames_at_once, int views_at_once);
/* Closes and frees both. */
void strict_close(struct spin_device *d);

/* Number of complaints so far, and the last one. Each is printed as "not ok" unless the test
 * expects complaints. */
int strict_complaints(void);
const char *strict_last(void);
void strict_expect(bool complaints);
/* Number of queued verbs. */
size_t strict_queued(const struct spin_device *d);

#endif
