#pragma once

#include <string>
#include <vector>

#include "calib/rectify/neighbour_matches.h"
#include "core/json.h"

namespace stuv {

/// How well two neighbouring rectified views line up, across the lattice's direction between them: v of
/// neighbours in a row, u of neighbours in a column.
struct PairAlignment {
  std::string a, b;
  bool in_a_row = true;
  int points = 0;
  double rms_px = 0, p95_px = 0;  ///< as they are
  /// Distance from the line on which the cameras' measured (s, t, w) put the point: real cameras stand a
  /// little off their lattice, which is parallax and no error.
  double beyond_rms_px = 0, beyond_p95_px = 0;
};

struct Alignment {
  std::string measured_from;  ///< "board" or "features"
  std::vector<PairAlignment> pairs;
  /// Over all pairs' points; NaN without any.
  double rms_px = 0, p95_px = 0, beyond_rms_px = 0, beyond_p95_px = 0;
  int points = 0;
};

/// Of matches of neighbours. Of features, those further than 4.5 robust deviations (1.4826 times the median
/// of |x - median|, at least 0.05 px) from a pair's median distance are taken for wrong matches: corners
/// where a near edge crosses a far one. Pairs with fewer than 8 points are left out.
Alignment alignment_of(const LightField& lf, const std::vector<ViewMatch>& matches,
                       const std::string& measured_from);

Json to_json(const Alignment& alignment);

}  // namespace stuv
