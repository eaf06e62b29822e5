/* A text with places for values of a JSON document: the reports of the commands, and the page of an
 * evaluation.
 *
 *     {{splats.mean}}  {{times.0}}        a value; nothing where there is none; of an array how many it has
 *     {{{picture}}}                       in HTML: as it is, without escapes
 *     {{psnr %8.3f}} {{name %-8s}}        by printf's d, f, g or s; a dash in its width where there is none
 *     {{share %.1p}} {{share %.3P}}       a number times 100, as f or g
 *     {{size %B}} {{seconds %T}}          12.3 MB; 2 h 36 min
 *     {{mean %M}} {{frames %N frame}}     2940, or 2940.5 when it is not whole; 1 frame, 2 frames, 2.5 frames
 *     {{psnr %+.2f before}}               a number less another
 *     {{options}}                         an object: its members in lines
 *     {{#data}}...{{/}}                   where it is neither absent, null, false, the integer 0 nor empty; of an
 *                                         array once for each element, and names are first looked for in that
 *     {{*ranges}}...{{/}}                 once for each member of an object
 *     {{#kind=ends}} {{#least=@most}}     where it is this text or number, or what another has; absent is empty
 *     {{^data}}...{{/}}  {{^kind=ends}}   where {{# }} is not
 *     {{.}} {{@}}                         the element; its key, or its number from 1
 */
#pragma once

#include "io/json.h"

/* html: values are escaped; else control characters in them become '?', as a terminal takes them
 * for commands. */
void spin_template_write(FILE *to, const char *text, const spin_json *document, bool html);
