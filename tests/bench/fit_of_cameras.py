"""How well two solutions' cameras explain one list of corners, by one measure.

    fit_of_cameras.py CORNERS.vnl COLUMNS ROWS SQUARE_M KEPT FIRST.cameramodel... -- SECOND.cameramodel...

CORNERS.vnl as corners_vnl.py prints it; both lists of models in the order of the cameras' names. The cameras are held, every
board's pose and the bend of all boards fitted to the corners (soft L1 beyond 0.1 px): solutions that weigh corners
differently or take different ones out are compared on the same ones. Prints the rms of all x and y residuals, and
of the corners that fit best, a share KEPT of them.
"""
import re, sys
import mrcal
import numpy as np
from scipy.optimize import least_squares

corners_file, columns, rows = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
square, kept = float(sys.argv[4]), float(sys.argv[5])
rest = sys.argv[6:]
lists = rest[:rest.index('--')], rest[rest.index('--') + 1:]
seen = {}
for line in open(corners_file):
    words = line.split()
    if words[0] == '#':
        continue
    place = re.search(r'Position(\w+)_Camera(\w+)\.png', words[0]).groups()
    seen.setdefault(place, []).append([np.nan if w == '-' else float(w) for w in words[1:3]])
seen = {place: np.array(q) for place, q in seen.items() if len(q) == columns * rows}
sets, names = sorted({s for s, _ in seen}), sorted({c for _, c in seen})
grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2).astype(float)
flat = np.c_[square * grid, np.zeros(len(grid))]
u = 2 * grid / [columns - 1, rows - 1] - 1


def board(bend):
    return flat + np.c_[np.zeros((len(grid), 2)), (bend * (1 - u * u)).sum(1)]


def fit(models):
    cameras = dict(zip(names, [mrcal.cameramodel(m) for m in models]))

    def residuals(x):
        points, out = board(x[:2]), []
        for i, s in enumerate(sets):
            ref = mrcal.transform_point_rt(x[2 + 6 * i:8 + 6 * i], points)
            for c in names:
                if (s, c) in seen:
                    at = mrcal.project(mrcal.transform_point_rt(cameras[c].extrinsics_rt_fromref(), ref), *cameras[c].intrinsics())
                    out.append((at - seen[s, c]).ravel())
        r = np.concatenate(out)
        return r[np.isfinite(r)]

    start = [0, 0]
    for s in sets:
        start += list(start_pose(cameras, s))
    r = residuals(least_squares(residuals, start, loss='soft_l1', f_scale=0.1, x_scale='jac').x)
    length = np.sort((r.reshape(-1, 2) ** 2).sum(1))
    return np.sqrt(length.mean() / 2), np.sqrt(length[:int(kept * len(length))].mean() / 2)


def start_pose(cameras, s):
    import cv2
    c = next(c for c in names if (s, c) in seen and np.isfinite(seen[s, c]).all())
    rays = mrcal.unproject(seen[s, c], *cameras[c].intrinsics())
    _, r, t = cv2.solvePnP(flat, np.ascontiguousarray((rays[:, :2] / rays[:, 2:])), np.eye(3), None)
    return mrcal.compose_rt(cameras[c].extrinsics_rt_toref(), np.r_[r.ravel(), t.ravel()])


first, second = fit(lists[0]), fit(lists[1])
print('same corners, same measure: rms %.4f and %.4f px over all, ratio %.3f; %.4f and %.4f px over the best %.1f %%, ratio %.3f' %
      (first[0], second[0], first[0] / second[0], first[1], second[1], 100 * kept, first[1] / second[1]))
