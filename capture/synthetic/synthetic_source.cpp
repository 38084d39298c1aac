#include "capture/synthetic/synthetic_source.h"

#include <fmt/format.h>

#include <stdexcept>

#include "capture/synthetic/random.h"
#include "core/error.h"
#include "core/image_io.h"
#include "core/parallel.h"

namespace stuv::synthetic {
namespace fs = std::filesystem;
namespace {

std::vector<Camera> cameras_of(const Rig& rig) {
  std::vector<Camera> cameras;
  for (const RigCamera& camera : rig.cameras) cameras.push_back(camera.camera);
  return cameras;
}

Json to_json(const std::vector<Eigen::Vector2d>& pixels) {
  Json list = Json::array();
  for (const Eigen::Vector2d& q : pixels) list.push_back({q.x(), q.y()});
  return list;
}

void make_folder(const fs::path& folder) {
  std::error_code ec;
  fs::create_directories(folder, ec);
  if (ec) throw Error(folder.string(), "cannot be created: " + ec.message(), "check the disk");
}

class SyntheticSource final : public Source {
 public:
  explicit SyntheticSource(const SyntheticOptions& options)
      : options_(options),
        truth_(make_rig(options.rig)),
        scene_(options.scene),
        poses_(synthetic::board_poses(options.board, cameras_of(truth_.rig), options.board_sets,
                                      options.rig.seed)) {
    for (const RigCamera& camera : truth_.rig.cameras)
      cameras_.push_back({camera.camera.name, camera.row, camera.col});
    depths_.resize(cameras_.size());
  }

  int rows() const override { return options_.rig.rows; }
  int cols() const override { return options_.rig.cols; }
  const std::vector<RecordedCamera>& cameras() const override { return cameras_; }
  std::optional<std::size_t> set_count() const override {
    return static_cast<std::size_t>(options_.board_sets + options_.scene_sets);
  }
  Json description() const override {
    const BoardOptions& board = options_.board;
    return {{"kind", "synthetic"},
            {"seed", options_.rig.seed},
            {"board", !board.spec.empty() ? board.spec
                                          : fmt::format("chessboard:{}x{}:{}mm", board.columns, board.rows,
                                                        1000 * board.square_m)},
            {"board_sets", options_.board_sets},
            {"scene_sets", options_.scene_sets}};
  }

  std::optional<SourceSet> next() override {
    if (next_ == options_.board_sets + options_.scene_sets) return std::nullopt;
    current_ = next_++;
    SourceSet set{name_of(current_), std::vector<SourceFrame>(cameras_.size())};
    parallel_for(static_cast<int>(cameras_.size()),
                 [&](int camera) { set.frames[static_cast<std::size_t>(camera)] = take(camera); });
    return set;
  }

  void write_extras(const fs::path& recording) override {
    const fs::path truth = recording / "truth";
    if (!fs::exists(truth / "rig.json")) write_rig_truth(truth);
    if (!is_board(current_)) write_depths(truth / "depth" / name_of(current_));
  }

 private:
  bool is_board(int set) const { return set < options_.board_sets; }
  std::string name_of(int set) const {
    return is_board(set) ? fmt::format("board{:02}", set)
                         : fmt::format("scene{:02}", set - options_.board_sets);
  }

  SourceFrame take(int index) {
    const auto i = static_cast<std::size_t>(index);
    const Camera& camera = truth_.rig.cameras[i].camera;
    SourceFrame frame;
    frame.status = FrameStatus::ok;
    frame.sequence = current_;
    // Counted from one interval before the first set, so that skew makes no time negative.
    frame.timestamp_ns = (current_ + 1) * options_.set_interval_ns + truth_.time_skew_ns[i];
    const std::uint64_t seed = hash({options_.rig.seed, 0x401, static_cast<std::uint64_t>(current_),
                                     static_cast<std::uint64_t>(truth_.rig.cameras[i].row),
                                     static_cast<std::uint64_t>(truth_.rig.cameras[i].col)});
    const Exposure exposure{truth_.gain[i], truth_.vignetting[i], seed, truth_.colour_gain[i],
                            truth_.offset[i]};
    frame.content = expose(light_of(camera, i), 3, options_.sensor, exposure);
    return frame;
  }

  ImageF light_of(const Camera& camera, std::size_t i) {
    if (is_board(current_))
      return render_board(options_.board, camera, poses_[static_cast<std::size_t>(current_)]);
    const std::int64_t time_ns =
        (current_ - options_.board_sets) * options_.set_interval_ns + truth_.time_skew_ns[i];
    TruePicture picture = render_picture(scene_, camera, time_ns);
    depths_[i] = std::move(picture.depth);
    return std::move(picture.colour);
  }

  void write_rig_truth(const fs::path& truth) const {
    make_folder(truth / "cameras");
    write_rig(truth, truth_.rig);
    write_json(truth / "boards.json", boards_json());
    Json exposures = Json::array();
    for (std::size_t i = 0; i < cameras_.size(); ++i)
      exposures.push_back({{"camera", cameras_[i].name},
                           {"gain", truth_.gain[i]},
                           {"colour_gain", truth_.colour_gain[i]},
                           {"offset", truth_.offset[i]},
                           {"vignetting", truth_.vignetting[i]},
                           {"time_skew_ns", truth_.time_skew_ns[i]}});
    write_json(truth / "exposures.json", {{"cameras", exposures}});
  }

  Json boards_json() const {
    const BoardOptions& board = options_.board;
    Json sets = Json::array();
    for (std::size_t k = 0; k < poses_.size(); ++k) {
      Json corners = Json::object();
      for (const RigCamera& camera : truth_.rig.cameras)
        corners[camera.camera.name] = to_json(board_pixels(board, camera.camera, poses_[k]));
      sets.push_back({{"set", name_of(static_cast<int>(k))},
                      {"rig_from_board", stuv::to_json(poses_[k])},
                      {"corners_px", corners}});
    }
    return {{"columns", board.columns},
            {"rows", board.rows},
            {"square_m", board.square_m},
            {"bend_m", board.bend_m},
            {"sets", std::move(sets)}};
  }

  void write_depths(const fs::path& folder) const {
    make_folder(folder);
    for (std::size_t i = 0; i < cameras_.size(); ++i)
      write_pfm(folder / (cameras_[i].name + ".pfm"), depths_[i]);
  }

  SyntheticOptions options_;
  TrueRig truth_;
  Scene scene_;
  std::vector<Pose> poses_;
  std::vector<RecordedCamera> cameras_;
  std::vector<ImageF> depths_;
  int next_ = 0, current_ = 0;
};

}  // namespace

std::string problem_of(const SyntheticOptions& options) {
  const auto in = [](const char* table, const std::string& problem) {
    return problem.empty() ? "" : fmt::format("{}.{}", table, problem);
  };
  for (const std::string& problem :
       {in("rig", problem_of(options.rig)), in("sensor", problem_of(options.sensor)),
        in("board", problem_of(options.board)), in("scene", problem_of(options.scene))})
    if (!problem.empty()) return problem;
  if (options.board_sets < 0 || options.scene_sets < 0 || options.board_sets + options.scene_sets == 0)
    return fmt::format("sets.boards and sets.scenes are {} and {}, but must be 0 or more, and not both 0",
                       options.board_sets, options.scene_sets);
  if (options.set_interval_ns <= 0) return "sets.interval_ns must be above 0";
  return "";
}

std::vector<Pose> board_poses(const SyntheticOptions& options) {
  return board_poses(options.board, cameras_of(make_rig(options.rig).rig), options.board_sets,
                     options.rig.seed);
}

std::unique_ptr<Source> open_synthetic(const SyntheticOptions& options) {
  if (const std::string problem = problem_of(options); !problem.empty()) throw std::invalid_argument(problem);
  if (!options.board.spec.empty() && !options.board.spec.starts_with("chessboard:") && !options.board.pattern)
    throw std::invalid_argument("the board's spec has not been turned into a pattern");
  return std::make_unique<SyntheticSource>(options);
}

}  // namespace stuv::synthetic
