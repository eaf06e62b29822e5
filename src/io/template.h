/* A text with placeholders for values of a JSON document, for the reports of the commands and the
 * page of an evaluation.
 *
 *     {{splats.mean}} {{times.0}}       the value, the length of an array, or nothing if absent
 *     {{{figure}}}                      in HTML: the value without escaping
 *     {{psnr %8.3f}} {{name %-8s}}      formatted as by printf with d, f, g or s; a dash of the
 *                                       same width if absent
 *     {{share %.1p}} {{share %.3P}}     100 times the number, formatted as with f or g
 *     {{size %B}} {{seconds %T}}        12.3 MB; 2 h 36 min
 *     {{mean %M}} {{frames %N frame}}   2940, or 2940.5 if fractional; 1 frame, 2 frames
 *     {{psnr %+.2f before}}             the difference of two numbers, psnr - before
 *     {{options}}                       the members of an object, wrapped into several lines
 *     {{#data}}...{{/}}                 a section; omitted if the value is absent, null, false, the
 *                                       integer 0 or empty; for an array, repeated for each
 *                                       element, whose members hide names from outside
 *     {{*ranges}}...{{/}}               a section, repeated for each member of an object
 *     {{#kind=ends}} {{#least=@most}}   a section; omitted unless the value equals this text or
 *                                       number, or the value of another name; an absent value
 *                                       counts as ""
 *     {{^data}}...{{/}} {{^kind=ends}}  a section; omitted if {{# }} would show it
 *     {{.}} {{@}}                       the current element; its key, or its number from 1
 */
#pragma once

#include "io/json.h"

/* Write `text` to a stream, with placeholders replaced by values of the document. html: escape
 * values for HTML. Otherwise control characters in values become '?', since a terminal would
 * interpret them. */
void spin_template_write(FILE *to, const char *text, const spin_json *document, bool html);
