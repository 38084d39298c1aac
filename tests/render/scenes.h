#pragma once

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <memory>

#include "render/view_set.h"

namespace stuv::test {

/// Colour of a point of the plane seen by a view: one channel, of plane coordinates in px.
using Texture = std::function<float(double x, double y)>;

/// Cheap, smooth enough for bilinear sampling, not periodic over a picture, 0..1.
inline float waves(double x, double y) {
  return static_cast<float>(0.5 + 0.2 * std::sin(0.45 * x + 0.2 * y) +
                            0.2 * std::sin(0.31 * y - 0.17 * x * 0.9) + 0.1 * std::sin(0.83 * x - 0.6 * y));
}

struct Lattice {
  int rows = 3, cols = 3;
  int width = 48, height = 40;
  double jitter = 0;     ///< of s, t, in spacings
  double off_plane = 0;  ///< of w, in spacings
  std::vector<std::pair<int, int>> holes = {};
};

/// Cameras at spacing 1, f = 40 px, parallel; pixels 0. Displacements are fixed waves: the same every time.
inline std::shared_ptr<ViewSet> make_views(const Lattice& lattice) {
  auto set = std::make_shared<ViewSet>();
  LightField& lf = set->lf;
  lf.width = lattice.width;
  lf.height = lattice.height;
  lf.channels = 1;
  lf.rows = lattice.rows;
  lf.cols = lattice.cols;
  lf.focal_px = 40;
  lf.metric = true;
  lf.cx0_px = (lattice.width - 1) / 2.0;
  lf.cy0_px = (lattice.height - 1) / 2.0;
  for (int row = 0; row < lattice.rows; ++row) {
    for (int col = 0; col < lattice.cols; ++col) {
      if (std::find(lattice.holes.begin(), lattice.holes.end(), std::pair(row, col)) != lattice.holes.end())
        continue;
      View view;
      const double k = row * 7 + col;
      view.name = std::to_string(row) + "_" + std::to_string(col);
      view.row = row;
      view.col = col;
      view.s = col + lattice.jitter * std::sin(12.9 * k + 1);
      view.t = row + lattice.jitter * std::sin(78.2 * k + 2);
      view.w = lattice.off_plane * std::sin(37.7 * k + 3);
      view.cx_px = lf.cx0_px;
      view.cy_px = lf.cy0_px;
      set->cameras.push_back(view);
      set->pixels.push_back({ImageF(lf.width, lf.height, 1), {}});
    }
  }
  lf.views = set->cameras;
  return set;
}

/// What `view` sees of a fronto-parallel textured plane of disparity d; texture coordinates are px of a view
/// at (0, 0, 0).
inline ImageF picture_of_plane(const LightField& lf, const View& view, double d, const Texture& texture) {
  ImageF image(lf.width, lf.height, 1);
  const double z = lf.focal_px / d;
  for (int y = 0; y < lf.height; ++y) {
    for (int x = 0; x < lf.width; ++x) {
      const double X = view.s + (x - view.cx_px) / lf.focal_px * (z - view.w);
      const double Y = view.t + (y - view.cy_px) / lf.focal_px * (z - view.w);
      image.at(x, y) = texture(X * d, Y * d);
    }
  }
  return image;
}

inline void paint_plane(ViewSet& set, double d, const Texture& texture) {
  for (std::size_t i = 0; i < set.cameras.size(); ++i)
    set.pixels[i].colour = picture_of_plane(set.lf, set.cameras[i], d, texture);
}

inline void paint_constant(ViewSet& set, float value) {
  for (ViewPixels& pixels : set.pixels)
    std::fill(pixels.colour.data.begin(), pixels.colour.data.end(), value);
}

/// Every view another picture, so that any mixing shows.
inline void paint_differently(ViewSet& set) {
  for (std::size_t i = 0; i < set.pixels.size(); ++i) {
    const double shift = 17.0 * static_cast<double>(i);
    for (int y = 0; y < set.lf.height; ++y)
      for (int x = 0; x < set.lf.width; ++x) set.pixels[i].colour.at(x, y) = waves(x + shift, y - shift);
  }
}

/// A plane of disparity 2 seen by 2x2 cameras, on disk.
inline LightField write_scene(const std::filesystem::path& folder, PixelType type, bool metric,
                              const Lattice& lattice = {.rows = 2, .cols = 2}) {
  const auto set = make_views(lattice);
  paint_plane(*set, 2, waves);
  LightField lf = set->lf;
  lf.folder = folder;
  lf.type = type;
  lf.metric = metric;
  lf.d_min = lf.d_max = std::nan("");
  for (std::size_t i = 0; i < lf.views.size(); ++i) {
    lf.views[i].file = "views/" + lf.views[i].name + ".tif";
    write_view(lf, lf.views[i], from_float(set->pixels[i].colour, lf.type));
  }
  write_manifest(lf);
  return lf;
}

}  // namespace stuv::test
