#include "calib/two_view/disparity.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "core/parallel.h"

namespace stuv {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr std::uint16_t kFar = 30000;
constexpr std::uint8_t kUnknown = 24;  ///< cost where a census is missing: that of a poor match
constexpr std::uint64_t kNoCensus = ~std::uint64_t{0};

/// One level of the pyramid: grey values, and where they are there.
struct Level {
  cv::Mat grey, mask;
};

Level grey_of(const Image& picture) {
  const ImageF p = to_float(picture);
  Level level{cv::Mat(p.height, p.width, CV_8U), cv::Mat(p.height, p.width, CV_8U, cv::Scalar(255))};
  for (int y = 0; y < p.height; ++y)
    for (int x = 0; x < p.width; ++x) {
      const float* v = &p.at(x, y);
      const float grey = p.channels == 3 ? 0.299F * v[0] + 0.587F * v[1] + 0.114F * v[2] : v[0];
      level.grey.at<std::uint8_t>(y, x) = cv::saturate_cast<std::uint8_t>(255 * grey);
      if (!picture.mask.empty()) level.mask.at<std::uint8_t>(y, x) = picture.mask.at(x, y);
    }
  return level;
}

Level halved(const Level& fine) {
  Level coarse;
  cv::pyrDown(fine.grey, coarse.grey);
  cv::resize(fine.mask, coarse.mask, coarse.grey.size(), 0, 0, cv::INTER_NEAREST);
  return coarse;
}

using Census = Raster<std::uint64_t>;

/// Bit by bit: is the neighbour darker than the middle. kNoCensus where the window meets the masked.
Census census_of(const Level& level) {
  constexpr int rx = 4, ry = 3;
  const int w = level.grey.cols, h = level.grey.rows;
  Census census(w, h, 1, kNoCensus);
  cv::Mat grey, mask;
  cv::copyMakeBorder(level.grey, grey, ry, ry, rx, rx, cv::BORDER_REPLICATE);
  cv::erode(level.mask, mask, cv::Mat::ones(2 * ry + 1, 2 * rx + 1, CV_8U));
  parallel_for(h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      if (mask.at<std::uint8_t>(y, x) == 0) continue;
      const std::uint8_t middle = grey.at<std::uint8_t>(y + ry, x + rx);
      std::uint64_t bits = 0;
      for (int dy = 0; dy <= 2 * ry; ++dy) {
        const std::uint8_t* row = grey.ptr(y + dy) + x;
        for (int dx = 0; dx <= 2 * rx; ++dx) bits = (bits << 1) | (row[dx] < middle ? 1U : 0U);
      }
      census.at(x, y) = bits;
    }
  });
  return census;
}

/// Which disparities each pixel may have, and where its costs lie: pixel (x, y) has lo .. lo + n - 1 at
/// `offset`.
struct Candidates {
  int width = 0, height = 0;
  std::vector<std::int16_t> lo, n;
  std::vector<std::uint32_t> offset;  ///< width * height + 1

  std::size_t at(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
  void close() {
    offset.resize(n.size() + 1);
    offset[0] = 0;
    for (std::size_t i = 0; i < n.size(); ++i) offset[i + 1] = offset[i] + static_cast<std::uint32_t>(n[i]);
  }
};

Candidates whole_range(int width, int height, int low, int high) {
  Candidates c;
  c.width = width;
  c.height = height;
  c.lo.assign(static_cast<std::size_t>(width) * height, static_cast<std::int16_t>(low));
  c.n.assign(c.lo.size(), static_cast<std::int16_t>(high - low + 1));
  c.close();
  return c;
}

/// Around twice what the parent's pixels nearby found, from the least to the greatest of them.
Candidates around(const ImageF& parent, int width, int height, int low, int high) {
  constexpr int kReach = 2, kMargin = 2;
  cv::Mat d(parent.height, parent.width, CV_32F, const_cast<float*>(parent.data.data())), least, most;
  const cv::Mat window = cv::Mat::ones(2 * kReach + 1, 2 * kReach + 1, CV_8U);
  cv::erode(d, least, window);
  cv::dilate(d, most, window);
  Candidates c = whole_range(width, height, low, high);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const int py = std::min(y / 2, parent.height - 1), px = std::min(x / 2, parent.width - 1);
      const int from =
          std::clamp(static_cast<int>(std::floor(2 * least.at<float>(py, px))) - kMargin, low, high);
      const int to = std::clamp(static_cast<int>(std::ceil(2 * most.at<float>(py, px))) + kMargin, low, high);
      c.lo[c.at(x, y)] = static_cast<std::int16_t>(from);
      c.n[c.at(x, y)] = static_cast<std::int16_t>(to - from + 1);
    }
  c.close();
  return c;
}

std::vector<std::uint8_t> costs_of(const Census& a, const Census& b, const Candidates& c) {
  std::vector<std::uint8_t> costs(c.offset.back());
  parallel_for(c.height, [&](int y) {
    for (int x = 0; x < c.width; ++x) {
      const std::size_t i = c.at(x, y);
      std::uint8_t* out = &costs[c.offset[i]];
      const std::uint64_t mine = a.at(x, y);
      for (int k = 0; k < c.n[i]; ++k) {
        const int xb = x + c.lo[i] + k;
        const std::uint64_t other = xb >= 0 && xb < b.width ? b.at(xb, y) : kNoCensus;
        out[k] = mine == kNoCensus || other == kNoCensus
                     ? kUnknown
                     : static_cast<std::uint8_t>(std::popcount(mine ^ other));
      }
    }
  });
  return costs;
}

/// One half of the eight paths: from the pixels that come before in row order (`step` 1) or after it (-1).
/// Adds to `sum`.
class Scan {
 public:
  Scan(const cv::Mat& grey, const Candidates& c, const std::vector<std::uint8_t>& costs,
       const DisparityOptions& o, int step)
      : grey_(grey), c_(c), costs_(costs), o_(o), step_(step) {}

  void run(std::vector<std::uint16_t>& sum) {
    sum.assign(costs_.size(), 0);
    Row before, now;
    for (int i = 0; i < c_.height; ++i) {
      const int y = step_ > 0 ? i : c_.height - 1 - i;
      const std::size_t begin = c_.offset[c_.at(0, y)];
      const std::size_t size = c_.offset[c_.at(c_.width - 1, y) + 1] - begin;
      for (int path = 0; path < 4; ++path) {
        now.cost[path].resize(size);
        now.least[path].resize(c_.width);
      }
      for (int j = 0; j < c_.width; ++j) {
        const int x = step_ > 0 ? j : c_.width - 1 - j;
        for (int path = 0; path < 4; ++path) advance(x, y, path, i > 0 ? &before : nullptr, now, sum);
      }
      std::swap(before, now);
    }
  }

 private:
  struct Row {
    std::vector<std::uint16_t> cost[4], least[4];
  };

  /// Paths: along the row, and from the row before at x - 1, x, x + 1 (seen in scan order).
  void advance(int x, int y, int path, const Row* before, Row& now, std::vector<std::uint16_t>& sum) {
    const std::size_t i = c_.at(x, y), begin = c_.offset[c_.at(0, y)];
    const int n = c_.n[i];
    const std::uint8_t* cost = &costs_[c_.offset[i]];
    std::uint16_t* out = &now.cost[path][c_.offset[i] - begin];
    std::uint16_t* total = &sum[c_.offset[i]];
    const int qx = x - step_ * (path == 0 ? 1 : path - 2), qy = path == 0 ? y : y - step_;
    const Row* row = path == 0 ? &now : before;
    std::uint16_t least = kFar;
    if (qx < 0 || qx >= c_.width || row == nullptr) {
      for (int k = 0; k < n; ++k) least = std::min(least, out[k] = cost[k]);
    } else {
      const std::size_t q = c_.at(qx, qy);
      gather(&row->cost[path][c_.offset[q] - c_.offset[c_.at(0, qy)]], c_.lo[q], c_.n[q], c_.lo[i], n);
      const std::uint16_t base = row->least[path][qx];
      const int contrast = std::abs(grey_.at<std::uint8_t>(y, x) - grey_.at<std::uint8_t>(qy, qx));
      const auto small = static_cast<std::uint16_t>(o_.small_step);
      const auto jump = static_cast<std::uint16_t>(
          base + std::max(o_.small_step + 4, o_.large_step * 12 / (12 + contrast)));
      const std::uint16_t* t = padded_.data();
      for (int k = 0; k < n; ++k) {
        const std::uint16_t step = std::min(t[k], t[k + 2]) + small;
        const std::uint16_t best = std::min(std::min(t[k + 1], step), jump);
        out[k] = static_cast<std::uint16_t>(cost[k] + best - base);
        least = std::min(least, out[k]);
      }
    }
    now.least[path][x] = least;
    for (int k = 0; k < n; ++k) total[k] = static_cast<std::uint16_t>(total[k] + out[k]);
  }

  /// The other pixel's costs at lo - 1 .. lo + n of this one's, kFar where it has none.
  void gather(const std::uint16_t* from, int from_lo, int from_n, int lo, int n) {
    if (static_cast<int>(padded_.size()) < n + 2) padded_.resize(n + 2);
    const int first = std::clamp(from_lo - (lo - 1), 0, n + 2);
    const int last = std::clamp(from_lo + from_n - (lo - 1), first, n + 2);
    std::fill(padded_.begin(), padded_.begin() + first, kFar);
    if (last > first)
      std::memcpy(padded_.data() + first, from + (lo - 1 + first - from_lo),
                  sizeof(std::uint16_t) * (last - first));
    std::fill(padded_.begin() + last, padded_.begin() + n + 2, kFar);
  }

  const cv::Mat& grey_;
  const Candidates& c_;
  const std::vector<std::uint8_t>& costs_;
  const DisparityOptions& o_;
  int step_;
  std::vector<std::uint16_t> padded_;
};

struct Winner {
  ImageF d;           ///< sub-pixel
  ImageF confidence;  ///< of the left-right check and of the second best
};

Winner choose(const Candidates& c, const std::vector<std::uint16_t>& sum, const cv::Mat& mask_b) {
  const int width_b = mask_b.cols;
  Winner w{ImageF(c.width, c.height, 1), ImageF(c.width, c.height, 1)};
  parallel_for(c.height, [&](int y) {
    std::vector<int> best(c.width);
    std::vector<std::uint16_t> best_b(width_b, std::numeric_limits<std::uint16_t>::max());
    std::vector<int> d_b(width_b, std::numeric_limits<int>::max());
    for (int x = 0; x < c.width; ++x) {
      const std::size_t i = c.at(x, y);
      const std::uint16_t* s = &sum[c.offset[i]];
      best[x] = static_cast<int>(std::min_element(s, s + c.n[i]) - s);
      for (int k = 0; k < c.n[i]; ++k) {
        const int xb = x + c.lo[i] + k;
        if (xb >= 0 && xb < width_b && s[k] < best_b[xb]) best_b[xb] = s[k], d_b[xb] = c.lo[i] + k;
      }
    }
    for (int x = 0; x < c.width; ++x) {
      const std::size_t i = c.at(x, y);
      const std::uint16_t* s = &sum[c.offset[i]];
      const int k = best[x], d = c.lo[i] + k;
      double part = 0;
      if (k > 0 && k + 1 < c.n[i]) {
        const double curvature = s[k - 1] - 2.0 * s[k] + s[k + 1];
        if (curvature > 0) part = 0.5 * (s[k - 1] - s[k + 1]) / curvature;
      }
      w.d.at(x, y) = static_cast<float>(d + part);
      std::uint16_t second = std::numeric_limits<std::uint16_t>::max();
      for (int j = 0; j < c.n[i]; ++j)
        if (std::abs(j - k) > 1) second = std::min(second, s[j]);
      const int xb = x + d;
      const bool agrees =
          xb >= 0 && xb < width_b && mask_b.at<std::uint8_t>(y, xb) != 0 && std::abs(d_b[xb] - d) <= 1;
      w.confidence.at(x, y) =
          agrees ? std::max(0.01F, 1 - static_cast<float>(s[k]) / static_cast<float>(second)) : 0;
    }
  });
  return w;
}

/// What failed takes, of the nearest good pixels left and right in its row, the one that is farther away:
/// what is hidden in B lies behind what hides it. `sign`: whether farther is a smaller (1) or a larger (-1)
/// D.
void fill(Winner& w, float sign) {
  parallel_for(w.d.height, [&](int y) {
    const int n = w.d.width;
    std::vector<float> left(n, kNaN), right(n, kNaN);
    float last = kNaN;
    for (int x = 0; x < n; ++x) {
      if (w.confidence.at(x, y) > 0) last = w.d.at(x, y);
      left[x] = last;
    }
    last = kNaN;
    for (int x = n - 1; x >= 0; --x) {
      if (w.confidence.at(x, y) > 0) last = w.d.at(x, y);
      right[x] = last;
    }
    for (int x = 0; x < n; ++x) {
      if (w.confidence.at(x, y) > 0) continue;
      if (std::isfinite(left[x]) && std::isfinite(right[x]))
        w.d.at(x, y) = sign * std::min(sign * left[x], sign * right[x]);
      else if (std::isfinite(left[x]) || std::isfinite(right[x]))
        w.d.at(x, y) = std::isfinite(left[x]) ? left[x] : right[x];
    }
  });
}

/// Small islands that differ from all around them are no surfaces.
void remove_speckles(Winner& w) {
  constexpr int kSmallest = 60;
  cv::Mat d(w.d.height, w.d.width, CV_16S);
  for (int y = 0; y < d.rows; ++y)
    for (int x = 0; x < d.cols; ++x)
      d.at<std::int16_t>(y, x) = w.confidence.at(x, y) > 0
                                     ? static_cast<std::int16_t>(std::lround(w.d.at(x, y) * 8))
                                     : std::numeric_limits<std::int16_t>::min();
  cv::filterSpeckles(d, std::numeric_limits<std::int16_t>::min(), kSmallest, 12);
  for (int y = 0; y < d.rows; ++y)
    for (int x = 0; x < d.cols; ++x)
      if (d.at<std::int16_t>(y, x) == std::numeric_limits<std::int16_t>::min()) w.confidence.at(x, y) = 0;
}

void median3(ImageF& d) {
  cv::Mat view(d.height, d.width, CV_32F, d.data.data()), out;
  cv::medianBlur(view, out, 3);
  out.copyTo(view);
}

Winner match_level(const Level& a, const Level& b, const Candidates& c, const DisparityOptions& options,
                   float sign) {
  const std::vector<std::uint8_t> costs = costs_of(census_of(a), census_of(b), c);
  std::vector<std::uint16_t> sums[2];
  parallel_for(2, [&](int half) { Scan(a.grey, c, costs, options, half == 0 ? 1 : -1).run(sums[half]); });
  for (std::size_t i = 0; i < costs.size(); ++i)
    sums[0][i] = static_cast<std::uint16_t>(sums[0][i] + sums[1][i]);
  Winner w = choose(c, sums[0], b.mask);
  remove_speckles(w);
  fill(w, sign);
  median3(w.d);
  return w;
}

}  // namespace

Disparity find_disparity(const Image& a, const Image& b, const DisparityOptions& options) {
  Disparity out;
  if (a.width < 1 || b.width < 1 || a.height != b.height || options.min_px > options.max_px) return out;
  std::vector<Level> la{grey_of(a)}, lb{grey_of(b)};
  constexpr int kCoarseRange = 40, kLeastSize = 48;
  while ((options.max_px - options.min_px) >> (la.size() - 1) > kCoarseRange &&
         std::min({la.back().grey.cols, lb.back().grey.cols, la.back().grey.rows}) > 2 * kLeastSize) {
    la.push_back(halved(la.back()));
    lb.push_back(halved(lb.back()));
  }
  // The side on which most of the range lies tells whether near means a smaller D.
  const float sign = options.min_px + options.max_px < 0 ? -1.0F : 1.0F;
  Winner w;
  for (int level = static_cast<int>(la.size()) - 1; level >= 0; --level) {
    const double scale = std::ldexp(1.0, -level);
    const int low = static_cast<int>(std::floor(options.min_px * scale));
    const int high = static_cast<int>(std::ceil(options.max_px * scale));
    const int width = la[level].grey.cols, height = la[level].grey.rows;
    const Candidates c =
        w.d.empty() ? whole_range(width, height, low, high) : around(w.d, width, height, low, high);
    w = match_level(la[level], lb[level], c, options, sign);
  }
  for (int y = 0; y < a.height; ++y)
    for (int x = 0; x < a.width; ++x)
      if (!a.mask.empty() && a.mask.at(x, y) == 0) w.d.at(x, y) = kNaN, w.confidence.at(x, y) = 0;
  out.d_px = std::move(w.d);
  out.confidence = std::move(w.confidence);
  return out;
}

Image rebuild(const Image& b, const Disparity& disparity) {
  const ImageF pixels = to_float(b);
  ImageF out(disparity.d_px.width, disparity.d_px.height, pixels.channels);
  Mask mask(out.width, out.height, 1);
  for (int y = 0; y < out.height; ++y)
    for (int x = 0; x < out.width; ++x) {
      const float xb = static_cast<float>(x) + disparity.d_px.at(x, y);
      if (!(disparity.confidence.at(x, y) > 0) || !(xb >= 0) || !(xb < static_cast<float>(b.width - 1)))
        continue;
      const int x0 = static_cast<int>(xb);
      const float t = xb - static_cast<float>(x0);
      mask.at(x, y) = 255;
      for (int c = 0; c < out.channels; ++c)
        out.at(x, y, c) = (1 - t) * pixels.at(x0, y, c) + t * pixels.at(x0 + 1, y, c);
    }
  Image image = from_float(out, b.type);
  image.mask = std::move(mask);
  return image;
}

}  // namespace stuv
