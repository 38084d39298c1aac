#include "calib/interchange/view_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <regex>
#include <sstream>

#include "calib/lattice_places.h"
#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> fields;
  std::istringstream in(line);
  for (std::string field; std::getline(in, field, ',');) fields.push_back(field);
  return fields;
}

double parse_coordinate(const std::string& text, const std::string& where) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
    throw Error(where, fmt::format("'{}' is not a finite number", text), "mend this line");
  return value;
}

std::vector<ListedView> list_csv(const fs::path& file) {
  std::istringstream in(read_text(file));
  std::vector<ListedView> views;
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (!line.empty() && line.back() == '\r') line.pop_back();
    const std::string where = fmt::format("{}:{}", file.string(), number);
    if (number == 1 && line != "file,s,t,role")
      throw Error(where, fmt::format("opens with '{}'", line), "the first line must be file,s,t,role");
    if (number == 1 || line.empty()) continue;
    const std::vector<std::string> fields = split(line);
    if (fields.size() != 4)
      throw Error(where, fmt::format("has {} fields", fields.size()), "write file,s,t,role");
    if (fields[3] != "input" && fields[3] != "truth")
      throw Error(where, fmt::format("has the role '{}'", fields[3]), "write input or truth");
    views.push_back({file.parent_path() / fields[0], parse_coordinate(fields[1], where),
                     parse_coordinate(fields[2], where),
                     fields[3] == "truth" ? ViewRole::truth : ViewRole::input});
  }
  return views;
}

/// Files of the folder whose whole name matches, in natural order, with the pattern's groups.
std::vector<std::pair<fs::path, std::smatch>> matching(const fs::path& folder, const std::string& pattern,
                                                       std::vector<std::string>& names) {
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(folder, ec))
    names.push_back(entry.path().filename().string());
  if (ec)
    throw Error(folder.string(), fmt::format("cannot be listed: {}", ec.message()), "name a folder of views");
  std::sort(names.begin(), names.end(), natural_less);
  const std::regex regex(pattern, std::regex::icase);
  std::vector<std::pair<fs::path, std::smatch>> found;
  for (const std::string& name : names) {
    std::smatch groups;
    if (std::regex_match(name, groups, regex)) found.emplace_back(folder / name, groups);
  }
  return found;
}

std::vector<ListedView> list_stanford(const fs::path& folder) {
  std::vector<std::string> names;
  std::vector<ListedView> views;
  for (const auto& [file, groups] : matching(
           folder, R"(.*_(\d+)_(\d+)_(-?[\d.]+)_(-?[\d.]+?)_?(?:_\d+)*\.(?:png|jpe?g|tiff?|exr|bmp|ppm))",
           names))
    views.push_back({file, 1e-3 * parse_coordinate(groups[4], file.string()),
                     1e-3 * parse_coordinate(groups[3], file.string())});
  return views;
}

std::vector<ListedView> list_hci(const fs::path& folder) {
  constexpr int kSide = 9;
  std::vector<std::string> names;
  std::vector<ListedView> views;
  for (const auto& [file, groups] : matching(folder, R"(input_Cam(\d{3})\.(?:png|jpe?g|tiff?|exr))", names)) {
    const int index = std::stoi(groups[1]);
    if (index >= kSide * kSide)
      throw Error(file.string(), "lies outside the benchmark's 9x9 grid", "import as csv");
    views.push_back({file, static_cast<double>(index % kSide - kSide / 2),
                     static_cast<double>(index / kSide - kSide / 2)});
  }
  return views;
}

}  // namespace

std::vector<ListedView> list_views(const fs::path& source, ViewLayout layout) {
  std::error_code ec;
  if (!fs::exists(source, ec)) throw Error(source.string(), "does not exist", "check the path");
  std::vector<ListedView> views;
  switch (layout) {
    case ViewLayout::csv:
      views = list_csv(fs::is_directory(source) ? source / "views.csv" : source);
      break;
    case ViewLayout::stanford:
      views = list_stanford(source);
      break;
    case ViewLayout::hci:
      views = list_hci(source);
      break;
  }
  const bool has_input =
      std::any_of(views.begin(), views.end(), [](const ListedView& v) { return v.role == ViewRole::input; });
  if (!has_input) throw Error(source.string(), "lists no input view", "check the folder and --layout");
  return views;
}

void place_on_lattice(LightField& lf, const std::string& source) {
  const std::vector<int> inputs = lf.views_with(ViewRole::input);
  std::vector<Eigen::Vector2d> points;
  for (const int i : inputs) points.emplace_back(lf.views[i].s, lf.views[i].t);
  const LatticePlaces places = places_on_lattice(points);
  lf.rows = places.rows;
  lf.cols = places.cols;
  std::map<std::pair<int, int>, std::string> taken;
  for (std::size_t k = 0; k < inputs.size(); ++k) {
    View& view = lf.views[inputs[k]];
    view.row = places.row[k];
    view.col = places.col[k];
    const auto [place, fresh] = taken.insert({{view.row, view.col}, view.name});
    if (!fresh)
      throw Error(source,
                  fmt::format("views {} and {} share one place of the lattice", place->second, view.name),
                  "the views must lie on a grid or in a row; remove duplicates");
  }
}

}  // namespace stuv
