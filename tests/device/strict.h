/* A device that does nothing until it must, around any device whose memory is the host's. Verbs are
 * queued, and run when the host asks for a result; in between, device memory cannot be read or
 * written. So it finds a host that follows a device pointer (the process is killed by SIGSEGV),
 * uses a result that it did not ask for, or hands over a pointer that is not, or no longer, device
 * memory (a complaint). It has no lazy Adam. */
#ifndef SPIN_TESTS_DEVICE_STRICT_H
#define SPIN_TESTS_DEVICE_STRICT_H

#include "device/device.h"

/* Takes inner over. At once: frames and views of one call. */
struct spin_device *strict_open(struct spin_device *inner, int frames_at_once, int views_at_once);
/* Closes and frees both. */
void strict_close(struct spin_device *d);

/* Complaints so far, and the last one. Without a test that expects them, print each as "not ok". */
int strict_complaints(void);
const char *strict_last(void);
void strict_expect(bool complaints);
/* Verbs that wait to be run. */
size_t strict_queued(const struct spin_device *d);

#endif
