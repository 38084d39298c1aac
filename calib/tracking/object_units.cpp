#include "calib/tracking/object_units.h"

#include <algorithm>

namespace stuv::tracking {

ObjectModel normalised(ObjectModel model, const Normalisation& n) {
  for (Eigen::Vector3d& v : model.vertices) v = n.point(v);
  for (Eigen::Vector3d& v : model.face_points) v = n.point(v);
  return model;
}

Twist one_pixel(double z, double focal_px) {
  Twist s;
  const double side = z / focal_px;
  s << side, side, side * std::max(1.0, z), side, side, side;
  return s;
}

Twist in_object(const Pose& cam_from_object, const Twist& cam) {
  Twist t;
  t << cam_from_object.R.transpose() * cam.head<3>(), cam_from_object.R.transpose() * cam.tail<3>();
  return t;
}

double distance_px(const Pose& a, const Pose& b, double focal_px) {
  const Twist d = log(a.inverse() * b);
  Twist cam;
  cam << a.R * d.head<3>(), a.R * d.tail<3>();
  return cam.cwiseQuotient(one_pixel(a.t.z(), focal_px)).cwiseAbs().maxCoeff();
}

}  // namespace stuv::tracking
