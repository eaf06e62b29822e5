/* A text with placeholders for values of a JSON document, for the reports of the commands and the
 * page of an evaluation.
 *
 *     {{splats.mean}}  {{times.0}}      a value, or nothing if absent; length of an array
 *     {{{figure}}}                      in HTML: without escaping
 *     {{psnr %8.3f}} {{name %-8s}}      with printf's d, f, g or s; if absent a dash, as wide
 *     {{share %.1p}} {{share %.3P}}     a number times 100, as f or g
 *     {{size %B}} {{seconds %T}}        12.3 MB; 2 h 36 min
 *     {{mean %M}} {{frames %N frame}}   2940, or 2940.5 if fractional; 1 frame, 2 frames
 *     {{psnr %+.2f before}}             a number minus another
 *     {{options}}                       an object: its members on lines
 *     {{#data}}...{{/}}                 if not absent, null, false, the integer 0 or empty; for
 *                                       an array, once per element, where names are looked up first
 *     {{*ranges}}...{{/}}               once per member of an object
 *     {{#kind=ends}} {{#least=@most}}   if it equals this text or number, or another value;
 *                                       absent equals ""
 *     {{^data}}...{{/}} {{^kind=ends}}  if {{# }} does not apply
 *     {{.}} {{@}}                       the element; its key, or its number from 1
 */
#pragma once

#include "io/json.h"

/* html: escape values; otherwise control characters in values become '?', since a terminal would
 * interpret them. */
void spin_template_write(FILE *to, const char *text, const spin_json *document, bool html);
