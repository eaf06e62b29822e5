/* Ctrl-C and its relatives. */
#ifndef SPIN_CMD_SIGNALS_H
#define SPIN_CMD_SIGNALS_H

/* From here on SIGINT, SIGTERM and SIGHUP ask the library to stop (spin_cancel()); a second SIGINT ends the
 * process. */
void spin_signals_catch(void);

/* Exit code of work that was stopped: 129, 130 or 143. */
int spin_signals_exit_code(void);

#endif
