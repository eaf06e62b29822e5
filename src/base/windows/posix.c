/* POSIX functions, implemented with functions of Windows; posix.h documents them. */
#include <windows.h>

#include <psapi.h>

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>

enum { PATH_ROOM = 4096 };

/* Set errno according to the last Windows error, and return -1. */
static int fail(void)
{
    switch (GetLastError()) {
    case ERROR_FILE_NOT_FOUND:
    case ERROR_PATH_NOT_FOUND:
    case ERROR_INVALID_NAME:
    case ERROR_BAD_NETPATH:
    case ERROR_NOT_READY:
        errno = ENOENT;
        break;
    case ERROR_ACCESS_DENIED:
    case ERROR_SHARING_VIOLATION:
    case ERROR_USER_MAPPED_FILE:
    case ERROR_WRITE_PROTECT:
        errno = EACCES;
        break;
    case ERROR_ALREADY_EXISTS:
    case ERROR_FILE_EXISTS:
        errno = EEXIST;
        break;
    case ERROR_NOT_ENOUGH_MEMORY:
    case ERROR_OUTOFMEMORY:
    case ERROR_COMMITMENT_LIMIT:
        errno = ENOMEM;
        break;
    case ERROR_HANDLE_DISK_FULL:
    case ERROR_DISK_FULL:
        errno = ENOSPC;
        break;
    case ERROR_DIR_NOT_EMPTY:
        errno = ENOTEMPTY;
        break;
    case ERROR_DIRECTORY:
        errno = ENOTDIR;
        break;
    case ERROR_LOCK_VIOLATION:
        errno = EWOULDBLOCK;
        break;
    case ERROR_INVALID_PARAMETER:
        errno = EINVAL;
        break;
    default:
        errno = EIO;
    }
    return -1;
}

/* ---- Names ---------------------------------------------------------------------------------- */

/* A UTF-16 path. A path that is too long or not UTF-8 becomes "", the name of no file. */
struct wide {
    wchar_t text[PATH_ROOM];
};

static const wchar_t *to_utf16(const char *path, struct wide *out)
{
    if (!MultiByteToWideChar(CP_UTF8, MB_ERR_INVALID_CHARS, path, -1, out->text, PATH_ROOM))
        out->text[0] = L'\0';
    return out->text;
}

/* Convert a path to UTF-8 with slashes. Returns the number of bytes without the NUL, or 0 if the
 * capacity n is too small. */
static size_t to_utf8(const wchar_t *text, char *out, size_t n)
{
    int bytes = WideCharToMultiByte(CP_UTF8, 0, text, -1, out, (int)n, NULL, NULL);

    for (char *at = out; bytes > 0 && (at = strchr(at, '\\'));)
        *at = '/';
    return bytes > 0 ? (size_t)bytes - 1 : 0;
}

char *posix_realpath(const char *path, char *none)
{
    struct wide wide, found;
    HANDLE file = CreateFileW(to_utf16(path, &wide), 0,
                              FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE, NULL,
                              OPEN_EXISTING, FILE_FLAG_BACKUP_SEMANTICS, NULL);
    DWORD n;
    wchar_t *from = found.text;
    char *out;

    (void)none;
    if (file == INVALID_HANDLE_VALUE)
        return (void)fail(), NULL;
    n = GetFinalPathNameByHandleW(file, found.text, PATH_ROOM, FILE_NAME_NORMALIZED);
    CloseHandle(file);
    if (n == 0 || n >= PATH_ROOM)
        return (void)fail(), NULL;
    if (wcsncmp(from, L"\\\\?\\UNC\\", 8) == 0) {
        from += 6;
        from[0] = L'\\';
    } else if (wcsncmp(from, L"\\\\?\\", 4) == 0)
        from += 4;
    out = malloc(3 * PATH_ROOM);
    if (out)
        to_utf8(from, out, 3 * PATH_ROOM);
    return out;
}

ssize_t posix_readlink(const char *path, char *out, size_t n)
{
    struct wide wide;
    DWORD got = GetModuleFileNameW(NULL, wide.text, PATH_ROOM);

    (void)path;
    return got > 0 && got < PATH_ROOM ? (ssize_t)to_utf8(wide.text, out, n) : -1;
}

/* ---- File attributes ------------------------------------------------------------------------ */

static int stat_handle(HANDLE file, struct posix_stat *out)
{
    const uint64_t from_1601_to_1970 = 116444736000000000;
    BY_HANDLE_FILE_INFORMATION info;
    uint64_t time;

    memset(out, 0, sizeof *out);
    switch (GetFileType(file)) {
    case FILE_TYPE_CHAR:
        out->st_mode = S_IFCHR | 0644;
        return 0;
    case FILE_TYPE_PIPE:
        out->st_mode = S_IFIFO | 0644;
        return 0;
    }
    if (!GetFileInformationByHandle(file, &info))
        return fail();
    time =
        ((uint64_t)info.ftLastWriteTime.dwHighDateTime << 32 | info.ftLastWriteTime.dwLowDateTime) -
        from_1601_to_1970;
    out->st_mtim.tv_sec = (time_t)(time / 10000000);
    out->st_mtim.tv_nsec = (long)(time % 10000000 * 100);
    out->st_dev = info.dwVolumeSerialNumber;
    out->st_ino = (uint64_t)info.nFileIndexHigh << 32 | info.nFileIndexLow;
    out->st_size = (uint64_t)info.nFileSizeHigh << 32 | info.nFileSizeLow;
    out->st_nlink = info.nNumberOfLinks;
    out->st_mode = info.dwFileAttributes & FILE_ATTRIBUTE_DIRECTORY  ? S_IFDIR | 0755
                   : info.dwFileAttributes & FILE_ATTRIBUTE_READONLY ? S_IFREG | 0444
                                                                     : S_IFREG | 0644;
    return 0;
}

static int stat_path(const char *path, DWORD flags, struct posix_stat *out)
{
    struct wide wide;
    HANDLE file = CreateFileW(to_utf16(path, &wide), FILE_READ_ATTRIBUTES,
                              FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE, NULL,
                              OPEN_EXISTING, FILE_FLAG_BACKUP_SEMANTICS | flags, NULL);
    int error;

    if (file == INVALID_HANDLE_VALUE)
        return fail();
    error = stat_handle(file, out);
    CloseHandle(file);
    return error;
}

int posix_stat(const char *path, struct posix_stat *out) { return stat_path(path, 0, out); }

int posix_lstat(const char *path, struct posix_stat *out)
{
    return stat_path(path, FILE_FLAG_OPEN_REPARSE_POINT, out);
}

int posix_fstat(int fd, struct posix_stat *out)
{
    return stat_handle((HANDLE)_get_osfhandle(fd), out);
}

int posix_access(const char *path, int mode)
{
    struct wide wide;
    DWORD attributes = GetFileAttributesW(to_utf16(path, &wide));

    if (attributes == INVALID_FILE_ATTRIBUTES)
        return fail();
    if (!(mode & W_OK) || !(attributes & FILE_ATTRIBUTE_READONLY) ||
        attributes & FILE_ATTRIBUTE_DIRECTORY)
        return 0;
    errno = EACCES;
    return -1;
}

int statvfs(const char *folder, struct statvfs *out)
{
    struct wide wide;
    ULARGE_INTEGER available;

    if (!GetDiskFreeSpaceExW(to_utf16(folder, &wide), &available, NULL, NULL))
        return fail();
    *out = (struct statvfs){available.QuadPart, 1};
    return 0;
}

/* ---- Open, read, write ---------------------------------------------------------------------- */

/* Open a file. Folders can be opened too, so that fstat() can identify them as folders. */
int posix_open(const char *path, int flags, ...)
{
    struct wide wide;
    DWORD rights = flags & O_RDWR     ? GENERIC_READ | GENERIC_WRITE
                   : flags & O_WRONLY ? GENERIC_WRITE
                                      : GENERIC_READ;
    DWORD how = !(flags & O_CREAT) ? OPEN_EXISTING : flags & O_EXCL ? CREATE_NEW : OPEN_ALWAYS;
    HANDLE file = CreateFileW(to_utf16(path, &wide), rights,
                              FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE, NULL, how,
                              FILE_ATTRIBUTE_NORMAL | FILE_FLAG_BACKUP_SEMANTICS, NULL);
    int fd;

    if (file == INVALID_HANDLE_VALUE)
        return fail();
    fd = _open_osfhandle((intptr_t)file, _O_BINARY | _O_NOINHERIT);
    if (fd < 0)
        CloseHandle(file);
    return fd;
}

/* Open a stream. The letter 'e' in `mode` (close on exec) is ignored: a child process inherits the
 * file, which is harmless. */
FILE *posix_fopen(const char *path, const char *mode)
{
    const wchar_t how[4] = {(wchar_t)mode[0], L'b', strchr(mode, '+') ? L'+' : L'\0'};
    struct wide wide;

    return _wfopen(to_utf16(path, &wide), how);
}

/* Write at an offset. This uses a second handle, since Windows would change the file position of
 * fd. */
ssize_t posix_pwrite(int fd, const void *data, size_t n, int64_t at)
{
    OVERLAPPED place = {.Offset = (DWORD)at, .OffsetHigh = (DWORD)(at >> 32)};
    HANDLE file = ReOpenFile((HANDLE)_get_osfhandle(fd), GENERIC_WRITE,
                             FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE, 0);
    DWORD written = 0;
    bool done;

    if (file == INVALID_HANDLE_VALUE)
        return fail();
    done = WriteFile(file, data, n < 1u << 30 ? (DWORD)n : 1u << 30, &written, &place);
    if (!done)
        fail();
    CloseHandle(file);
    return done ? (ssize_t)written : -1;
}

/* Lock a file. The lock covers a byte far beyond the end of the file, because Windows prevents
 * other processes from reading locked bytes. */
int posix_flock(int fd, int how)
{
    OVERLAPPED place = {.OffsetHigh = 0x7fffffff};

    (void)how;
    return LockFileEx((HANDLE)_get_osfhandle(fd),
                      LOCKFILE_EXCLUSIVE_LOCK | LOCKFILE_FAIL_IMMEDIATELY, 0, 1, 0, &place)
               ? 0
               : fail();
}

/* ---- Files in memory: temporary files, read when they are closed ---------------------------- */

static struct memory {
    struct memory *next;
    FILE *file;
    char **text, *fixed; /* where fclose() stores the text: exactly one of these two is set */
    size_t *n, room;
} * memories;
static pthread_mutex_t memory_mutex = PTHREAD_MUTEX_INITIALIZER;

static FILE *open_temporary(void)
{
    wchar_t folder[PATH_ROOM], path[MAX_PATH];
    HANDLE file;
    int fd;

    if (!GetTempPathW(PATH_ROOM, folder) || !GetTempFileNameW(folder, L"spn", 0, path))
        return (void)fail(), NULL;
    file = CreateFileW(path, GENERIC_READ | GENERIC_WRITE, FILE_SHARE_DELETE, NULL, CREATE_ALWAYS,
                       FILE_ATTRIBUTE_TEMPORARY | FILE_FLAG_DELETE_ON_CLOSE, NULL);
    if (file == INVALID_HANDLE_VALUE)
        return (void)fail(), NULL;
    fd = _open_osfhandle((intptr_t)file, _O_BINARY | _O_NOINHERIT);
    return fd < 0 ? NULL : fdopen(fd, "w+b");
}

static FILE *open_memory(struct memory kind)
{
    struct memory *memory = malloc(sizeof *memory);

    kind.file = memory ? open_temporary() : NULL;
    if (!kind.file) {
        free(memory);
        return NULL;
    }
    *memory = kind;
    pthread_mutex_lock(&memory_mutex);
    memory->next = memories;
    memories = memory;
    pthread_mutex_unlock(&memory_mutex);
    return kind.file;
}

FILE *posix_open_memstream(char **text, size_t *n)
{
    *text = NULL;
    *n = 0;
    return open_memory((struct memory){.text = text, .n = n});
}

FILE *posix_fmemopen(void *text, size_t n, const char *mode)
{
    (void)mode;
    return open_memory((struct memory){.fixed = text, .room = n});
}

static int read_back(const struct memory *memory)
{
    int64_t end = ferror(memory->file) || fflush(memory->file) != 0 ? -1 : _ftelli64(memory->file);
    size_t n = end > 0 ? (size_t)end : 0;
    char *text = memory->fixed ? memory->fixed : malloc(n + 1);

    if (memory->fixed && n >= memory->room)
        n = memory->room - 1;
    if (end < 0 || !text || _fseeki64(memory->file, 0, SEEK_SET) != 0 ||
        fread(text, 1, n, memory->file) != n) {
        if (!memory->fixed)
            free(text);
        return EOF;
    }
    text[n] = '\0';
    if (memory->fixed)
        return 0;
    *memory->text = text;
    *memory->n = n;
    return 0;
}

#undef fclose
int posix_fclose(FILE *file)
{
    struct memory *memory = NULL;
    int error = 0;

    pthread_mutex_lock(&memory_mutex);
    for (struct memory **at = &memories; *at; at = &(*at)->next)
        if ((*at)->file == file) {
            memory = *at;
            *at = memory->next;
            break;
        }
    pthread_mutex_unlock(&memory_mutex);
    if (memory)
        error = read_back(memory);
    free(memory);
    return fclose(file) != 0 ? EOF : error;
}

/* ---- File names ----------------------------------------------------------------------------- */

int posix_unlink(const char *path)
{
    struct wide wide;

    return DeleteFileW(to_utf16(path, &wide)) ? 0 : fail();
}

int posix_rmdir(const char *path)
{
    struct wide wide;

    return RemoveDirectoryW(to_utf16(path, &wide)) ? 0 : fail();
}

int posix_mkdir(const char *path, int mode)
{
    struct wide wide;

    (void)mode;
    return CreateDirectoryW(to_utf16(path, &wide), NULL) ? 0 : fail();
}

/* The old versions of files that were replaced while mapped, to be removed at exit. */
static struct old {
    struct old *next;
    struct wide path;
} * old_files;

static void remove_old_files(void)
{
    for (; old_files; old_files = old_files->next)
        (void)DeleteFileW(old_files->path.text);
}

/* Windows cannot replace a mapped file, but can rename it. Therefore rename the old file, and give
 * its former name to the new file. The old file is named like a temporary file of process getpid()
 * + 1, which does not exist: if the old file cannot be removed at exit, spin_out_sweep() removes it
 * later. */
static bool replace_mapped(const wchar_t *from, const wchar_t *to)
{
    static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
    struct old *old = malloc(sizeof *old);

    if (!old || snwprintf(old->path.text, PATH_ROOM, L"%ls.tmp.%ld", to, (long)getpid() + 1) < 0 ||
        !MoveFileExW(to, old->path.text, MOVEFILE_REPLACE_EXISTING)) {
        free(old);
        return false;
    }
    if (!MoveFileExW(from, to, 0)) {
        (void)MoveFileExW(old->path.text, to, 0);
        free(old);
        return false;
    }
    pthread_mutex_lock(&mutex);
    if (!old_files)
        atexit(remove_old_files);
    old->next = old_files;
    old_files = old;
    pthread_mutex_unlock(&mutex);
    return true;
}

int posix_rename(const char *from, const char *to)
{
    struct wide a, b;

    if (MoveFileExW(to_utf16(from, &a), to_utf16(to, &b), MOVEFILE_REPLACE_EXISTING))
        return 0;
    fail();
    return errno == EACCES && replace_mapped(a.text, b.text) ? 0 : -1;
}

int posix_link(const char *from, const char *to)
{
    struct wide a, b;

    return CreateHardLinkW(to_utf16(to, &b), to_utf16(from, &a), NULL) ? 0 : fail();
}

struct posix_dir {
    HANDLE find;
    WIN32_FIND_DATAW next;
    bool ends; /* no entry follows `next` */
    struct dirent entry;
};

DIR *posix_opendir(const char *path)
{
    struct wide wide;
    DIR *dir = malloc(sizeof *dir);
    size_t n = wcslen(to_utf16(path, &wide));

    if (!dir)
        return NULL;
    if (n == 0 || n + 3 > PATH_ROOM)
        SetLastError(ERROR_INVALID_NAME);
    else
        wcscpy(wide.text + n, L"/*");
    dir->ends = false;
    dir->find =
        n == 0 || n + 3 > PATH_ROOM ? INVALID_HANDLE_VALUE : FindFirstFileW(wide.text, &dir->next);
    if (dir->find != INVALID_HANDLE_VALUE)
        return dir;
    free(dir);
    return (void)fail(), NULL;
}

struct dirent *posix_readdir(DIR *dir)
{
    if (dir->ends)
        return NULL;
    to_utf8(dir->next.cFileName, dir->entry.d_name, sizeof dir->entry.d_name);
    dir->ends = !FindNextFileW(dir->find, &dir->next);
    return &dir->entry;
}

int posix_closedir(DIR *dir)
{
    FindClose(dir->find);
    free(dir);
    return 0;
}

/* ---- Memory and processors ------------------------------------------------------------------ */

void *mmap(void *none, size_t n, int protection, int flags, int fd, int64_t zero)
{
    HANDLE map;
    void *at;

    (void)none, (void)protection, (void)zero;
    if (flags & MAP_ANONYMOUS) {
        at = VirtualAlloc(NULL, n, MEM_RESERVE | MEM_COMMIT, PAGE_READWRITE);
    } else {
        map = CreateFileMappingW((HANDLE)_get_osfhandle(fd), NULL, PAGE_READONLY, 0, 0, NULL);
        at = map ? MapViewOfFile(map, FILE_MAP_READ, 0, 0, n) : NULL;
        if (map)
            CloseHandle(map);
    }
    if (at)
        return at;
    fail();
    return MAP_FAILED;
}

/* Decommit the pages, and release the address range once all its pages are decommitted. A mapped
 * file is unmapped as a whole. */
int munmap(void *at, size_t n)
{
    MEMORY_BASIC_INFORMATION info, part;
    char *page;

    if (!VirtualQuery(at, &info, sizeof info))
        return fail();
    if (info.Type == MEM_MAPPED)
        return UnmapViewOfFile(at) ? 0 : fail();
    if (!VirtualFree(at, n, MEM_DECOMMIT))
        return fail();
    for (page = info.AllocationBase;
         VirtualQuery(page, &part, sizeof part) && part.AllocationBase == info.AllocationBase;
         page += part.RegionSize)
        if (part.State == MEM_COMMIT)
            return 0;
    return VirtualFree(info.AllocationBase, 0, MEM_RELEASE) ? 0 : fail();
}

/* MADV_DONTNEED removes pages from the working set, by VirtualUnlock() on pages that are not
 * locked. The pages are read again on access. */
int madvise(void *at, size_t n, int advice)
{
    if (advice == MADV_DONTNEED)
        (void)VirtualUnlock(at, n);
    return 0;
}

long long sysconf(int name)
{
    MEMORYSTATUSEX memory = {.dwLength = sizeof memory};
    SYSTEM_INFO system;

    GetSystemInfo(&system);
    if (name == _SC_NPROCESSORS_ONLN)
        return system.dwNumberOfProcessors;
    if (name == _SC_PAGESIZE)
        return system.dwPageSize;
    if (!GlobalMemoryStatusEx(&memory))
        return -1;
    return (long long)((memory.ullAvailPhys < memory.ullAvailPageFile ? memory.ullAvailPhys
                                                                      : memory.ullAvailPageFile) /
                       system.dwPageSize);
}

int sched_getaffinity(int self, size_t n, cpu_set_t *out)
{
    DWORD_PTR own, all;

    (void)self, (void)n;
    if (!GetProcessAffinityMask(GetCurrentProcess(), &own, &all))
        return fail();
    *out = own;
    return 0;
}

int getrusage(int self, struct rusage *out)
{
    PROCESS_MEMORY_COUNTERS memory;

    (void)self;
    if (!K32GetProcessMemoryInfo(GetCurrentProcess(), &memory, sizeof memory))
        return fail();
    out->ru_maxrss = (long long)(memory.PeakWorkingSetSize / 1024);
    return 0;
}

/* ---- Processes and signals ------------------------------------------------------------------ */

int posix_kill(pid_t pid, int zero)
{
    HANDLE process = OpenProcess(SYNCHRONIZE, FALSE, (DWORD)pid);

    (void)zero;
    if (!process && GetLastError() == ERROR_INVALID_PARAMETER) {
        errno = ESRCH;
        return -1;
    }
    if (!process)
        return fail();
    CloseHandle(process);
    return 0;
}

/* Quote an argument: double backslashes that precede a quote, and escape quotes with a backslash.
 * Returns the end of the output. */
static char *quote_argument(const char *text, char *out)
{
    *out++ = '"';
    for (size_t n = 0; *text; text++) {
        n = *text == '\\' ? n + 1 : 0;
        if (*text == '"')
            *out++ = '\\';
        *out++ = *text;
        if (n > 0 && (text[1] == '"' || !text[1]))
            for (; n > 0; n--)
                *out++ = '\\';
    }
    *out++ = '"';
    *out++ = ' ';
    return out;
}

static BOOL WINAPI ignore_interrupt(DWORD event)
{
    return event == CTRL_C_EVENT || event == CTRL_BREAK_EVENT;
}

intptr_t posix_execv(const char *path, char *const *argv)
{
    enum { LINE = 32767 };
    STARTUPINFOW start = {.cb = sizeof start};
    PROCESS_INFORMATION child;
    size_t n = 1;
    char *line, *end;
    wchar_t *wide;
    struct wide program;
    char with_exe[PATH_ROOM];
    DWORD code = 1;

    for (char *const *text = argv; *text; text++)
        n += 2 * strlen(*text) + 3;
    line = end = malloc(n);
    wide = malloc(LINE * sizeof *wide);
    if (!line || !wide)
        return -1;
    for (char *const *text = argv; *text; text++)
        end = quote_argument(*text, end);
    *end = '\0';
    snprintf(with_exe, sizeof with_exe, "%s.exe", path);
    SetConsoleCtrlHandler(ignore_interrupt, TRUE);
    if (!MultiByteToWideChar(CP_UTF8, 0, line, -1, wide, LINE) ||
        !CreateProcessW(to_utf16(with_exe, &program), wide, NULL, NULL, TRUE, 0, NULL, NULL, &start,
                        &child))
        return fail();
    WaitForSingleObject(child.hProcess, INFINITE);
    GetExitCodeProcess(child.hProcess, &code);
    exit((int)code);
}

static struct sigaction on_interrupt, on_terminate, on_bus;

static BOOL WINAPI handle_event(DWORD event)
{
    const struct sigaction *action = event == CTRL_C_EVENT       ? &on_interrupt
                                     : event == CTRL_BREAK_EVENT ? &on_terminate
                                                                 : NULL;

    if (!action || !action->sa_handler)
        return FALSE;
    action->sa_handler(event == CTRL_C_EVENT ? SIGINT : SIGTERM);
    return TRUE;
}

static LONG WINAPI handle_fault(EXCEPTION_POINTERS *fault)
{
    const EXCEPTION_RECORD *record = fault->ExceptionRecord;
    siginfo_t info;

    if (record->ExceptionCode == EXCEPTION_IN_PAGE_ERROR && record->NumberParameters > 1 &&
        on_bus.sa_sigaction) {
        info.si_addr = (void *)record->ExceptionInformation[1];
        on_bus.sa_sigaction(SIGBUS, &info, NULL);
    }
    return EXCEPTION_CONTINUE_SEARCH;
}

int sigaction(int number, const struct sigaction *in, struct sigaction *none)
{
    (void)none;
    if (number == SIGINT)
        on_interrupt = *in;
    else if (number == SIGTERM)
        on_terminate = *in;
    else if (number == SIGBUS) {
        on_bus = *in;
        AddVectoredExceptionHandler(1, handle_fault);
    }
    if (number == SIGINT)
        SetConsoleCtrlHandler(handle_event, TRUE);
    return 0;
}

void (*posix_signal(int number, void (*how)(int)))(int)
{
    (void)number, (void)how;
    return SIG_DFL;
}

int pause(void)
{
    Sleep(INFINITE);
    return -1;
}

/* ---- Libraries ------------------------------------------------------------------------------ */

static _Thread_local char dl_error[512];

void *dlopen(const char *path, int flags)
{
    struct wide wide, full;
    char name[PATH_ROOM], *ending;
    HMODULE object;

    (void)flags;
    snprintf(name, sizeof name, "%s", path);
    ending = strchr(name, '/') ? NULL : strstr(name, ".so");
    if (ending)
        snprintf(ending, sizeof name - (size_t)(ending - name), ".dll");
    if (ending)
        to_utf16(name, &full);
    else if (!GetFullPathNameW(to_utf16(name, &wide), PATH_ROOM, full.text, NULL))
        full.text[0] = L'\0';
    object = LoadLibraryExW(full.text, NULL,
                            ending ? LOAD_LIBRARY_SEARCH_APPLICATION_DIR
                                   : LOAD_LIBRARY_SEARCH_DLL_LOAD_DIR |
                                         LOAD_LIBRARY_SEARCH_DEFAULT_DIRS);
    if (!object)
        snprintf(dl_error, sizeof dl_error, "'%.400s' %s: Windows error %lu", name,
                 ending ? "beside the program cannot be loaded" : "cannot be loaded",
                 GetLastError());
    return (void *)object;
}

void *dlsym(void *object, const char *name)
{
    FARPROC found = GetProcAddress(object, name);
    void *out;

    memcpy(&out, &found, sizeof out);
    return out;
}

int dlclose(void *object) { return FreeLibrary(object) ? 0 : -1; }

const char *dlerror(void) { return dl_error; }

/* ---- Text ----------------------------------------------------------------------------------- */

char *strndup(const char *text, size_t n)
{
    size_t length = strnlen(text, n);
    char *out = malloc(length + 1);

    if (!out)
        return NULL;
    memcpy(out, text, length);
    out[length] = '\0';
    return out;
}

char *strsep(char **rest, const char *ends)
{
    char *piece = *rest;

    if (!piece)
        return NULL;
    *rest = piece + strcspn(piece, ends);
    *rest = **rest ? (**rest = '\0', *rest + 1) : NULL;
    return piece;
}

void *memmem(const void *in, size_t n, const void *what, size_t n_what)
{
    const char *at = in;

    for (; n >= n_what; at++, n--)
        if (memcmp(at, what, n_what) == 0)
            return (void *)(uintptr_t)at;
    return NULL;
}

/* ---- Numbers -------------------------------------------------------------------------------- */

/* Replaces MinGW's function, which rounds the product, too. A double holds the product. The sum is
 * rounded to a double whose last bit is odd unless the double is exact: rounded to a float, it is
 * then never taken for a tie that it is not. */
float fmaf(float x, float y, float z)
{
    double product = (double)x * (double)y, sum = product + (double)z;
    double added = sum - product, lost = (product - (sum - added)) + ((double)z - added);
    int64_t bits;

    memcpy(&bits, &sum, sizeof bits);
    if (!isfinite(sum) || lost == 0 || bits & 1)
        return (float)sum;
    bits += (lost > 0) == (sum > 0) ? 1 : -1;
    memcpy(&sum, &bits, sizeof bits);
    return (float)sum;
}
