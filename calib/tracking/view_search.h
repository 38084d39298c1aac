#pragma once

#include <vector>

#include "calib/tracking/texture.h"

namespace stuv::tracking {

/// A place in the frame that looks like a taught view.
struct ViewMatch {
  Pose cam_from_object;
  double correlation = 0;
};

/// Looks for the object as the taught views show it, anywhere in the frame: for objects with too few
/// keypoints to start from. Each view's picture of the object alone, made small (its longer side some 28 px),
/// turned by -20, 0, 20 degrees and scaled by 0.7 to 1.4, is slid over the frame made equally small;
/// zero-mean normalised correlation under the object's mask. A peak at pixel q with scale m and turn a stands
/// for the pose that looks nearly the same from there,
///
///   R = D Rz(a) R_view,  middle of the object at  ray(q) z_view / m,  D turns ray(q_view) to ray(q).
///
/// The `most` best peaks of at least `least` correlation, best first; of places and sizes that are much alike
/// the best only. Views must be of the camera that took the frame.
std::vector<ViewMatch> search_views(const std::vector<TexturedView>& views, const Grey& frame,
                                    const ImageF& rays, int most, double least = 0.4);

}  // namespace stuv::tracking
