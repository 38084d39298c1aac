#include "render/view_set.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "core/error.h"
#include "core/parallel.h"
#include "render/lattice_chart.h"

namespace stuv {
namespace {

/// Masks pixels that hold NaN or Inf, so that back ends need to know masks only.
void mask_non_finite(ViewPixels& view) {
  const int channels = view.colour.channels;
  for (int y = 0; y < view.colour.height; ++y) {
    for (int x = 0; x < view.colour.width; ++x) {
      float* pixel = &view.colour.at(x, y);
      if (std::all_of(pixel, pixel + channels, [](float v) { return std::isfinite(v); })) continue;
      if (view.mask.empty()) view.mask = Mask(view.colour.width, view.colour.height, 1, 255);
      view.mask.at(x, y) = 0;
      std::fill_n(pixel, channels, 0.0F);
    }
  }
}

}  // namespace

namespace {

/// Place of each line that is used, among those that are used.
std::vector<int> ranks_of(int lines, const std::vector<View>& cameras, int View::*line) {
  std::vector<int> rank(static_cast<std::size_t>(lines), 0);
  for (const View& camera : cameras) rank[static_cast<std::size_t>(camera.*line)] = 1;
  int next = 0;
  for (int& r : rank) r = r > 0 ? next++ : -1;
  return rank;
}

}  // namespace

void drop_empty_lines(ViewSet& set) {
  const std::vector<int> rows = ranks_of(set.lf.rows, set.cameras, &View::row);
  const std::vector<int> cols = ranks_of(set.lf.cols, set.cameras, &View::col);
  for (View& camera : set.cameras) {
    camera.row = rows[static_cast<std::size_t>(camera.row)];
    camera.col = cols[static_cast<std::size_t>(camera.col)];
  }
  set.lf.rows = 1 + *std::max_element(rows.begin(), rows.end());
  set.lf.cols = 1 + *std::max_element(cols.begin(), cols.end());
}

namespace {

std::shared_ptr<ViewSet> make_set(const LightFieldReader& reader, const std::vector<std::string>& leave_out) {
  auto set = std::make_shared<ViewSet>();
  set->lf = reader.light_field();
  set->reader = &reader;
  for (const std::string& name : leave_out) {
    const int index = set->lf.view_index(name);
    if (index < 0 || set->lf.views[static_cast<std::size_t>(index)].role != ViewRole::input)
      throw Error(set->lf.folder.string(), "has no input view " + name, "see the names in lightfield.json");
  }
  for (const int i : set->lf.views_with(ViewRole::input)) {
    const View& view = set->lf.views[static_cast<std::size_t>(i)];
    if (std::find(leave_out.begin(), leave_out.end(), view.name) != leave_out.end()) continue;
    set->reader_index.push_back(i);
    set->cameras.push_back(view);
  }
  if (set->cameras.empty()) throw Error(set->lf.folder.string(), "has no view left", "leave fewer views out");
  drop_empty_lines(*set);
  return set;
}

/// A part of a picture.
template <class T>
Raster<T> part_of(const Raster<T>& from, int x, int y, int width, int height) {
  Raster<T> out(width, height, from.channels);
  for (int row = 0; row < height; ++row)
    std::copy_n(&from.at(x, y + row), static_cast<std::size_t>(width) * from.channels, out.row(row));
  return out;
}

}  // namespace

ViewPixels ViewSet::read(int camera, int x, int y, int width, int height) const {
  const auto i = static_cast<std::size_t>(camera);
  if (source) return source(camera, x, y, width, height);
  ViewPixels out;
  if (pixels.empty()) {
    out = reader->read(reader_index[i], 0, x, y, width, height);
  } else {
    out.colour = part_of(pixels[i].colour, x, y, width, height);
    if (!pixels[i].mask.empty()) out.mask = part_of(pixels[i].mask, x, y, width, height);
  }
  mask_non_finite(out);
  return out;
}

std::shared_ptr<const ViewSet> open_views(const LightFieldReader& reader,
                                          const std::vector<std::string>& leave_out) {
  return make_set(reader, leave_out);
}

std::shared_ptr<const ViewSet> load_views(const LightFieldReader& reader,
                                          const std::vector<std::string>& leave_out) {
  const auto set = make_set(reader, leave_out);
  std::vector<ViewPixels> pixels(set->cameras.size());
  parallel_for(static_cast<int>(pixels.size()), [&](int i) {
    pixels[static_cast<std::size_t>(i)] = set->read(i, 0, 0, set->lf.width, set->lf.height);
  });
  set->pixels = std::move(pixels);
  return set;
}

Viewpoint default_viewpoint(const LightField& lf, double s, double t, double z) {
  Viewpoint view;
  view.s = s;
  view.t = t;
  view.z = z;
  view.focal_px = lf.focal_px;
  view.cx_px = lf.cx0_px + lf.convergence_px * s;
  view.cy_px = lf.cy0_px + lf.convergence_px * t;
  view.width = lf.width;
  view.height = lf.height;
  return view;
}

double camera_surface_z(const LightField& lf, double s, double t) {
  std::vector<View> cameras;
  for (const int i : lf.views_with(ViewRole::input)) cameras.push_back(lf.views[static_cast<std::size_t>(i)]);
  const LatticeChart chart(lf.rows, lf.cols, cameras);
  return chart.planar() ? 0 : chart.surface_w(chart.position({s, t, 0}, 0, 0));
}

Viewpoint middle_viewpoint(const LightField& lf) {
  constexpr double inf = std::numeric_limits<double>::infinity();
  double s_min = inf, s_max = -inf, t_min = inf, t_max = -inf;
  for (const int i : lf.views_with(ViewRole::input)) {
    const View& view = lf.views[static_cast<std::size_t>(i)];
    s_min = std::min(s_min, view.s);
    s_max = std::max(s_max, view.s);
    t_min = std::min(t_min, view.t);
    t_max = std::max(t_max, view.t);
  }
  const double s = (s_min + s_max) / 2, t = (t_min + t_max) / 2;
  return default_viewpoint(lf, s, t, camera_surface_z(lf, s, t));
}

Viewpoint resized(const Viewpoint& view, int width, int height) {
  const double scale = static_cast<double>(width) / view.width;
  Viewpoint out = view;
  out.width = width;
  out.height = height;
  out.focal_px = view.focal_px * scale;
  // Pixel 0 is a centre, so edges lie at -0.5.
  out.cx_px = (view.cx_px + 0.5) * scale - 0.5;
  out.cy_px = (view.cy_px + 0.5) * scale - 0.5 + (height - view.height * scale) / 2;
  return out;
}

bool is_parallel(const Viewpoint& view) { return view.view_from_scene == Eigen::Matrix3d::Identity(); }

void validate(const Viewpoint& view, const LightField& lf) {
  if (view.width <= 0 || view.height <= 0)
    throw std::invalid_argument("Viewpoint: width and height must be > 0");
  if (!std::isfinite(view.focal_px) || view.focal_px <= 0)
    throw std::invalid_argument("Viewpoint: focal_px must be > 0");
  for (const double value : {view.s, view.t, view.z, view.cx_px, view.cy_px})
    if (!std::isfinite(value)) throw std::invalid_argument("Viewpoint: s, t, z, cx_px, cy_px must be finite");
  if (!view.view_from_scene.allFinite())
    throw std::invalid_argument("Viewpoint: view_from_scene must be finite");
  if (!lf.metric && (view.z != 0 || !is_parallel(view)))
    throw std::invalid_argument(
        "Viewpoint: a scene without metres has parallel views on its plane only (z = 0)");
}

}  // namespace stuv
