/* Which exporter writes a file, by the ending of its name. */
#include "base/base.h"
#include "spin_run.h"

static const char *const endings[][2] = {{".compressed.ply", "compressed-ply"},
                                         {".ftgs.ply", "ftgs"},
                                         {".sogst.ply", "sogst-ply"},
                                         {".ply", "ply"},
                                         {".glb", "gltf"},
                                         {".sog", "sog"},
                                         {".sogst", "sogst"},
                                         {".splat", "splat"},
                                         {".spz", "spz"},
                                         {".tsog", "tsog"},
                                         {".usda", "usd"},
                                         {".html", "html"},
                                         {".mp4", "video"},
                                         {".webm", "video"}};
enum { N_ENDINGS = sizeof endings / sizeof *endings };

const char *spin_exporter_for(const char *output)
{
    for (size_t i = 0; i < N_ENDINGS; i++)
        if (!spin_text_ends(endings[i][0], output) && spin_text_ends(output, endings[i][0]))
            return endings[i][1];
    return NULL;
}

const char *spin_exporter_nearest(const char *ending)
{
    static const char *const kin[][2] = {
        {"gif mov avi mkv m4v ogv mpg mpeg apng", ".mp4"},
        {"png jpg jpeg exr tif tiff bmp webp", "a folder with --to images"},
        {"gltf obj fbx stl dae", ".glb"},
        {"usd usdc usdz", ".usda"},
        {"ksplat splatv", ".splat"},
        {"splat4d 4dgs", ".sogst"}};
    size_t length = strlen(ending + 1);
    const char *best = NULL;
    int least = 3;

    for (size_t k = 0; k < sizeof kin / sizeof *kin; k++)
        for (const char *word = kin[k][0]; *word; word += strspn(word, " ")) {
            size_t n = strcspn(word, " ");

            if (n == length && strncmp(word, ending + 1, n) == 0)
                return kin[k][1];
            word += n;
        }
    for (size_t i = 0; i < N_ENDINGS; i++) {
        int d = spin_text_distance(ending, length + 1, endings[i][0]);

        best = d < least ? endings[i][0] : best;
        least = d < least ? d : least;
    }
    return best;
}
