#pragma once

#include <vector>

#include "calib/tracking/measurement.h"
#include "calib/tracking/object_model.h"

namespace stuv::tracking {

/// Directions (x/z, y/z) of all pixels, made once a camera: 2 channels.
ImageF rays_of(const Camera& camera);

/// Depth along the camera's axis in a box of the picture whose first pixel is (x0, y0), Inf where there is no
/// object, and the face that is seen there, -1: none.
struct DepthPatch {
  int x0 = 0, y0 = 0;
  ImageF depth;
  Raster<int> face;
};

/// Every triangle is intersected with the pixels' rays, so the lens does not matter. Triangles that reach
/// nearer than `slack` to the camera are left out. With a stride only every so many rows and columns are
/// made.
DepthPatch render_depth(const ObjectModel& model, const Lens& lens, const ImageF& rays,
                        const Pose& cam_from_object, double slack, int stride = 1);

/// A picture of the object taken at a known pose: what the object looks like.
struct TexturedView {
  Grey picture;
  Pose cam_from_object;
  DepthPatch depth;
};

/// The object as a taught view shows it, moved to another pose: `picture` and `seen` (255 where the taught
/// view saw the same side of the surface, no more than 75 degrees slanted) have the size of the depth patch.
struct WarpedView {
  DepthPatch depth;
  Grey picture, seen;
};
WarpedView warp_view(const TexturedView& view, const ObjectModel& model, const Lens& lens, const ImageF& rays,
                     const Pose& to_cam_from_object, double slack, int stride = 1);

/// Where points of the object's surface lie in the frame: corners of the warped view, followed into the frame
/// by pyramidal Lucas-Kanade and back; a point that does not come back within 0.5 px is dropped. As the view
/// is warped from the taught picture by the pose's own geometry, errors do not add up from frame to frame.
std::vector<PointMatch> follow_texture(const WarpedView& warped, const Grey& frame, const ImageF& rays,
                                       const Pose& cam_from_object, int most_points);

/// Zero-mean normalised correlation of the warped view with the frame over the seen pixels, freed of what
/// their noise takes from it: contrast is what the variance is above the pictures' noise. NaN with fewer than
/// 100 pixels, or if the warped view has no more contrast than twice the noise: a plain side looks like any.
double correlation(const WarpedView& warped, const Grey& frame);

/// Standard deviation of a picture's noise [grey levels], from the median of its second differences
/// (Immerkaer, CVIU 64(2), 1996, with the median in place of the mean: texture is no noise).
double noise_of(const Grey& picture);

}  // namespace stuv::tracking
