#pragma once

#include "render/pixel_store.h"

namespace stuv {

/// The light field of brightness, (R + 2 G + B) / 4; that of bytes is u16. It reads from `store`, whose
/// light field has three channels and which must outlive it.
std::shared_ptr<const ViewSet> grey_views(PixelStore& store);

}  // namespace stuv
