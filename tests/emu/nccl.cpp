/* A replacement for libnccl between processes on one machine, connected pairwise by sockets. A
 * thread of its own carries out a group of sums, as a GPU would, and operations queued on the
 * stream later wait for it (gpu.cpp): every rank sends its values to all others, and adds up the
 * values in the order of the ranks.
 *
 * For tests: SPIN_EMU_NCCL_FAIL=NAME makes function NAME fail. */
#include "nccl.h"

#include <atomic>
#include <errno.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <thread>
#include <unistd.h>
#include <vector>

struct message {
    bool receive;
    int peer;
    char *at;
    size_t bytes, done; /* done: including the 8-byte head, which holds the number of bytes that
                         * follow */
    uint64_t head;
};

struct reduction {
    char *at;
    size_t count;
    ncclDataType_t type;
    std::vector<std::vector<char>> of; /* [n] values of each rank */
};

struct ncclComm {
    int rank, n;
    std::vector<int> socket; /* to each rank */
    std::thread worker;
    std::atomic<bool> stop{false};
    std::atomic<ncclResult_t> error{ncclSuccess};
};

static std::vector<reduction> group;
static ncclComm *of_group;
static std::atomic<int> *stream_of_group;
static int depth;

static bool is_to_fail(const char *name)
{
    const char *wanted = getenv("SPIN_EMU_NCCL_FAIL");

    return wanted && strcmp(wanted, name) == 0;
}
#define MAY_FAIL()                                                                                 \
    if (is_to_fail(__func__))                                                                      \
    return ncclSystemError

const char *ncclGetErrorString(ncclResult_t result)
{
    return result == ncclSystemError       ? "unhandled system error"
           : result == ncclInvalidArgument ? "invalid argument"
           : result == ncclInvalidUsage    ? "invalid usage"
                                           : "no error";
}

ncclResult_t ncclGetVersion(int *version)
{
    *version = 20000;
    return ncclSuccess;
}

ncclResult_t ncclGetUniqueId(ncclUniqueId *id)
{
    MAY_FAIL();
    memset(id, 0, sizeof *id);
    snprintf(id->internal, sizeof id->internal, "spin4d-emulated-nccl-%d", (int)getpid());
    return ncclSuccess;
}

/* ---- Sockets ---- */

/* An abstract socket name, which is not a file. */
static sockaddr_un address_of(const ncclUniqueId &id, int rank)
{
    sockaddr_un address = {};

    address.sun_family = AF_UNIX;
    snprintf(address.sun_path + 1, sizeof address.sun_path - 1, "%.80s.%d", id.internal, rank);
    return address;
}

static bool move_all(int s, void *at, size_t bytes, bool receive)
{
    for (size_t done = 0; done < bytes;) {
        ssize_t n = receive ? recv(s, (char *)at + done, bytes - done, 0)
                            : send(s, (char *)at + done, bytes - done, MSG_NOSIGNAL);

        if (n <= 0)
            return false;
        done += (size_t)n;
    }
    return true;
}

/* Each rank connects to the ranks before it. */
ncclResult_t ncclCommInitRank(ncclComm_t *out, int n, ncclUniqueId id, int rank)
{
    auto comm = new ncclComm;
    sockaddr_un own = address_of(id, rank);
    int listener = socket(AF_UNIX, SOCK_STREAM, 0);

    MAY_FAIL();
    comm->rank = rank;
    comm->n = n;
    comm->socket.assign((size_t)n, -1);
    if (bind(listener, (sockaddr *)&own, sizeof own) != 0 || listen(listener, n) != 0)
        return ncclSystemError;
    for (int peer = 0; peer < rank; peer++) {
        sockaddr_un address = address_of(id, peer);
        int s = socket(AF_UNIX, SOCK_STREAM, 0);

        while (connect(s, (sockaddr *)&address, sizeof address) != 0)
            usleep(1000);
        if (!move_all(s, &rank, sizeof rank, false))
            return ncclSystemError;
        comm->socket[(size_t)peer] = s;
    }
    for (int k = rank + 1; k < n; k++) {
        int s = accept(listener, NULL, NULL), peer;

        if (s < 0 || !move_all(s, &peer, sizeof peer, true))
            return ncclSystemError;
        comm->socket[(size_t)peer] = s;
    }
    close(listener);
    *out = comm;
    return ncclSuccess;
}

ncclResult_t ncclCommAbort(ncclComm_t comm)
{
    comm->stop = true;
    if (comm->worker.joinable())
        comm->worker.join();
    for (int s : comm->socket)
        if (s >= 0)
            close(s);
    delete comm;
    return ncclSuccess;
}

ncclResult_t ncclCommGetAsyncError(ncclComm_t comm, ncclResult_t *error)
{
    *error = comm->error;
    return ncclSuccess;
}

/* ---- Messages ---- */

/* Transfers as much of a message as is possible now. Returns false if the sizes differ on the two
 * sides, or the other side is gone. */
static bool go_on(ncclComm *comm, message &m)
{
    const size_t head = sizeof m.head;
    int s = comm->socket[(size_t)m.peer];

    while (m.done < head + m.bytes) {
        bool in_head = m.done < head;
        char *at = in_head ? (char *)&m.head + m.done : m.at + (m.done - head);
        size_t left = in_head ? head - m.done : head + m.bytes - m.done;
        ssize_t n = m.receive ? recv(s, at, left, MSG_DONTWAIT)
                              : send(s, at, left, MSG_DONTWAIT | MSG_NOSIGNAL);

        if (n < 0 && (errno == EAGAIN || errno == EINTR))
            return true;
        if (n <= 0)
            return false;
        m.done += (size_t)n;
        if (m.receive && m.done == head && m.head != m.bytes)
            return false;
    }
    return true;
}

/* Transfers all messages; the sends to a peer stay in order, and so do the receives from it. */
static void exchange(ncclComm *comm, std::vector<message> &messages)
{
    size_t left = 1;

    while (left > 0 && !comm->stop && comm->error == ncclSuccess) {
        std::vector<bool> busy((size_t)comm->n * 2);

        left = 0;
        for (auto &m : messages) {
            auto way = busy.begin() + 2 * m.peer + m.receive;

            if (*way || m.done == sizeof m.head + m.bytes) {
                left += *way;
                continue;
            }
            if (!go_on(comm, m))
                comm->error = ncclSystemError;
            *way = m.done < sizeof m.head + m.bytes;
            left += *way;
        }
        if (left > 0)
            usleep(100);
    }
}

template <typename T> static void add_up(const reduction &r)
{
    for (size_t i = 0; i < r.count; i++) {
        T sum = 0;

        for (auto &of : r.of)
            sum += ((const T *)of.data())[i];
        ((T *)r.at)[i] = sum;
    }
}

static void carry_out(ncclComm *comm, std::vector<reduction> sums, std::atomic<int> *stream)
{
    std::vector<message> messages;

    for (auto &r : sums) {
        size_t bytes = 4 * r.count;

        r.of.assign((size_t)comm->n, std::vector<char>(bytes));
        memcpy(r.of[(size_t)comm->rank].data(), r.at, bytes);
        for (int peer = 0; peer < comm->n; peer++) {
            if (peer == comm->rank)
                continue;
            messages.push_back({false, peer, r.of[(size_t)comm->rank].data(), bytes, 0, bytes});
            messages.push_back({true, peer, r.of[(size_t)peer].data(), bytes, 0, 0});
        }
    }
    exchange(comm, messages);
    for (auto &r : sums)
        if (comm->error == ncclSuccess && !comm->stop)
            r.type == ncclFloat32 ? add_up<float>(r) : add_up<uint32_t>(r);
    while (comm->error != ncclSuccess && !comm->stop) /* the stream hangs, as on a GPU */
        usleep(100);
    --*stream;
}

ncclResult_t ncclGroupStart()
{
    MAY_FAIL();
    depth++;
    return ncclSuccess;
}

ncclResult_t ncclAllReduce(const void *from, void *to, size_t count, ncclDataType_t type,
                           ncclRedOp_t op, ncclComm_t comm, cudaStream_t stream)
{
    MAY_FAIL();
    if (from != to || op != ncclSum || (type != ncclFloat32 && type != ncclUint32))
        return ncclInvalidArgument;
    if (depth == 0)
        return ncclInvalidUsage; /* a sum outside a group would be slow in NCCL, and is refused
                                  * here */
    of_group = comm;
    stream_of_group = (std::atomic<int> *)stream;
    group.push_back({(char *)to, count, type, {}});
    return ncclSuccess;
}

ncclResult_t ncclGroupEnd()
{
    ncclComm *comm = of_group;

    MAY_FAIL();
    if (depth == 0)
        return ncclInvalidUsage;
    if (--depth > 0 || group.empty())
        return ncclSuccess;
    if (comm->worker.joinable())
        comm->worker.join();
    ++*stream_of_group;
    comm->worker = std::thread(carry_out, comm, std::move(group), stream_of_group);
    group.clear();
    return ncclSuccess;
}
