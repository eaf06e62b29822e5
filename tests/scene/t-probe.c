/* What the probes of importers are shown of an input.  K: scene probe */

#include "scene/probe.h"
#include "tests/check.h"
#include "tests/tap.h"

static const char *root; /* a fresh folder */

static const char *in_root(const char *name)
{
    static char ring[4][512];
    static int next;

    next = (next + 1) % 4;
    snprintf(ring[next], sizeof ring[0], "%s/%s", root, name);
    return ring[next];
}

static void put_file(const char *path, const char *text)
{
    FILE *file = fopen(path, "wb");

    if (file) {
        fputs(text, file);
        fclose(file);
    }
}

static void peeks(void)
{
    struct spin_peek peek;
    struct spin_zip_writer w;
    char large[20001];

    memset(large, 'z', 20000);
    large[20000] = '\0';
    put_file(in_root("large"), large);
    ok(spin_peek_open(in_root("large"), &peek) == SPIN_OK && peek.n_head == 16384 &&
           !peek.is_folder && peek.head[16383] == 'z',
       "peeks at the first 16384 bytes");
    is_text(peek.tail_names, "", "which has no members");
    is_text(peek.path, in_root("large"), "keeps the path");
    spin_peek_free(&peek);

    spin_zip_writer_open(in_root("z.npz"), false, &w);
    spin_zip_member_begin(&w, "a.npy", 0);
    spin_zip_member_end(&w);
    spin_zip_member_begin(&w, "b/c.npy", 0);
    spin_zip_member_end(&w);
    spin_zip_writer_commit(&w);
    ok(spin_peek_open(in_root("z.npz"), &peek) == SPIN_OK, "peeks at an archive");
    is_text(peek.tail_names, "a.npy\nb/c.npy", "sees its members");
    spin_peek_free(&peek);
    put_file(in_root("bad.npz"), "PK\003\004 and nothing more");
    ok(spin_peek_open(in_root("bad.npz"), &peek) == SPIN_OK, "peeks at a broken archive");
    is_text(peek.tail_names, "", "sees no members");
    spin_peek_free(&peek);

    mkdir(in_root("folder"), 0777);
    mkdir(in_root("saves"), 0777);
    put_file(in_root("folder/a"), "a");
    put_file(in_root("folder/B"), "b");
    ok(spin_peek_open(in_root("folder"), &peek) == SPIN_OK && peek.is_folder &&
           !strcmp(peek.names[0], "B") && !strcmp(peek.names[1], "a") && !peek.names[2],
       "peeks into a folder");
    spin_peek_free(&peek);
    for (int i = 0; i < 3; i++) {
        static const char *const heads[] = {"folder/point_cloud.ply", "folder/deformation.pth",
                                            "folder/cfg_args"};

        put_file(in_root(heads[i]), heads[i]);
        ok(spin_peek_open(in_root("folder"), &peek) == SPIN_OK && peek.n_head == strlen(heads[i]) &&
               memcmp(peek.head, heads[i], peek.n_head) == 0,
           "the head of a folder is that of its %s", spin_path_name(heads[i]));
        spin_peek_free(&peek);
    }
    put_file(in_root("saves/chkpnt7.pth"), "seven");
    put_file(in_root("saves/chkpnt8.pth"), "eight");
    ok(spin_peek_open(in_root("saves"), &peek) == SPIN_OK && peek.n_head == 5 &&
           !memcmp(peek.head, "seven", 5),
       "sees how the first checkpoint in it begins");
    spin_peek_free(&peek);
    put_file(in_root("saves/cfg_args"), "Namespace()");
    ok(spin_peek_open(in_root("saves"), &peek) == SPIN_OK && peek.n_head == 11, "or its cfg_args");
    spin_peek_free(&peek);
    ok(spin_peek_open(in_root("none"), &peek) == SPIN_E_NOT_FOUND,
       "what is not there is not found");
    ok(strstr(spin_last_error(), "no such file or folder") != NULL, "in these words");
    spin_peek_free(&peek);
}

TAP_MAIN
{
    root = check_folder();
    peeks();
}
