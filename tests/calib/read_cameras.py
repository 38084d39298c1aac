#!/usr/bin/python3
"""Reads camera files of other tools, without any of stuv's code, and projects points with them.

  read_cameras.py FORMAT PATH X,Y,Z [X,Y,Z ...]

prints a line `NAME x y` for every camera and point, pixel (0, 0) being the centre of the top-left pixel. Each
reader is written from its tool's documentation; mrcal's models go through mrcal itself.
"""
import glob
import json
import os
import re
import sys

import numpy as np


def opencv_project(k, d, p):
    """OpenCV's rational model; k = fx, fy, cx, cy; d = k1 k2 p1 p2 k3 k4 k5 k6."""
    d = np.concatenate([d, np.zeros(8 - len(d))])
    x, y = p[0] / p[2], p[1] / p[2]
    r2 = x * x + y * y
    radial = (1 + d[0] * r2 + d[1] * r2**2 + d[4] * r2**3) / (1 + d[5] * r2 + d[6] * r2**2 + d[7] * r2**3)
    u = x * radial + 2 * d[2] * x * y + d[3] * (r2 + 2 * x * x)
    v = y * radial + d[2] * (r2 + 2 * y * y) + 2 * d[3] * x * y
    return k[0] * u + k[2], k[1] * v + k[3]


def fisheye_project(k, d, p):
    r = np.hypot(p[0], p[1])
    t = np.arctan2(r, p[2])
    td = t + d[0] * t**3 + d[1] * t**5 + d[2] * t**7 + d[3] * t**9
    return k[0] * td * p[0] / r + k[2], k[1] * td * p[1] / r + k[3]


def quaternion(w, x, y, z):
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def colmap(path):
    def lines(name):
        return [l for l in open(os.path.join(path, name)).read().split("\n") if not l.startswith("#")]
    lenses = {}
    for l in lines("cameras.txt"):
        if l:
            w = l.split()
            lenses[w[0]] = (w[1], np.array(w[4:], float))
    images = lines("images.txt")
    # As COLMAP 3.12 composes them: sensor_from_rig * rig_from_world.
    rig, frame = lines("rigs.txt")[0].split(), lines("frames.txt")[0].split()
    poses = {rig[3]: (np.eye(3), np.zeros(3))}
    at = 4
    while at < len(rig):
        assert rig[at] == "CAMERA" and rig[at + 2] == "1"
        q = np.array(rig[at + 3:at + 10], float)
        poses[rig[at + 1]] = (quaternion(*q[:4]), q[4:])
        at += 10
    q = np.array(frame[2:9], float)
    R0, t0 = quaternion(*q[:4]), q[4:]
    data = frame[10:]
    sensor_of = {data[i + 2]: data[i + 1] for i in range(0, len(data), 3)}
    assert int(frame[9]) == len(sensor_of) == len(poses)
    for l in images[0::2]:
        if not l:
            continue
        w = l.split()
        q = np.array(w[1:8], float)
        R, t = quaternion(*q[:4]), q[4:]
        Rs, ts = poses[sensor_of[w[0]]]
        assert np.allclose(Rs @ R0, R, atol=1e-12) and np.allclose(Rs @ t0 + ts, t, atol=1e-12)
        model, p = lenses[w[8]]
        k, d = p[:4], p[4:]
        project = fisheye_project if "FISHEYE" in model else opencv_project
        yield w[9].rsplit(".", 1)[0], lambda X, R=R, t=t, k=k, d=d, f=project: np.array(f(k, d, R @ X + t)) - 0.5


def nerfstudio(path):
    j = json.load(open(path))
    for f in j["frames"]:
        m = np.array(f["transform_matrix"])
        k = [f["fl_x"], f["fl_y"], f["cx"], f["cy"]]
        if f["camera_model"] == "OPENCV_FISHEYE":
            d, project = [f[n] for n in ("k1", "k2", "k3", "k4")], fisheye_project
        else:
            d, project = [f.get(n, 0) for n in ("k1", "k2", "p1", "p2", "k3")], opencv_project

        def pixel(X, m=m, k=k, d=d, f=project):
            c = np.linalg.inv(m) @ np.append(X, 1)  # x right, y up, z backwards
            return np.array(f(k, d, np.array([c[0], -c[1], -c[2]]))) - 0.5
        yield os.path.basename(f["file_path"]).rsplit(".", 1)[0], pixel


def llff(path):
    rows = np.load(path)
    assert rows.dtype == np.float64 and rows.shape[1] == 17
    for i, row in enumerate(rows):
        m = row[:15].reshape(3, 5)
        down, right, back, centre, (h, w, f) = m.T

        def pixel(X, a=(down, right, back, centre), h=h, w=w, f=f):
            v = X - a[3]
            z = -(a[2] @ v)
            return np.array([f * (a[1] @ v) / z + w / 2, f * (a[0] @ v) / z + h / 2]) - 0.5
        yield f"view{i:03}", pixel


def mrcal_models(path):
    import mrcal
    for file in sorted(glob.glob(path + "/*.cameramodel")):
        model = mrcal.cameramodel(file)
        yield (os.path.basename(file)[:-12],
               lambda X, m=model: mrcal.project(mrcal.transform_point_rt(m.extrinsics_rt_fromref(), X), *m.intrinsics()))


def opencv(path):
    def matrix(text, name):
        found = re.search(name + r": !!opencv-matrix\s+rows: (\d+)\s+cols: (\d+)\s+dt: d\s+data: \[([^\]]*)\]", text)
        return np.array(found[3].split(","), float).reshape(int(found[1]), int(found[2]))
    for file in sorted(glob.glob(path + "/*.yml")):
        text = open(file).read()
        K, D = matrix(text, "camera_matrix"), matrix(text, "distortion_coefficients").ravel()
        R, T = matrix(text, "R"), matrix(text, "T").ravel()
        k = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        yield os.path.basename(file)[:-4], lambda X, k=k, D=D, R=R, T=T: opencv_project(k, D, R @ X + T)


def kalibr(path):
    numbers = lambda text: np.array(re.findall(r"[-+0-9.e]+", text), float)
    pose = np.eye(4)
    for part in re.split(r"^cam\d+:\n", open(path).read(), flags=re.M)[1:]:
        value = lambda key: re.search(r"^  " + key + r": (.*)$", part, re.M)[1]
        if "T_cn_cnm1" in part:
            rows = re.findall(r"^  - \[(.*)\]$", part, re.M)
            pose = np.array([numbers(r) for r in rows]) @ pose
        project = fisheye_project if value("distortion_model") == "equidistant" else opencv_project
        k, d = numbers(value("intrinsics")), numbers(value("distortion_coeffs"))
        yield (value("rostopic").split("/")[1],
               lambda X, T=pose, k=k, d=d, f=project: f(k, d, (T @ np.append(X, 1))[:3]))


readers = {"colmap": colmap, "nerfstudio": nerfstudio, "llff": llff, "mrcal": mrcal_models, "opencv": opencv,
           "kalibr": kalibr}
for name, pixel in readers[sys.argv[1]](sys.argv[2]):
    for text in sys.argv[3:]:
        x, y = pixel(np.array(text.split(","), float))
        print(name, repr(float(x)), repr(float(y)))
