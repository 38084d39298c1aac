#pragma once

#include "render/pixel_store.h"
#include "render/renderer.h"

namespace stuv {

/// Method `fast` on the CPU: `exact` on what is left after leaving out what the scene does not need (Skips).
///
/// A coarse pass sweeps all planes over the picture at a quarter of its size. A tile of the picture is then
/// evaluated on the planes that the pass chose in or next to it and on their neighbours. Tiles that look the
/// same on every plane take the pass's plane as it is. A picture close to the one before takes its planes,
/// moved by their own disparity, instead of the pass. Statistics name what each of these left out. Confidence
/// is relative to the planes that were evaluated. The result depends on the pictures before it only, not on
/// the number of threads.
std::unique_ptr<Renderer> make_cpu_fast_renderer(std::shared_ptr<const ViewSet> views);

}  // namespace stuv
