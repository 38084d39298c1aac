#include "render/cpu/sweep.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "render/all_in_focus.h"

namespace stuv {
namespace {

using kernels::ShiftTap;
using kernels::WarpMap;

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr int kVectorPadding = 64;  ///< values that a kernel may write behind a row

PixelRect intersection(const PixelRect& a, const PixelRect& b) {
  return {std::max(a.x0, b.x0), std::max(a.y0, b.y0), std::min(a.x1, b.x1), std::min(a.y1, b.y1)};
}

bool any_missing(const StoredView& view, const PixelRect& rect) {
  const std::uint8_t* mask = view.mask_plane();
  if (mask == nullptr) return false;
  for (int y = std::max(rect.y0, 0); y < std::min(rect.y1, view.height); ++y) {
    const int x0 = std::max(rect.x0, 0), x1 = std::min(rect.x1, view.width);
    if (x0 < x1 && std::memchr(mask + static_cast<std::size_t>(y) * view.width + x0, 0,
                               static_cast<std::size_t>(x1 - x0)))
      return true;
  }
  return false;
}

/// The first columns of each row of `rect` between which nothing is missing: all of them, where a picture was
/// warped and lacks its corners only.
std::vector<kernels::PresentSpan> present_spans(const StoredView& view, const PixelRect& rect) {
  std::vector<kernels::PresentSpan> spans;
  for (int y = rect.y0; y < rect.y1; ++y) {
    const std::uint8_t* row = view.mask_plane() + static_cast<std::size_t>(y) * view.width;
    const auto* begin = std::find_if(row + rect.x0, row + rect.x1, [](std::uint8_t m) { return m != 0; });
    const auto* end = std::find(begin, row + rect.x1, std::uint8_t{0});
    spans.push_back({static_cast<std::int32_t>(begin - row), static_cast<std::int32_t>(end - row)});
  }
  return spans;
}

/// The pixels of a camera that rays through `halo` may meet on planes between two.
PixelRect needed_pixels(const Sweep& sweep, const View& camera, const PixelRect& halo) {
  const LightField& lf = sweep.store.views().lf;
  const PixelRect all{0, 0, lf.width, lf.height};
  double u0 = INFINITY, u1 = -INFINITY, v0 = INFINITY, v1 = -INFINITY;
  for (const double d : {sweep.disparities.front(), sweep.disparities.back()}) {
    const CameraMap map = camera_map(lf, camera, sweep.view, d);
    if (!map.visible) return all;
    for (const int x : {halo.x0, halo.x1 - 1})
      for (const int y : {halo.y0, halo.y1 - 1}) {
        const Ray ray = ray_of(sweep.view, x, y);
        if (!ray.towards_scene) return all;
        const double u = map.u0 + map.scale * ray.gx, v = map.v0 + map.scale * ray.gy;
        if (!std::isfinite(u) || !std::isfinite(v)) return all;
        u0 = std::min(u0, u), u1 = std::max(u1, u), v0 = std::min(v0, v), v1 = std::max(v1, v);
      }
  }
  const auto whole = [](double at, int size) { return static_cast<int>(std::clamp(at, -2.0, size + 2.0)); };
  return intersection(all, {whole(std::floor(u0) - 1, lf.width), whole(std::floor(v0) - 1, lf.height),
                            whole(std::floor(u1) + 3, lf.width), whole(std::floor(v1) + 3, lf.height)});
}

}  // namespace

SweepLattice::SweepLattice(const ViewSet& views) : chart(views.lf.rows, views.lf.cols, views.cameras) {
  for (const Filter filter : {Filter::normal, Filter::wide, Filter::skipped})
    filters.emplace_back(views.lf.rows, views.lf.cols, views.cameras, filter);
}

RenderOptions focal_plane_options(double d_px, Filter filter) {
  if (!std::isfinite(d_px)) throw std::invalid_argument("render: the disparity must be finite");
  RenderOptions options;
  options.planes = 1;
  options.window = 0;
  options.k = filter;
  options.d_min = options.d_max = d_px;
  return options;
}

Sweep::Sweep(PixelStore& pixels, const SweepLattice& sweep_lattice, const Viewpoint& viewpoint,
             const RenderOptions& render_options, Windows reach)
    : store(pixels), lattice(sweep_lattice), view(viewpoint), options(render_options), windows(reach) {
  for (int n = 0; n < options.planes; ++n) disparities.push_back(plane_disparity(options, n));
  positions = lattice_positions(lattice.chart, view);
  if (positions.constant)
    for (std::size_t k = 0; k < 3; ++k) lattice.filters[k].weights(positions.p[0], constant[k]);
  parallel = is_parallel(view);
  const PixelType type = store.views().lf.type;
  scale = type == PixelType::u8 ? 1.0F / 255 : type == PixelType::u16 ? 1.0F / 65535 : 1.0F;
  tie = static_cast<float>(tie_of(type));
  M_x = std::min(options.window, view.width);
  M_y = std::min(options.window, view.height);
  if (parallel && positions.constant && view.focal_px == store.views().lf.focal_px) find_shifts();
}

void Sweep::find_shifts() {
  const ViewSet& set = store.views();
  std::vector<char> wanted(set.cameras.size(), options.skips.idle_cameras ? 0 : 1);
  for (const auto& filter : constant)
    for (const CameraWeight& c : filter) wanted[static_cast<std::size_t>(c.camera)] = 1;
  const auto split = [](double at, int& whole, float& fraction) {
    const double nearest = std::round(at);
    if (std::abs(at - nearest) < FocalPlaneRenderer::kSnap_px) at = nearest;
    whole = static_cast<int>(std::floor(at));
    fraction = static_cast<float>(at - whole);
  };
  shifts.resize(disparities.size() * set.cameras.size());
  auto shift = shifts.begin();
  for (const double d : disparities)
    for (std::size_t c = 0; c < set.cameras.size(); ++c, ++shift) {
      if (!wanted[c]) continue;
      const CameraMap map = camera_map(set.lf, set.cameras[c], view, d);
      const double u = map.u0 - view.cx_px, v = map.v0 - view.cy_px;
      // Nowhere near the picture is as good as not visible.
      shift->visible = map.visible && std::abs(u) < 1e6 && std::abs(v) < 1e6;
      if (!shift->visible) continue;
      split(u, shift->dx, shift->ax);
      split(v, shift->dy, shift->ay);
      shift->valid = {-shift->dx, -shift->dy, set.lf.width - shift->dx - (shift->ax > 0 ? 1 : 0),
                      set.lf.height - shift->dy - (shift->ay > 0 ? 1 : 0)};
    }
}

kernels::PairWeights Sweep::pair_weights() const {
  return {static_cast<float>(options.a01), static_cast<float>(options.a02), static_cast<float>(options.a12)};
}

std::vector<CameraPart> cameras_in(const Sweep& sweep, const PixelRect& rect, const Filter* only) {
  const ViewSet& views = sweep.store.views();
  std::vector<CameraPart> parts(views.cameras.size());
  for (std::size_t c = 0; c < parts.size(); ++c) parts[c].camera = static_cast<int>(c);
  if (sweep.positions.constant) {
    for (std::size_t k = 0; k < 3; ++k)
      for (const CameraWeight& c : sweep.constant[k])
        parts[static_cast<std::size_t>(c.camera)].weight[k] = c.weight;
  } else {
    // Whoever may have a part anywhere: the box around the rays' places on the lattice.
    Eigen::Vector2d low(INFINITY, INFINITY), high(-INFINITY, -INFINITY);
    for (int y = rect.y0; y < rect.y1; ++y)
      for (int x = rect.x0; x < rect.x1; ++x) {
        const Eigen::Vector2d& p = sweep.positions.at(sweep.view, x, y);
        if (!p.allFinite()) continue;
        low = low.cwiseMin(p);
        high = high.cwiseMax(p);
      }
    const Eigen::Vector2d last(views.lf.cols - 1, views.lf.rows - 1);
    low = low.cwiseMax(Eigen::Vector2d::Zero()).cwiseMin(last);
    high = high.cwiseMax(Eigen::Vector2d::Zero()).cwiseMin(last);
    for (int k = 0; k < 3; ++k) {
      const LatticeFilter& filter = sweep.lattice.filters[static_cast<std::size_t>(k)];
      const double reach = filter.half_width();
      for (int row = 0; row < filter.thinned_rows(); ++row)
        for (int col = 0; col < filter.thinned_cols(); ++col) {
          if (col <= low.x() / filter.stride() - reach || col >= high.x() / filter.stride() + reach) continue;
          if (row <= low.y() / filter.stride() - reach || row >= high.y() / filter.stride() + reach) continue;
          for (const CameraWeight& c :
               sweep.lattice.stands(k)[static_cast<std::size_t>(row * filter.thinned_cols() + col)])
            parts[static_cast<std::size_t>(c.camera)].weight[static_cast<std::size_t>(k)] = 1;
        }
    }
  }
  if (only != nullptr)
    for (CameraPart& part : parts)
      for (std::size_t k = 0; k < 3; ++k)
        if (k != static_cast<std::size_t>(*only)) part.weight[k] = 0;
  const auto idle = [](const CameraPart& part) {
    return std::all_of(part.weight.begin(), part.weight.end(), [](double w) { return w <= 0; });
  };
  if (sweep.options.skips.idle_cameras)
    parts.erase(std::remove_if(parts.begin(), parts.end(), idle), parts.end());
  return parts;
}

bool meet_at_one_offset(const Sweep& sweep, const std::vector<int>& cameras) {
  const ViewSet& set = sweep.store.views();
  return !sweep.shifts.empty() && std::all_of(cameras.begin(), cameras.end(), [&](int c) {
    return set.cameras[static_cast<std::size_t>(c)].w == sweep.view.z;
  });
}

SweepBlock::SweepBlock(const Sweep& sweep, const PixelRect& rect, Purpose purpose)
    : sweep_(sweep), purpose_(purpose), rect_(rect) {
  const int M_x = sweep.M_x, M_y = sweep.M_y;
  padded_ = {rect.x0 - M_x, rect.y0 - M_y, rect.x1 + M_x, rect.y1 + M_y};
  halo_ = sweep.windows == Windows::cut || purpose == Purpose::colour
              ? rect
              : intersection(padded_, {0, 0, sweep.view.width, sweep.view.height});
  stride_ = static_cast<std::size_t>(padded_.x1 - padded_.x0) + kVectorPadding;
  padded_size_ = stride_ * static_cast<std::size_t>(padded_.y1 - padded_.y0) + kVectorPadding;
  const std::size_t size = stride_ * static_cast<std::size_t>(rect.y1 - rect.y0) + kVectorPadding;
  if (purpose == Purpose::search) {
    E0_.resize(padded_size_);
    sum_.resize(size);
    count_.resize(size);
    inverse_.resize(size);
  }
  E_min_.assign(size, kInfinity);
  E_sum_.assign(size, 0.0F);
  E_count_.assign(size, 0.0F);
  plane_.assign(size, -1);
  const Filter* only = purpose == Purpose::colour ? &sweep.options.k : nullptr;
  for (const CameraPart& part : cameras_in(sweep, halo_, only)) {
    cameras_.push_back(part.camera);
    constant_.push_back(part.weight);
  }
  acquire_views();
  by_shift_ = !any_masked_ && meet_at_one_offset(sweep, cameras_);
  if (!views_.empty()) type_ = views_.front()->type;
  channels_ = sweep.store.views().lf.channels;
}

void SweepBlock::acquire_views() {
  const ViewSet& set = sweep_.store.views();
  for (const int c : cameras_) {
    const PixelRect needed = needed_pixels(sweep_, set.cameras[static_cast<std::size_t>(c)], halo_);
    views_.push_back(sweep_.store.acquire(
        c, sweep_.options.skips.unread_tiles ? needed : PixelRect{0, 0, set.lf.width, set.lf.height}));
    masked_.push_back(any_missing(*views_.back(), needed) ? 1 : 0);
    spans_.push_back({needed.y0, {}});
    if (masked_.back()) spans_.back().rows = present_spans(*views_.back(), needed);
    any_masked_ = any_masked_ || masked_.back() != 0;
  }
}

/// The job of a part in which the same cameras see all pixels. A band later the plane's job is the same.
const SweepBlock::PlaneJob& SweepBlock::shift_job(int n, const PixelRect& part,
                                                  const kernels::PairWeights& a) {
  bool all = true;
  sees_.resize(cameras_.size());
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const CameraShift& s = shift(n, i);
    sees_[i] = s.visible && s.valid.x0 <= part.x0 && part.x1 <= s.valid.x1 && s.valid.y0 <= part.y0 &&
               part.y1 <= s.valid.y1;
    all = all && (sees_[i] || !s.visible);
  }
  std::vector<PlaneJob>& of_all = a == sweep_.pair_weights() ? jobs_ : jobs_without_wide_;
  of_all.resize(sweep_.disparities.size());
  PlaneJob& plane = all ? of_all[static_cast<std::size_t>(n)] : part_job_;
  if (all && plane.ready) return plane;
  plane.job.type = type_;
  plane.job.channels = channels_;
  plane.job.a = a;
  fill_shift_job(n, sees_, plane);
  plane.ready = true;
  return plane;
}

void SweepBlock::fill_shift_job(int n, const std::vector<char>& sees, PlaneJob& plane) {
  std::array<double, 3> seen{0, 0, 0};
  for (std::size_t i = 0; i < cameras_.size(); ++i)
    if (sees[i])
      for (std::size_t k = 0; k < 3; ++k) seen[k] += constant_[i][k];
  kernels::ShiftJob& job = plane.job;
  const auto& a = job.a;
  const bool takes_part[3] = {a.a01 != 0 || a.a02 != 0, a.a01 != 0 || a.a12 != 0, a.a02 != 0 || a.a12 != 0};
  plane.defined = true;
  for (std::size_t k = 0; k < 3; ++k)
    plane.defined = plane.defined &&
                    (!takes_part[k] || static_cast<float>(seen[k]) >= FocalPlaneRenderer::kLeastCoverage);
  plane.candidate = seen[static_cast<std::size_t>(sweep_.options.k)] > 0;
  job.taps.clear();
  if (!plane.defined) return;

  // A filter that takes no part may see nothing; its weights are then 0.
  const auto part_of = [&](std::size_t i, std::size_t k) {
    return seen[k] > 0 ? constant_[i][k] / seen[k] : 0.0;
  };
  const bool use_first = a.a01 != 0 || a.a12 != 0, use_second = a.a02 != 0 || a.a12 != 0;
  first_weights_.clear();
  second_weights_.clear();
  for (const bool second : {true, false}) {
    for (std::size_t i = 0; i < cameras_.size(); ++i) {
      if (!sees[i]) continue;
      const double w1 = use_first ? part_of(i, 0) - part_of(i, 1) : 0.0;
      const double w2 = use_second ? part_of(i, 0) - part_of(i, 2) : 0.0;
      // A camera of weight 0 is here only if idle cameras are not to be skipped.
      if (second == (w2 != 0) && (w1 != 0 || w2 != 0 || !sweep_.options.skips.idle_cameras))
        add_tap(shift(n, i), *views_[i], w1, w2, job);
    }
    if (second) job.in_second = job.taps.size();
  }
  job.unit1 = fix_weights(first_weights_, job, &ShiftTap::fixed1);
  job.unit2 = fix_weights(second_weights_, job, &ShiftTap::fixed2);
}

void SweepBlock::add_tap(const CameraShift& s, const StoredView& view, double w1, double w2,
                         kernels::ShiftJob& job) {
  ShiftTap tap;
  tap.view = &view;
  tap.offset = static_cast<std::ptrdiff_t>(s.dy) * view.width + s.dx;
  tap.ax = s.ax;
  tap.two_rows = s.ay > 0;
  tap.two_columns = s.ax > 0;
  const double rows[] = {1 - s.ay, s.ay}, columns[] = {1 - s.ax, s.ax};
  for (int q = 0; q < 2; ++q) {
    tap.w1[q] = static_cast<float>(w1 * rows[q] * sweep_.scale);
    tap.w2[q] = static_cast<float>(w2 * rows[q] * sweep_.scale);
  }
  const auto bilinear = [&](double w) {
    return std::array<double, 4>{w * rows[0] * columns[0], w * rows[0] * columns[1], w * rows[1] * columns[0],
                                 w * rows[1] * columns[1]};
  };
  first_weights_.push_back(bilinear(w1));
  second_weights_.push_back(bilinear(w2));
  job.taps.push_back(tap);
}

/// Integers in the place of weights, as large as their products with pixels may be. What rounding takes from
/// one the next one gets, so their sum is that of the weights, 0, and a picture that is only brighter has the
/// same differences. Returns what one of them is worth, in full scale.
float SweepBlock::fix_weights(const std::vector<std::array<double, 4>>& weights, kernels::ShiftJob& job,
                              std::int32_t (ShiftTap::*fixed)[2]) const {
  double largest = 0, total = 0;
  for (const auto& tap : weights)
    for (const double w : tap) {
      largest = std::max(largest, std::abs(w));
      total += std::abs(w);
    }
  if (!(largest > 0)) return 0;
  // Sums of 32 bits; of u16, less 2^15, each pixel is as large as that.
  const double most = type_ == PixelType::u8 ? 8e6 : 6.5e4;
  const double scale = std::min(32766 / largest, most / total);
  double sum = 0;
  long before = 0;
  const auto next = [&](double w) {
    sum += w * scale;
    // To the nearest, as lround, which is a call.
    const long now = static_cast<long>(sum + std::copysign(0.5, sum)), whole = now - before;
    before = now;
    return static_cast<std::uint16_t>(whole);
  };
  for (std::size_t t = 0; t < weights.size(); ++t)
    for (std::size_t row = 0; row < 2; ++row) {
      const std::uint32_t left = next(weights[t][2 * row]), right = next(weights[t][2 * row + 1]);
      (job.taps[t].*fixed)[row] = static_cast<std::int32_t>(left | right << 16);
    }
  return static_cast<float>(sweep_.scale / scale);
}

/// Every camera sees all of `halo` on plane n, or nothing.
bool SweepBlock::seen_alike(int n, const PixelRect& halo) const {
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const CameraShift& s = shift(n, i);
    if (!s.visible) continue;
    const PixelRect seen = intersection(s.valid, halo);
    if (!seen.empty() && seen != halo) return false;
  }
  return true;
}

void SweepBlock::evaluate_shift_job(const PlaneJob& plane, const PixelRect& part) {
  const int width = part.x1 - part.x0, height = part.y1 - part.y0;
  shift_difference(plane.job, part.x0, part.y0, width, height, E0_at(part.x0, part.y0), stride_);
  multiply_adds_ += kernels::multiply_adds(plane.job) * width * height;
}

/// True if equation 5 is defined and the plane a candidate everywhere; otherwise `defined_` and `candidate_`
/// say where.
bool SweepBlock::difference_by_shift(int n, const PixelRect& halo, const kernels::PairWeights& a) {
  if (seen_alike(n, halo)) {
    const PlaneJob& plane = shift_job(n, halo, a);
    if (plane.defined && plane.candidate) {
      evaluate_shift_job(plane, halo);
      return true;
    }
  }
  // Cameras come and go along straight lines only.
  std::vector<int> xs{halo.x0, halo.x1}, ys{halo.y0, halo.y1};
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const CameraShift& s = shift(n, i);
    if (!s.visible) continue;
    for (const int x : {s.valid.x0, s.valid.x1})
      if (x > halo.x0 && x < halo.x1) xs.push_back(x);
    for (const int y : {s.valid.y0, s.valid.y1})
      if (y > halo.y0 && y < halo.y1) ys.push_back(y);
  }
  for (std::vector<int>* lines : {&xs, &ys}) {
    std::sort(lines->begin(), lines->end());
    lines->erase(std::unique(lines->begin(), lines->end()), lines->end());
  }
  struct Gap {
    PixelRect part;
    bool defined, candidate;
  };
  std::vector<Gap> gaps;
  for (std::size_t j = 0; j + 1 < ys.size(); ++j)
    for (std::size_t i = 0; i + 1 < xs.size(); ++i) {
      const PixelRect part{xs[i], ys[j], xs[i + 1], ys[j + 1]};
      const PlaneJob& plane = shift_job(n, part, a);
      if (!plane.defined || !plane.candidate) gaps.push_back({part, plane.defined, plane.candidate});
      if (plane.defined) evaluate_shift_job(plane, part);
    }
  if (gaps.empty()) return true;
  defined_.resize(padded_size_);
  candidate_.resize(padded_size_);
  for (int y = halo.y0; y < halo.y1; ++y) {
    std::fill_n(defined_.data() + index_of(halo.x0, y), halo.x1 - halo.x0, 1.0F);
    std::fill_n(candidate_.data() + index_of(halo.x0, y), halo.x1 - halo.x0, 1.0F);
  }
  for (const Gap& gap : gaps)
    for (int y = gap.part.y0; y < gap.part.y1; ++y) {
      const int width = gap.part.x1 - gap.part.x0;
      if (!gap.defined) {
        std::fill_n(E0_at(gap.part.x0, y), width, 0.0F);
        std::fill_n(defined_.data() + index_of(gap.part.x0, y), width, 0.0F);
      }
      if (!gap.candidate) std::fill_n(candidate_.data() + index_of(gap.part.x0, y), width, 0.0F);
    }
  return false;
}

/// Directions of the rays relative to the block's centre, so that float has the digits for them.
void SweepBlock::make_rays() {
  const Viewpoint& view = sweep_.view;
  const Ray centre = ray_of(view, (halo_.x0 + halo_.x1) / 2, (halo_.y0 + halo_.y1) / 2);
  if (sweep_.parallel) {
    gx_.assign(stride_, 0.0F);
    gy_.assign(static_cast<std::size_t>(padded_.y1 - padded_.y0), 0.0F);
    for (int x = halo_.x0; x < halo_.x1; ++x)
      gx_[static_cast<std::size_t>(x - padded_.x0)] = static_cast<float>(ray_of(view, x, 0).gx - centre.gx);
    for (int y = halo_.y0; y < halo_.y1; ++y)
      gy_[static_cast<std::size_t>(y - padded_.y0)] = static_cast<float>(ray_of(view, 0, y).gy - centre.gy);
    return;
  }
  gx_.assign(padded_size_, 0.0F);
  gy_.assign(padded_size_, 0.0F);
  for (int y = halo_.y0; y < halo_.y1; ++y) {
    for (int x = halo_.x0; x < halo_.x1; ++x) {
      const Ray ray = ray_of(view, x, y);
      gx_[index_of(x, y)] = ray.towards_scene ? static_cast<float>(ray.gx - centre.gx) : std::nanf("");
      gy_[index_of(x, y)] = ray.towards_scene ? static_cast<float>(ray.gy - centre.gy) : std::nanf("");
    }
  }
}

void SweepBlock::make_maps() {
  const ViewSet& set = sweep_.store.views();
  const Ray centre = ray_of(sweep_.view, (halo_.x0 + halo_.x1) / 2, (halo_.y0 + halo_.y1) / 2);
  maps_.assign(sweep_.disparities.size() * cameras_.size(), {});
  auto map = maps_.begin();
  for (const double d : sweep_.disparities) {
    for (const int c : cameras_) {
      const CameraMap at = camera_map(set.lf, set.cameras[static_cast<std::size_t>(c)], sweep_.view, d);
      WarpMap& out = *map++;
      if (!at.visible) continue;
      const double u = at.u0 + at.scale * centre.gx, v = at.v0 + at.scale * centre.gy;
      if (!(std::abs(u) < 1e8 && std::abs(v) < 1e8)) continue;
      out.whole_x = static_cast<std::int32_t>(std::lround(u));
      out.whole_y = static_cast<std::int32_t>(std::lround(v));
      out.frac_x = static_cast<float>(u - out.whole_x);
      out.frac_y = static_cast<float>(v - out.whole_y);
      out.slope = static_cast<float>(at.scale);
      out.visible = 1;
    }
  }
}

/// Weights of each camera and filter at each pixel of the block, as LatticeFilter::weights.
void SweepBlock::make_weights() {
  // Where all differences are made by shifts, only the picture's own filter is needed.
  const auto wanted = [&](std::size_t i, std::size_t k) {
    return constant_[i][k] > 0 && (!by_shift_ || k == static_cast<std::size_t>(sweep_.options.k));
  };
  const bool constant = sweep_.positions.constant;
  warp_job_.weight_stride = constant ? 0 : stride_;
  const std::size_t raster = constant ? stride_ : padded_size_;
  std::vector<std::array<std::size_t, 3>> at(cameras_.size());
  std::size_t rasters = 0;
  for (std::size_t i = 0; i < cameras_.size(); ++i)
    for (std::size_t k = 0; k < 3; ++k)
      if (wanted(i, k)) at[i][k] = raster * rasters++;
  weights_.assign(rasters * raster, 0.0F);
  std::vector<int> slot(sweep_.store.views().cameras.size(), -1);
  for (std::size_t i = 0; i < cameras_.size(); ++i)
    slot[static_cast<std::size_t>(cameras_[i])] = static_cast<int>(i);
  warp_job_.cameras.assign(cameras_.size(), {});
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    warp_job_.cameras[i].view = views_[i].get();
    warp_job_.cameras[i].masked = masked_[i] != 0;
    warp_job_.cameras[i].spans = spans_[i].rows.data();
    warp_job_.cameras[i].spans_y0 = spans_[i].y0;
    warp_job_.cameras[i].spans_y1 = spans_[i].y0 + static_cast<int>(spans_[i].rows.size());
    for (std::size_t k = 0; k < 3; ++k)
      warp_job_.cameras[i].constant[k] = static_cast<float>(constant_[i][k]);
    for (std::size_t k = 0; k < 3; ++k)
      if (wanted(i, k)) warp_job_.cameras[i].weight[k] = weights_.data() + at[i][k];
  }
  const auto weight_row = [&](std::size_t i, std::size_t k, int y) {
    return weights_.data() + at[i][k] + index_of(halo_.x0, y);
  };
  const int width = halo_.x1 - halo_.x0;
  if (constant) {
    for (std::size_t i = 0; i < cameras_.size(); ++i)
      for (std::size_t k = 0; k < 3; ++k)
        if (wanted(i, k))
          std::fill_n(weights_.data() + at[i][k] + (halo_.x0 - padded_.x0), halo_.x1 - halo_.x0,
                      static_cast<float>(constant_[i][k]));
    return;
  }
  const LightField& lf = sweep_.store.views().lf;
  std::vector<float> px(static_cast<std::size_t>(width)), py(px.size()), tents(px.size()), total(px.size());
  for (int y = halo_.y0; y < halo_.y1; ++y) {
    for (int k = 0; k < 3; ++k) {
      if (purpose_ == Purpose::colour && k != static_cast<int>(sweep_.options.k)) continue;
      const LatticeFilter& filter = sweep_.lattice.filters[static_cast<std::size_t>(k)];
      const auto stride = static_cast<float>(filter.stride());
      const auto inverse = static_cast<float>(1 / filter.half_width());
      float x_low = kInfinity, x_high = -kInfinity, y_low = kInfinity, y_high = -kInfinity;
      for (int x = 0; x < width; ++x) {
        const Eigen::Vector2d& p = sweep_.positions.at(sweep_.view, halo_.x0 + x, y);
        const auto i = static_cast<std::size_t>(x);
        px[i] = static_cast<float>(std::clamp(p.x(), 0.0, lf.cols - 1.0)) / stride;
        py[i] = static_cast<float>(std::clamp(p.y(), 0.0, lf.rows - 1.0)) / stride;
        x_low = std::min(x_low, px[i]), x_high = std::max(x_high, px[i]);
        y_low = std::min(y_low, py[i]), y_high = std::max(y_high, py[i]);
      }
      std::fill(total.begin(), total.end(), 0.0F);
      const auto reach = static_cast<float>(filter.half_width());
      for (int row = 0; row < filter.thinned_rows(); ++row) {
        if (lf.rows > 1 &&
            (static_cast<float>(row) <= y_low - reach || static_cast<float>(row) >= y_high + reach))
          continue;
        for (int col = 0; col < filter.thinned_cols(); ++col) {
          if (lf.cols > 1 &&
              (static_cast<float>(col) <= x_low - reach || static_cast<float>(col) >= x_high + reach))
            continue;
          const auto& stands =
              sweep_.lattice.stands(k)[static_cast<std::size_t>(row * filter.thinned_cols() + col)];
          if (stands.empty()) continue;
          for (std::size_t x = 0; x < px.size(); ++x) {
            const float along =
                lf.cols == 1 ? 1.0F : std::max(0.0F, 1 - std::abs(static_cast<float>(col) - px[x]) * inverse);
            const float across =
                lf.rows == 1 ? 1.0F : std::max(0.0F, 1 - std::abs(static_cast<float>(row) - py[x]) * inverse);
            tents[x] = along * across;
            total[x] += tents[x];
          }
          for (const CameraWeight& stand : stands) {
            const int i = slot[static_cast<std::size_t>(stand.camera)];
            if (i < 0 || !wanted(static_cast<std::size_t>(i), static_cast<std::size_t>(k))) continue;
            float* w = weight_row(static_cast<std::size_t>(i), static_cast<std::size_t>(k), y);
            for (std::size_t x = 0; x < px.size(); ++x) w[x] += tents[x] * static_cast<float>(stand.weight);
          }
        }
      }
      for (float& t : total) t = t > 0 ? 1 / t : 0;
      for (std::size_t i = 0; i < cameras_.size(); ++i) {
        if (!wanted(i, static_cast<std::size_t>(k))) continue;
        float* w = weight_row(i, static_cast<std::size_t>(k), y);
        for (std::size_t x = 0; x < px.size(); ++x) w[x] *= total[x];
      }
    }
  }
}

void SweepBlock::prepare_warp() {
  if (warp_ready_) return;
  warp_ready_ = true;
  make_rays();
  make_maps();
  make_weights();
  warp_job_.channels = channels_;
  warp_job_.scale = sweep_.scale;
  warp_job_.a = sweep_.pair_weights();
  warp_job_.k = static_cast<int>(sweep_.options.k);
  warp_job_.parallel = sweep_.parallel;
  warp_job_.gx = gx_.data();
  warp_job_.gy = gy_.data();
  warp_job_.stride = stride_;
}

bool SweepBlock::difference_by_warp(int n, const PixelRect& halo) {
  prepare_warp();
  defined_.resize(padded_size_);
  candidate_.resize(padded_size_);
  const int x = halo.x0 - padded_.x0, y = halo.y0 - padded_.y0;
  kernels::warp_difference(warp_job_, maps_.data() + static_cast<std::size_t>(n) * cameras_.size(), x, y,
                           halo.x1 - halo.x0, halo.y1 - halo.y0, E0_.data(), defined_.data(),
                           candidate_.data());
  // Three for the bilinear sample, one for each difference.
  multiply_adds_ += 5.0 * warp_job_.channels * static_cast<double>(cameras_.size()) * (halo.x1 - halo.x0) *
                    (halo.y1 - halo.y0);
  // The last vector of a row ran over its end.
  for (int row = halo.y0; row < halo.y1; ++row)
    for (std::vector<float>* raster : {&E0_, &defined_})
      std::fill_n(raster->data() + index_of(halo.x1, row), padded_.x1 - halo.x1 + 16, 0.0F);
  return false;
}

/// Zero around `halo`, out to `padded`.
void SweepBlock::clear_outside(std::vector<float>& raster, const PixelRect& padded, const PixelRect& halo) {
  for (int y = padded.y0; y < padded.y1; ++y) {
    float* row = raster.data() + index_of(padded.x0, y);
    if (y < halo.y0 || y >= halo.y1) {
      std::fill_n(row, padded.x1 - padded.x0, 0.0F);
      continue;
    }
    std::fill_n(row, halo.x0 - padded.x0, 0.0F);
    std::fill_n(raster.data() + index_of(halo.x1, y), padded.x1 - halo.x1, 0.0F);
  }
}

/// Where windows around `part` lie.
PixelRect SweepBlock::halo_of(const PixelRect& part) const {
  return intersection(
      {part.x0 - sweep_.M_x, part.y0 - sweep_.M_y, part.x1 + sweep_.M_x, part.y1 + sweep_.M_y}, halo_);
}

/// inverse_: 1 / the pixels of each window that lie in `halo`.
void SweepBlock::invert_counts(const PixelRect& halo, const PixelRect& part) {
  if (inverted_halo_ == halo && inverted_part_ == part) return;
  inverted_halo_ = halo;
  inverted_part_ = part;
  const auto inside = [](int at, int M, int low, int high) {
    return std::min(at + M, high - 1) - std::max(at - M, low) + 1;
  };
  int last = 0;
  const float* before = nullptr;
  for (int y = part.y0; y < part.y1; ++y) {
    float* inverse =
        inverse_.data() + static_cast<std::size_t>(y - rect_.y0) * stride_ + (part.x0 - rect_.x0);
    const int rows = inside(y, sweep_.M_y, halo.y0, halo.y1);
    if (rows == last) {
      std::copy_n(before, part.x1 - part.x0, inverse);
    } else {
      for (int x = part.x0; x < part.x1; ++x)
        inverse[x - part.x0] = 1 / static_cast<float>(rows * inside(x, sweep_.M_x, halo.x0, halo.x1));
    }
    last = rows;
    before = inverse;
  }
}

bool SweepBlock::difference(int n, const PixelRect& halo) {
  return by_shift_ ? difference_by_shift(n, halo, sweep_.pair_weights()) : difference_by_warp(n, halo);
}

void SweepBlock::evaluate_rows(int n, int y0, int y1) {
  carries_.resize(sweep_.disparities.size());
  evaluate_part(n, {rect_.x0, y0, rect_.x1, y1}, &carries_[static_cast<std::size_t>(n)]);
}

void SweepBlock::evaluate_part(int n, const PixelRect& part, Carry* carry) {
  const int M_x = sweep_.M_x, M_y = sweep_.M_y;
  const PixelRect padded{part.x0 - M_x, part.y0 - M_y, part.x1 + M_x, part.y1 + M_y};
  const PixelRect halo = halo_of(part);
  const int width = part.x1 - part.x0, height = part.y1 - part.y0;
  const auto carried_size = static_cast<std::size_t>(2 * M_y) * static_cast<std::size_t>(width);
  bool carried = carry != nullptr && carry->y == part.y0;
  PixelRect rows = padded, fresh = halo;
  if (carried) {
    rows.y0 = part.y0 + M_y;
    fresh.y0 = std::min(rows.y0, halo.y1);
  }
  defined_everywhere_ = difference(n, fresh);
  if (carried && !defined_everywhere_) {
    // What was carried knows no gaps.
    carried = false;
    rows = padded;
    fresh = halo;
    difference(n, fresh);
  }
  clear_outside(E0_, rows, fresh);
  kernels::sum_rows(E0_at(rows.x0, rows.y0), stride_, width, rows.y1 - rows.y0, M_x, scratch_);
  const auto row_of_sums = [&](int y) { return E0_at(padded.x0, y); };
  const auto carried_row = [&](int i) { return carry->rows.data() + static_cast<std::ptrdiff_t>(i) * width; };
  for (int i = 0; carried && i < 2 * M_y; ++i) std::copy_n(carried_row(i), width, row_of_sums(padded.y0 + i));
  if (carry != nullptr) {
    carry->rows.resize(carried_size);
    carry->y = defined_everywhere_ ? part.y1 : std::numeric_limits<int>::min();
    for (int i = 0; defined_everywhere_ && i < 2 * M_y; ++i)
      std::copy_n(row_of_sums(part.y1 - M_y + i), width, carried_row(i));
  }
  const std::size_t first =
      static_cast<std::size_t>(part.y0 - rect_.y0) * stride_ + static_cast<std::size_t>(part.x0 - rect_.x0);
  kernels::sum_columns(row_of_sums(padded.y0), stride_, width, height, M_y, sum_.data() + first, stride_);
  multiply_adds_ += kernels::multiply_adds_of_window(M_x, M_y) * width * height;
  if (defined_everywhere_) {
    invert_counts(halo, part);
  } else {
    clear_outside(defined_, padded, halo);
    float* defined = defined_.data() + index_of(padded.x0, padded.y0);
    kernels::sum_rows(defined, stride_, width, padded.y1 - padded.y0, M_x, scratch_);
    kernels::sum_columns(defined, stride_, width, height, M_y, count_.data() + first, stride_);
  }
  for (int y = 0; y < height; ++y) {
    const std::size_t at = static_cast<std::size_t>(y) * stride_ + first;
    const kernels::MinimumRow best{E_min_.data() + at, plane_.data() + at, E_sum_.data() + at,
                                   E_count_.data() + at};
    if (defined_everywhere_)
      kernels::add_plane(best, n, width, sum_.data() + at, inverse_.data() + at, sweep_.tie);
    else
      kernels::add_part_plane(best, n, width, sum_.data() + at, count_.data() + at,
                              candidate_.data() + index_of(part.x0, part.y0 + y), sweep_.tie);
  }
}

bool SweepBlock::ruled_out(int n, int x0, int x1) {
  const kernels::PairWeights all = sweep_.pair_weights();
  if (!by_shift_ || all.a02 == 0 || all.a01 == 0) return false;
  const PixelRect part{x0, rect_.y0, x1, rect_.y1};
  const int width = x1 - x0, height = rect_.y1 - rect_.y0;
  // Cheap first look: without any cost to beat there is nothing to rule out.
  for (int y = 0; y < height; ++y) {
    const float* E = E_min_.data() + static_cast<std::size_t>(y) * stride_ + (x0 - rect_.x0);
    if (*std::max_element(E, E + width) == kInfinity) return false;
  }
  const int M_x = sweep_.M_x, M_y = sweep_.M_y;
  const PixelRect padded{x0 - M_x, padded_.y0, x1 + M_x, padded_.y1};
  const PixelRect halo = halo_of(part);
  if (!difference_by_shift(n, halo, {0, all.a02, 0})) return false;
  clear_outside(E0_, padded, halo);
  const std::size_t first = static_cast<std::size_t>(x0 - rect_.x0);
  kernels::sum_rows(E0_at(padded.x0, padded.y0), stride_, width, padded.y1 - padded.y0, M_x, scratch_);
  kernels::sum_columns(E0_at(padded.x0, padded.y0), stride_, width, height, M_y, sum_.data() + first,
                       stride_);
  invert_counts(halo, part);
  for (int y = 0; y < height; ++y) {
    const std::size_t at = static_cast<std::size_t>(y) * stride_ + first;
    for (std::size_t x = at; x < at + static_cast<std::size_t>(width); ++x)
      if (sum_[x] * inverse_[x] < E_min_[x] + sweep_.tie) return false;
  }
  return true;
}

void SweepBlock::choose(int n, int x0, int x1) {
  for (int y = 0; y < rect_.y1 - rect_.y0; ++y)
    std::fill_n(plane_.data() + static_cast<std::size_t>(y) * stride_ + (x0 - rect_.x0), x1 - x0, n);
}

PixelRect SweepBlock::without_plane(int x0, int x1) const {
  PixelRect out{x1, rect_.y1, x0, rect_.y0};
  for (int y = rect_.y0; y < rect_.y1; ++y) {
    const std::int32_t* planes = plane(y - rect_.y0);
    for (int x = x0; x < x1; ++x) {
      if (planes[x - rect_.x0] >= 0) continue;
      out = {std::min(out.x0, x), std::min(out.y0, y), std::max(out.x1, x + 1), std::max(out.y1, y + 1)};
    }
  }
  return out;
}

void SweepBlock::take(const SweepBlock& other, int x0, int x1) {
  for (int y = 0; y < rect_.y1 - rect_.y0; ++y) {
    const std::size_t at = static_cast<std::size_t>(y) * stride_ + static_cast<std::size_t>(x0 - rect_.x0);
    const auto copy = [&](const auto& from, auto& to) {
      std::copy_n(from.data() + at, x1 - x0, to.data() + at);
    };
    copy(other.plane_, plane_);
    copy(other.E_min_, E_min_);
    copy(other.E_sum_, E_sum_);
    copy(other.E_count_, E_count_);
  }
}

double SweepBlock::bytes() const {
  const int channels = channels_;
  const double pixels = static_cast<double>(rect_.x1 - rect_.x0) * (rect_.y1 - rect_.y0);
  const double sample = static_cast<double>(bytes_per_sample(type_));
  // The result: colour, disparity, plane and confidence.
  return pixels * (static_cast<double>(cameras_.size()) * channels * sample + 4.0 * (channels + 3));
}

/// colour and coverage: rasters of the block's outputs.
void SweepBlock::colour_by_warp(const PixelRect& part, const SweepBlock& searched, float* colour,
                                float* coverage) {
  if (part.empty()) return;
  prepare_warp();
  // The kernel walks the part from its first pixel.
  kernels::WarpJob job = warp_job_;
  const std::size_t in = index_of(part.x0, part.y0);
  const auto left = static_cast<std::size_t>(part.x0 - padded_.x0);
  job.gx += job.parallel ? left : in;
  job.gy += job.parallel ? static_cast<std::size_t>(part.y0 - padded_.y0) : in;
  for (kernels::WarpCamera& camera : job.cameras)
    for (const float*& weight : camera.weight)
      if (weight != nullptr) weight += job.weight_stride == 0 ? left : in;
  const std::size_t out =
      static_cast<std::size_t>(part.y0 - rect_.y0) * stride_ + static_cast<std::size_t>(part.x0 - rect_.x0);
  kernels::warp_colour(job, maps_.data(), searched.plane_.data() + out, part.x1 - part.x0, part.y1 - part.y0,
                       colour + out, searched.plane_.size(), coverage + out);
}

/// Returns the part of the block that all cameras of the picture's filter see on all of its planes.
PixelRect SweepBlock::fill_colour_job(const SweepBlock& searched, kernels::ColourJob& job) {
  const auto k = static_cast<std::size_t>(sweep_.options.k);
  const std::size_t planes = sweep_.disparities.size();
  std::vector<char> present(planes, 0);
  for (int y = 0; y < rect_.y1 - rect_.y0; ++y)
    for (int x = 0; x < rect_.x1 - rect_.x0; ++x)
      if (const int n = searched.plane(y)[x]; n >= 0) present[static_cast<std::size_t>(n)] = 1;
  std::vector<std::size_t> filter;
  double total = 0;
  for (std::size_t i = 0; i < cameras_.size(); ++i)
    if (constant_[i][k] > 0) {
      filter.push_back(i);
      total += constant_[i][k];
    }
  PixelRect seen = filter.empty() ? PixelRect{} : rect_;
  job.type = type_;
  job.channels = channels_;
  job.cameras = filter.size();
  job.taps.resize(planes * filter.size());
  for (std::size_t n = 0; n < planes; ++n) {
    if (!present[n]) continue;
    for (std::size_t c = 0; c < filter.size(); ++c) {
      const std::size_t i = filter[c];
      const CameraShift& s = shift(static_cast<int>(n), i);
      if (!s.visible) return {};
      seen = intersection(seen, s.valid);
      const double w = constant_[i][k] / total * sweep_.scale;
      kernels::ColourTap& tap = job.taps[n * filter.size() + c];
      tap.view = views_[i].get();
      tap.offset = static_cast<std::ptrdiff_t>(s.dy) * tap.view->width + s.dx;
      const double bilinear[] = {(1 - s.ax) * (1 - s.ay), s.ax * (1 - s.ay), (1 - s.ax) * s.ay, s.ax * s.ay};
      for (int q = 0; q < 4; ++q) tap.w[q] = static_cast<float>(w * bilinear[q]);
      tap.two_rows = s.ay > 0;
      tap.two_columns = s.ax > 0;
    }
  }
  return seen;
}

void SweepBlock::colour_by_shift(const PixelRect& part, const kernels::ColourJob& job,
                                 const SweepBlock& searched, float* colour, float* coverage) const {
  if (part.empty()) return;
  const std::size_t out =
      static_cast<std::size_t>(part.y0 - rect_.y0) * stride_ + static_cast<std::size_t>(part.x0 - rect_.x0);
  const int width = part.x1 - part.x0, height = part.y1 - part.y0;
  kernels::shift_colour(job, part.x0, part.y0, width, height, searched.plane_.data() + out, stride_,
                        colour + out, searched.plane_.size());
  for (int y = 0; y < height; ++y)
    std::fill_n(coverage + out + static_cast<std::size_t>(y) * stride_, width, 1.0F);
}

void SweepBlock::write(RenderedView& out, const SweepBlock& searched) {
  const int width = rect_.x1 - rect_.x0, height = rect_.y1 - rect_.y0, channels = channels_;
  const std::size_t plane_size = searched.plane_.size();
  const auto colour =
      std::make_unique_for_overwrite<float[]>(plane_size * static_cast<std::size_t>(channels));
  const auto coverage = std::make_unique_for_overwrite<float[]>(plane_size);
  kernels::ColourJob job;
  PixelRect seen = by_shift_ ? fill_colour_job(searched, job) : PixelRect{};
  if (seen.empty()) seen = {rect_.x0, rect_.y0, rect_.x0, rect_.y0};
  // Vectors run over the end of a row, into what is done after it.
  const auto warp = [&](const PixelRect& part) {
    colour_by_warp(part, searched, colour.get(), coverage.get());
  };
  warp({rect_.x0, rect_.y0, rect_.x1, seen.y0});
  warp({rect_.x0, seen.y0, seen.x0, seen.y1});
  colour_by_shift(seen, job, searched, colour.get(), coverage.get());
  warp({seen.x1, seen.y0, rect_.x1, seen.y1});
  warp({rect_.x0, seen.y1, rect_.x1, rect_.y1});
  const LatticeChart& chart = sweep_.lattice.chart;
  const bool constant_hull = sweep_.positions.constant && chart.inside_hull(sweep_.positions.p[0]);
  for (int y = 0; y < height; ++y) {
    const std::size_t in = static_cast<std::size_t>(y) * stride_;
    const int Y = rect_.y0 + y;
    float* pixel = &out.colour.at(rect_.x0, Y);
    float *disparity = &out.disparity.at(rect_.x0, Y), *confidence = &out.confidence.at(rect_.x0, Y);
    int* plane = &out.plane.at(rect_.x0, Y);
    for (int x = 0; x < width; ++x, pixel += channels) {
      const std::size_t i = in + static_cast<std::size_t>(x);
      const int n = searched.plane_[i];
      plane[x] = n;
      if (n < 0) continue;
      for (int c = 0; c < channels; ++c) pixel[c] = colour[plane_size * static_cast<std::size_t>(c) + i];
      disparity[x] = static_cast<float>(sweep_.disparities[static_cast<std::size_t>(n)]);
      const float contrast =
          searched.E_sum_[i] > 0
              ? std::clamp(1 - searched.E_min_[i] * searched.E_count_[i] / searched.E_sum_[i], 0.0F, 1.0F)
              : 0.0F;
      const bool inside = sweep_.positions.constant
                              ? constant_hull
                              : chart.inside_hull(sweep_.positions.at(sweep_.view, rect_.x0 + x, Y));
      confidence[x] = inside ? coverage[i] * contrast : 0.0F;
    }
  }
}

}  // namespace stuv
