#include "calib/tracking/texture.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "core/parallel.h"

namespace stuv::tracking {
namespace {

/// Cosine of the steepest slant at which a taught view still shows a surface: 75 degrees.
constexpr double kLeastSlant = 0.26;
constexpr float kInf = std::numeric_limits<float>::infinity();

/// Pixels that a projected triangle may touch; its sides are followed, as a lens bends them.
Eigen::AlignedBox2i pixels_of(const std::array<Eigen::Vector3d, 3>& corners, const Lens& lens) {
  Eigen::AlignedBox2d box;
  bool all = false;
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 8; ++k) {
      Eigen::Vector2d q;
      if (lens.project(corners[i] + k / 8.0 * (corners[(i + 1) % 3] - corners[i]), q))
        box.extend(q);
      else
        all = true;  // partly beyond the field of view
    }
  const Eigen::Vector2d last(lens.width() - 1, lens.height() - 1);
  if (all) box = Eigen::AlignedBox2d(Eigen::Vector2d(0, 0), last);
  if (box.isEmpty()) return {};
  const Eigen::Vector2d margin(2, 2);
  return {(box.min() - margin).cwiseMax(0.0).cwiseMin(1e6).cast<int>(),
          (box.max() + margin).cwiseMax(-1.0).cwiseMin(last).cast<int>()};
}

void draw_depth(const std::array<Eigen::Vector3d, 3>& c, int face, const Eigen::AlignedBox2i& box,
                const ImageF& rays, int stride, DepthPatch& patch) {
  Eigen::Matrix3d A;
  A << c[0], c[1], c[2];
  const double det = A.determinant();
  if (std::abs(det) < 1e-12) return;  // seen edge-on
  // ray * depth = A b: barycentric b / depth = A^-1 ray
  const Eigen::Matrix3f inverse = A.inverse().cast<float>();
  // The rows and columns of the stride count from the patch's corner.
  const auto from = [&](int first, int origin) {
    return first + (stride - (first - origin) % stride) % stride;
  };
  for (int y = from(box.min().y(), patch.y0); y <= box.max().y(); y += stride) {
    float* out = patch.depth.row(y - patch.y0);
    for (int x = from(box.min().x(), patch.x0); x <= box.max().x(); x += stride) {
      const Eigen::Vector3f b = inverse * Eigen::Vector3f(rays.at(x, y, 0), rays.at(x, y, 1), 1);
      if (b.minCoeff() < 0) continue;
      const float depth = 1 / b.sum();
      if (!(depth < out[x - patch.x0])) continue;
      out[x - patch.x0] = depth;
      patch.face.at(x - patch.x0, y - patch.y0) = face;
    }
  }
}

/// Bilinear value; the place must be inside.
float bilinear(const Grey& picture, float x, float y) {
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const float fx = x - static_cast<float>(ix), fy = y - static_cast<float>(iy);
  const std::uint8_t *a = picture.row(iy) + ix, *b = picture.row(iy + 1) + ix;
  return (1 - fy) * ((1 - fx) * a[0] + fx * a[1]) + fy * ((1 - fx) * b[0] + fx * b[1]);
}

/// The largest depth of the four pixels around q: on a slanted face the nearest pixel's may be too small.
float depth_around(const DepthPatch& patch, const Eigen::Vector2d& q) {
  const int x = static_cast<int>(std::floor(q.x())) - patch.x0,
            y = static_cast<int>(std::floor(q.y())) - patch.y0;
  if (x < 0 || y < 0 || x + 1 >= patch.depth.width || y + 1 >= patch.depth.height) return kInf;
  return std::max({patch.depth.at(x, y), patch.depth.at(x + 1, y), patch.depth.at(x, y + 1),
                   patch.depth.at(x + 1, y + 1)});
}

cv::Mat mat_of(const Grey& grey) {
  return {grey.height, grey.width, CV_8U, const_cast<std::uint8_t*>(grey.data.data())};
}

}  // namespace

ImageF rays_of(const Camera& camera) {
  std::vector<Eigen::Vector2d> pixels;
  pixels.reserve(static_cast<std::size_t>(camera.width) * camera.height);
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) pixels.emplace_back(x, y);
  const std::vector<Eigen::Vector3d> directions = unproject(camera, pixels);
  ImageF rays(camera.width, camera.height, 2);
  for (std::size_t i = 0; i < directions.size(); ++i) {
    rays.data[2 * i] = static_cast<float>(directions[i].x() / directions[i].z());
    rays.data[2 * i + 1] = static_cast<float>(directions[i].y() / directions[i].z());
  }
  return rays;
}

DepthPatch render_depth(const ObjectModel& model, const Lens& lens, const ImageF& rays, const Pose& pose,
                        double slack, int stride) {
  struct Part {
    std::array<Eigen::Vector3d, 3> corners;
    int face;
    Eigen::AlignedBox2i box;
  };
  std::vector<Part> parts;
  Eigen::AlignedBox2i whole;
  for (std::size_t n = 0; n < model.triangles.size(); ++n) {
    const auto& [i, j, k] = model.triangles[n];
    Part part{{pose * model.vertices[i], pose * model.vertices[j], pose * model.vertices[k]},
              model.face_of_triangle[n],
              {}};
    if (std::any_of(part.corners.begin(), part.corners.end(), [&](const auto& c) { return c.z() < slack; }))
      continue;
    part.box = pixels_of(part.corners, lens);
    if (part.box.isEmpty()) continue;
    whole.extend(part.box);
    parts.push_back(part);
  }
  DepthPatch patch;
  if (whole.isEmpty()) return patch;
  patch.x0 = whole.min().x();
  patch.y0 = whole.min().y();
  patch.depth = ImageF(whole.sizes().x() + 1, whole.sizes().y() + 1, 1, kInf);
  patch.face = Raster<int>(patch.depth.width, patch.depth.height, 1, -1);
  for (const Part& part : parts) draw_depth(part.corners, part.face, part.box, rays, stride, patch);
  return patch;
}

WarpedView warp_view(const TexturedView& view, const ObjectModel& model, const Lens& lens, const ImageF& rays,
                     const Pose& to, double slack, int stride) {
  WarpedView out;
  out.depth = render_depth(model, lens, rays, to, slack, stride);
  const int width = out.depth.depth.width, height = out.depth.depth.height;
  out.picture = Grey(width, height, 1);
  out.seen = Grey(width, height, 1);
  const Pose there_from_to = view.cam_from_object * to.inverse();
  const Eigen::Vector3d eye = to.centre(), taught_eye = view.cam_from_object.centre();
  // Faces that both views see from the same side.
  std::vector<bool> shared(model.face_normals.size());
  for (std::size_t f = 0; f < shared.size(); ++f) {
    const Eigen::Vector3d& n = model.face_normals[f];
    const Eigen::Vector3d ray = taught_eye - model.face_points[f];
    shared[f] =
        std::abs(n.dot(ray)) > kLeastSlant * ray.norm() && n.dot(ray) * n.dot(eye - model.face_points[f]) > 0;
  }
  parallel_for((height + stride - 1) / stride, [&](int row) {
    const int y = row * stride;
    for (int x = 0; x < width; x += stride) {
      const float z = out.depth.depth.at(x, y);
      if (!std::isfinite(z) || !shared[out.depth.face.at(x, y)]) continue;
      const float* ray = &rays.at(x + out.depth.x0, y + out.depth.y0);
      const Eigen::Vector3d there = there_from_to * (double(z) * Eigen::Vector3d(ray[0], ray[1], 1));
      Eigen::Vector2d q;
      if (!lens.project(there, q) || !lens.inside(q, 1)) continue;
      // A surface that lies nearer to the taught view hides this point.
      if (!(there.z() < double(depth_around(view.depth, q)) + 5 * slack)) continue;
      const float value = bilinear(view.picture, static_cast<float>(q.x()), static_cast<float>(q.y()));
      out.picture.at(x, y) = static_cast<std::uint8_t>(value + 0.5F);
      out.seen.at(x, y) = 255;
    }
  });
  return out;
}

std::vector<PointMatch> follow_texture(const WarpedView& warped, const Grey& frame, const ImageF& rays,
                                       const Pose& cam_from_object, int most_points) {
  constexpr int window = 13, border = 24;
  const int width = warped.picture.width, height = warped.picture.height;
  if (width < 2 * window || height < 2 * window) return {};
  // Corners whose surroundings the taught view saw.
  cv::Mat inner;
  cv::erode(mat_of(warped.seen), inner, cv::Mat::ones(5, 5, CV_8U), {-1, -1}, 1, cv::BORDER_CONSTANT,
            cv::Scalar(0));
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(mat_of(warped.picture), corners, most_points, 0.02, 5, inner, 5);
  if (corners.empty()) return {};
  // The warped view put into the frame: around the object both pictures are then the same, and no step.
  const cv::Rect box(warped.depth.x0, warped.depth.y0, width, height);
  const cv::Rect wide = (box + cv::Size(2 * border, 2 * border) - cv::Point(border, border)) &
                        cv::Rect(0, 0, frame.width, frame.height);
  const cv::Mat to = mat_of(frame)(wide).clone(), from = to.clone();
  mat_of(warped.picture).copyTo(from(box - wide.tl()), mat_of(warped.seen));
  const cv::Point2f shift(static_cast<float>(box.x - wide.x), static_cast<float>(box.y - wide.y));
  for (cv::Point2f& c : corners) c += shift;
  std::vector<cv::Point2f> there, back = corners;
  std::vector<std::uint8_t> found, found_back;
  const cv::TermCriteria until(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 20, 0.01);
  const cv::Size size(window, window);
  std::vector<cv::Mat> from_levels, to_levels;  // both directions use both
  const int levels = cv::buildOpticalFlowPyramid(from, from_levels, size, 3);
  cv::buildOpticalFlowPyramid(to, to_levels, size, 3);
  cv::calcOpticalFlowPyrLK(from_levels, to_levels, corners, there, found, cv::noArray(), size, levels, until);
  cv::calcOpticalFlowPyrLK(to_levels, from_levels, there, back, found_back, cv::noArray(), size, levels,
                           until);
  std::vector<PointMatch> matches;
  const Pose object_from_cam = cam_from_object.inverse();
  for (std::size_t i = 0; i < corners.size(); ++i) {
    if (found[i] == 0 || found_back[i] == 0 || cv::norm(back[i] - corners[i]) > 0.5) continue;
    // The surface under the corner, from the pixel it lies in and that pixel's plane by interpolated depth.
    const float x = corners[i].x - shift.x, y = corners[i].y - shift.y;
    const int ix = static_cast<int>(x), iy = static_cast<int>(y);
    if (ix + 1 >= width || iy + 1 >= height) continue;
    const float fx = x - static_cast<float>(ix), fy = y - static_cast<float>(iy);
    // 1 / z and the ray are linear over a few pixels.
    Eigen::Vector3d ray(0, 0, 1);
    double inverse = 0;
    for (int dy = 0; dy < 2; ++dy)
      for (int dx = 0; dx < 2; ++dx) {
        const double w = (dx != 0 ? fx : 1 - fx) * (dy != 0 ? fy : 1 - fy);
        const float* r = &rays.at(ix + dx + box.x, iy + dy + box.y);
        ray.x() += w * r[0];
        ray.y() += w * r[1];
        inverse += w / warped.depth.depth.at(ix + dx, iy + dy);
      }
    if (!(inverse > 0)) continue;
    matches.push_back({object_from_cam * (ray / inverse),
                       Eigen::Vector2d(double(there[i].x) + wide.x, double(there[i].y) + wide.y), 1});
  }
  return matches;
}

double noise_of(const Grey& picture) {
  std::vector<int> sizes;
  for (int y = 1; y + 1 < picture.height; y += 2)
    for (int x = 1; x + 1 < picture.width; x += 3) {
      const std::uint8_t *a = picture.row(y - 1) + x, *b = picture.row(y) + x, *c = picture.row(y + 1) + x;
      sizes.push_back(std::abs(a[-1] + a[1] + c[-1] + c[1] + 4 * b[0] - 2 * (a[0] + c[0] + b[-1] + b[1])));
    }
  if (sizes.empty()) return 0;
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return 1.4826 * *middle / 6;  // the mask's squares sum to 36
}

double correlation(const WarpedView& warped, const Grey& frame) {
  double n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
  for (int y = 0; y < warped.seen.height; ++y)
    for (int x = 0; x < warped.seen.width; ++x) {
      if (warped.seen.at(x, y) == 0) continue;
      const double u = warped.picture.at(x, y), v = frame.at(x + warped.depth.x0, y + warped.depth.y0);
      n += 1, a += u, b += v, aa += u * u, bb += v * v, ab += u * v;
    }
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  if (n < 100) return nan;
  const double noise = noise_of(frame), noise_var = std::max(0.5, noise * noise);
  const double va = aa / n - a * a / (n * n), vb = bb / n - b * b / (n * n), cov = ab / n - a * b / (n * n);
  if (!(va > 4 * noise_var)) return nan;
  // The frame's own contrast may be less: then it does not look like the view.
  const double signal = (va - noise_var) * std::max(noise_var, vb - noise_var);
  return std::clamp(cov / std::sqrt(signal), -1.0, 1.0);
}

}  // namespace stuv::tracking
