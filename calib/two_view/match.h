#pragma once

#include <Eigen/Dense>
#include <filesystem>
#include <vector>

namespace stuv {

/// A point of picture A and the point of picture B that is taken for the same one [px].
struct Match {
  Eigen::Vector2d a, b;
};
using Matches = std::vector<Match>;

/// Text, a line a match: `x1 y1 x2 y2 [score]`, `#` begins a comment. Throws Error naming file and line for
/// anything else. "nan" and "inf" are numbers: the estimators leave such matches out.
Matches read_matches(const std::filesystem::path& file);
void write_matches(const std::filesystem::path& file, const Matches& matches);

/// Indices of the matches that are finite, each place once, sorted by their coordinates: what the estimators
/// work on, so that order changes no result. `counts`: how often each is there.
std::vector<int> distinct_matches(const Matches& matches, std::vector<double>* counts = nullptr);

}  // namespace stuv
