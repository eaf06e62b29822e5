/* A text with places for values of a JSON document: the reports of the commands, and the page of an evaluation.
 *
 *     {{splats.mean}}  {{times.0}}        a value; nothing where there is none; of an array how many it has
 *     {{{picture}}}                       in HTML: as it is, without escapes
 *     {{psnr %8.3f}}                      a number by printf's d, f or g; a dash in its width where there is none
 *     {{share %.1p}} {{size %B}}          a number times 100; bytes: 12.3 MB
 *     {{seconds %T}} {{mean %M}}          2 h 36 min; 2940, or 2940.5 when it is not whole
 *     {{frames %N frame}}                 1 frame, 2 frames
 *     {{psnr %+.2f before}}               a number less another
 *     {{#data}}...{{/}}                   where it is neither absent, null, false, the integer 0 nor empty; of an
 *                                         array once for each element, and names are first looked for in that
 *     {{*ranges}}...{{/}}                 once for each member of an object
 *     {{#kind=ends}}...{{/}}              where it is this text or number
 *     {{^data}}...{{/}}  {{^kind=ends}}   where {{# }} is not
 *     {{.}} {{@}}                         the element; its key, or its number from 1
 */
#ifndef SPIN_IO_TEMPLATE_H
#define SPIN_IO_TEMPLATE_H

#include "io/json.h"

/* html: values are escaped; else control characters in them become '?', as a terminal takes them for commands. */
void spin_template_write(FILE *to, const char *text, const spin_json *document, bool html);

#endif
