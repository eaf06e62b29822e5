/* Removes the previews of an earlier training, which would otherwise remain beside those of the new
 * one and look like its later iterations. */
#pragma once

/* Removes from this folder all files named as spin_test_views_preview() names them, and logs their
 * number. Does nothing if the folder cannot be read. */
void spin_former_previews_remove(const char *folder);
