/* Outputs looked at and locked before long work: what can be written, and who holds the lock.  K:
 * io file lock */
#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include "io/output.h"
#include "tests/check.h"
#include "tests/tap.h"

static char output[300], lock[310];

static void put_file(const char *path, const char *text)
{
    FILE *file = fopen(path, "wb");

    if (file) {
        fputs(text, file);
        fclose(file);
    }
}

static void files(const char *root)
{
    char path[300];

    ok(spin_output_check_file(output, false) == SPIN_OK && !spin_path_exists(output),
       "a file that could be written is not");
    snprintf(path, sizeof path, "%s/none/a.spin", root);
    ok(spin_output_check_file(path, true) == SPIN_E_NOT_FOUND, "no folder to write into");
    snprintf(path, sizeof path, "%s/there", root);
    put_file(path, "x");
    ok(spin_output_check_file(path, false) == SPIN_E_IO &&
           spin_output_check_file(path, true) == SPIN_OK,
       "one that is there needs force");
    ok(spin_output_check_folder(path) == SPIN_E_IO &&
           strstr(spin_last_error(), "a file has that name"),
       "a file is no folder");
    snprintf(path, sizeof path, "%s/a/b", root);
    ok(spin_output_check_folder(path) == SPIN_OK && spin_path_is_folder(path), "a folder is made");
}

/* Another process takes the lock and keeps it until it is killed. */
static pid_t hold(void)
{
    int ready[2];
    char byte = 0;
    pid_t child;

    if (pipe(ready) != 0 || (child = fork()) < 0)
        exit(1);
    if (child == 0) {
        struct spin_output_lock held;

        byte = spin_output_lock_take(output, &held) == SPIN_OK;
        (void)!write(ready[1], &byte, 1);
        pause();
        _exit(0);
    }
    ok(read(ready[0], &byte, 1) == 1 && byte == 1, "another process takes the lock");
    close(ready[0]);
    close(ready[1]);
    return child;
}

static void locks(void)
{
    struct spin_output_lock held, second;
    pid_t child;

    ok(spin_output_lock_take(output, &held) == SPIN_OK && spin_path_exists(lock), "takes the lock");
    ok(spin_output_lock_take(output, &second) == SPIN_E_IO && strstr(spin_last_error(), output) &&
           strstr(spin_last_error(), "another run"),
       "nobody else does; the text names the output");
    spin_output_lock_drop(&second);
    ok(spin_path_exists(lock), "dropping what was not taken does nothing");
    spin_output_lock_drop(&held);
    ok(!spin_path_exists(lock), "dropped, it is gone");
    spin_output_lock_drop(&held);

    child = hold();
    ok(spin_output_lock_take(output, &held) == SPIN_E_IO, "it holds between processes");
    kill(child, SIGKILL);
    waitpid(child, NULL, 0);
    ok(spin_path_exists(lock), "what is killed leaves a file");
    ok(spin_output_lock_take(output, &held) == SPIN_OK, "which is no lock");
    /* Removed under us, as its holder does when it ends just then: the name is another file's. */
    unlink(lock);
    ok(spin_output_lock_take(output, &second) == SPIN_OK, "a lock without a name is none");
    spin_output_lock_drop(&second);
    spin_output_lock_drop(&held);
    put_file(lock, "notes");
    ok(spin_output_lock_take(output, &held) == SPIN_OK, "a file of that name is used");
    spin_output_lock_drop(&held);
    ok(spin_path_exists(lock), "and stays when there is something in it");
    unlink(lock);
    ok(symlink("elsewhere", lock) == 0 && spin_output_lock_take(output, &held) == SPIN_E_IO,
       "a link is not followed");
    unlink(lock);
}

TAP_MAIN
{
    const char *root = check_folder();

    snprintf(output, sizeof output, "%s/out.spin", root);
    snprintf(lock, sizeof lock, "%s.lock", output);
    files(root);
    locks();
}
