#pragma once

#include <vector>

#include "calib/solve/observations.h"

namespace stuv {

/// Which cameras hang together through boards that two of them see in one set.
struct CameraGroups {
  std::vector<std::vector<int>> groups;  ///< the one to solve first: most cameras, then most corners
  std::vector<int> blind;                ///< cameras that see no board
};
CameraGroups camera_groups(const std::vector<BoardObservation>& boards, int cameras);

/// The part of `all` that some of its cameras see, with the way back.
struct ObservedPart {
  Observations observations;
  std::vector<int> camera_of;  ///< of each camera of the part, its index in `all`
  std::vector<int> board_of;   ///< of each board observation of the part, its index in `all`
};
ObservedPart part_of(const Observations& all, const std::vector<int>& cameras);

}  // namespace stuv
