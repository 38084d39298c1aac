#include "calib/tracking/surface_view.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <random>

namespace stuv::tracking {
namespace {

/// Cosine of the steepest slant at which a surface is taught, 75 degrees, and compared: 84 degrees. A side
/// that is seen steeply says that the background is not there.
constexpr double kLeastSlant = 0.26, kLeastSeen = 0.1;
/// Least standard deviation of a view's brightness, and of the print on its faces [grey levels].
constexpr double kLeastContrast = 2.5, kLeastPrint = 5;
/// Differences in brightness below this are no pattern [grey levels]; gains of the exposure that are fitted.
constexpr double kPattern = 10, kLeastGain = 0.4, kMostGain = 2.5;
/// Smoothing of the finest level.
constexpr double kSmooth_px = 1;
/// How far inside the outline points lie, as part of the object's size, and at most [px]: where the outline
/// is off by more than a little, points near it see the background.
constexpr double kInside = 0.04, kMostInside_px = 2;
/// Points that must face the camera, and as part of all.
constexpr int kLeastPoints = 30;
constexpr double kLeastPart = 1.0 / 3;
/// Neighbouring residuals go wrong together: this many count as one.
constexpr double kAlike = 30;
/// The object's surface is off its model by this much in places, which a gradient turns into brightness [px].
constexpr double kModelError_px = 0.6;
/// Least deviation of the brightness: light and lens do not repeat better [grey levels].
constexpr double kLeastDeviation = 2;
constexpr int kSteps = 8;

cv::Mat mat_of(const ImageF& picture) {
  return {picture.height, picture.width, CV_32F, const_cast<float*>(picture.data.data())};
}

/// The levels of one float picture, as matrices.
std::array<cv::Mat, SmoothPyramid::count> levels_of(const cv::Mat& picture) {
  std::array<cv::Mat, SmoothPyramid::count> levels;
  cv::GaussianBlur(picture, levels[0], {}, kSmooth_px);
  for (int l = 1; l < SmoothPyramid::count; ++l) cv::pyrDown(levels[l - 1], levels[l]);
  return levels;
}

cv::Mat float_of(const Grey& picture) {
  cv::Mat out;
  cv::Mat(picture.height, picture.width, CV_8U, const_cast<std::uint8_t*>(picture.data.data()))
      .convertTo(out, CV_32F);
  return out;
}

/// Bilinear; false outside.
template <class Picture>
bool sample(const Picture& at, int width, int height, double x, double y, float& value) {
  if (!(x >= 0 && y >= 0 && x < width - 1 && y < height - 1)) return false;
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const float fx = static_cast<float>(x - ix), fy = static_cast<float>(y - iy);
  const float *a = at(iy) + ix, *b = at(iy + 1) + ix;
  value = (1 - fy) * ((1 - fx) * a[0] + fx * a[1]) + fy * ((1 - fx) * b[0] + fx * b[1]);
  return true;
}

bool sample(const ImageF& picture, const Eigen::Vector2d& q, float& value) {
  return sample([&](int y) { return picture.row(y); }, picture.width, picture.height, q.x(), q.y(), value);
}

/// And its central differences; false where a neighbour is outside.
bool sample(const ImageF& picture, const Eigen::Vector2d& q, float& value, Eigen::RowVector2d& gradient) {
  const double x = q.x(), y = q.y();
  if (!(x >= 1 && y >= 1 && x < picture.width - 2 && y < picture.height - 2)) return false;
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const float fx = static_cast<float>(x - ix), fy = static_cast<float>(y - iy);
  const float *a = picture.row(iy - 1) + ix, *b = picture.row(iy) + ix, *c = picture.row(iy + 1) + ix,
              *d = picture.row(iy + 2) + ix;
  const auto along = [fx](const float* row, int k) { return (1 - fx) * row[k] + fx * row[k + 1]; };
  const auto across = [fy](float above, float below) { return (1 - fy) * above + fy * below; };
  const float middle_b = along(b, 0), middle_c = along(c, 0);
  value = across(middle_b, middle_c);
  gradient = {0.5 * across(along(b, 1) - along(b, -1), along(c, 1) - along(c, -1)),
              0.5 * across(middle_c - along(a, 0), along(d, 0) - middle_b)};
  return true;
}

/// How near to the outline the background is mixed in: coarser levels are smoother.
double margin_px(const SurfaceView& view, int level) { return (1 + level) * view.inside_px; }

/// How large an area of the picture a piece of surface at a point takes, seen from `eye`: cos / distance^2;
/// 0 if its slant has a cosine below `least`.
double area_seen(const SurfaceView::Point& p, const Eigen::Vector3d& eye, double least) {
  const Eigen::Vector3d ray = eye - p.x;
  const double square = ray.squaredNorm(), length = std::sqrt(square), across = p.n.dot(ray);
  return across > least * length ? across / (square * length) : 0;
}

/// The part of the area that the point was taught on which it is seen from `eye`; 0: it is turned away. A
/// side that turns away shows less than was taught, and at the right pose looks unlike it: counted in full it
/// would prefer poses that hide it.
double weight_from(const SurfaceView::Point& p, const Eigen::Vector3d& eye) {
  return std::min(1.0, area_seen(p, eye, kLeastSeen) / p.area);
}

struct Sums {
  double n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
  void add(double u, double v, double weight = 1) {
    const double wu = weight * u, wv = weight * v;
    n += weight, a += wu, b += wv, aa += wu * u, bb += wv * v, ab += wu * v;
  }
};

/// Sums of squares about the mean.
struct Moments {
  double aa = 0, bb = 0, ab = 0;
  void add(const Sums& s) {
    if (!(s.n > 0)) return;
    aa += s.aa - s.a * s.a / s.n, bb += s.bb - s.b * s.b / s.n, ab += s.ab - s.a * s.b / s.n;
  }
  double fit(double n) const {
    const double gain = std::clamp(aa > 0 ? ab / aa : 1.0, kLeastGain, kMostGain);
    const double left = bb - 2 * gain * ab + gain * gain * aa;
    return 1 - left / std::max({bb, gain * gain * aa, kPattern * kPattern * n});
  }
  double correlation(double n, double least) const {
    if (!(aa > least * least * n)) return std::numeric_limits<double>::quiet_NaN();
    // A picture without contrast is not like one that has some.
    return ab / std::sqrt(aa * std::max(bb, 1e-3 * aa + 1e-9));
  }
};

/// In an order that is the same for the same number of points.
void shuffle(std::vector<SurfaceView::Point>& points) {
  std::mt19937 random(1);
  for (std::size_t i = points.size(); i > 1; --i) std::swap(points[i - 1], points[random() % i]);
}

/// The face's normal, away from the object, if all of the object lies behind the face.
std::optional<Eigen::Vector3d> outward(const ObjectModel& model, std::size_t face, double slack) {
  double least = 0, most = 0;
  for (const Eigen::Vector3d& v : model.vertices) {
    const double d = model.face_normals[face].dot(v - model.face_points[face]);
    least = std::min(least, d), most = std::max(most, d);
  }
  if (most < slack) return model.face_normals[face];
  if (least > -slack) return -model.face_normals[face];
  return {};
}

/// Points of a triangle, `spacing` apart, copies of `like` but for their place.
void add_grid(const ObjectModel& model, const std::array<int, 3>& triangle, double spacing,
              SurfaceView::Point like, std::vector<SurfaceView::Point>& out) {
  const Eigen::Vector3d &a = model.vertices[triangle[0]], along = model.vertices[triangle[1]] - a,
                        across = model.vertices[triangle[2]] - a;
  const Eigen::Vector3d u = along.normalized(), up = across - across.dot(u) * u;
  const double height = up.norm();
  for (double y = 0.5 * spacing; y < height; y += spacing) {
    const double part = y / height, first = part * across.dot(u), width = (1 - part) * along.norm();
    for (double x = 0.5 * spacing; x < width; x += spacing) {
      like.x = a + (first + x) * u + part * up;
      out.push_back(like);
    }
  }
}

/// One row of the normal equations: derivative by twist, gain, offset; residual; part of its area seen.
struct Row {
  Twist J;
  double e = 0, taught = 0, weight = 1;
  double slope = 0;  ///< the gradient's size [grey levels per px]
  int view = 0;
};

constexpr int kMostUnknowns = 6 + 2 * kMostViews;
using Unknowns = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMostUnknowns, 1>;
using Normal = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostUnknowns, kMostUnknowns>;

/// Brightness and its derivatives where one view's points fall; false, and nothing added, if too few are
/// seen.
bool collect(const SurfaceView& view, const SmoothPyramid& picture, int level, const Lens& lens,
             const Pose& pose, int number, std::vector<Row>& rows) {
  const std::size_t before = rows.size(), stride = std::size_t(1) << level;  // a coarse level needs fewer
  const ImageF& frame = picture.levels[level];
  const double scale = 1.0 / (1 << level);
  const Eigen::Vector3d eye = pose.centre();
  const Outline outline(view.edges, lens, pose);
  const double margin = margin_px(view, level);
  Eigen::Vector2d q;
  Eigen::Matrix<double, 2, 3> by_point;
  Eigen::RowVector2d gradient;
  float value;
  std::size_t seen = 0;
  for (std::size_t j = 0; j < view.points.size(); j += stride) {
    const SurfaceView::Point& p = view.points[j];
    const double weight = weight_from(p, eye);
    if (!(weight > 0) || !lens.project(pose * p.x, q, &by_point)) continue;
    ++seen;
    if (outline.is_near(q, margin) || !sample(frame, scale * q, value, gradient)) continue;
    gradient *= scale;
    const Eigen::Vector3d by_v = pose.R.transpose() * (gradient * by_point).transpose();
    Row row;
    row.J << by_v, p.x.cross(by_v);
    row.taught = p.value[level];
    row.e = value;
    row.weight = weight;
    row.slope = gradient.norm();
    row.view = number;
    rows.push_back(row);
  }
  if (rows.size() - before >= kLeastPoints &&
      static_cast<double>(seen * stride) > kLeastPart * static_cast<double>(view.points.size()))
    return true;
  rows.resize(before);
  return false;
}

double robust_deviation(std::vector<double>& e) {
  const auto middle = e.begin() + static_cast<std::ptrdiff_t>(e.size() / 2);
  std::nth_element(e.begin(), middle, e.end());
  return std::max(kLeastDeviation, 1.4826 * *middle);
}

/// Gain and offset by least squares.
Eigen::Vector2d exposure_of(const std::vector<Row>& rows, int view) {
  Sums s;
  for (const Row& r : rows)
    if (r.view == view) s.add(r.taught, r.e, r.weight);
  if (!(s.n > 0)) return {1, 0};
  const double va = s.aa - s.a * s.a / s.n, gain = va > 0 ? (s.ab - s.a * s.b / s.n) / va : 1;
  // A gain near 0 or below says nothing of the pose.
  const double kept = std::clamp(gain, 0.2, 5.0);
  return {kept, (s.b - kept * s.a) / s.n};
}

struct Level {
  std::span<const SurfaceView* const> views;
  const SmoothPyramid& picture;
  int level;
  const Lens& lens;
};

/// Normal equations of the weighted residuals by twist and each view's gain and offset.
void normal_equations(const std::vector<Row>& rows, double deviation, Normal& H, Unknowns& g) {
  // A row knows the twist and its own view's gain and offset only.
  using Vector8 = Eigen::Matrix<double, 8, 1>;
  std::array<Eigen::Matrix<double, 8, 8>, kMostViews> JtJ;
  std::array<Vector8, kMostViews> Jte;
  JtJ.fill(Eigen::Matrix<double, 8, 8>::Zero());
  Jte.fill(Vector8::Zero());
  Vector8 J;
  for (const Row& r : rows) {
    const double u = r.e / (4.685 * deviation);
    if (std::abs(u) >= 1) continue;
    const double by_model = kModelError_px * r.slope;
    const double w =
        r.weight * (1 - u * u) * (1 - u * u) / (kAlike * (deviation * deviation + by_model * by_model));
    J << r.J, -r.taught, -1;
    JtJ[r.view].noalias() += w * J * J.transpose();
    Jte[r.view].noalias() += w * r.e * J;
  }
  H.setZero();
  g.setZero();
  for (Eigen::Index v = 0, at = 6; at < g.size(); ++v, at += 2) {
    H.topLeftCorner<6, 6>() += JtJ[v].topLeftCorner<6, 6>();
    H.block<6, 2>(0, at) = JtJ[v].topRightCorner<6, 2>();
    H.block<2, 6>(at, 0) = JtJ[v].bottomLeftCorner<2, 6>();
    H.block<2, 2>(at, at) = JtJ[v].bottomRightCorner<2, 2>();
    g.head<6>() -= Jte[v].head<6>();
    g.segment<2>(at) = -Jte[v].tail<2>();
  }
}

/// Moves the pose on one level; false if too little of the object is seen.
bool align_level(const Level& l, const Matrix6& prior, const Pose& start, Alignment& out) {
  const int count = std::min<int>(static_cast<int>(l.views.size()), kMostViews), unknowns = 6 + 2 * count;
  std::vector<Row> rows;
  std::vector<double> sizes;
  Normal H(unknowns, unknowns);
  Unknowns g(unknowns);
  for (int step = 0; step < kSteps; ++step) {
    rows.clear();
    for (int v = 0; v < count; ++v)
      if (collect(*l.views[v], l.picture, l.level, l.lens, out.cam_from_object, v, rows)) {
        const Eigen::Vector2d exposure = exposure_of(rows, v);
        for (Row& r : rows)
          if (r.view == v) r.e -= exposure[0] * r.taught + exposure[1];
      }
    if (rows.empty()) return false;
    sizes.clear();
    for (const Row& r : rows) sizes.push_back(std::abs(r.e));
    normal_equations(rows, robust_deviation(sizes), H, g);
    out.information = H.topLeftCorner<6, 6>();
    // P holds the pose near where it started: mu is counted from here.
    const Twist so_far = log(start.inverse() * out.cam_from_object);
    H.topLeftCorner<6, 6>() += prior;
    g.head<6>() -= prior * so_far;
    H.diagonal().tail(2 * count).array() += 1e-9;  // a view that is left out
    const Unknowns mu = H.ldlt().solve(g);
    if (!mu.allFinite() || mu.segment<3>(3).norm() > 1) return false;
    const Twist twist = mu.head<6>();
    out.cam_from_object = out.cam_from_object * exp(twist);
    if (twist.dot(prior * twist) < 1e-5) break;
  }
  return true;
}

/// 255 where the patch shows the object.
cv::Mat object_of(const DepthPatch& patch) {
  cv::Mat there(patch.depth.height, patch.depth.width, CV_8U, cv::Scalar(0));
  for (int y = 0; y < there.rows; ++y)
    for (int x = 0; x < there.cols; ++x)
      if (std::isfinite(patch.depth.at(x, y))) there.at<std::uint8_t>(y, x) = 255;
  return there;
}

/// What of a mask is farther than `by` pixels from its outline.
cv::Mat shrunk(const cv::Mat& mask, int by) {
  cv::Mat inside;
  cv::erode(mask, inside, cv::Mat::ones(2 * by + 1, 2 * by + 1, CV_8U), {-1, -1}, 1, cv::BORDER_CONSTANT,
            cv::Scalar(0));
  return inside;
}

/// A taught picture smoothed over the object's pixels only.
class ObjectAlone {
 public:
  ObjectAlone(const Grey& picture, const DepthPatch& patch, const cv::Mat& there) {
    cv::Mat mask(picture.height, picture.width, CV_32F, cv::Scalar(0));
    there.convertTo(mask({patch.x0, patch.y0, there.cols, there.rows}), CV_32F, 1.0 / 255);
    sums_ = levels_of(float_of(picture).mul(mask));
    weights_ = levels_of(mask);
  }

  /// On each level; false where one is not known.
  bool brightness_at(double x, double y, std::array<float, SmoothPyramid::count>& value) const {
    const auto in = [](const cv::Mat& m) { return [&m](int row) { return m.ptr<float>(row); }; };
    for (int l = 0; l < SmoothPyramid::count; ++l) {
      const double scale = 1.0 / (1 << l);
      const cv::Mat &sums = sums_[l], &weights = weights_[l];
      float sum = 0, weight = 0;
      if (!sample(in(sums), sums.cols, sums.rows, scale * x, scale * y, sum) ||
          !sample(in(weights), weights.cols, weights.rows, scale * x, scale * y, weight) || !(weight > 0.05F))
        return false;
      value[l] = sum / weight;
    }
    return true;
  }

 private:
  std::array<cv::Mat, SmoothPyramid::count> sums_, weights_;
};

}  // namespace

SmoothPyramid smooth_pyramid(const Grey& picture) {
  SmoothPyramid out;
  smooth_pyramid(picture, out);
  return out;
}

void smooth_pyramid(const Grey& picture, SmoothPyramid& out) {
  int width = picture.width, height = picture.height;
  for (ImageF& level : out.levels) {
    if (level.width != width || level.height != height) level = ImageF::unset(width, height, 1);
    width = (width + 1) / 2, height = (height + 1) / 2;
  }
  cv::Mat finest = mat_of(out.levels[0]);
  cv::Mat(picture.height, picture.width, CV_8U, const_cast<std::uint8_t*>(picture.data.data()))
      .convertTo(finest, CV_32F);
  cv::GaussianBlur(finest, finest, {}, kSmooth_px);
  for (int l = 1; l < SmoothPyramid::count; ++l)
    cv::pyrDown(mat_of(out.levels[l - 1]), mat_of(out.levels[l]));
}

SurfaceView surface_view(const TexturedView& view, const ObjectModel& model, const ImageF& rays, int most) {
  SurfaceView out;
  out.cam_from_object = view.cam_from_object;
  out.edges = outline_edges(model);
  const DepthPatch& patch = view.depth;
  const int width = patch.depth.width, height = patch.depth.height;
  if (width < 3 || height < 3) return out;
  const Eigen::Vector3d eye = view.cam_from_object.centre();
  const cv::Mat there = object_of(patch);
  const int pixels = cv::countNonZero(there);
  out.inside_px = std::round(std::clamp(kInside * std::sqrt(double(pixels)), 1.0, kMostInside_px));
  const cv::Mat inside = shrunk(there, static_cast<int>(out.inside_px));
  const ObjectAlone alone(view.picture, patch, there);
  const double step = std::max(1.0, std::sqrt(pixels / static_cast<double>(std::max(1, most))));
  std::vector<int> face_number(model.face_normals.size(), -1);
  const Pose object_from_cam = view.cam_from_object.inverse();
  for (double sy = 1; sy < height - 1; sy += step)
    for (double sx = 1; sx < width - 1; sx += step) {
      const int x = static_cast<int>(sx), y = static_cast<int>(sy);
      if (inside.at<std::uint8_t>(y, x) == 0) continue;
      const int face = patch.face.at(x, y);
      SurfaceView::Point p;
      const float* ray = &rays.at(x + patch.x0, y + patch.y0);
      p.x = object_from_cam * (double(patch.depth.at(x, y)) * Eigen::Vector3d(ray[0], ray[1], 1));
      p.n = model.face_normals[face];
      if (p.n.dot(eye - p.x) < 0) p.n = -p.n;
      p.area = area_seen(p, eye, kLeastSlant);
      if (!(p.area > 0)) continue;
      if (!alone.brightness_at(x + patch.x0, y + patch.y0, p.value)) continue;
      if (face_number[face] < 0) face_number[face] = out.faces++, out.face_of.push_back(face);
      p.face = face_number[face];
      out.points.push_back(p);
    }
  out.spacing = step * std::abs(rays.at(1, 0) - rays.at(0, 0)) * out.cam_from_object.t.z();
  shuffle(out.points);
  return out;
}

bool is_plain(const SurfaceView& view) {
  std::vector<Sums> by_face(static_cast<std::size_t>(view.faces));
  for (const SurfaceView::Point& p : view.points) by_face[p.face].add(p.value[1], p.value[1]);
  Moments print;
  for (const Sums& s : by_face) print.add(s);
  return !(print.aa > kLeastPrint * kLeastPrint * static_cast<double>(view.points.size()));
}

void add_unseen_faces(const ObjectModel& model, SurfaceView& view) {
  const double slack = 1e-3 * model.radius();
  std::vector<bool> known(model.face_normals.size());
  for (const int face : view.face_of) known[face] = true;
  for (std::size_t f = 0; f < model.face_normals.size(); ++f) {
    if (known[f]) continue;
    const auto out = outward(model, f, slack);
    if (!out) continue;
    for (std::size_t t = 0; t < model.triangles.size(); ++t)
      if (model.face_of_triangle[t] == static_cast<int>(f))
        add_grid(model, model.triangles[t], view.spacing,
                 {{}, *out, view.unseen_faces, {}, 1 / view.cam_from_object.t.squaredNorm()}, view.unseen);
    ++view.unseen_faces;
  }
  shuffle(view.unseen);
}

Likeness likeness(const SurfaceView& view, const SmoothPyramid& picture, int level, const Lens& lens,
                  const Pose& pose, int most) {
  const ImageF& frame = picture.levels[level];
  const double scale = 1.0 / (1 << level);
  const Eigen::Vector3d eye = pose.centre();
  const std::size_t count = std::min(view.points.size(), static_cast<std::size_t>(std::max(0, most)));
  std::vector<Sums> by_face(static_cast<std::size_t>(view.faces));
  Sums whole;
  const Outline outline(view.edges, lens, pose);
  const double margin = margin_px(view, level);
  std::size_t seen = 0;
  int inside = 0;
  Eigen::Vector2d q;
  for (std::size_t j = 0; j < count; ++j) {
    const SurfaceView::Point& p = view.points[j];
    const double weight = weight_from(p, eye);
    float value;
    if (!(weight > 0) || !lens.project(pose * p.x, q) || !sample(frame, scale * q, value)) continue;
    ++seen;
    if (outline.is_near(q, margin)) continue;
    ++inside;
    by_face[p.face].add(p.value[level], value, weight);
    whole.add(p.value[level], value, weight);
  }
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  std::vector<Sums> by_unseen(static_cast<std::size_t>(view.unseen_faces));
  // As many of these in proportion.
  const std::size_t count_unseen = count * view.unseen.size() / std::max<std::size_t>(1, view.points.size());
  for (std::size_t j = 0; j < std::min(count_unseen, view.unseen.size()); ++j) {
    const SurfaceView::Point& p = view.unseen[j];
    const double weight = weight_from(p, eye);
    float value;
    if (weight > 0 && lens.project(pose * p.x, q) && sample(frame, scale * q, value) &&
        !outline.is_near(q, margin))
      by_unseen[p.face].add(0, value, weight);
  }
  if (inside < kLeastPoints || static_cast<double>(seen) < kLeastPart * static_cast<double>(count))
    return {nan, nan, nan};
  Moments all, print;
  all.add(whole);
  for (const Sums& s : by_face) print.add(s);
  Moments with_unseen = all;
  double n = whole.n;
  for (const Sums& s : by_unseen) with_unseen.add(s), n += s.n;
  return {with_unseen.fit(n), all.correlation(whole.n, kLeastContrast),
          print.correlation(whole.n, kLeastPrint)};
}

Alignment align(std::span<const SurfaceView* const> views, const SmoothPyramid& picture, int from,
                const Lens& lens, const Pose& cam_from_object, const Twist& spread, int to) {
  Alignment out;
  out.cam_from_object = cam_from_object;
  // From the camera's axes into the object's: cov = D S D^T with D a rotation, so its inverse is alike.
  const Twist inverse = spread.cwiseAbs2().cwiseInverse();
  Matrix6 prior = Matrix6::Zero();
  for (const int k : {0, 3})
    prior.block<3, 3>(k, k) =
        cam_from_object.R.transpose() * inverse.segment<3>(k).asDiagonal() * cam_from_object.R;
  for (int level = std::min(from, SmoothPyramid::count - 1); level >= to; --level)
    if (!align_level({views, picture, level, lens}, prior, cam_from_object, out)) return out;
  out.converged = true;
  return out;
}

}  // namespace stuv::tracking
