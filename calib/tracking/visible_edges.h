#pragma once

#include <vector>

#include "calib/tracking/object_model.h"
#include "core/pose.h"

namespace stuv::tracking {

/// A part of a model edge: the points a + t (b - a) of the object, t between.
struct VisibleSegment {
  int edge = 0;
  double t0 = 0, t1 = 1;
};

/// The parts of the model's edges that no face hides from the camera: exact hidden-line removal.
///
/// An edge counts if it is sharp, or if it parts a face seen from the front from one seen from behind. In
/// the camera's frame a triangle hides the points behind its plane inside the pyramid from the eye through
/// its sides; both are half-spaces, so what it hides of an edge is one interval, found by clipping, and the
/// visible parts are what all intervals leave. Faces are opaque from both sides. A point lies behind a plane
/// if it is more than `slack` farther along the plane's normal (1e-3 of the object's radius is right), so
/// faces do not hide their own edges. Points nearer than `slack` to the plane z = 0 are cut off.
/// Independent of the lens. Cost: edges times triangles, about 50 ns each.
std::vector<VisibleSegment> visible_edges(const ObjectModel& model, const Pose& cam_from_object,
                                          double slack);

}  // namespace stuv::tracking
