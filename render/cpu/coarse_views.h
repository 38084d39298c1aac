#pragma once

#include "render/pixel_store.h"

namespace stuv {

/// Fine pixels along each side of a coarse one.
inline constexpr int kCoarse = 4;

/// The light field at a quarter of its size: means of 4x4 pixels, everything measured in px scaled with it.
/// It reads from `store`, which must outlive it.
std::shared_ptr<const ViewSet> coarse_views(PixelStore& store);
Viewpoint coarse_viewpoint(const Viewpoint& view);
RenderOptions coarse_options(const RenderOptions& options);

}  // namespace stuv
