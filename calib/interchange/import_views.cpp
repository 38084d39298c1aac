#include "calib/interchange/import_views.h"

#include <fmt/format.h>

#include <atomic>
#include <cmath>
#include <mutex>

#include "core/error.h"
#include "core/image_io.h"
#include "core/parallel.h"

namespace stuv {
namespace {

/// Principal points of views that converge at Z0: a point there, straight before the lattice's middle, is in
/// the middle of every picture, so cx(s) = centre + f / Z0 (s - middle).
void set_principal_points(LightField& lf) {
  double s = 0, t = 0;
  const std::vector<int> inputs = lf.views_with(ViewRole::input);
  for (const int i : inputs) {
    s += lf.views[i].s / static_cast<double>(inputs.size());
    t += lf.views[i].t / static_cast<double>(inputs.size());
  }
  lf.cx0_px = 0.5 * (lf.width - 1) - lf.convergence_px * s;
  lf.cy0_px = 0.5 * (lf.height - 1) - lf.convergence_px * t;
  for (View& view : lf.views) {
    view.cx_px = lf.cx0_px + lf.convergence_px * view.s;
    view.cy_px = lf.cy0_px + lf.convergence_px * view.t;
  }
}

}  // namespace

LightField import_views(const std::filesystem::path& source, const std::filesystem::path& folder,
                        const ImportOptions& options, const Reporter& reporter) {
  const std::vector<ListedView> listed = list_views(source, options.layout);
  const ImageInfo info = read_image_info(listed.front().file);
  LightField lf;
  lf.folder = folder;
  lf.width = info.width;
  lf.height = info.height;
  lf.channels = info.channels;
  lf.type = info.type;
  lf.metric = options.focal_px > 0;
  lf.focal_px = lf.metric ? options.focal_px : info.width;
  lf.convergence_px = lf.metric ? lf.focal_px / options.converge_m : 0;
  lf.d_min = options.d_min;
  lf.d_max = options.d_max;
  lf.produced_by = {{"command", "import"}, {"stuv", STUV_VERSION}, {"source", source.filename().string()}};
  for (const ListedView& entry : listed) {
    View view;
    view.name = entry.file.stem().string();
    view.file = fmt::format("views/{}.tif", view.name);
    view.role = entry.role;
    view.s = entry.s;
    view.t = entry.t;
    if (lf.view_index(view.name) >= 0)
      throw Error(source.string(), fmt::format("lists view {} twice", view.name), "remove one");
    lf.views.push_back(std::move(view));
  }
  place_on_lattice(lf, source.string());
  set_principal_points(lf);

  std::size_t done = 0;
  std::mutex mutex;
  parallel_for(static_cast<int>(listed.size()), [&](int i) {
    const Image image = read_image(listed[i].file);
    if (image.width != lf.width || image.height != lf.height || image.channels != lf.channels)
      throw Error(listed[i].file.string(),
                  fmt::format("is {}x{} with {} channels, the first view {}x{} with {}", image.width,
                              image.height, image.channels, lf.width, lf.height, lf.channels),
                  "all views need one size");
    write_view(lf, lf.views[i], image);
    const std::lock_guard lock(mutex);
    reporter.at("importing views", ++done, listed.size());
  });
  write_manifest(lf);
  return lf;
}

}  // namespace stuv
