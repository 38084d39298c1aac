#include "calib/board/kalibr_target.h"

#include <fmt/format.h>

#include <fstream>
#include <map>

#include "core/error.h"

namespace stuv {
namespace {

/// Without blanks and quotes at its ends.
std::string trimmed(const std::string& text) {
  const char* const blanks = " \t\r'\"";
  const std::size_t begin = text.find_first_not_of(blanks);
  if (begin == std::string::npos) return "";
  return text.substr(begin, text.find_last_not_of(blanks) - begin + 1);
}

std::map<std::string, std::string> read_lines(const std::filesystem::path& file) {
  std::ifstream in(file);
  if (!in) throw Error(file.string(), "cannot be read", "check the path of the target file");
  std::map<std::string, std::string> values;
  for (std::string line; std::getline(in, line);) {
    line = line.substr(0, line.find('#'));
    const std::size_t colon = line.find(':');
    if (colon != std::string::npos) values[trimmed(line.substr(0, colon))] = trimmed(line.substr(colon + 1));
  }
  return values;
}

}  // namespace

std::string kalibr_target_spec(const std::filesystem::path& file) {
  const std::map<std::string, std::string> values = read_lines(file);
  const auto value = [&](const std::string& key) {
    const auto it = values.find(key);
    if (it == values.end() || it->second.empty())
      throw Error(file.string(), "has no " + key,
                  "write it as Kalibr's target files are, or use --board KIND:...");
    return it->second;
  };
  const std::string type = value("target_type");
  if (type == "aprilgrid") {
    const std::string columns = value("tagCols"), rows = value("tagRows");
    const std::string size = value("tagSize"), spacing = value("tagSpacing");
    return fmt::format("aprilgrid:{}x{}:{}m:{}", columns, rows, size, spacing);
  }
  if (type != "checkerboard")
    throw Error(file.string(), "is of type '" + type + "'", "use a target of type aprilgrid or checkerboard");
  const std::string square = value("rowSpacingMeters");
  if (value("colSpacingMeters") != square)
    throw Error(file.string(), "has squares that are not square", "use a board with square fields");
  return fmt::format("chessboard:{}x{}:{}m", value("targetCols"), value("targetRows"), square);
}

}  // namespace stuv
