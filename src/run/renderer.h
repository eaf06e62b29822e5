/* The renderer that exporters receive (struct spin_renderer of spin.h). */
#pragma once

#include "render/player.h"

struct spin_renderer {
    struct spin_player player;
};
