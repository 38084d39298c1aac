#include "calib/tracking/edge_search.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "core/parallel.h"

namespace stuv::tracking {
namespace {

constexpr int kMostRange = 96;

double median_magnitude(const ImageF& gradient) {
  std::vector<float> magnitudes;
  // Every fifth pixel of every third row is enough for a median.
  for (int y = 0; y < gradient.height; y += 3)
    for (int x = 0; x < gradient.width; x += 5)
      magnitudes.push_back(std::hypot(gradient.at(x, y, 0), gradient.at(x, y, 1)));
  const auto middle = magnitudes.begin() + static_cast<std::ptrdiff_t>(magnitudes.size() / 2);
  std::nth_element(magnitudes.begin(), middle, magnitudes.end());
  return *middle;
}

/// Bilinear; 0 outside.
inline Eigen::Vector2f sample(const ImageF& g, float x, float y) {
  if (!(x >= 0 && y >= 0 && x < static_cast<float>(g.width - 1) && y < static_cast<float>(g.height - 1)))
    return {0, 0};
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const float fx = x - static_cast<float>(ix), fy = y - static_cast<float>(iy);
  const float *a = g.row(iy) + 2 * ix, *b = g.row(iy + 1) + 2 * ix;
  const float w00 = (1 - fx) * (1 - fy), w10 = fx * (1 - fy), w01 = (1 - fx) * fy, w11 = fx * fy;
  return {w00 * a[0] + w10 * a[2] + w01 * b[0] + w11 * b[2],
          w00 * a[1] + w10 * a[3] + w01 * b[1] + w11 * b[3]};
}

/// Whether bilinear gradients can reach the threshold, by the pixel they start from.
void find_strong_cells(const ImageF& gradient, double threshold, Raster<std::uint8_t>& strong) {
  const auto least = static_cast<float>(threshold * threshold);
  parallel_for(gradient.height, [&](int y) {
    const float* g = gradient.row(y);
    std::uint8_t* out = strong.row(y);
    for (int x = 0; x < gradient.width; ++x)
      out[x] = g[2 * x] * g[2 * x] + g[2 * x + 1] * g[2 * x + 1] >= least ? 1 : 0;
  });
  for (int y = 0; y + 1 < strong.height; ++y) {
    std::uint8_t *out = strong.row(y), *next = strong.row(y + 1);
    for (int x = 0; x + 1 < strong.width; ++x)
      out[x] = static_cast<std::uint8_t>(out[x] | out[x + 1] | next[x] | next[x + 1]);
  }
}

/// The raster as a matrix, made anew if it has another size.
template <class T>
cv::Mat sized(Raster<T>& raster, const Grey& like, int channels, int type) {
  if (raster.width != like.width || raster.height != like.height)
    raster = Raster<T>::unset(like.width, like.height, channels);
  return {like.height, like.width, type, raster.data.data()};
}

void insert_nearest(EdgeHypotheses& h, float distance, float strength) {
  int at = std::min(h.count, EdgeHypotheses::most - 1);
  if (h.count == EdgeHypotheses::most && std::abs(distance) >= std::abs(h.distance[at])) return;
  while (at > 0 && std::abs(h.distance[at - 1]) > std::abs(distance)) {
    h.distance[at] = h.distance[at - 1];
    h.strength[at] = h.strength[at - 1];
    --at;
  }
  h.distance[at] = distance;
  h.strength[at] = strength;
  h.count = std::min(h.count + 1, EdgeHypotheses::most);
}

}  // namespace

GradientPicture gradient_of(const Grey& picture, double sigma_px, double least) {
  GradientPicture out;
  gradient_of(picture, sigma_px, least, out);
  return out;
}

void gradient_of(const Grey& picture, double sigma_px, double least, GradientPicture& out) {
  const cv::Mat grey(picture.height, picture.width, CV_8U, const_cast<std::uint8_t*>(picture.data.data()));
  cv::Mat smooth = sized(out.smooth, picture, 1, CV_32F), both = sized(out.gradient, picture, 2, CV_32FC2);
  cv::Mat parts[2] = {sized(out.along_x, picture, 1, CV_32F), sized(out.along_y, picture, 1, CV_32F)};
  sized(out.strong, picture, 1, CV_8U);
  grey.convertTo(smooth, CV_32F);
  if (sigma_px > 0) cv::GaussianBlur(smooth, smooth, {}, sigma_px);
  cv::Scharr(smooth, parts[0], CV_32F, 1, 0, 1.0 / 32);
  cv::Scharr(smooth, parts[1], CV_32F, 0, 1, 1.0 / 32);
  cv::merge(parts, 2, both);
  out.threshold = std::clamp(4 * 1.48 * median_magnitude(out.gradient), least, 3 * least);
  find_strong_cells(out.gradient, out.threshold, out.strong);
}

EdgeHypotheses search_edges(const GradientPicture& picture, const Eigen::Vector2d& p,
                            const Eigen::Vector2d& n, double range_px, double least_cosine) {
  const int range = std::clamp(static_cast<int>(std::ceil(range_px)), 1, kMostRange);
  const int count = 2 * range + 3;
  const Eigen::Vector2f nf = n.cast<float>(), first = p.cast<float>() - static_cast<float>(range + 1) * nf;
  const auto place = [&](int i) -> Eigen::Vector2f { return first + static_cast<float>(i) * nf; };
  const auto inside = [&](const Eigen::Vector2f& q) {
    return q.x() >= 0 && q.y() >= 0 && q.x() < static_cast<float>(picture.gradient.width - 1) &&
           q.y() < static_cast<float>(picture.gradient.height - 1);
  };
  // Where no pixel around reaches the threshold nothing is interpolated: most of a picture is like that.
  std::array<bool, 2 * kMostRange + 5> near;  // by i + 1
  near[0] = near[count + 1] = false;
  const bool all_inside = inside(place(0)) && inside(place(count - 1));
  bool any = false;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector2f q = place(i);
    near[i + 1] =
        (all_inside || inside(q)) && picture.strong.at(static_cast<int>(q.x()), static_cast<int>(q.y())) != 0;
    any = any || near[i + 1];
  }
  if (!any) return {};
  std::array<float, 2 * kMostRange + 3> response;
  std::array<Eigen::Vector2f, 2 * kMostRange + 3> gradient;
  for (int i = 0; i < count; ++i) {
    response[i] = 0;
    if (!near[i] && !near[i + 1] && !near[i + 2]) continue;
    const Eigen::Vector2f q = place(i);
    gradient[i] = sample(picture.gradient, q.x(), q.y());
    response[i] = gradient[i].dot(nf);
  }
  EdgeHypotheses out;
  for (int i = 1; i + 1 < count; ++i) {
    const float r = std::abs(response[i]), before = std::abs(response[i - 1]),
                after = std::abs(response[i + 1]);
    if (r < picture.threshold || r < before || r <= after || r < least_cosine * gradient[i].norm()) continue;
    const float bend = before - 2 * r + after;
    const float shift = bend < 0 ? std::clamp(0.5F * (before - after) / bend, -0.5F, 0.5F) : 0;
    insert_nearest(out, static_cast<float>(i - range - 1) + shift, response[i]);
  }
  return out;
}

}  // namespace stuv::tracking
