/* Comparing arrays with golden values, checking slopes, cutting files short. */
#ifndef SPIN_TESTS_CHECK_H
#define SPIN_TESTS_CHECK_H

#include "device/device.h"
#include "io/json.h"
#include "io/npy.h"

/* $SPIN_FIXTURES/name, else ../shared/fixtures/name, else fixtures/name. Static buffer ring of 8.
 * NULL when it is in none. */
const char *check_fixture(const char *name);

/* An array of an npz as doubles (malloc'd), NULL and a "not ok" line when missing. */
double *check_load(struct spin_npz *npz, const char *key, struct spin_array *info);
float *check_load_f32(struct spin_npz *npz, const char *key, struct spin_array *info);

struct spin_bundle;
/* An array of a bundle, packed or not, as its 4-byte values (malloc'd); NULL and a "not ok" line
 * when it cannot be read. */
void *check_values(struct spin_bundle *bundle, const char *key, size_t *n);

/* One ok/not ok line. Passes when |got - want| <= abs + rel * |want| for every element. Prints the
 * worst index and both values when it fails. NaN fails. */
int check_close(const float *got, const double *want, size_t n, double abs, double rel,
                const char *what);
/* max|got - want| <= tol * max|want|. */
int check_rel_to_absmax(const float *got, const double *want, size_t n, double tol,
                        const char *what);

/* Same bits. */
int check_same_bits(const void *got, const void *want, size_t bytes, const char *what);

/* Numbers out of core/manifest.json beside core/<file>: files.<file>.tolerance.<key>, or
 * `fallback`. */
double check_tolerance(const char *file, const char *key, double fallback);
/* files.<file>.meta of the same manifest, NULL when there is none. */
const spin_json *check_meta(const char *file);

/* A number of a report, by its path: "times.0". NaN: there is none; of an array how many it has. */
double check_report(const char *report, const char *path);
/* A number in it, "a.b" for b in a; a test that lacks one ends here, as a failure. */
double check_setting(const char *file, const char *path);
/* The same, or `fallback`: for what may be missing and can be told from the arrays. */
double check_setting_or(const char *file, const char *path, double fallback);
/* Names of the npz files in core/ that begin so, without ".npz"; ended by NULL, one block to free.
 */
const char **check_files(const char *prefix);
/* The folders in a folder of fixtures that have this file; ended by NULL, one block to free. */
const char **check_cases(const char *folder, const char *file);

/* A device for tests: $SPIN_TEST_DEVICE, else the cpu with n threads; fails the test program when
 * it cannot be had. */
struct spin_device *check_device(int n_threads);
const char *check_device_name(void);
/* How many of check_thread_counts, numbers of threads whose results are to be alike, a test
 * compares: all on the CPU, two of a device without threads, which shows that it gives the same
 * again. */
extern const int check_thread_counts[4];
int check_n_threads(void);
bool check_device_is_cpu(void);
bool check_device_is_emulated(void); /* its errors can be ordered (tests/emu/gpu.cpp) */
/* True for a GPU or for its emulation, whose memory is not that of the host. */
bool check_device_is_card(const struct spin_device *d);
/* Sums that a device may add in any order: the same bits on the CPU, equal to rounding elsewhere.
 */
int check_same_sums(const float *got, const float *want, size_t n, const char *what);
void check_device_free(struct spin_device *d);

/* Write the first n bytes of `path` to a new temporary file and return its name (static ring). */
const char *check_truncated(const char *path, size_t n);
/* Two ok/not ok lines: reading ends well with any of 1000 bits of the file flipped, and no cut of
 * the file can be read. `reads` says whether all of it could be. The file is empty in the end. */
void check_damage(const char *path, bool (*reads)(const char *path));
/* A fresh empty temporary folder, removed with its contents at exit. */
const char *check_folder(void);

#endif
