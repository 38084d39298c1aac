#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/light_field.h"
#include "core/view.h"

namespace stuv {

/// The input views that a renderer blends. Their pixels are either all in memory (`pixels`) or reached
/// through `reader`, which must then outlive the set.
struct ViewSet {
  LightField lf;
  std::vector<View> cameras;       ///< input views, without those that were left out
  std::vector<ViewPixels> pixels;  ///< beside `cameras`; a non-finite pixel is masked, its colour 0
  const LightFieldReader* reader = nullptr;
  std::vector<int> reader_index;  ///< beside `cameras`: number of the view in the reader's light field
  /// Instead of both: a set whose pixels are made from another's.
  std::function<ViewPixels(int camera, int x, int y, int width, int height)> source;

  /// Pixels [x, x + width) x [y, y + height) of a camera, non-finite ones masked.
  ViewPixels read(int camera, int x, int y, int width, int height) const;
};

/// Rows and columns of the lattice on which no camera stands are taken out, the others counted anew: along a
/// row the filters then count in cameras that are there. Otherwise, at the place of a missing camera, all
/// three would be the mean of its two neighbours, and nothing could be told to be in focus.
void drop_empty_lines(ViewSet& set);

/// All input views but those named in `leave_out`, which become holes of the lattice; their pixels stay on
/// disk. Throws Error if a name is no input view or none is left.
std::shared_ptr<const ViewSet> open_views(const LightFieldReader& reader,
                                          const std::vector<std::string>& leave_out = {});

/// The same with all pixels in memory, as `literal` needs them. Throws Error if a picture cannot be read.
std::shared_ptr<const ViewSet> load_views(const LightFieldReader& reader,
                                          const std::vector<std::string>& leave_out = {});

/// The viewpoint at (s, t, z) that looks as the views do, with their size, focal length and the principal
/// point that a view at (s, t) has: a parallel view on the plane then sees u = u_out - d (s_c - s).
Viewpoint default_viewpoint(const LightField& lf, double s, double t, double z = 0);

/// z of the surface through the cameras' centres, bilinear between them: real cameras stand a little off
/// their plane. A viewpoint there at a camera's (s, t) is on that camera.
double camera_surface_z(const LightField& lf, double s, double t);

/// The middle of the lattice: centre of the bounding box of the input views, on the cameras' surface.
Viewpoint middle_viewpoint(const LightField& lf);

/// The same view with another size: focal length scaled with the width, rows cropped or added evenly above
/// and below.
Viewpoint resized(const Viewpoint& view, int width, int height);

/// The view's axes are those of the light field's frame.
bool is_parallel(const Viewpoint& view);

/// Throws std::invalid_argument naming the value unless sizes and focal length are positive, everything is
/// finite, and, for a scene without metres, the view is parallel and on the plane (elsewhere its disparities
/// do not say what is seen).
void validate(const Viewpoint& view, const LightField& lf);

}  // namespace stuv
