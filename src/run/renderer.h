/* Defines struct spin_renderer of spin.h, the renderer that exporters receive. */
#pragma once

#include "render/player.h"

struct spin_renderer {
    struct spin_player player;
};
