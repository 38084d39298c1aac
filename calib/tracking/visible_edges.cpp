#include "calib/tracking/visible_edges.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace stuv::tracking {
namespace {

/// A triangle seen from the eye at the origin: points with inside_i . x >= 0 and plane . x >= depth are
/// hidden.
struct Occluder {
  std::array<Eigen::Vector3d, 3> inside;
  Eigen::Vector3d plane;
  double depth = 0;
};

struct Interval {
  double from = 0, to = 1;
  /// Keeps the part where f0 + t (f1 - f0) >= 0; false if nothing is left.
  bool clip(double f0, double f1) {
    if (f0 < 0 && f1 < 0) return false;
    if (f0 < 0)
      from = std::max(from, f0 / (f0 - f1));
    else if (f1 < 0)
      to = std::min(to, f0 / (f0 - f1));
    return from < to;
  }
};

std::vector<Occluder> occluders_of(const ObjectModel& model, const std::vector<Eigen::Vector3d>& cam,
                                   double slack) {
  std::vector<Occluder> occluders;
  occluders.reserve(model.triangles.size());
  for (const auto& [i, j, k] : model.triangles) {
    Occluder o;
    Eigen::Vector3d n = (cam[j] - cam[i]).cross(cam[k] - cam[i]).normalized();
    double d = n.dot(cam[i]);
    const double flip = d < 0 ? -1 : 1;
    n *= flip;
    d *= flip;
    // Seen edge-on, or from a place on it: hides nothing.
    if (!(d > slack * 1e-3)) continue;
    o.plane = n;
    o.depth = d + slack;
    o.inside = {flip * cam[i].cross(cam[j]), flip * cam[j].cross(cam[k]), flip * cam[k].cross(cam[i])};
    occluders.push_back(o);
  }
  return occluders;
}

bool shows(const ObjectModel& model, const ObjectModel::Edge& edge, const Eigen::Vector3d& eye) {
  if (edge.sharp) return true;
  const auto front = [&](int face) {
    return model.face_normals[face].dot(eye - model.face_points[face]) > 0;
  };
  return front(edge.faces[0]) != front(edge.faces[1]);
}

void append_visible(int edge, const Interval& whole, std::vector<Interval>& hidden, double least,
                    std::vector<VisibleSegment>& out) {
  std::sort(hidden.begin(), hidden.end(),
            [](const Interval& a, const Interval& b) { return a.from < b.from; });
  double at = whole.from;
  for (const Interval& h : hidden) {
    if (h.from > at + least) out.push_back({edge, at, std::min(h.from, whole.to)});
    at = std::max(at, h.to);
  }
  if (whole.to > at + least) out.push_back({edge, at, whole.to});
}

}  // namespace

std::vector<VisibleSegment> visible_edges(const ObjectModel& model, const Pose& cam_from_object,
                                          double slack) {
  std::vector<Eigen::Vector3d> cam;
  cam.reserve(model.vertices.size());
  for (const Eigen::Vector3d& v : model.vertices) cam.push_back(cam_from_object * v);
  const std::vector<Occluder> occluders = occluders_of(model, cam, slack);
  const Eigen::Vector3d eye = cam_from_object.centre();
  std::vector<VisibleSegment> out;
  std::vector<Interval> hidden;
  for (std::size_t e = 0; e < model.edges.size(); ++e) {
    const ObjectModel::Edge& edge = model.edges[e];
    if (!shows(model, edge, eye)) continue;
    const Eigen::Vector3d &a = cam[edge.a], &b = cam[edge.b];
    Interval whole;
    if (!whole.clip(a.z() - slack, b.z() - slack)) continue;
    hidden.clear();
    for (const Occluder& o : occluders) {
      Interval h = whole;
      if (h.clip(o.plane.dot(a) - o.depth, o.plane.dot(b) - o.depth) &&
          h.clip(o.inside[0].dot(a), o.inside[0].dot(b)) && h.clip(o.inside[1].dot(a), o.inside[1].dot(b)) &&
          h.clip(o.inside[2].dot(a), o.inside[2].dot(b)))
        hidden.push_back(h);
    }
    append_visible(static_cast<int>(e), whole, hidden, 1e-9, out);
  }
  return out;
}

}  // namespace stuv::tracking
