#include "calib/two_view/rectify_pair.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "calib/two_view/fundamental.h"

namespace stuv {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector2i;
using Eigen::Vector3d;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

std::array<Vector2d, 4> corners_of(const Vector2i& size) {
  const double w = size.x() - 1, h = size.y() - 1;
  return {Vector2d(0, 0), Vector2d(w, 0), Vector2d(w, h), Vector2d(0, h)};
}

/// Signed so that the third coordinate is positive in the middle; false if it changes `most` times over the
/// corners.
bool orient(Matrix3d& H, const Vector2i& size, double most) {
  if (H.row(2).dot(Vector3d(0.5 * size.x(), 0.5 * size.y(), 1)) < 0) H = -H;
  double low = std::numeric_limits<double>::infinity(), high = 0;
  for (const Vector2d& c : corners_of(size)) {
    const double w = H.row(2).dot(c.homogeneous());
    if (!(w > 0)) return false;
    low = std::min(low, w);
    high = std::max(high, w);
  }
  return high < most * low;
}

/// Row 0 replaced by r0 + s r1 scaled so that the lines through the middles of opposite sides stay
/// perpendicular and keep their proportion (Loop, Zhang, CVPR 1999, section 6).
void shear(Matrix3d& H, const Vector2i& size) {
  const double w = size.x(), h = size.y();
  const auto at = [&](double x, double y) { return Vector2d((H * Vector3d(x, y, 1)).hnormalized()); };
  const Vector2d x = at(w, 0.5 * h) - at(0, 0.5 * h), y = at(0.5 * w, h) - at(0.5 * w, 0);
  const double d = x.y() * y.x() - x.x() * y.y();
  if (!(std::abs(d) > 1e-9)) return;
  double a = (h * h * x.y() * x.y() + w * w * y.y() * y.y()) / (h * w * d);
  double b = (h * h * x.x() * x.y() + w * w * y.x() * y.y()) / (-h * w * d);
  if (a < 0) a = -a, b = -b;
  Matrix3d S = Matrix3d::Identity();
  S(0, 0) = a;
  S(0, 1) = b;
  H = S * H;
}

cv::Mat as_mat(const ImageF& image) {
  return {image.height, image.width, CV_MAKETYPE(CV_32F, image.channels),
          const_cast<float*>(image.data.data())};
}

/// The picture at the places of `from`; masked where they are NaN.
Image sampled(const Image& picture, const ImageF& from) {
  const ImageF pixels = to_float(picture);
  ImageF out(from.width, from.height, pixels.channels);
  cv::Mat target = as_mat(out);
  cv::remap(as_mat(pixels), target, as_mat(from), cv::noArray(), cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  Image image = from_float(out, picture.type);
  image.mask = Mask(from.width, from.height, 1);
  for (int y = 0; y < from.height; ++y)
    for (int x = 0; x < from.width; ++x) image.mask.at(x, y) = std::isfinite(from.at(x, y)) ? 255 : 0;
  return image;
}

bool inside(const Vector2d& p, const Image& picture) {
  return p.x() >= 0 && p.y() >= 0 && p.x() <= picture.width - 1 && p.y() <= picture.height - 1;
}

ImageF planar_map(const Image& picture, const Matrix3d& H, int width, int height) {
  ImageF from(width, height, 2, kNaN);
  const Matrix3d inverse = H.inverse();
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const Vector2d p = (inverse * Vector3d(x, y, 1)).hnormalized();
      if (!inside(p, picture)) continue;
      from.at(x, y, 0) = static_cast<float>(p.x());
      from.at(x, y, 1) = static_cast<float>(p.y());
    }
  return from;
}

/// The half lines of one picture: origin e, a direction a row.
struct Pencil {
  Vector2d e;
  std::vector<Vector2d> direction;
  double nearest = 0, farthest = 0;
  bool inwards = false;  ///< columns run towards e
};

/// Distances from e between which the picture lies.
void measure(Pencil& pencil, const Image& picture) {
  const Vector2i size(picture.width, picture.height);
  pencil.farthest = 0;
  for (const Vector2d& c : corners_of(size))
    pencil.farthest = std::max(pencil.farthest, (c - pencil.e).norm());
  const Vector2d closest(std::clamp(pencil.e.x(), 0.0, size.x() - 1.0),
                         std::clamp(pencil.e.y(), 0.0, size.y() - 1.0));
  pencil.nearest = (closest - pencil.e).norm();
}

ImageF polar_map(const Image& picture, const Pencil& pencil) {
  const int width = static_cast<int>(std::ceil(pencil.farthest - pencil.nearest)) + 1;
  ImageF from(width, static_cast<int>(pencil.direction.size()), 2, kNaN);
  for (int y = 0; y < from.height; ++y)
    for (int x = 0; x < width; ++x) {
      const double distance = pencil.inwards ? pencil.farthest - x : pencil.nearest + x;
      const Vector2d p = pencil.e + distance * pencil.direction[y];
      if (!inside(p, picture)) continue;
      from.at(x, y, 0) = static_cast<float>(p.x());
      from.at(x, y, 1) = static_cast<float>(p.y());
    }
  return from;
}

/// Direction, from e', of the half line of B that belongs to the half line (e, d) of A; its sign is still
/// free.
Vector2d transferred(const Matrix3d& F, const Vector2d& e, const Vector2d& d) {
  const Vector3d l = F * Vector3d(e.x() + d.x(), e.y() + d.y(), 1);
  return Vector2d(l.y(), -l.x()).normalized();
}

/// Angles of A's half lines between which the picture lies, from the first on, anticlockwise or not as it
/// comes.
std::pair<double, double> angles(const Vector2d& e, const Image& picture) {
  if (inside(e, picture)) return {-M_PI, M_PI};
  const Vector2d middle(0.5 * picture.width, 0.5 * picture.height), axis = (middle - e).normalized();
  const double middle_angle = std::atan2(axis.y(), axis.x());
  double low = 0, high = 0;
  for (const Vector2d& c : corners_of({picture.width, picture.height})) {
    const Vector2d d = c - e;
    const double angle = std::atan2(axis.x() * d.y() - axis.y() * d.x(), axis.dot(d));
    low = std::min(low, angle);
    high = std::max(high, angle);
  }
  return {middle_angle + low, middle_angle + high};
}

}  // namespace

std::optional<RectifyingHomographies> rectifying_homographies(const Matrix3d& F, const Matches& inliers,
                                                              const Vector2i& size_a, const Vector2i& size_b,
                                                              double most_stretch) {
  if (inliers.size() < 8) return std::nullopt;
  const Vector2d middle = 0.5 * size_b.cast<double>();
  Matrix3d T = Matrix3d::Identity();
  T.topRightCorner<2, 1>() = -middle;
  const Vector3d e_b = epipole_b(F);
  Vector3d e = T * e_b;
  if (e.x() < 0) e = -e;  // turned the shorter way
  const double r = e.head<2>().norm();
  if (!(r > 1e-12)) return std::nullopt;
  Matrix3d R = Matrix3d::Identity();
  R.topLeftCorner<2, 2>() << e.x() / r, e.y() / r, -e.y() / r, e.x() / r;
  Matrix3d G = Matrix3d::Identity();
  G(2, 0) = -e.z() / r;
  RectifyingHomographies H;
  H.b = G * R * T;
  if (!orient(H.b, size_b, most_stretch)) return std::nullopt;
  shear(H.b, size_b);
  // A: rows 1 and 2 of H_b ([e']_x F + e' v^T) do not depend on v; v only has to keep it regular.
  const Vector3d v = (cross_matrix(e_b) * F).row(0).cross((cross_matrix(e_b) * F).row(1)).normalized();
  H.a = H.b * (cross_matrix(e_b) * F + (cross_matrix(e_b) * F).norm() * e_b * v.transpose());
  if (!orient(H.a, size_a, most_stretch)) return std::nullopt;
  Eigen::Matrix3d AtA = Matrix3d::Zero();
  Vector3d Atb = Vector3d::Zero();
  for (const Match& m : inliers) {
    const Vector2d p = (H.a * m.a.homogeneous()).hnormalized(), q = (H.b * m.b.homogeneous()).hnormalized();
    const Vector3d x = p.homogeneous();
    AtA += x * x.transpose();
    Atb += q.x() * x;
  }
  Matrix3d fit = Matrix3d::Identity();
  fit.row(0) = AtA.ldlt().solve(Atb).transpose();
  H.a = fit * H.a;
  if (!H.a.allFinite() || !H.b.allFinite() || !(H.a.determinant() > 0)) return std::nullopt;
  return H;
}

RectifyingHomographies rectifying_homographies(const Matrix3d& K_a, const Matrix3d& K_b,
                                               const Pose& b_from_a) {
  const Vector3d baseline = b_from_a.centre();  // of B in A's frame
  Vector3d x = baseline.normalized();
  const Vector3d z_mean = Vector3d::UnitZ() + b_from_a.R.row(2).transpose();
  const Vector3d right = Vector3d::UnitX() + b_from_a.R.row(0).transpose();
  if (x.dot(right) < 0) x = -x;
  const Vector3d y = z_mean.cross(x).normalized();
  Matrix3d R;
  R << x.transpose(), y.transpose(), x.cross(y).transpose();
  return {K_a * R * K_a.inverse(), K_a * R * b_from_a.R.transpose() * K_b.inverse()};
}

RectifiedPair rectify_planar(const Image& a, const Image& b, const RectifyingHomographies& H) {
  RectifiedPair pair;
  const auto box_of = [](const Matrix3d& h, const Image& picture) {
    Eigen::AlignedBox2d box;
    for (const Vector2d& c : corners_of({picture.width, picture.height}))
      box.extend(Vector2d((h * c.homogeneous()).hnormalized()));
    return box;
  };
  const Eigen::AlignedBox2d box_a = box_of(H.a, a), box_b = box_of(H.b, b);
  // Rows that only one picture has are of no use.
  const double top = std::max(box_a.min().y(), box_b.min().y()),
               bottom = std::min(box_a.max().y(), box_b.max().y());
  const double left = std::min(box_a.min().x(), box_b.min().x()),
               right = std::max(box_a.max().x(), box_b.max().x());
  const int height = std::clamp(static_cast<int>(bottom - top) + 1, 1, 2 * std::max(a.height, b.height));
  const int width = std::clamp(static_cast<int>(right - left) + 1, 1, 2 * std::max(a.width, b.width));
  Matrix3d shift = Matrix3d::Identity();
  shift(0, 2) = -left;
  shift(1, 2) = -top;
  pair.H_a = shift * H.a;
  pair.H_b = shift * H.b;
  pair.from_a = planar_map(a, pair.H_a, width, height);
  pair.from_b = planar_map(b, pair.H_b, width, height);
  pair.a = sampled(a, pair.from_a);
  pair.b = sampled(b, pair.from_b);
  return pair;
}

std::optional<RectifiedPair> rectify_polar(const Image& a, const Image& b, const Matrix3d& F,
                                           const Matches& inliers) {
  const Vector3d ea = epipole_a(F), eb = epipole_b(F);
  if (std::abs(ea.z()) < 1e-9 || std::abs(eb.z()) < 1e-9) return std::nullopt;
  Pencil pa, pb;
  pa.e = ea.hnormalized();
  pb.e = eb.hnormalized();
  measure(pa, a);
  measure(pb, b);
  int forward = 0;
  for (const Match& m : inliers)
    forward += transferred(F, pa.e, (m.a - pa.e).normalized()).dot(m.b - pb.e) > 0 ? 1 : -1;
  const double sign = forward >= 0 ? 1 : -1;
  const auto [low, high] = angles(pa.e, a);
  // Neighbouring half lines lie at most a pixel apart at the far end, in both pictures.
  constexpr int kMostRows = 20000;
  for (double angle = low; angle < high && pa.direction.size() < kMostRows;) {
    const Vector2d d(std::cos(angle), std::sin(angle));
    pa.direction.push_back(d);
    pb.direction.push_back(sign * transferred(F, pa.e, d));
    const double step = 1 / std::max(1.0, pa.farthest);
    const Vector2d next(std::cos(angle + step), std::sin(angle + step));
    const double turned = (sign * transferred(F, pa.e, next) - pb.direction.back()).norm();
    angle += step / std::max(1.0, turned * pb.farthest);
  }
  // Left of the epipole, where angles grow upwards and distances leftwards, both would stand on their heads.
  if (!inside(pa.e, a) && pa.e.x() > 0.5 * a.width)
    for (Pencil* pencil : {&pa, &pb}) {
      std::reverse(pencil->direction.begin(), pencil->direction.end());
      pencil->inwards = true;
    }
  RectifiedPair pair;
  pair.polar = true;
  // Columns are distances from the epipole; each picture begins where it does.
  pair.from_a = polar_map(a, pa);
  pair.from_b = polar_map(b, pb);
  pair.a = sampled(a, pair.from_a);
  pair.b = sampled(b, pair.from_b);
  return pair;
}

std::optional<RectifiedPair> rectify_pair(const Image& a, const Image& b, const Matrix3d& F,
                                          const Matches& inliers) {
  if (const auto H = rectifying_homographies(F, inliers, {a.width, a.height}, {b.width, b.height}))
    return rectify_planar(a, b, *H);
  return rectify_polar(a, b, F, inliers);
}

namespace {

std::optional<Vector2d> place_in(const ImageF& from, const Matrix3d& H, const Vector2d& p) {
  if (H.norm() > 0) return Vector2d((H * p.homogeneous()).hnormalized());
  double best = 1.0;
  std::optional<Vector2d> place;
  for (int y = 0; y < from.height; ++y)
    for (int x = 0; x < from.width; ++x) {
      const double d = std::hypot(from.at(x, y, 0) - p.x(), from.at(x, y, 1) - p.y());
      if (d < best) best = d, place = Vector2d(x, y);
    }
  return place;
}

}  // namespace

std::optional<Match> rectified(const RectifiedPair& pair, const Match& m) {
  const auto a = place_in(pair.from_a, pair.H_a, m.a), b = place_in(pair.from_b, pair.H_b, m.b);
  if (!a || !b) return std::nullopt;
  return Match{*a, *b};
}

}  // namespace stuv
