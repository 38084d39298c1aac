#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace stuv {

/// Calls f(i) for i in [0, n) on oneTBB's threads. Results must not depend on the order.
template <class F>
void parallel_for(int n, const F& f) {
  tbb::parallel_for(0, n, f);
}

}  // namespace stuv
