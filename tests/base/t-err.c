/* The error trail.  K: base threads */
#include <pthread.h>

#include "base/err.h"
#include "tests/tap.h"

static spin_status inner(void) { return spin_fail(SPIN_E_MALFORMED, "array '%s' is short", "x"); }

static spin_status outer(void)
{
    spin_status status;

    SPIN_TRY_OUT(inner());
out:
    return spin_fail_context(status, "cannot open '%s'", "a.npz");
}

static spin_status forwards(void)
{
    SPIN_TRY(inner());
    return SPIN_OK;
}

static void *other_thread(void *result)
{
    *(int *)result = strcmp(spin_last_error(), "") == 0;
    spin_fail(SPIN_E_IO, "of another thread");
    return NULL;
}

TAP_MAIN
{
    pthread_t thread;
    int was_empty = 0;
    char large[5000];

    is_text(spin_last_error(), "", "the trail is empty at first");
    ok(outer() == SPIN_E_MALFORMED, "more keeps the code it is given");
    is_text(spin_last_error(), "cannot open 'a.npz': array 'x' is short", "links go in front");
    ok(forwards() == SPIN_E_MALFORMED, "SPIN_TRY forwards");
    is_text(spin_last_error(), "array 'x' is short", "a new failure starts a new trail");

    spin_fail(SPIN_E_IO, "name '%s'", "a\nb\033[31m\x7f\xc3\xa9");
    is_text(spin_last_error(), "name 'a?b?[31m?\xc3\xa9'",
            "control characters become question marks");
    spin_fail(SPIN_E_IO, "again: %s", spin_last_error());
    is_text(spin_last_error(), "again: name 'a?b?[31m?\xc3\xa9'",
            "the trail may be its own argument");

    spin_fail(SPIN_E_MALFORMED, "no array");
    ok(spin_fail_reading(SPIN_E_MALFORMED, "a.npz") == SPIN_E_MALFORMED, "reading fails");
    is_text(spin_last_error(), "cannot read 'a.npz': no array", "the file is named");
    spin_fail_reading(SPIN_E_MALFORMED, "a.npz");
    is_text(spin_last_error(), "cannot read 'a.npz': no array", "once");
    spin_fail(SPIN_E_MALFORMED, "no array");
    spin_fail_reading(SPIN_E_MALFORMED, "arr");
    is_text(spin_last_error(), "cannot read 'arr': no array", "a name that is part of a word too");
    spin_fail(SPIN_E_USAGE, "--cull");
    spin_fail_reading(SPIN_E_USAGE, "a.npz");
    is_text(spin_last_error(), "--cull", "but not for a wrong option");
    ok(spin_fail_reading(SPIN_OK, "b.npz") == SPIN_OK, "success stays success");

    memset(large, 'x', sizeof large - 1);
    large[sizeof large - 1] = '\0';
    spin_fail(SPIN_E_IO, "%s", large);
    ok(strlen(spin_last_error()) == 4095, "an overlong text is cut");
    spin_fail_context(SPIN_E_IO, "outside");
    ok(strlen(spin_last_error()) == 4095 && strncmp(spin_last_error(), "outside: xxx", 12) == 0,
       "an overlong trail loses its inner end");
    spin_fail_context(SPIN_E_IO, "%s", large);
    ok(strlen(spin_last_error()) == 4095, "an overlong link is cut");

    spin_fail(SPIN_E_IO, "mine");
    pthread_create(&thread, NULL, other_thread, &was_empty);
    pthread_join(thread, NULL);
    ok(was_empty, "a thread begins with an empty trail");
    is_text(spin_last_error(), "mine", "another thread's failure does not touch mine");

    ok(!spin_cancelled(), "not cancelled at first");
    spin_cancel();
    ok(spin_cancelled(), "cancelled after spin_cancel");
    ok(spin_fail_cancelled() == SPIN_E_CANCELLED, "cancelling has a code");
    is_text(spin_last_error(), "interrupted", "and a text");
}
