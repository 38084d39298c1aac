#include "calib/solve/own_lens.h"

#include "calib/solve/groups.h"

namespace stuv {

OwnLens own_lens(const Observations& observations, const JointSolution& solution, int camera,
                 const SolveOptions& options) {
  const ObservedPart part = part_of(observations, {camera});
  if (part.observations.boards.size() < 2) return {};
  const Camera& joint = solution.cameras[camera];
  Seed seed;
  seed.focal_px = {0.5 * (joint.intrinsics[0] + joint.intrinsics[1])};
  seed.cam_from_ref = {Pose{}};
  for (const Pose& ref_from_board : solution.ref_from_board)
    seed.ref_from_board.push_back(joint.cam_from_rig * ref_from_board);
  seed.suspect.assign(part.observations.boards.size(),
                      std::vector<bool>(static_cast<std::size_t>(observations.board.corners()), false));
  const JointSolution own = joint_solve(part.observations, seed, options);
  if (!own.converged || own.focal_sigma.empty()) return {};
  const std::vector<double>& p = own.cameras.front().intrinsics;
  return {true, {p[0], p[1]}, own.noise_px * own.focal_sigma.front()};
}

}  // namespace stuv
