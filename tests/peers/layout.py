"""Draws the layouts of a nuScenes log with Pillow and compares them with those written by pskel: the reference for
src/conditions/layout.

It shares only the files of the data set with the program. Tables and map are read here; edges are computed, clipped in
depth and projected with numpy, drawn by ImageDraw.line with a width of 8, and reduced by Image.resize with BILINEAR.

Pillow truncates the ends of a line to whole pixels. This moves a nearly vertical or horizontal line by up to a pixel, and
the corners of its 8 px are rounded once more. So the full size is also drawn FINE times larger, 8 * FINE px wide, and the
middle one of FINE x FINE pixels is sampled: the same lines by the same code, with ends truncated to 1/FINE px. Our drawing
must agree with that one within SHARE. The distances of the plain drawing from ours and from Pillow's finer one are printed
beside it. The reduced sizes must agree with the reduced plain drawing within LEVELS.

    python3 tests/peers/layout.py LOG_DIR FULL_DIR [REDUCED_DIR] [--every N] [--map NAME] [--keep DIR]

LOG_DIR is the data set. FULL_DIR and REDUCED_DIR are folders written by `pskel render --maps boxes,map --format npz`,
the latter with --out-size. Exit code 0 if everything is within the bounds below, 1 if not.
(Pillow 13.0, numpy 2.4)
"""

import argparse
import json
import pathlib
import sys

import numpy as np
from PIL import Image, ImageDraw, ImageFilter

WIDTH = 8  # pixels
NEAR = 0.05  # meters
BOXES_FAR, MAP_FAR = 512.0, 65.0
LAYERS = [("lane", (0, 255, 0)), ("drivable_area", (0, 0, 255)), ("ped_crossing", (255, 0, 0))]
CATEGORIES = [  # the first entry that is a part of the category name wins
    ("pedestrian", (255, 0, 0)), ("bicycle", (128, 255, 0)), ("motorcycle", (0, 255, 128)), ("bus", (128, 0, 255)),
    ("car", (0, 0, 255)), ("construction", (128, 128, 255)), ("emergency", (255, 128, 128)),
    ("trailer", (255, 255, 255)), ("truck", (255, 255, 0)),
]
SHARE = 0.999  # minimum share of a color's pixels within 1 px of the other drawing's (eight directions)
FINE = 5
LEVELS = 2.0  # maximum mean absolute difference of reduced layouts


def rotation(w, x, y, z):
    """Returns the 3x3 matrix of a quaternion, which is normalized."""
    n = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def pose(record):
    """Returns the 4x4 matrix of a record with a rotation and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(*record["rotation"])
    matrix[:3, 3] = record["translation"]
    return matrix


class Tables:
    """Tables of the data set, by token."""

    def __init__(self, folder):
        self.folder = next(folder.glob("v1.0-*"))
        self.cache = {}

    def __call__(self, name):
        if name not in self.cache:
            records = json.loads((self.folder / f"{name}.json").read_text())
            self.cache[name] = {record["token"]: record for record in records}
        return self.cache[name]


def box_lines(tables, sample):
    """Returns edges and diagonals of all boxes of a frame, sorted by track: pairs of global points with colors."""
    lines = []
    boxes = [a for a in tables("sample_annotation").values() if a["sample_token"] == sample]
    for box in sorted(boxes, key=lambda a: a["instance_token"]):
        instance = tables("instance")[box["instance_token"]]
        parts = tables("category")[instance["category_token"]]["name"].split(".")
        color = next((rgb for name, rgb in CATEGORIES if name in parts), None)
        if color is None or parts[0] in ("movable_object", "static_object"):
            continue
        width, length, height = box["size"]
        to_global = pose(box)

        def at(x, y, z):
            return (to_global @ [x * length / 2, y * width / 2, z * height / 2, 1])[:3]

        ends = (-1, 1)
        pairs = [(at(-1, y, z), at(1, y, z)) for z in ends for y in ends]
        pairs += [(at(x, -1, z), at(x, 1, z)) for z in ends for x in ends]
        pairs += [(at(x, y, -1), at(x, y, 1)) for y in ends for x in ends]
        corner = at(1, 1, -1)
        pairs += [(corner, at(1, -1, 1)), (corner, at(-1, 1, 1))]
        lines += [(a, b, color) for a, b in pairs]
    return lines


def map_lines(path, origins):
    """Returns the map outlines in drawing order, each corner at the height of the nearest ego origin."""
    data = json.loads(path.read_text())
    nodes = {n["token"]: (n["x"], n["y"]) for n in data["node"]}
    polygons = {p["token"]: p for p in data["polygon"]}

    def lifted(tokens):
        ring = np.array([nodes[t] for t in tokens])
        if len(ring) > 1 and tuple(ring[0]) == tuple(ring[-1]):
            ring = ring[:-1]
        far = ((ring[:, None] - origins[None, :, :2]) ** 2).sum(axis=2)
        return np.column_stack([ring, origins[far.argmin(axis=1), 2]])

    lines = []
    for layer, color in LAYERS:
        for record in data[layer]:
            for token in record.get("polygon_tokens") or [record["polygon_token"]]:
                polygon = polygons[token]
                rings = [polygon["exterior_node_tokens"]] + [h["node_tokens"] for h in polygon["holes"]]
                for ring in map(lifted, rings):
                    lines += [(a, b, color) for a, b in zip(ring, np.roll(ring, -1, axis=0))]
    return lines


def projected(lines, intrinsics, camera_from_global, far):
    """Clips lines in depth and projects them: pairs of pixels with colors."""
    out = []
    for a, b, color in lines:
        a, b = (camera_from_global[:3, :3] @ p + camera_from_global[:3, 3] for p in (a, b))
        if max(a[2], b[2]) < NEAR or min(a[2], b[2]) > far:
            continue
        clipped = []
        for p, q in ((a, b), (b, a)):
            for depth in (NEAR, far):
                beyond = p[2] < depth if depth == NEAR else p[2] > depth
                if beyond:
                    p = p + (q - p) * ((depth - p[2]) / (q[2] - p[2]))
                    p[2] = depth
            pixel = intrinsics @ p
            clipped.append(tuple(pixel[:2] / pixel[2]))
        out.append((*clipped, color))
    return out


def drawn(lines, size, fine=1):
    """Returns an RGB image of lines, drawn larger by an odd factor and sampled at the middle pixels."""
    image = Image.new("RGB", (size[1] * fine, size[0] * fine))
    draw = ImageDraw.Draw(image)
    for a, b, color in lines:
        draw.line([(a[0] * fine, a[1] * fine), (b[0] * fine, b[1] * fine)], fill=color, width=WIDTH * fine)
    if fine == 1:
        return image
    return Image.fromarray(np.asarray(image)[fine // 2::fine, fine // 2::fine])


def grown(mask):
    """Dilates a mask by one pixel in all eight directions."""
    return np.asarray(Image.fromarray(mask).filter(ImageFilter.MaxFilter(3)))


PAIRS = ["1 ours, fine Pillow", "2 ours, Pillow", "3 fine Pillow, Pillow"]


class Totals:
    """Sums over all frames and cameras."""

    def __init__(self):
        self.near = {}
        self.differences = {}

    def compare_full(self, name, ours, peer):
        """Counts, per color, the pixels of each drawing near one of the other; `name` is the pair and the layout."""
        ours, peer = (image.astype(np.int32) @ [1 << 16, 1 << 8, 1] for image in (ours, peer))
        for color in (set(np.unique(ours)) | set(np.unique(peer))) - {0}:
            key = (name, (int(color) >> 16, int(color) >> 8 & 255, int(color) & 255))
            masks = [image == color for image in (ours, peer)]
            counts = self.near.setdefault(key, np.zeros(5, dtype=np.int64))
            counts += [
                (masks[0] & grown(masks[1])).sum(), masks[0].sum(),
                (masks[1] & grown(masks[0])).sum(), masks[1].sum(), (masks[0] ^ masks[1]).sum(),
            ]

    def compare_reduced(self, name, ours, peer):
        difference = np.abs(ours.astype(int) - peer.astype(int))
        drawn_on = (ours.any(axis=2) | peer.any(axis=2))
        sums = self.differences.setdefault(name, [0, 0, 0, 0, 0.0])
        sums[0] += difference.sum()
        sums[1] += difference.size
        sums[2] += difference[drawn_on].sum()
        sums[3] += difference[drawn_on].size
        sums[4] = max(sums[4], difference.mean())

    def report(self):
        """Prints all results; returns whether everything is within bounds."""
        good = bool(self.near)
        for ((pair, name), color), (a, n, b, m, xor) in sorted(self.near.items()):
            ours, peer = a / max(n, 1), b / max(m, 1)
            if pair == PAIRS[0]:
                good &= ours >= SHARE and peer >= SHARE
            print(f"{pair:20} {name:5} {str(color):15} within 1 px: {100 * ours:8.4f} % of {n} and "
                  f"{100 * peer:8.4f} % of {m}; differing {xor}")
        for name, (total, count, total_on, count_on, worst) in sorted(self.differences.items()):
            mean = total / max(count, 1)
            good &= worst <= LEVELS
            print(f"{name:6} reduced: mean absolute difference {mean:.3f} levels, {worst:.3f} in the worst camera, "
                  f"{total_on / max(count_on, 1):.2f} where drawn")
        return good


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("log", type=pathlib.Path)
    parser.add_argument("full", type=pathlib.Path)
    parser.add_argument("reduced", type=pathlib.Path, nargs="?")
    parser.add_argument("--every", type=int, default=1, help="compare every N-th frame")
    parser.add_argument("--map", help="file below maps/expansion, without .json [default: the log's location]")
    parser.add_argument("--keep", type=pathlib.Path, help="folder for pictures of both drawings, side by side")
    args = parser.parse_args()
    tables, totals = Tables(args.log), Totals()
    samples = sorted(tables("sample").values(), key=lambda s: s["timestamp"])
    by_frame = {}
    for data in tables("sample_data").values():
        sensor = tables("calibrated_sensor")[data["calibrated_sensor_token"]]
        channel = tables("sensor")[sensor["sensor_token"]]["channel"]
        by_frame[data["sample_token"], channel] = (data, sensor)
    ego = tables("ego_pose")
    origins = np.array([ego[by_frame[s["token"], "LIDAR_TOP"][0]["ego_pose_token"]]["translation"] for s in samples])
    place = args.map or next(iter(tables("log").values()))["location"]
    outlines = map_lines(args.log / "maps" / "expansion" / f"{place}.json", origins)
    frames = json.loads((args.full / "index.json").read_text())["frames"]
    frames = frames[::args.every]
    for frame in frames:
        sample = samples[int(frame["name"])]["token"]
        sources = {"boxes": (box_lines(tables, sample), BOXES_FAR), "map": (outlines, MAP_FAR)}
        full = np.load(args.full / frame["name"] / "maps.npz")
        reduced = args.reduced and np.load(args.reduced / frame["name"] / "maps.npz")
        for number, channel in enumerate(frame["cameras"]):
            data, sensor = by_frame[sample, channel]
            global_from_camera = pose(ego[data["ego_pose_token"]]) @ pose(sensor)
            for name in [n for n in sources if n in full]:
                ours = full[name][number]
                intrinsics = np.array(sensor["camera_intrinsic"])
                scale = [ours.shape[1] / data["width"], ours.shape[0] / data["height"], 1]
                lines, far = sources[name]
                lines = projected(lines, np.diag(scale) @ intrinsics, np.linalg.inv(global_from_camera), far)
                peer, fine = (drawn(lines, ours.shape[:2], by) for by in (1, FINE))
                drawings = {"ours": ours, "fine Pillow": np.asarray(fine), "Pillow": np.asarray(peer)}
                for pair in PAIRS:
                    a, b = (drawings[one] for one in pair[2:].split(", "))
                    totals.compare_full((pair, name), a, b)
                if args.keep:
                    args.keep.mkdir(parents=True, exist_ok=True)
                    both = np.concatenate([ours, np.asarray(peer)])
                    Image.fromarray(both).save(args.keep / f"{frame['name']}-{channel}-{name}.png")
                if reduced is not None:
                    small = reduced[name][number]
                    peer = peer.resize((small.shape[1], small.shape[0]), Image.BILINEAR)
                    totals.compare_reduced(name, small, np.asarray(peer))
    print(f"{len(frames)} frames of {place}")
    return 0 if totals.report() else 1


if __name__ == "__main__":
    sys.exit(main())
