#include "calib/two_view/match.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <iterator>
#include <string_view>

#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace {

constexpr std::string_view kBlank = " \t\r,;";

std::string_view next_word(std::string_view& line) {
  line.remove_prefix(std::min(line.find_first_not_of(kBlank), line.size()));
  const std::string_view word = line.substr(0, line.find_first_of(kBlank));
  line.remove_prefix(word.size());
  return word;
}

/// Numbers of a line: 0 (nothing but a comment), 4 or 5, or -1 if it is no match.
int parse_line(std::string_view line, std::array<double, 5>& value) {
  line = line.substr(0, line.find('#'));
  int count = 0;
  for (std::string_view word = next_word(line); !word.empty(); word = next_word(line)) {
    if (count == 5) return -1;
    if (word.front() == '+') word.remove_prefix(1);
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value[count]);
    if (error != std::errc() || end != word.data() + word.size()) return -1;
    ++count;
  }
  return count == 0 || count >= 4 ? count : -1;
}

std::array<double, 4> key(const Match& m) { return {m.a.x(), m.a.y(), m.b.x(), m.b.y()}; }

}  // namespace

Matches read_matches(const std::filesystem::path& file) {
  const std::string text = read_text(file);
  Matches matches;
  std::array<double, 5> v{};
  int number = 0;
  for (std::size_t begin = 0; begin < text.size();) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    ++number;
    const int count = parse_line(std::string_view(text).substr(begin, end - begin), v);
    if (count < 0)
      throw Error(file.string(), fmt::format("line {} is no match", number), "lines are x1 y1 x2 y2 [score]");
    if (count > 0) matches.push_back({{v[0], v[1]}, {v[2], v[3]}});
    begin = end + 1;
  }
  return matches;
}

void write_matches(const std::filesystem::path& file, const Matches& matches) {
  std::string text = "# x1 y1 x2 y2\n";
  for (const Match& m : matches)
    fmt::format_to(std::back_inserter(text), "{} {} {} {}\n", m.a.x(), m.a.y(), m.b.x(), m.b.y());
  write_text(file, text);
}

std::vector<int> distinct_matches(const Matches& matches, std::vector<double>* counts) {
  std::vector<int> index;
  for (std::size_t i = 0; i < matches.size(); ++i)
    if (matches[i].a.allFinite() && matches[i].b.allFinite()) index.push_back(static_cast<int>(i));
  const auto less = [&](int i, int j) {
    return std::pair(key(matches[i]), i) < std::pair(key(matches[j]), j);
  };
  std::sort(index.begin(), index.end(), less);
  const auto same = [&](int i, int j) { return key(matches[i]) == key(matches[j]); };
  std::vector<int> distinct;
  std::vector<double> count;
  for (const int i : index) {
    if (distinct.empty() || !same(distinct.back(), i)) distinct.push_back(i), count.push_back(0);
    ++count.back();
  }
  if (counts != nullptr) *counts = std::move(count);
  return distinct;
}

}  // namespace stuv
