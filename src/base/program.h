/* The executable file of this program. */
#pragma once

#include <stdbool.h>

/* Find the path of this program's file; returns false if it is unknown or too long. Works without
 * /proc on Linux. */
bool spin_program_path(char path[4096]);

/* If /proc is not mounted, restart the program with LD_ORIGIN_PATH set to its folder: otherwise,
 * the loader cannot find the libraries of a relocatable installation. Returns if no restart is
 * needed, or if it fails. */
void spin_program_restart(char **argv);
