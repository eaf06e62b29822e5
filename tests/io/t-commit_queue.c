/* K: files threads */
#include "io/commit_queue.h"
#include "tests/check.h"
#include "tests/tap.h"

static const char *folder;

static int add(struct spin_commit_queue *c, const char *name, spin_status *status)
{
    struct spin_out out;
    char path[4096];

    snprintf(path, sizeof path, "%s/%s", folder, name);
    if (spin_out_open(path, true, &out) != SPIN_OK || spin_out_write(&out, name, 3) != SPIN_OK)
        return 0;
    *status = spin_commit_queue_add(c, &out);
    return 1;
}

static size_t n_files(void)
{
    char **names;
    size_t n = 0;

    if (spin_folder_list(folder, &names, &n) == SPIN_OK)
        spin_folder_list_free(names);
    return n;
}

TAP_MAIN
{
    struct spin_commit_queue *c = NULL;
    spin_status status = SPIN_OK, first = SPIN_OK;
    char name[64], path[4096];
    int good = 1;

    folder = check_folder();
    ok(spin_commit_queue_create(&c) == SPIN_OK, "creates");
    for (int i = 0; i < 40; i++) {
        snprintf(name, sizeof name, "file_%d", i);
        good &= add(c, name, &status) && status == SPIN_OK;
    }
    ok(good && spin_commit_queue_wait(c) == SPIN_OK && n_files() == 40, "forty files are there");
    ok(add(c, "late", &status), "one more");
    spin_commit_queue_free(c);
    ok(n_files() == 41, "what was given before the end is there after it");

    ok(spin_commit_queue_create(&c) == SPIN_OK, "creates another");
    snprintf(path, sizeof path, "%s/taken", folder);
    ok(add(c, "taken", &status), "gives a file");
    ok(spin_commit_queue_wait(c) == SPIN_OK && remove(path) == 0 &&
           spin_folder_make(path) == SPIN_OK,
       "puts a folder in the place of the next");
    snprintf(path, sizeof path, "%s/taken/in_it", folder);
    ok(spin_folder_make(path) == SPIN_OK, "that is not empty");
    snprintf(path, sizeof path, "%s/other", folder);
    {
        struct spin_out out;

        ok(spin_out_open(path, true, &out) == SPIN_OK, "opens a file");
        snprintf(out.path, strlen(out.path) + 1, "%s/taken", folder);
        first = spin_commit_queue_add(c, &out);
    }
    ok(first == SPIN_OK && spin_commit_queue_wait(c) == SPIN_E_IO &&
           strstr(spin_last_error(), "taken") != NULL,
       "a failure is told when one waits, by name");
    ok(add(c, "after", &status) && status == SPIN_E_IO, "and to whoever gives the next");
    spin_commit_queue_free(c);
    snprintf(path, sizeof path, "%s/after", folder);
    ok(!spin_path_exists(path) && n_files() == 42, "which is not written; nothing is left over");
}
