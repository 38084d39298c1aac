#!/usr/bin/python3
"""corner_errors.py REC: corners that `stuv calibrate` found in a synthetic recording of a chessboard, and OpenCV's,
against REC/truth/boards.json: rms [px], the part that all cameras of a set share (and what chance makes of it), and
errors by stated sigma."""
import glob
import json
import sys

import cv2
import numpy as np

rec = sys.argv[1]
truth = json.load(open(rec + '/truth/boards.json'))
size = (truth['columns'], truth['rows'])
errors = {}  # method: set: views of corners
stated = []  # (sigma, error) of ours


def aligned(corners, exact):
    """The board's order is one of two."""
    turned = corners[::-1]
    return corners if np.nansum((corners - exact) ** 2) < np.nansum((turned - exact) ** 2) else turned


def add(method, name, corners, exact):
    errors.setdefault(method, {}).setdefault(name, []).append(aligned(corners, exact) - exact)


for board in truth['sets']:
    name = board['set']
    for camera, pixels in board['corners_px'].items():
        exact = np.array(pixels, float)
        found = json.load(open(glob.glob(f'{rec}/corners/*/{name}/{camera}.json')[0]))['corners']
        picture = cv2.imread(f'{rec}/sets/{name}/{camera}.png', cv2.IMREAD_GRAYSCALE)
        ok, sb = cv2.findChessboardCornersSB(picture, size, flags=cv2.CALIB_CB_ACCURACY)
        if not ok or len(found) != len(exact):
            continue
        rows = aligned(np.array([[c[1], c[2], c[3]] for c in found]), np.column_stack([exact, np.full(len(exact), np.nan)]))
        add('stuv', name, rows[:, :2], exact)
        stated += zip(rows[:, 2], np.abs(rows[:, :2] - exact).tolist())
        sub = cv2.cornerSubPix(picture, sb.copy(), (5, 5), (-1, -1), (3, 50, 1e-4))
        add('SB', name, sb[:, 0].astype(float), exact)
        add('cornerSubPix', name, sub[:, 0].astype(float), exact)

for method, sets in errors.items():
    every = np.concatenate([np.concatenate(v) for v in sets.values()])
    shared = np.concatenate([np.mean(v, 0) for v in sets.values()])
    views = np.mean([len(v) for v in sets.values()])
    rms = np.sqrt((every ** 2).mean())
    print(f'{method}: {len(every)} corners, rms {rms:.4f} px, shared {np.sqrt((shared ** 2).mean()):.4f} '
          f'(by chance {rms / np.sqrt(views):.4f}), worst {np.abs(every).max():.3f}')
sigma = np.array([s for s, _ in stated])
error = np.array([e for _, e in stated])
for low, high in ((0, .006), (.006, .009), (.009, .013), (.013, .02), (.02, .05), (.05, 9)):
    here = (sigma >= low) & (sigma < high)
    if here.any():
        print(f'sigma {low} to {high}: {here.sum()} corners, rms {np.sqrt((error[here] ** 2).mean()):.4f} px')
