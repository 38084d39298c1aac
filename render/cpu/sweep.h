#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/view.h"
#include "render/cpu/sweep_kernels.h"
#include "render/lattice_positions.h"
#include "render/pixel_store.h"

namespace stuv {

/// The lattice and the filters of one light field.
struct SweepLattice {
  explicit SweepLattice(const ViewSet& views);

  LatticeChart chart;
  std::vector<LatticeFilter> filters;  ///< by Filter
  /// Per filter and node of the thinned lattice, row by row: who stands there.
  const std::vector<std::vector<CameraWeight>>& stands(int filter) const {
    return filters[static_cast<std::size_t>(filter)].bridges();
  }
};

/// The sweep over a single plane, as focal_plane() wants it. Throws std::invalid_argument unless d_px is
/// finite.
RenderOptions focal_plane_options(double d_px, Filter filter);

/// How far windows reach.
enum class Windows {
  whole,  ///< to the border of the picture
  cut     ///< to the upper and the lower border of the block
};

/// Where a parallel view meets one camera's picture on one plane: at one offset from every output pixel.
struct CameraShift {
  int dx = 0, dy = 0;    ///< to the upper left tap
  float ax = 0, ay = 0;  ///< shares of the right and the lower taps
  PixelRect valid;       ///< output pixels all of whose taps are there
  bool visible = false;
};

/// What all blocks of one picture share.
struct Sweep {
  Sweep(PixelStore& pixels, const SweepLattice& sweep_lattice, const Viewpoint& viewpoint,
        const RenderOptions& render_options, Windows reach = Windows::whole);

  kernels::PairWeights pair_weights() const;

  PixelStore& store;
  const SweepLattice& lattice;
  const Viewpoint view;
  const RenderOptions options;
  const Windows windows;
  std::vector<double> disparities;  ///< of plane n
  LatticePositions positions;
  /// Weights by filter of all cameras, where they are the same for the whole picture.
  std::array<std::vector<CameraWeight>, 3> constant;
  bool parallel = false;
  /// [plane][camera], of cameras that may have weight; empty if no camera is met at one offset.
  std::vector<CameraShift> shifts;
  float scale = 1;       ///< of stored values: 1/255, 1/65535 or 1
  float tie = 0;         ///< costs that differ by no more are equal
  int M_x = 0, M_y = 0;  ///< the window, no larger than the picture needs

 private:
  void find_shifts();
};

/// A camera that has a part in a rectangle, and its weights by filter where these are the same for all
/// pixels.
struct CameraPart {
  int camera = 0;
  std::array<double, 3> weight{};
};

/// Whoever may have a part in the views of `rect` through filter k, or through any if k is null.
std::vector<CameraPart> cameras_in(const Sweep& sweep, const PixelRect& rect, const Filter* k = nullptr);

/// True if on every plane every output pixel meets the picture of each of those cameras at one offset from
/// itself: parallel views on the cameras' plane.
bool meet_at_one_offset(const Sweep& sweep, const std::vector<int>& cameras);

/// Planes evaluated on one rectangle of the output picture: equations 5 to 8 for it. All memory is the
/// block's own, so blocks run in parallel and their results do not depend on how the picture is divided.
class SweepBlock {
 public:
  /// What a block is for: `colour` knows the cameras of the picture's own filter only, and can be asked for
  /// choose() and write().
  enum class Purpose { search, colour };
  SweepBlock(const Sweep& sweep, const PixelRect& rect, Purpose purpose = Purpose::search);

  /// Plane n on a part of the picture that must lie in the block, or on columns [x0, x1) of it.
  void evaluate(int n, const PixelRect& part) { evaluate_part(n, part, nullptr); }
  void evaluate(int n, int x0, int x1) { evaluate(n, {x0, rect_.y0, x1, rect_.y1}); }
  void evaluate(int n) { evaluate(n, rect_.x0, rect_.x1); }
  /// Plane n on the block's rows [y0, y1). Each plane's rows in order: what its windows share with the rows
  /// before is kept, so that a block can be walked in bands whose pixels stay in the cache.
  void evaluate_rows(int n, int y0, int y1);
  /// True if the difference of the normal and the skipped filter alone, a lower bound of equation 5, shows on
  /// every pixel of the columns that plane n is not the best. Costs a third of evaluate().
  bool ruled_out(int n, int x0, int x1);
  /// Plane n is chosen on those columns without looking at any cost.
  void choose(int n, int x0, int x1);
  /// The smallest part of the columns beyond which every pixel has a plane; empty if all have one.
  PixelRect without_plane(int x0, int x1) const;
  /// Takes planes and costs of those columns from another block of the same rectangle.
  void take(const SweepBlock& other, int x0, int x1);
  /// Writes colour, disparity, plane and confidence of the block, the planes and costs being those of
  /// `searched`, a block of the same rectangle.
  void write(RenderedView& out, const SweepBlock& searched);
  void write(RenderedView& out) { write(out, *this); }

  const PixelRect& rect() const { return rect_; }
  /// The costs of the chosen planes, block row y.
  const float* E_min(int y) const { return E_min_.data() + static_cast<std::size_t>(y) * stride_; }
  const std::int32_t* plane(int y) const { return plane_.data() + static_cast<std::size_t>(y) * stride_; }
  /// Mean cost over the planes evaluated at a pixel of the picture; 0 where none is defined.
  float E_mean(int x, int y) const {
    const std::size_t i =
        static_cast<std::size_t>(y - rect_.y0) * stride_ + static_cast<std::size_t>(x - rect_.x0);
    return E_count_[i] > 0 ? E_sum_[i] / E_count_[i] : 0;
  }
  /// Cost of the plane evaluated last; Inf where it is not defined.
  float last_cost(int x, int y) const {
    const std::size_t i =
        static_cast<std::size_t>(y - rect_.y0) * stride_ + static_cast<std::size_t>(x - rect_.x0);
    if (defined_everywhere_) return sum_[i] * inverse_[i];
    return count_[i] > 0 ? sum_[i] / count_[i] : std::numeric_limits<float>::infinity();
  }
  /// Cameras, by number, that have a part in the block.
  const std::vector<int>& cameras() const { return cameras_; }
  int camera_count() const { return static_cast<int>(cameras_.size()); }
  /// Multiply-adds that the differences took.
  double multiply_adds() const { return multiply_adds_; }
  /// Bytes of the views' pixels and of the result, each once.
  double bytes() const;

 private:
  /// Row sums of one plane that the next rows' windows reach back to: 2 M_y rows from y - M_y on.
  struct Carry {
    int y = std::numeric_limits<int>::min();
    std::vector<float> rows;
  };
  void evaluate_part(int n, const PixelRect& part, Carry* carry);
  bool difference(int n, const PixelRect& halo);
  void acquire_views();
  void make_weights();
  void make_rays();
  void make_maps();
  const CameraShift& shift(int n, std::size_t i) const {
    return sweep_.shifts[static_cast<std::size_t>(n) * sweep_.store.views().cameras.size() +
                         static_cast<std::size_t>(cameras_[i])];
  }
  bool seen_alike(int n, const PixelRect& halo) const;
  /// Equation 5 of one plane where the same cameras see all pixels.
  struct PlaneJob {
    kernels::ShiftJob job;
    bool ready = false;
    bool defined = false, candidate = false;  ///< whether equation 5 is, and the plane is one
  };
  void evaluate_shift_job(const PlaneJob& plane, const PixelRect& part);
  bool difference_by_shift(int n, const PixelRect& halo, const kernels::PairWeights& a);
  bool difference_by_warp(int n, const PixelRect& halo);
  void invert_counts(const PixelRect& halo, const PixelRect& part);
  PixelRect halo_of(const PixelRect& part) const;
  void clear_outside(std::vector<float>& raster, const PixelRect& padded, const PixelRect& halo);
  const PlaneJob& shift_job(int n, const PixelRect& part, const kernels::PairWeights& a);
  void fill_shift_job(int n, const std::vector<char>& sees, PlaneJob& plane);
  void add_tap(const CameraShift& s, const StoredView& view, double w1, double w2, kernels::ShiftJob& job);
  float fix_weights(const std::vector<std::array<double, 4>>& weights, kernels::ShiftJob& job,
                    std::int32_t (kernels::ShiftTap::*fixed)[2]) const;
  void prepare_warp();
  void colour_by_warp(const PixelRect& part, const SweepBlock& searched, float* colour, float* coverage);
  PixelRect fill_colour_job(const SweepBlock& searched, kernels::ColourJob& job);
  void colour_by_shift(const PixelRect& part, const kernels::ColourJob& job, const SweepBlock& searched,
                       float* colour, float* coverage) const;
  float* E0_at(int x, int y) { return E0_.data() + index_of(x, y); }
  std::size_t index_of(int x, int y) const {
    return static_cast<std::size_t>(y - padded_.y0) * stride_ + static_cast<std::size_t>(x - padded_.x0);
  }

  const Sweep& sweep_;
  const Purpose purpose_;
  PixelRect rect_, halo_, padded_;  ///< outputs; with the window, inside the picture; with all of the window
  std::size_t stride_ = 0;          ///< of all rasters of the block
  std::size_t padded_size_ = 0;
  std::vector<int> cameras_;                     ///< that have a part in it
  std::vector<std::array<double, 3>> constant_;  ///< their weights by filter
  std::vector<std::shared_ptr<const StoredView>> views_;
  std::vector<char> masked_;
  struct Spans {
    int y0 = 0;
    std::vector<kernels::PresentSpan> rows;
  };
  std::vector<Spans> spans_;  ///< of masked views
  bool any_masked_ = false, by_shift_ = false;
  std::vector<Carry> carries_;  ///< by plane
  PixelType type_ = PixelType::u8;
  int channels_ = 3;
  std::vector<PlaneJob> jobs_, jobs_without_wide_;  ///< by plane, of all cameras; ruled_out() has the second
  PlaneJob part_job_;                               ///< of some of the cameras
  std::vector<char> sees_;
  std::vector<std::array<double, 4>> first_weights_, second_weights_;  ///< of a job's taps, by corner
  kernels::WarpJob warp_job_;
  bool warp_ready_ = false;
  std::vector<kernels::WarpMap> maps_;  ///< [plane][camera]
  std::vector<float> gx_, gy_, weights_;
  std::vector<float> E0_, defined_, candidate_, sum_, count_, inverse_, E_min_, E_sum_, E_count_, scratch_;
  std::vector<std::int32_t> plane_;
  PixelRect inverted_halo_, inverted_part_;  ///< what inverse_ is of
  bool defined_everywhere_ = false;          ///< equation 5 of the plane evaluated last
  double multiply_adds_ = 0;
};

}  // namespace stuv
