/* easyvolcap: sets compared with the method's own reader, static and moving cameras, and
 * malformed files.
 * K: easyvolcap import views */
#include "tests/importers/sets.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

static void test_set(const char *folder, const char *name, const spin_json *manifest)
{
    struct spin_views views;
    struct spin_npz npz;
    bool masks = true;

    if (!rig_opens(folder, name, "easyvolcap", &views, &npz))
        return;
    check_rig(&views, &npz, manifest, "time_freetimegs", name);
    check_rig_colours(&views, &npz, manifest);
    for (size_t i = 0; i < views.n; i++)
        masks = masks && views.view[i].mask && spin_path_exists(views.view[i].mask);
    ok(masks || !has(path_in(folder, "scene"), "masks"), "%s: each picture has its mask", name);
    ok(strstr(views.notes, "'unit'") && strstr(views.notes, "time=count"),
       "%s: the notes say which time rule it is", name);
    spin_views_free(&views);
    if (set_opens(path_in(folder, "scene"), "easyvolcap:time=count", &views,
                  "with the method's own times")) {
        check_rig(&views, &npz, manifest, "time_easyvolcap", name);
        spin_views_free(&views);
    }
    spin_npz_close(&npz);
}

/* ---- Files made here ------------------------------------------------------------------------- */

#define HEAD "%YAML:1.0\n---\n"
#define MATRIX(rows, cols, data)                                                                   \
    " !!opencv-matrix\n  rows: " #rows "\n  cols: " #cols "\n  dt: d\n  data: [" data "]\n"
#define NAMES "names:\n  - \"b\"\n  - \"a\"\n"
#define K_A "K_a:" MATRIX(3, 3, "10, 0, 4, 0, 11, 3, 0, 0, 1")
#define SIZE_A "H_a: 6.0000\nW_a: 8\n"
#define D_A "D_a:" MATRIX(5, 1, "0, 0, 0, 0, 0")
#define B_IN "ccm_b: 1\nK_b:" MATRIX(3, 3, "20, 0, 4,\n    0, 20, 3, 0., 0, 1.")
#define R_A "R_a:" MATRIX(3, 1, "0, 0, 1.5707963267948966")
#define T_A "T_a:" MATRIX(3, 1, "1, 2, 3")
#define B_EX "Rot_b:" MATRIX(3, 3, "1, 0, 0, 0, -1, 0, 0, 0, -1") "T_b:" MATRIX(3, 1, "4, 5, 6")
#define INTRI HEAD NAMES K_A SIZE_A D_A B_IN
#define EXTRI                                                                                      \
    HEAD NAMES R_A "Rot_a:" MATRIX(3, 3, "1, 0, 0, 0, 1, 0, 0, 0, 1") T_A "n_a: 0.1\n" B_EX

static void make_pictures(const char *folder, const char *where, int first, int n)
{
    char name[64];

    for (int i = 0; i < 2; i++) {
        snprintf(name, sizeof name, "%s/%c", where, 'a' + i);
        make_folder(folder, name);
        for (int k = 0; k < n; k++) {
            snprintf(name, sizeof name, "%s/%c/%06d.png", where, 'a' + i, first + k);
            make_image(folder, name, 8, 6);
        }
    }
}

static const char *make_set(const char *intri, const char *extri)
{
    const char *folder = new_folder();

    make_text(folder, "intri.yml", intri);
    make_text(folder, "extri.yml", extri);
    make_pictures(folder, "images", 5, 2);
    return folder;
}

/* Rows of R and T. */
static bool is_pose(const struct spin_view *v, const double expected[12])
{
    for (int i = 0; i < 12; i++) {
        if (!(fabs(v->camera.w2c[i] - expected[i]) < 1e-12))
            return false;
    }
    return true;
}

static void test_still(void)
{
    static const double a[12] = {0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3};
    static const double b[12] = {1, 0, 0, 4, 0, -1, 0, 5, 0, 0, -1, 6};
    const char *folder = make_set(INTRI, EXTRI);
    struct spin_views views;

    if (set_opens(folder, NULL, &views, "a set made here")) {
        ok(views.n == 4 && views.n_dataset_frames == 2 && views.numbered &&
               views.view[0].number == 5 && views.view[3].time == 1 && !views.view[0].mask,
           "has two frames of two cameras, numbered as the files");
        ok(is_pose(&views.view[0], a), "a rotation vector wins over a matrix");
        ok(is_pose(&views.view[1], b), "which counts alone");
        ok(views.view[0].camera.fx == 10 && views.view[0].camera.fy == 11 &&
               views.view[1].camera.fx == 20 && views.view[1].camera.width == 8 &&
               views.view[1].camera.height == 6,
           "without H and W the size is the picture's");
        ok(views.view[0].test && !views.view[1].test && views.view[1].camera_id == 1,
           "cameras are sorted by name, and the first is held out");
        ok(strstr(views.notes, "ccm") != NULL, "colour matrices are noted");
        spin_views_free(&views);
    }
    make_pictures(folder, "msk", 5, 1);
    if (set_opens(folder, "easyvolcap:hold=0", &views, "with masks of one frame")) {
        ok(views.view[1].mask && strstr(views.view[1].mask, "msk/b/000005.png") &&
               !views.view[2].mask && !views.view[0].test,
           "has these, and holds out nothing when asked");
        spin_views_free(&views);
    }
    make_text(folder, "intri.yml",
              HEAD NAMES
              "K_a:" MATRIX(3, 3, "20, 0, 8, 0, 22, 6, 0, 0, 1") "H_a: 12\nW_a: 16\ndist_a:" MATRIX(
                  5, 1, "0,0,0,0,-0.0") B_IN);
    if (set_opens(folder, NULL, &views, "pictures of half the size")) {
        ok(views.view[0].camera.width == 8 && views.view[0].camera.fx == 10 &&
               views.view[0].camera.cy == 3,
           "get a camera of half the size");
        spin_views_free(&views);
    }
}

/* A rotation vector rotates by its length; length 0 is the identity. */
static void test_rotations(void)
{
    static const double none[12] = {1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 3};
    static const double third[12] = {0, 0, 1, 1, 1, 0, 0, 2, 0, 1, 0, 3};
    struct spin_views views;

    if (set_opens(make_set(INTRI, HEAD NAMES "R_a:" MATRIX(3, 1, "0, 0, 0") T_A B_EX), NULL, &views,
                  "a rotation of 0")) {
        ok(is_pose(&views.view[0], none), "is none");
        spin_views_free(&views);
    }
    if (set_opens(
            make_set(INTRI, HEAD NAMES "R_a:" MATRIX(3, 1,
                                                     "1.2091995761561452, 1.2091995761561452, "
                                                     "1.2091995761561452") T_A B_EX),
            NULL, &views, "a third of a turn about x = y = z")) {
        ok(is_pose(&views.view[0], third), "exchanges the axes");
        spin_views_free(&views);
    }
}

static void test_moving(void)
{
    const char *folder = new_folder();
    struct spin_views views;

    make_pictures(folder, "images", 5, 2);
    for (int i = 0; i < 2; i++) {
        static const char intri[] =
            HEAD "names:\n  - \"000006\"\n  - \"000005\"\n"
                 "K_000005:" MATRIX(3, 3, "10, 0, 4, 0, 11, 3, 0, 0, 1") "K_000006:" MATRIX(
                     3, 3, "12, 0, 4, 0, 11, 3, 0, 0, 1");
        static const char extri[] = HEAD "R_000005:" MATRIX(3, 1, "0, 0, 0") "R_000006:" MATRIX(
            3, 1, "0, 0, 0") "T_000005:" MATRIX(3, 1, "5, 0, 0") "T_000006:" MATRIX(3, 1,
                                                                                    "6, 0, 0");

        make_folder(folder, i ? "cameras/b" : "cameras/a");
        make_text(folder, i ? "cameras/b/intri.yml" : "cameras/a/intri.yml", intri);
        make_text(folder, i ? "cameras/b/extri.yml" : "cameras/a/extri.yml", extri);
    }
    make_text(folder, "cameras/.hidden", "x");
    if (set_opens(folder, NULL, &views, "cameras that move")) {
        ok(views.n == 4 && views.view[0].camera.w2c[3] == 5 && views.view[3].camera.w2c[3] == 6 &&
               views.view[2].camera.fx == 12,
           "have a pose and a lens for each frame, by its number");
        spin_views_free(&views);
    }
    make_pictures(folder, "images", 7, 1);
    set_refused(folder, NULL, "no entry for image", "a picture without an entry");
    make_folder(folder, "cameras/0");
    set_refused(folder, NULL, "cameras/0/intri.yml", "a camera without files");
}

static void test_lies(void)
{
    struct spin_views views;
    static const struct {
        const char *intri, *extri, *word, *what;
    } cases[] = {
        {HEAD K_A SIZE_A B_IN, EXTRI, "'names'", "no names"},
        {HEAD "names: 3\n" K_A B_IN, EXTRI, "'names'", "names that are a number"},
        {HEAD "names:\n" K_A B_IN, EXTRI, "'names'", "no name among the names"},
        {HEAD "names:\n  - \"a\"\n  - \"a\"\n" K_A, EXTRI, "two cameras", "a name twice"},
        {HEAD "names:\n- \"a\"\n" K_A, EXTRI, "1 entries in 'names', but",
         "a camera of one file only"},
        {HEAD "names:\n  - \"a\"\n  - \"../b\"\n" K_A, EXTRI, "folder's name",
         "a name that climbs out"},
        {HEAD "names:\n  - \"a\"\n  - \"c\"\n" K_A, EXTRI, "images/c", "a camera without pictures"},
        {HEAD NAMES K_A, EXTRI, "no matrix 'K_b'", "a camera without K"},
        {HEAD NAMES K_A K_A B_IN, EXTRI, "'K_a' occurs twice", "K that is there twice"},
        {HEAD NAMES "K_a:" MATRIX(3, 3, "10, 0, 4, 0, 11, 3, 0, 0") B_IN, EXTRI, "8 numbers",
         "K of eight numbers"},
        {HEAD NAMES "K_a:" MATRIX(9, 1, "10, 0, 4, 0, 11, 3, 0, 0, 1") B_IN, EXTRI, "9 x 1",
         "K of another aspect ratio"},
        {HEAD NAMES "K_a:" MATRIX(3, 3, "10, 0, 4, 0, .nan, 3, 0, 0, 1") B_IN, EXTRI, "'.nan, 3",
         "K with NaN as YAML writes it"},
        {HEAD NAMES "K_a:" MATRIX(3, 3, "10, 0, 4, 0, inf, 3, 0, 0, 1") B_IN, EXTRI, "'inf, 3",
         "K with infinity"},
        {HEAD NAMES "K_a:" MATRIX(3, 3, "10, 0, 4, 0, 1e999, 3, 0, 0, 1") B_IN, EXTRI, "'1e999",
         "K with a number that no double holds"},
        {HEAD NAMES "K_a:" MATRIX(3, 3, "10, 0, 4, 0, 11x, 3, 0, 0, 1") B_IN, EXTRI, "'11x",
         "K with letters"},
        {HEAD NAMES "K_a: 3\n" B_IN, EXTRI, "'K_a' is 0 x 0", "K that is a number"},
        {HEAD NAMES "K_a:" MATRIX(3, 3, "10, 0, 4, 0, 11, 3, 0, 0, 2") B_IN, EXTRI, "'K' is not",
         "K that is no pinhole"},
        {HEAD NAMES "K_a:" MATRIX(3, 3, "10, 0, 9, 0, 11, 3, 0, 0, 1") B_IN, EXTRI,
         "principal point", "a principal point outside"},
        {HEAD NAMES K_A "H_a: 6\n" B_IN, EXTRI, "'H_a' and 'W_a'", "a height without a width"},
        {HEAD NAMES K_A "H_a: 8\nW_a: 8\n" B_IN, EXTRI, "another aspect ratio",
         "pictures of another aspect ratio"},
        {HEAD NAMES K_A "H_a: 6\nW_a: 8.5\n" B_IN, EXTRI, "image size", "half a pixel"},
        {HEAD NAMES K_A "D_a:" MATRIX(5, 1, "0, 0, 0, 0, 0.1") B_IN, EXTRI, "distortion of 0.1",
         "distortion"},
        {HEAD NAMES K_A "dist_a:" MATRIX(5, 1, "-0.1, 0, 0, 0, 0") B_IN, EXTRI,
         "distortion of -0.1", "distortion by its other name"},
        {HEAD NAMES K_A "D_a:" MATRIX(4, 1, "0, 0, 0, 0") B_IN, EXTRI, "'D_a' is 4 x 1",
         "a distortion of four numbers"},
        {INTRI, HEAD NAMES T_A B_EX, "no matrix 'R_a'", "no rotation"},
        {INTRI, HEAD NAMES R_A B_EX, "no matrix 'T_a'", "no translation"},
        {INTRI, HEAD NAMES "Rot_a:" MATRIX(3, 3, "1, 0, 0, 0, 1, 0, 0, 0, -1") T_A B_EX,
         "reflection", "a rotation that mirrors"},
        {INTRI, HEAD NAMES "Rot_a:" MATRIX(3, 3, "1, 0, 0, 0, 1, 0, 0, 0, 1.1") T_A B_EX,
         "orthonormal", "a rotation that scales"},
        {INTRI, HEAD NAMES "R_a:" MATRIX(3, 1, "0, 1e300, 0") T_A B_EX, "not finite",
         "a rotation vector without end"},
        {"K_a: 3\n" INTRI, EXTRI, "first line", "no first line"},
        {HEAD NAMES "K_a: &anchor 3\n" B_IN, EXTRI, "line 6: 'K_a' is '&anchor 3'", "an anchor"},
        {HEAD NAMES "K_a: !!binary x\n" B_IN, EXTRI, "!!binary", "another tag"},
        {HEAD NAMES "K_a\n" B_IN, EXTRI, "is not a key", "a line without a colon"},
        {HEAD "  - \"a\"\n", EXTRI, "does not belong to", "a text that belongs to no list"},
        {HEAD "a: 1\n  rows: 3\n", EXTRI, "does not belong to", "rows that belong to no matrix"},
        {HEAD "a: !!opencv-matrix\n  dt: i\n", EXTRI, "is not an entry of a matrix",
         "a matrix of integers"},
        {HEAD "a: !!opencv-matrix\n  rows: x\n", EXTRI, "is not an entry of a matrix",
         "rows that are no number"},
        {HEAD "a: !!opencv-matrix\n  rows: 3\n  rows: 3\n", EXTRI, "'rows' occurs twice",
         "rows twice"},
        {HEAD "a: !!opencv-matrix\n  data: 3\n", EXTRI, "is not an entry of a matrix",
         "data that are no list"},
        {HEAD NAMES K_A "x:" MATRIX(1, 1, "1, 2, 3\n  4"), EXTRI, "no matrix 'K_b'",
         "data over two lines are read"},
        {HEAD NAMES K_A "x: !!opencv-matrix\n  data: [1, 2\n", EXTRI, "cut short",
         "data that do not end"},
        {"", EXTRI, "first line", "an empty file"},
    };
    const char *folder = make_set(INTRI, EXTRI);

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        make_text(folder, "intri.yml", cases[i].intri);
        make_text(folder, "extri.yml", cases[i].extri);
        set_refused(folder, NULL, cases[i].word, cases[i].what);
    }
    make_file(folder, "intri.yml", "%YAML:1.0\n---\n\0", 15);
    set_refused(folder, NULL, "not text", "a byte of 0");
    make_text(folder, "intri.yml", INTRI);
    remove(path_in(folder, "extri.yml"));
    set_refused(folder, "easyvolcap", "extri.yml", "a file that is missing");
    make_text(folder, "extri.yml", EXTRI);
    remove(path_in(folder, "images/a/000005.png"));
    if (set_opens(folder, NULL, &views, "a camera that begins later")) {
        ok(views.n == 3 && views.view[0].camera_id == 1, "lacks the first frame");
        spin_views_free(&views);
    }
    remove(path_in(folder, "images/a/000006.png"));
    set_refused(folder, NULL, "contains no images", "a camera without pictures");
}

/* Only the end of the last line may be missing. */
static void test_cuts(void)
{
    const char *folder = make_set(INTRI, EXTRI);

    ok(set_truncations(folder, "extri.yml", NULL) == 1, "no truncation of extri.yml can be read");
    make_text(folder, "extri.yml", EXTRI);
    ok(set_truncations(folder, "intri.yml", NULL) == 1, "nor of intri.yml");
}

TAP_MAIN
{
    spin_log_set_level(-2);
    test_still();
    test_rotations();
    test_moving();
    test_lies();
    test_cuts();
    each_set_in("datasets4d", "easyvolcap", test_set);
}
