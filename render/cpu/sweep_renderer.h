#pragma once

#include "render/pixel_store.h"
#include "render/renderer.h"

namespace stuv {

/// Method `exact` on the CPU: the picture of `literal`, every plane evaluated on blocks that fit the caches.
std::unique_ptr<Renderer> make_cpu_exact_renderer(std::shared_ptr<const ViewSet> views);

}  // namespace stuv
