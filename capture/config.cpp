#include "capture/config.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <map>
#include <set>

#include "capture/default_config.h"  // made of configs/synthetic-5x5.toml by CMake
#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace {

using synthetic::SyntheticOptions;

std::string place(const std::string& file, const toml::source_region& region) {
  return fmt::format("{}:{}", file, region.begin.line);
}

/// Reads the keys of one table into variables that hold their defaults, and then refuses what is left over.
class TableReader {
 public:
  TableReader(const toml::table& table, std::string path, const std::string& file)
      : table_(table), path_(std::move(path)), file_(file) {}

  template <class T>
  void read(const char* key, T& value) {
    if (const toml::node* node = take(key)) assign(*node, key, value);
  }

  TableReader child(const char* key) {
    static const toml::table empty;
    const toml::node* node = take(key);
    if (node != nullptr && !node->is_table()) fail(*node, key, "must be a table");
    return {node != nullptr ? *node->as_table() : empty, path_ + key + ".", file_};
  }

  /// The tables of [[key]].
  std::vector<TableReader> children(const char* key) {
    std::vector<TableReader> tables;
    const toml::node* node = take(key);
    if (node == nullptr) return tables;
    if (!node->is_array_of_tables()) fail(*node, key, "must be tables, [[" + std::string(key) + "]]");
    for (const toml::node& entry : *node->as_array())
      tables.emplace_back(*entry.as_table(), path_ + key + ".", file_);
    return tables;
  }

  /// Throws if the table has a key that nobody asked for.
  void finish() const {
    for (const auto& [key, node] : table_)
      if (!known_.contains(std::string(key.str())))
        throw Error(place(file_, key.source()), fmt::format("unknown key {}{}", path_, key.str()),
                    fmt::format("known here: {}", fmt::join(known_, ", ")));
  }

 private:
  const toml::node* take(const char* key) {
    known_.insert(key);
    return table_.get(key);
  }

  [[noreturn]] void fail(const toml::node& node, const char* key, const std::string& problem) const {
    throw Error(place(file_, node.source()), fmt::format("{}{} {}", path_, key, problem),
                "correct the value");
  }

  void assign(const toml::node& node, const char* key, double& value) const {
    // A whole number is a number too.
    if (!node.is_number()) fail(node, key, "must be a number");
    value = *node.value<double>();
  }
  template <class Integer>
  requires std::is_integral_v<Integer> &&
      (!std::is_same_v<Integer, bool>)void assign(const toml::node& node, const char* key,
                                                  Integer& value) const {
    const auto number = node.is_integer() ? node.value<Integer>() : std::nullopt;
    if (!number) fail(node, key, "must be a whole number in range");
    value = *number;
  }
  void assign(const toml::node& node, const char* key, bool& value) const {
    if (!node.is_boolean()) fail(node, key, "must be true or false");
    value = *node.value<bool>();
  }
  void assign(const toml::node& node, const char* key, std::string& value) const {
    if (!node.is_string()) fail(node, key, "must be a string");
    value = *node.value<std::string>();
  }
  template <class T, std::size_t n>
  void assign(const toml::node& node, const char* key, std::array<T, n>& value) const {
    const toml::array* array = node.as_array();
    if (array == nullptr || array->size() != n) fail(node, key, fmt::format("must be a list of {}", n));
    for (std::size_t i = 0; i < n; ++i) assign(*array->get(i), key, value[i]);
  }
  void assign(const toml::node& node, const char* key, std::map<std::string, std::int64_t>& value) const {
    if (!node.is_table()) fail(node, key, "must be a table of whole numbers");
    for (const auto& [name, entry] : *node.as_table())
      assign(entry, name.data(), value[std::string(name.str())]);
  }
  void assign(const toml::node& node, const char* key, std::vector<std::string>& value) const {
    const toml::array* array = node.as_array();
    if (array == nullptr) fail(node, key, "must be a list of strings");
    value.assign(array->size(), "");
    for (std::size_t i = 0; i < value.size(); ++i) assign(*array->get(i), key, value[i]);
  }

  const toml::table& table_;
  std::string path_;
  const std::string& file_;
  std::set<std::string> known_;
};

void read_rig(TableReader table, synthetic::RigOptions& rig) {
  table.read("rows", rig.rows);
  table.read("cols", rig.cols);
  table.read("spacing_m", rig.spacing_m);
  table.read("width", rig.width);
  table.read("height", rig.height);
  table.read("focal_px", rig.focal_px);
  table.read("distortion", rig.distortion);
  table.read("vignetting", rig.vignetting);
  table.read("offset", rig.offset);
  table.read("missing", rig.missing);
  TableReader jitter = table.child("jitter");
  jitter.read("position_m", rig.jitter.position_m);
  jitter.read("direction_rad", rig.jitter.direction_rad);
  jitter.read("focal_relative", rig.jitter.focal_relative);
  jitter.read("principal_point_px", rig.jitter.principal_point_px);
  jitter.read("distortion", rig.jitter.distortion);
  jitter.read("gain_relative", rig.jitter.gain_relative);
  jitter.read("colour_gain_relative", rig.jitter.colour_gain_relative);
  jitter.read("offset", rig.jitter.offset);
  jitter.read("vignetting", rig.jitter.vignetting);
  jitter.read("time_skew_ns", rig.jitter.time_skew_ns);
  jitter.finish();
  table.finish();
}

void read_sensor(TableReader table, synthetic::SensorOptions& sensor) {
  table.read("gamma", sensor.gamma);
  table.read("full_well_e", sensor.full_well_e);
  table.read("read_noise_e", sensor.read_noise_e);
  table.finish();
}

void read_board(TableReader table, synthetic::BoardOptions& board) {
  table.read("spec", board.spec);
  std::array<int, 2> corners = {board.columns, board.rows};
  table.read("corners", corners);
  board.columns = corners[0];
  board.rows = corners[1];
  table.read("square_m", board.square_m);
  table.read("margin_squares", board.margin_squares);
  table.read("bend_m", board.bend_m);
  table.finish();
}

void read_scene(TableReader table, synthetic::SceneOptions& scene, const std::string& file) {
  std::string kind = "room";
  table.read("kind", kind);
  if (kind != "room" && kind != "wall")
    throw Error(file, fmt::format("scene.kind is '{}'", kind), "use \"room\" or \"wall\"");
  scene.kind = kind == "room" ? synthetic::SceneOptions::Kind::room : synthetic::SceneOptions::Kind::wall;
  table.read("wall_m", scene.wall_m);
  table.read("ball_speed_m_per_s", scene.ball_speed_m_per_s);
  table.finish();
}

SyntheticOptions read_synthetic(TableReader& root, TableReader& source, const std::string& file) {
  SyntheticOptions options;
  source.read("seed", options.rig.seed);
  read_rig(root.child("rig"), options.rig);
  read_sensor(root.child("sensor"), options.sensor);
  read_board(root.child("board"), options.board);
  read_scene(root.child("scene"), options.scene, file);
  TableReader sets = root.child("sets");
  sets.read("boards", options.board_sets);
  sets.read("scenes", options.scene_sets);
  sets.read("interval_ns", options.set_interval_ns);
  sets.finish();
  if (const std::string problem = problem_of(options); !problem.empty())
    throw Error(file, problem, "correct the value");
  return options;
}

FilesOptions read_files(TableReader& source, const std::string& file) {
  FilesOptions options;
  source.read("pattern", options.pattern);
  source.read("rows", options.rows);
  source.read("cols", options.cols);
  source.read("names", options.names);
  source.read("copy", options.copy);
  source.read("complete", options.complete);
  source.read("every", options.every);
  if (options.pattern.find("{camera}") == std::string::npos)
    throw Error(file, fmt::format("source.pattern is '{}'", options.pattern),
                "give a path with {camera} in it");
  if (options.every < 1)
    throw Error(file, fmt::format("source.every is {}", options.every), "give 1 or more");
  if (options.rows < 1 || options.cols < 1)
    throw Error(file, fmt::format("source.rows and source.cols are {} and {}", options.rows, options.cols),
                "give the grid's size, each 1 or more");
  return options;
}

CameraSourceOptions::Mode mode_from(const std::string& name, const std::string& file) {
  using Mode = CameraSourceOptions::Mode;
  if (name == "free") return Mode::free;
  if (name == "common-start") return Mode::common_start;
  if (name == "trigger") return Mode::trigger;
  throw Error(file, fmt::format("source.mode is '{}'", name),
              "use \"free\", \"common-start\" or \"trigger\"");
}

void read_camera(TableReader table, CameraSettings& camera) {
  table.read("id", camera.id);
  table.read("name", camera.name);
  table.read("row", camera.row);
  table.read("col", camera.col);
  table.read("format", camera.format);
  table.read("width", camera.width);
  table.read("height", camera.height);
  table.read("fps", camera.fps);
  table.read("buffers", camera.buffers);
  table.read("controls", camera.controls);
  table.finish();
}

CameraSourceOptions read_cameras(TableReader& root, TableReader& source, const std::string& file) {
  CameraSourceOptions options;
  std::string mode = "free";
  source.read("rows", options.rows);
  source.read("cols", options.cols);
  source.read("mode", mode);
  source.read("trigger_window_ms", options.trigger_window_ms);
  source.read("duration_s", options.duration_s);
  source.read("queue_sets", options.queue_sets);
  source.read("allow_missing", options.allow_missing);
  source.read("give_up_s", options.give_up_s);
  source.read("record", options.record);
  options.mode = mode_from(mode, file);
  TableReader motion = root.child("motion");
  motion.read("speed_m_per_s", options.motion.speed_m_per_s);
  motion.read("distance_m", options.motion.distance_m);
  motion.read("focal_px", options.motion.focal_px);
  motion.finish();
  for (const TableReader& table : root.children("camera")) read_camera(table, options.cameras.emplace_back());
  if (const std::string problem = problem_of(options); !problem.empty())
    throw Error(file, problem, "correct the value");
  return options;
}

toml::table parse_toml(std::string_view text, const std::string& name) {
  try {
    return toml::parse(text, name);
  } catch (const toml::parse_error& error) {
    throw Error(place(name, error.source()), fmt::format("is no TOML: {}", error.description()),
                "correct the line");
  }
}

}  // namespace

CaptureConfig parse_capture_config(std::string_view text, const std::string& name) {
  const toml::table table = parse_toml(text, name);
  TableReader root(table, "", name);
  TableReader source = root.child("source");
  std::string kind;
  source.read("kind", kind);
  CaptureConfig config;
  if (kind == "synthetic")
    config = read_synthetic(root, source, name);
  else if (kind == "files")
    config = read_files(source, name);
  else if (kind == "cameras")
    config = read_cameras(root, source, name);
  else
    throw Error(name, fmt::format("source.kind is '{}'", kind),
                "use \"cameras\", \"files\" or \"synthetic\"");
  source.finish();
  root.finish();
  return config;
}

CaptureConfig read_capture_config(const std::filesystem::path& file) {
  return parse_capture_config(read_text(file), file.string());
}

CaptureConfig default_capture_config() {
  return parse_capture_config(kDefaultConfig, "the built-in configs/synthetic-5x5.toml");
}

std::unique_ptr<Source> open_source(const CaptureConfig& config, const Reporter& reporter,
                                    const std::atomic<bool>* stop, StatusFunction status) {
  if (const auto* files = std::get_if<FilesOptions>(&config)) return open_files(*files, reporter);
  if (const auto* cameras = std::get_if<CameraSourceOptions>(&config))
    return open_cameras(*cameras, reporter, stop, std::move(status));
  return synthetic::open_synthetic(std::get<SyntheticOptions>(config));
}

}  // namespace stuv
