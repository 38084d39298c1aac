#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/json.h"

namespace stuv {

// A light field database is a folder: lightfield.json and views/NAME.tif, tiled and mip-mapped by OpenImageIO
// (alpha 0 where a pixel is missing), which ordinary picture viewers open.

enum class ViewRole {
  input,  ///< a camera of the lattice
  truth   ///< a held-out picture, for comparison only
};

/// One picture of the light field. A point at X, Y, Z of the plane's frame is seen at
///   u = cx_px + f (X - s) / (Z - w),   v = cy_px + f (Y - t) / (Z - w).
struct View {
  std::string name;
  std::string file;  ///< relative to the folder
  ViewRole role = ViewRole::input;
  int row = 0, col = 0;         ///< on the lattice (input views)
  double s = 0, t = 0, w = 0;   ///< measured position, in the scene's unit
  double cx_px = 0, cy_px = 0;  ///< principal point of this view; moves with (s, t) in converged scenes
};

/// The manifest. The pixels stay on disk: LightFieldReader reaches them.
struct LightField {
  std::filesystem::path folder;
  int width = 0, height = 0, channels = 3;
  PixelType type = PixelType::u8;
  int rows = 0, cols = 0;
  std::vector<View> views;

  /// Focal length [px]. Without metres it is nominal: only products f / Z, which are disparities, are
  /// meaningful.
  double focal_px = 0;
  bool metric = false;  ///< s, t, w and Z are metres and focal_px is real
  /// q = f / Z0 [px per unit of s] of a scene whose views converge at Z0; 0: parallel. The principal point of
  /// a view at s is cx_px(s) = cx0_px + q s; in the same way cy.
  double convergence_px = 0;
  double cx0_px = 0, cy0_px = 0;
  /// Range of d = f / Z - q [px per unit of s] in which the scene lies; both NaN if unknown.
  double d_min = 0, d_max = 0;
  Json produced_by;

  int view_index(const std::string& name) const;  ///< -1 if there is none
  std::vector<int> views_with(ViewRole role) const;
  bool has_range() const { return d_min <= d_max; }
  /// 1 / Z of the plane of disparity d; 0 is infinity, negative lies beyond.
  double inverse_depth(double d) const { return (d + convergence_px) / focal_px; }
  double disparity(double inverse_z) const { return focal_px * inverse_z - convergence_px; }
};

LightField open_light_field(const std::filesystem::path& folder);
/// Writes lightfield.json into lf.folder.
void write_manifest(const LightField& lf);

/// Writes one view's picture, tiled and mip-mapped, to lf.folder / view.file.
void write_view(const LightField& lf, const View& view, const Image& image);

struct ViewPixels {
  ImageF colour;  ///< 0..1 for integer types; 0 where missing
  Mask mask;      ///< empty: all there
};

/// Reads pixels of views tile by tile; keeps a bounded number of files open. Thread-safe.
class LightFieldReader {
 public:
  explicit LightFieldReader(LightField lf);
  ~LightFieldReader();
  LightFieldReader(LightFieldReader&&) noexcept;

  const LightField& light_field() const { return lf_; }
  /// Pixels [x, x + width) x [y, y + height) of a view at a mip level (0: full size). Must lie inside the
  /// picture.
  ViewPixels read(int view, int level, int x, int y, int width, int height) const;
  ViewPixels read(int view) const;

 private:
  struct Files;
  LightField lf_;
  std::unique_ptr<Files> files_;
};

}  // namespace stuv
