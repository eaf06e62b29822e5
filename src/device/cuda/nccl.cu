/* All-reduce between the GPUs of ranks with NCCL, compiled if nccl.h is found (NCCL= in the
 * Makefile). libnccl is loaded on first use, since the machine that runs the program may lack it.
 *
 * The rules of NCCL are in https://docs.nvidia.com/deeplearning/nccl/user-guide/docs/api.html, in
 * the parts about group calls and collective communication. The calls of one group run together;
 * all ranks must make matching calls in the same order. */
#include <dlfcn.h>
#include <nccl.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "device/cuda/cuda.h"

static_assert(sizeof(ncclUniqueId) <= sizeof(struct spin_link_name),
              "a name of NCCL has its place");

/* The functions of libnccl that are used. */
#define FUNCTIONS(X)                                                                               \
    X(ncclGetVersion)                                                                              \
    X(ncclGetUniqueId)                                                                             \
    X(ncclCommInitRank)                                                                            \
    X(ncclCommAbort)                                                                               \
    X(ncclCommGetAsyncError)                                                                       \
    X(ncclGetErrorString)                                                                          \
    X(ncclGroupStart)                                                                              \
    X(ncclGroupEnd)                                                                                \
    X(ncclAllReduce)

#define FIELD(name) decltype(&::name) name;
static struct {
    void *object;
    FUNCTIONS(FIELD)
} nccl;

static ncclComm_t comm_of(struct spin_device *d) { return (ncclComm_t)cuda_of(d)->link; }

static spin_status nccl_error(const char *call, ncclResult_t result)
{
    char what[64];

    snprintf(what, sizeof what, "NCCL failed in %s", call);
    return cuda_fail(SPIN_E_DEVICE, what, nccl.ncclGetErrorString(result));
}

/* Calls a function of NCCL. If that fails, the calling function returns its error. */
#define NCCL(name, ...)                                                                            \
    do {                                                                                           \
        ncclResult_t result = nccl.name(__VA_ARGS__);                                              \
                                                                                                   \
        if (result != ncclSuccess)                                                                 \
            return nccl_error(#name, result);                                                      \
    } while (0)

static spin_status load_nccl(void)
{
    const char *wanted = getenv("SPIN_NCCL"), *file = wanted && *wanted ? wanted : "libnccl.so.2";

    if (strcmp(file, "0") == 0)
        return cuda_fail(SPIN_E_UNSUPPORTED, "NCCL is disabled", "SPIN_NCCL is 0");
    if (nccl.object)
        return SPIN_OK;
    nccl.object = dlopen(file, RTLD_NOW | RTLD_LOCAL);
    if (!nccl.object)
        return cuda_fail(SPIN_E_UNSUPPORTED, "cannot load NCCL", dlerror());
#define FIND(name)                                                                                 \
    nccl.name = (decltype(nccl.name))dlsym(nccl.object, #name);                                    \
    if (!nccl.name) {                                                                              \
        dlclose(nccl.object);                                                                      \
        nccl.object = NULL;                                                                        \
        return cuda_fail(SPIN_E_UNSUPPORTED, file, "function not found: " #name);                  \
    }
    FUNCTIONS(FIND)
    return SPIN_OK;
}

spin_status cuda_link_ready(struct spin_device *, char about[32])
{
    int version = 0;

    SPIN_TRY(load_nccl());
    NCCL(ncclGetVersion, &version);
    snprintf(about, 32, "NCCL %d.%d.%d", version / 10000, version / 100 % 100, version % 100);
    return SPIN_OK;
}

spin_status cuda_link_name(struct spin_device *, struct spin_link_name *out)
{
    ncclUniqueId id;

    NCCL(ncclGetUniqueId, &id);
    memcpy(out->text, &id, sizeof id);
    return SPIN_OK;
}

spin_status cuda_link(struct spin_device *d, const struct spin_link_name *name, int rank,
                      int n_ranks)
{
    ncclUniqueId id;
    ncclComm_t comm;

    memcpy(&id, name->text, sizeof id);
    gpu_wait(gpu_of(d)); /* this also makes the GPU the current one of this thread */
    NCCL(ncclCommInitRank, &comm, n_ranks, id, rank);
    cuda_of(d)->link = comm;
    return SPIN_OK;
}

void cuda_unlink(struct spin_device *d)
{
    if (comm_of(d))
        nccl.ncclCommAbort(comm_of(d));
    cuda_of(d)->link = NULL;
}

static spin_status queue_sums(struct spin_device *d, const struct spin_device_sum *sum, size_t n)
{
    cudaStream_t stream = (cudaStream_t)gpu_of(d)->stream;
    ncclResult_t result = ncclSuccess, end;

    NCCL(ncclGroupStart);
    for (size_t i = 0; i < n && result == ncclSuccess; i++)
        result = nccl.ncclAllReduce(sum[i].at, sum[i].at, sum[i].n,
                                    sum[i].counts ? ncclUint32 : ncclFloat32, ncclSum, comm_of(d),
                                    stream);
    end = nccl.ncclGroupEnd();
    if (result != ncclSuccess)
        return nccl_error("ncclAllReduce", result);
    return end == ncclSuccess ? SPIN_OK : nccl_error("ncclGroupEnd", end);
}

static void sleep_briefly(void)
{
    const struct timespec nap = {0, 50000};

    nanosleep(&nap, NULL);
}

/* Waits for the error message of another rank and returns that error. When a rank fails, its link
 * breaks first, and its message arrives a little later. If no message arrives, returns the error of
 * NCCL. */
static spin_status wait_for_error(ncclResult_t result, spin_status (*listen)(void))
{
    enum { NAPS = 40000 }; /* sleeps at least two seconds in total */

    for (int i = 0; i < NAPS; i++) {
        SPIN_TRY(listen());
        sleep_briefly();
    }
    return nccl_error("an all-reduce", result);
}

/* Waits until the all-reduce is done. The function polls instead of waiting in CUDA, which would
 * never return if another rank has failed, since the values of that rank never arrive. */
static spin_status wait_for_others(struct spin_device *d, spin_status (*listen)(void))
{
    enum { EAGER = 2000 };
    ncclResult_t state = ncclSuccess;

    for (int turn = 0; !gpu_done(gpu_of(d)); turn += turn < EAGER) {
        NCCL(ncclCommGetAsyncError, comm_of(d), &state);
        if (state != ncclSuccess)
            return wait_for_error(state, listen);
        if (turn % 100 == 99 || turn == EAGER)
            SPIN_TRY(listen());
        if (turn == EAGER)
            sleep_briefly();
    }
    return d->op->wait(d);
}

spin_status cuda_sum(struct spin_device *d, const struct spin_device_sum *sum, size_t n,
                     spin_status (*listen)(void))
{
    spin_status status;

    SPIN_TRY(d->op->wait(d)); /* returns an earlier error of this GPU first */
    status = queue_sums(d, sum, n);
    if (status == SPIN_OK)
        status = wait_for_others(d, listen);
    if (status != SPIN_OK)
        cuda_unlink(d);
    return status;
}
