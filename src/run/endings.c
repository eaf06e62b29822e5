/* Maps the extension of an output to an exporter. If no exporter writes a given extension, the
 * error message suggests a similar one. */
#include <strings.h>

#include "base/base.h"
#include "io/file.h"
#include "spin_run.h"

static const char *const endings[][2] = {
    {".4dgs", "4dgs"},       {".compressed.ply", "compressed-ply"},
    {".ftgs.ply", "ftgs"},   {".sogst.ply", "sogst-ply"},
    {".stg.ply", "stglite"}, {".ply", "ply"},
    {".glb", "gltf"},        {".sog", "sog"},
    {".sogst", "sogst"},     {".splat", "splat"},
    {".spz", "spz"},         {".tsog", "tsog"},
    {".usdc", "usd"},        {".usdz", "usd"},
    {".usda", "usd"},        {".html", "html"},
    {".mp4", "video"},       {".webm", "video"}};
enum { N_ENDINGS = sizeof endings / sizeof *endings };

/* Each row: extensions that no exporter writes; what to write instead; the exporter that writes it.
 */
static const char *const kin[][3] = {
    {"gif mov avi mkv m4v ogv mpg mpeg apng", ".mp4", "video"},
    {"exr", "a folder with --to images --format exr", "images"},
    {"png jpg jpeg tif tiff bmp webp", "a folder with --to images", "images"},
    {"gltf obj fbx stl dae", ".glb", "gltf"},
    {"usd", ".usdc", "usd"},
    {"ksplat splatv", ".splat", "splat"},
    {"splat4d", ".4dgs", "4dgs"},
    {"spin", "a bundle, which spin-import and spin-retrain write", NULL}};
enum { N_KIN = sizeof kin / sizeof *kin };

static bool is_ending(const char *output, const char *ending)
{
    return strlen(output) > strlen(ending) && spin_text_ends_any_case(output, ending);
}

const char *spin_exporter_for(const char *output)
{
    for (size_t i = 0; i < N_ENDINGS; i++)
        if (is_ending(output, endings[i][0]))
            return endings[i][1];
    return NULL;
}

/* Returns the row of `kin` that lists an extension, given without its dot; -1 if none does. */
static int find_kin(const char *ending)
{
    for (int k = 0; k < N_KIN; k++)
        for (const char *word = kin[k][0]; *word; word += strspn(word, " ")) {
            size_t n = strcspn(word, " ");

            if (n == strlen(ending) && strncasecmp(word, ending, n) == 0)
                return k;
            word += n;
        }
    return -1;
}

const char *spin_exporter_nearest(const char *ending)
{
    size_t length = strlen(ending);
    const char *best = NULL;
    /* A known extension is suggested if its edit distance is below `least`: one typing error is
     * assumed in a short extension, and up to two in a long one. */
    int least = length < 6 ? 2 : 3, k = find_kin(ending + 1);

    if (k >= 0)
        return kin[k][1];
    for (size_t i = 0; i < N_ENDINGS; i++) {
        int d = spin_text_distance(ending, length, endings[i][0]);

        best = d < least ? endings[i][0] : best;
        least = d < least ? d : least;
    }
    return best;
}

const char *spin_exporter_of_format(const char *format)
{
    int k = find_kin(format);

    for (size_t i = 0; i < N_ENDINGS && k < 0; i++)
        if (strcasecmp(endings[i][0] + 1, format) == 0)
            return endings[i][1];
    return k < 0 ? NULL : kin[k][2];
}

const struct spin_exporter *spin_exporter_named(const char *name)
{
    const struct spin_exporter *found = NULL;

    for (const struct spin_exporter *const *i = spin_exporter_list(); *i; i++) {
        if (strcmp((*i)->name, name) == 0)
            return *i;
        found = !found && strcasecmp((*i)->name, name) == 0 ? *i : found;
    }
    return found;
}

/* Returns the longest known extension that `output` ends in, with its dot; NULL if it ends in none.
 */
static const char *known_ending(const char *output)
{
    const char *dot = strrchr(spin_path_name(output), '.');

    for (size_t i = 0; i < N_ENDINGS; i++)
        if (is_ending(output, endings[i][0]))
            return output + strlen(output) - strlen(endings[i][0]);
    return dot && find_kin(dot + 1) >= 0 ? dot : NULL;
}

spin_status spin_exporter_check_name(const struct spin_exporter *e, const char *output)
{
    const char *by = spin_exporter_for(output), *ending = known_ending(output);

    if (!by || strcmp(by, e->name) == 0 || spin_plugin_origin(e) || spin_path_is_folder(output))
        return SPIN_OK;
    /* An exporter that accepts only 4D splats allows a shorter form of its extension, such as .ply
     * for .ftgs.ply. */
    for (size_t i = 0; i < N_ENDINGS; i++)
        if (!e->frame && strcmp(endings[i][1], e->name) == 0 &&
            spin_text_ends_any_case(endings[i][0], ending))
            return SPIN_OK;
    return spin_misuse("the extension of '%s' is that of exporter '%s', but --to is '%s': omit "
                       "--to or the extension",
                       output, by, e->name);
}

spin_status spin_bundle_check_name(const char *output)
{
    const char *ending = known_ending(output);

    if (!ending || strcasecmp(ending, ".spin") == 0)
        return SPIN_OK;
    return spin_misuse(
        "'%s' would be a bundle and must be named *.spin; to write %s, use spin-export", output,
        spin_exporter_for(output) ? ending : spin_exporter_nearest(ending));
}

spin_status spin_report_check_name(const char *path)
{
    static const char *const others[][2] = {{".pdf", "a browser prints the page as PDF"},
                                            {".md", "--table md prints Markdown"},
                                            {".csv", "--table csv prints CSV"},
                                            {".tex", "--table latex prints LaTeX"},
                                            {".json", "--json prints JSON"},
                                            {".svg", "--figures DIR writes SVG"},
                                            {".png", "--figures DIR writes PNG"}};
    const char *ending = known_ending(path);

    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (is_ending(path, others[i][0]))
            return spin_misuse(
                "--report '%s': the report is an HTML page and must be named *.html; %s", path,
                others[i][1]);
    if (ending && strcasecmp(ending, ".html") != 0)
        return spin_misuse("--report '%s': the report is an HTML page and must be named *.html",
                           path);
    return SPIN_OK;
}
