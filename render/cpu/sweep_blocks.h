#pragma once

#include <vector>

#include "render/cpu/sweep.h"

namespace stuv {

/// Blocks of equal size, about `width` x `height`.
std::vector<PixelRect> blocks_of(const Viewpoint& view, int width, int height);

/// Large enough that the halo of the window is a small part, small enough for every thread to get some.
std::vector<PixelRect> exact_blocks(const Sweep& sweep);

/// The size alone.
RenderedView unset_picture(const Viewpoint& view, int channels);

/// Black, no plane, confidence 0.
RenderedView empty_picture(const Viewpoint& view, int channels);

}  // namespace stuv
