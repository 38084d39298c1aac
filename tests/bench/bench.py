#!/usr/bin/python3
"""Run time against error of `stuv`, and how its cost grows: tables, CSV, SVG. See tests/bench/run."""
import argparse
import csv
import json
import os
import statistics
import subprocess
from pathlib import Path

import matplotlib
from PIL import Image

matplotlib.use("svg")
import matplotlib.pyplot as plt

# name, list of views, disparity range, N, M, views compared
SCENES = [
    ("knights", "knights/views.csv", -347, 231, 41, 3, 6),
    ("shop", "shop/views.csv", 0, 276, 49, 4, 2),
    ("dino", "hci/dino/views.csv", -2.5, 2.5, 41, 3, 3),
    ("cotton", "hci/cotton/views.csv", -2.5, 2.5, 41, 3, 3),
]
BORDER = 24
ROUNDS = 3  # the peer and `stuv` take turns; medians are compared
COLOURS = {"peer": "tab:red", "literal": "tab:gray", "exact": "tab:blue", "fast": "tab:green"}


class Bench:
    def __init__(self, args):
        self.args = args
        self.limits = None

    def stuv(self, *arguments, **options):
        done = subprocess.run([self.args.stuv, *map(str, arguments)], capture_output=True, text=True, **options)
        if done.returncode != 0:
            raise SystemExit(f"bench.py: stuv {arguments[0]} failed: {done.stderr.strip()}")

    def scene(self, name, listed, low, high):
        folder = self.args.work / name
        self.stuv("import", listed, "-o", folder, f"--disparity={low},{high}", "--force")
        return folder

    def rows(self, scene, methods, planes, window, views, backend="cpu"):
        out = self.args.work / "rows.json"
        self.stuv("bench", scene, "-o", out, "--force", "--methods", methods, "--planes", planes, "--window", window,
                  "--border", BORDER, "--views", views, "--backend", backend)
        result = json.loads(out.read_text())
        self.limits = self.limits or result["limits"]
        self.machine = result["machine"]
        if backend == "gl":
            self.limits["texels_per_s"] = result["limits"]["texels_per_s"]
        return result["rows"]

    def peer(self, listed, low, high, planes, window, views):
        done = subprocess.run([self.args.peer, listed, *map(str, (low, high, planes, window, views))],
                              capture_output=True, text=True, check=True)
        return json.loads(done.stdout)

    def milliseconds(self, scene, method, viewpoints, *flags, cores=None):
        """Median over viewpoints, pixels in memory, nothing known from the picture before."""
        path = self.args.work / "path.csv"
        # The first of each pair reads the pixels.
        path.write_text("".join(f"{s},{t}\n" * 2 for s, t in viewpoints))
        limited = {"preexec_fn": lambda: os.sched_setaffinity(0, cores)} if cores else {}
        result = self.args.work / "path.json"
        self.stuv("render", scene, "-o", self.args.work / "path.png", "--force", "--path", path, "--method", method,
                  "--no-skip", "previous-view", "--json", result, *flags, **limited)
        views = json.loads(result.read_text())["views"]
        return statistics.median(view["milliseconds"] for view in views[1::2])


def median_rows(rounds):
    """Rows of several rounds into one: median times."""
    out = []
    for same in zip(*rounds):
        row = dict(same[0])
        row["ms_median"] = statistics.median(r["ms_median"] for r in same)
        if row["limit_fraction"] is not None:
            row["limit_fraction"] = statistics.median(r["limit_fraction"] for r in same)
        out.append(row)
    return out


def against_peer(bench):
    """Every scene, method and back end at the scene's own N and M."""
    rows = []
    for name, listed, low, high, planes, window, views in SCENES:
        listed = bench.args.data / listed
        if not listed.exists():
            print(f"{name}: no {listed}, left out")
            continue
        scene = bench.scene(name, listed, low, high)
        peers, ours = [], []
        for _ in range(ROUNDS):
            if bench.args.peer:
                peers.append(bench.peer(listed, low, high, planes, window, views))
            ours.append(bench.rows(scene, "exact,fast", planes, window, views))
        if peers:
            # The peer's 33.58 and the like: `literal` has its PSNR to 0.05 dB.
            rows.append({"scene": name, "method": "peer", "backend": "cpu", "planes": planes, "window": window,
                         "views": views, "ms_median": statistics.median(p["ms_mean"] for p in peers),
                         "psnr_db": peers[0]["psnr_db"]})
        single = bench.rows(scene, "literal", planes, window, views) + bench.rows(scene, "exact", planes, window, views, "gl")
        for row in median_rows(ours) + single:
            rows.append({"scene": name, **row})
        base = rows[-5]["ms_median"] if peers else None
        for row in rows[-5:] if peers else []:
            row["times_faster"] = base / row["ms_median"]
        print_rows(rows[-5 if peers else -4:])
    return rows


def print_rows(rows):
    for row in rows:
        of = f'{100 * row["limit_fraction"]:.0f} % of {row["limit"]}' if row.get("limit_fraction") else "-"
        print(f'{row["scene"]:<8} {row["method"]:<8} {row["backend"]:<4} N {row["planes"]:<3} M {row["window"]:<2} '
              f'{row["ms_median"]:>9.1f} ms {row["psnr_db"]:>7.2f} dB  {row.get("times_faster", float("nan")):>6.1f} '
              f'times the peer\'s speed, evaluated {row.get("evaluated_fraction", 1):.3f}, {of}', flush=True)


def over_error(bench, scenes):
    """N and M swept: what an error costs."""
    rows = []
    for name, listed, low, high, planes, window, views in scenes:
        scene = bench.args.work / name
        for m in sorted({1, window, 7}):
            for row in bench.rows(scene, "exact,fast", "9,17,29,41,61", m, views):
                rows.append({"scene": name, **row})
    return rows


def front(points):
    """Of (ms, dB): those that no other beats in both."""
    best, out = float("-inf"), []
    for ms, db in sorted(points):
        if db > best:
            best = db
            out.append((ms, db))
    return out


def plot_error(rows, peers, path):
    names = list(dict.fromkeys(row["scene"] for row in rows))
    figure, axes = plt.subplots(1, len(names), figsize=(4.2 * len(names), 3.8), squeeze=False)
    for axis, name in zip(axes[0], names):
        here = [row for row in rows if row["scene"] == name]
        for method, marker in (("exact", "o"), ("fast", "^")):
            points = [(row["ms_median"], row["psnr_db"]) for row in here if row["method"] == method]
            axis.plot(*zip(*points), marker, color=COLOURS[method], markersize=4, alpha=0.6, label=method)
        axis.plot(*zip(*front([(row["ms_median"], row["psnr_db"]) for row in here])), "k-", linewidth=1,
                  label="Pareto front")
        for row in peers:
            if row["scene"] == name and row["method"] in ("peer", "literal"):
                axis.plot(row["ms_median"], row["psnr_db"], "s", color=COLOURS[row["method"]], label=row["method"])
        axis.set_xscale("log")
        axis.set_title(name)
        axis.set_xlabel("ms a picture")
        axis.grid(True, which="both", linewidth=0.3)
    axes[0][0].set_ylabel("PSNR [dB]")
    axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def thinned_list(listed, every, path):
    """The list with every k-th row and column of the input cameras, the others left out."""
    with open(listed, newline="") as file:
        rows = list(csv.DictReader(file))
    columns = rows[0].keys()
    inputs = [row for row in rows if not row["role"].startswith("truth")]
    places = {axis: sorted({round(float(row[axis]), 3) for row in inputs}) for axis in "st"}
    kept = [row for row in inputs
            if all(places[axis].index(round(float(row[axis]), 3)) % every == 0 for axis in "st")]
    for row in kept:
        row["file"] = str((Path(listed).parent / row["file"]).resolve())
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(kept)
    return len(kept)


def resized_list(listed, size, folder):
    """The input views at another size."""
    folder.mkdir(exist_ok=True)
    with open(listed, newline="") as file:
        rows = [row for row in csv.DictReader(file) if not row["role"].startswith("truth")]
    for row in rows:
        image = Image.open(Path(listed).parent / row["file"]).convert("RGB").resize((size, size), Image.LANCZOS)
        row["file"] = Path(row["file"]).stem + ".png"
        image.save(folder / row["file"])
    with open(folder / "views.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    return folder / "views.csv"


def growth(bench):
    """Cost over pixels, planes, cameras and threads, of one scene."""
    name, listed, low, high, planes, window, _ = SCENES[2] if (bench.args.data / SCENES[2][1]).exists() else SCENES[0]
    scene = bench.args.work / name
    light_field = json.loads((scene / "lightfield.json").read_text())
    inputs = [view for view in light_field["views"] if view["role"] == "input"]
    span = [(min(view[axis] for view in inputs), max(view[axis] for view in inputs)) for axis in "st"]
    views = [tuple(a + f * (b - a) for (a, b), f in zip(span, at)) for at in ((0.41, 0.43), (0.55, 0.38), (0.47, 0.61))]
    rows = []

    def add(what, amount, cost, **more):
        for method in ("exact", "fast"):
            rows.append({"scene": name, "over": what, "amount": amount, "method": method,
                         "ms": cost(method), **more})

    common = ("--planes", planes, "--window", window)
    for size in (128, 256, 512, 1024):
        scale = size / light_field["width"]
        other = bench.scene("resized", resized_list(bench.args.data / listed, size, bench.args.work / "resized_views"),
                            low * scale, high * scale)
        add("pixels", size * size, lambda m: bench.milliseconds(other, m, views, *common))
    for n in (5, 9, 17, 33, 65, 129):
        add("planes", n, lambda m: bench.milliseconds(scene, m, views, "--planes", n, "--window", window))
    for m_px in (0, 1, 3, 7, 15, 31):
        add("window M", m_px, lambda m: bench.milliseconds(scene, m, views, "--planes", planes, "--window", m_px))
    for every in (1, 2, 4):
        thin = bench.args.work / "thinned.csv"
        count = thinned_list(bench.args.data / listed, every, thin)
        other = bench.scene("thinned", thin, low, high)
        add("cameras", count, lambda m: bench.milliseconds(other, m, views, *common))
    available = sorted(os.sched_getaffinity(0))
    threads = sorted({1, len(available)} | {2 ** k for k in range(1, 7) if 2 ** k < len(available)})
    for count in threads:
        add("threads", count, lambda m: bench.milliseconds(scene, m, views, *common, cores=available[:count]))
    return rows


def plot_growth(rows, path):
    kinds = list(dict.fromkeys(row["over"] for row in rows))
    figure, axes = plt.subplots(1, len(kinds), figsize=(3.3 * len(kinds), 3.3), squeeze=False)
    for axis, kind in zip(axes[0], kinds):
        for method in ("exact", "fast"):
            points = [(row["amount"], row["ms"]) for row in rows if row["over"] == kind and row["method"] == method]
            axis.plot(*zip(*points), "o-", color=COLOURS[method], markersize=4, label=method)
        axis.set_xscale("symlog" if kind == "window M" else "log", base=2)
        axis.set_yscale("log")
        axis.set_xlabel(kind)
        axis.grid(True, which="both", linewidth=0.3)
    axes[0][0].set_ylabel("ms a picture")
    axes[0][0].legend(fontsize=7)
    figure.suptitle(rows[0]["scene"], fontsize=9)
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def write_csv(rows, path):
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows({key: f"{value:.5g}" if isinstance(value, float) else value for key, value in row.items()}
                         for row in rows)


def write_table(bench, rows, path):
    limits = bench.limits
    lines = [f"{bench.machine}: {limits['multiply_adds_per_s'] * 1e-9:.0f} G multiply-adds/s, "
             f"{limits['bytes_per_s'] * 1e-9:.0f} GB/s, {(limits['texels_per_s'] or 0) * 1e-9:.1f} G texels/s.", "",
             "| scene | method | on | N | M | views | ms | PSNR dB | times the peer | evaluated | peak MB | reached |",
             "|---|---|---|---|---|---|---|---|---|---|---|---|"]
    for row in rows:
        of = f'{100 * row["limit_fraction"]:.0f} % of {row["limit"]}' if row.get("limit_fraction") else ""
        faster = f'{row["times_faster"]:.1f}' if "times_faster" in row else ""
        peak = f'{row["peak_mb"]:.0f}' if row.get("peak_mb") else ""
        lines.append(f'| {row["scene"]} | {row["method"]} | {row["backend"]} | {row["planes"]} | {row["window"]} | '
                     f'{row["views"]} | {row["ms_median"]:.1f} | {row["psnr_db"]:.2f} | {faster} | '
                     f'{row.get("evaluated_fraction", 1):.3f} | {peak} | {of} |')
    path.write_text("\n".join(lines) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stuv", required=True)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--peer")
    args = parser.parse_args()
    args.stuv = str(Path(args.stuv).resolve())
    bench = Bench(args)
    compared = against_peer(bench)
    write_csv(compared, args.out / "methods.csv")
    write_table(bench, compared, args.out / "methods.md")
    there = {row["scene"] for row in compared}
    swept = over_error(bench, [scene for scene in SCENES if scene[0] in there])
    write_csv(swept, args.out / "error.csv")
    plot_error(swept, compared, args.out / "error.svg")
    grown = growth(bench)
    write_csv(grown, args.out / "growth.csv")
    plot_growth(grown, args.out / "growth.svg")
    print(f"tables, CSV and SVG: {args.out}")


if __name__ == "__main__":
    main()
