/* spin-import and spin-export as one program for the browser. argv[1] is "import" or "export". */
#include <stdio.h>
#include <string.h>

int spin_import_main(int argc, char **argv);
int spin_export_main(int argc, char **argv);

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], "import") == 0)
        return spin_import_main(argc - 1, argv + 1);
    if (argc > 1 && strcmp(argv[1], "export") == 0)
        return spin_export_main(argc - 1, argv + 1);
    fprintf(stderr, "the first argument must be import or export\n");
    return 2;
}
