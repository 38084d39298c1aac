#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace stuv {

/// The value of rank floor(part n) of n values, 0 <= part <= 1 (the largest for 1). NaN of none; of integers
/// 0. NaN among the values has no rank: leave them out before.
template <class T>
T value_of_rank(std::vector<T> values, double part) {
  if (values.empty()) return std::numeric_limits<T>::quiet_NaN();
  const auto rank =
      std::min(static_cast<std::size_t>(part * static_cast<double>(values.size())), values.size() - 1);
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(rank);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// Of an even number of values the upper one of the two in the middle.
template <class T>
T median(std::vector<T> values) {
  return value_of_rank(std::move(values), 0.5);
}

}  // namespace stuv
