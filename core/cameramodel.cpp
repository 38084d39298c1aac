#include <fmt/format.h>

#include <cctype>
#include <charconv>

#include "core/camera.h"
#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace {

// A .cameramodel is the text of a Python dictionary. mrcal's own reader prints to stderr when it fails, so
// this one picks the few keys that make a camera and passes over the rest (optimization_inputs may be
// megabytes).
class ModelText {
 public:
  ModelText(std::string text, std::string file) : text_(std::move(text)), file_(std::move(file)) {}

  std::string string_value(const std::string& key) const {
    const std::size_t begin = value_of(key);
    const char quote = text_[begin];
    const std::size_t end = quote == '\'' || quote == '"' ? text_.find(quote, begin + 1) : std::string::npos;
    if (end == std::string::npos) fail("has no text for '" + key + "'");
    return text_.substr(begin + 1, end - begin - 1);
  }

  std::vector<double> numbers(const std::string& key) const {
    std::size_t i = value_of(key);
    if (text_[i] != '[' && text_[i] != '(') fail("has no list for '" + key + "'");
    std::vector<double> values;
    for (++i; i < text_.size() && text_[i] != ']' && text_[i] != ')';) {
      if (text_[i] == ',' || std::isspace(static_cast<unsigned char>(text_[i])) != 0) {
        ++i;
        continue;
      }
      double value = 0;
      const auto [end, error] = std::from_chars(text_.data() + i, text_.data() + text_.size(), value);
      if (error != std::errc()) fail("has a damaged number in '" + key + "'");
      values.push_back(value);
      i = static_cast<std::size_t>(end - text_.data());
    }
    if (i >= text_.size()) fail("is truncated in '" + key + "'");
    return values;
  }

  [[noreturn]] void fail(const std::string& problem) const {
    throw Error(file_, problem, "this is no mrcal .cameramodel; calibrate again or restore a copy");
  }

 private:
  std::size_t value_of(const std::string& key) const {
    std::size_t i = text_.find("'" + key + "'");
    if (i == std::string::npos) i = text_.find("\"" + key + "\"");
    if (i == std::string::npos) fail("has no '" + key + "'");
    i = text_.find(':', i);
    if (i != std::string::npos) i = text_.find_first_not_of(" \t\n", i + 1);
    if (i == std::string::npos) fail("is truncated at '" + key + "'");
    return i;
  }

  std::string text_, file_;
};

std::string list(const std::vector<double>& values) {
  // {} prints the shortest decimal that reads back as the same double.
  return fmt::format("{}", fmt::join(values, ", "));
}

}  // namespace

Camera read_cameramodel(const std::filesystem::path& file) {
  const ModelText text(read_text(file), file.string());
  Camera camera;
  camera.name = file.stem().string();
  camera.lens_model = text.string_value("lensmodel");
  camera.intrinsics = text.numbers("intrinsics");
  const std::vector<double> size = text.numbers("imagersize"), rt = text.numbers("extrinsics");
  if (size.size() != 2 || rt.size() != 6)
    text.fail("has an 'imagersize' or 'extrinsics' of the wrong length");
  camera.width = static_cast<int>(size[0]);
  camera.height = static_cast<int>(size[1]);
  camera.cam_from_rig.R = rotation_from_vector({rt[0], rt[1], rt[2]});
  camera.cam_from_rig.t = {rt[3], rt[4], rt[5]};
  validate(camera, file.string());
  return camera;
}

void write_cameramodel(const std::filesystem::path& file, const Camera& camera) {
  validate(camera, file.string());
  const Eigen::Vector3d r = vector_from_rotation(camera.cam_from_rig.R), t = camera.cam_from_rig.t;
  write_text(
      file,
      fmt::format("# written by stuv {}\n"
                  "{{\n"
                  "    'lensmodel':  '{}',\n"
                  "    'intrinsics': [ {} ],\n"
                  "    # rt_fromref: rotation vector [rad] and translation [m], reference = camera plane\n"
                  "    'extrinsics': [ {} ],\n"
                  "    'imagersize': [ {}, {} ]\n"
                  "}}\n",
                  STUV_VERSION, camera.lens_model, list(camera.intrinsics),
                  list({r.x(), r.y(), r.z(), t.x(), t.y(), t.z()}), camera.width, camera.height));
}

}  // namespace stuv
