/* Calls the command's main() with its arguments in UTF-8 and with slashes instead of
 * backslashes. */
#include <windows.h>

#include <shellapi.h>

#undef main

/* Enable escape sequences in a console, since progress lines are erased with them. */
static void set_console(DWORD which)
{
    HANDLE console = GetStdHandle(which);
    DWORD mode;

    if (GetConsoleMode(console, &mode))
        SetConsoleMode(console, mode | ENABLE_VIRTUAL_TERMINAL_PROCESSING);
}

static char *convert_argument(const wchar_t *given)
{
    int n = WideCharToMultiByte(CP_UTF8, 0, given, -1, NULL, 0, NULL, NULL);
    char *text = malloc((size_t)n + 1);

    if (!text || !WideCharToMultiByte(CP_UTF8, 0, given, -1, text, n, NULL, NULL))
        exit(1);
    for (char *at = text; (at = strchr(at, '\\'));)
        *at = '/';
    return text;
}

int main(void)
{
    int argc, i;
    wchar_t **given = CommandLineToArgvW(GetCommandLineW(), &argc);
    char **argv = given ? calloc((size_t)argc + 1, sizeof *argv) : NULL;

    if (!argv)
        return 1;
    for (i = 0; i < argc; i++)
        argv[i] = convert_argument(given[i]);
    _setmode(STDIN_FILENO, _O_BINARY);
    _setmode(STDOUT_FILENO, _O_BINARY);
    _setmode(STDERR_FILENO, _O_BINARY);
    SetConsoleOutputCP(CP_UTF8);
    set_console(STD_OUTPUT_HANDLE);
    set_console(STD_ERROR_HANDLE);
    return posix_main(argc, argv);
}
