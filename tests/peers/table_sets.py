#!/usr/bin/env python3
"""Compares data sets with nuScenes' tables, as this project reads them, with their own development kits.

    cargo run -p pskel-testing --example table_sets -- OUT
    pip install truckscenes-devkit lyft_dataset_sdk git+https://github.com/tier4/t4-devkit
    python3 tests/peers/table_sets.py OUT

For each data set that has its kit installed: time, number and global mean of the points of each key frame of each LiDAR, place
and time of each image, categories, centers and sizes of all boxes. Prints the counts, and exits 1 if one differs.
"""
import json
import os
import pathlib
import sys
import tempfile

import numpy as np
from pyquaternion import Quaternion

METERS = 1e-4


def pose(record):
    matrix = Quaternion(record["rotation"]).transformation_matrix
    matrix[:3, 3] = record["translation"]
    return matrix


def read(get, samples, points_of):
    """Returns what the kit reads; `get` returns a record as a dict, `points_of` the points of a sweep."""
    found = {"sweeps": [], "images": [], "boxes": []}
    for sample in samples:
        for channel, token in sample["data"].items():
            data = get("sample_data", token)
            calibrated = get("calibrated_sensor", data["calibrated_sensor_token"])
            place = pose(get("ego_pose", data["ego_pose_token"])) @ pose(calibrated)
            t_us = round(data["timestamp"])
            if channel.startswith("LIDAR"):
                points = points_of(data)
                whole = place @ np.vstack([points[:3].astype(float), np.ones(points.shape[1])])
                found["sweeps"].append([t_us, points.shape[1], whole[:3].mean(axis=1).tolist()])
            elif channel.startswith("CAM"):
                found["images"].append([channel, t_us, place[:3, 3].tolist()])
        for token in sample["boxes"]:
            box = get("sample_annotation", token)
            category = get("category", get("instance", box["instance_token"])["category_token"])["name"]
            width, length, height = box["size"]
            found["boxes"].append([category, list(box["translation"]), [length, width, height]])
    return found


def truckscenes(root):
    from truckscenes import TruckScenes
    from truckscenes.utils.data_classes import LidarPointCloud

    kit = TruckScenes("v1.0-mini", str(root), verbose=False)
    samples = [{"data": s["data"], "boxes": s["anns"]} for s in kit.sample]
    return read(kit.get, samples, lambda data: LidarPointCloud.from_file(kit.get_sample_data_path(data["token"])).points)


def t4(root):
    from t4_devkit import T4Devkit
    from t4_devkit.dataclass import LidarPointCloud

    kit = T4Devkit(str(root), verbose=False)

    def get(table, token):
        record = kit.get(table, token)
        fields = {name: getattr(record, name) for name in dir(record) if not name.startswith("_")}
        return {name: value for name, value in fields.items() if not callable(value)}

    def points(data):
        info = os.path.join(kit.data_root, data["info_filename"])
        return LidarPointCloud.from_file(kit.get_sample_data_path(data["token"]), info).points

    samples = [{"data": s.data, "boxes": s.ann_3ds} for s in kit.sample]
    return read(get, samples, points)


def lyft(root):
    from lyft_dataset_sdk.lyftdataset import LyftDataset
    from lyft_dataset_sdk.utils.data_classes import LidarPointCloud

    # The kit wants the folders that tables name, and all tables.
    with tempfile.TemporaryDirectory() as folder:
        view = pathlib.Path(folder)
        for name in ["images", "lidar", "maps"]:
            (view / name).symlink_to((root / f"train_{name}").resolve())
        (view / "data").mkdir()
        for table in (root / "train_data").iterdir():
            (view / "data" / table.name).symlink_to(table.resolve())
        for table in ["visibility", "attribute"]:
            (view / "data" / f"{table}.json").write_text("[]")
        kit = LyftDataset(data_path=str(view), json_path=str(view / "data"), verbose=False)
        samples = [{"data": s["data"], "boxes": s["anns"]} for s in kit.sample]
        return read(kit.get, samples, lambda data: LidarPointCloud.from_file(kit.get_sample_data_path(data["token"])).points)


def same(a, b):
    """Returns whether two lists agree: text and whole numbers exactly, coordinates within a tenth of a millimeter."""
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    return abs(a - b) <= METERS if isinstance(a, float) or isinstance(b, float) else a == b


def main():
    out, wrong, missing = pathlib.Path(sys.argv[1]), 0, []
    for kit in [truckscenes, t4, lyft]:
        own = json.loads((out / f"{kit.__name__}.json").read_text())
        try:
            found = kit(out / kit.__name__)
        except ModuleNotFoundError as error:
            missing.append(f"{kit.__name__} ({error})")
            continue
        for part, items in own.items():
            differing = sum(not same(a, b) for a, b in zip(sorted(items), sorted(found[part])))
            wrong += differing + abs(len(items) - len(found[part]))
            print(f"{kit.__name__:12} {len(items):4} {part:7} {len(found[part]):4} by the kit, {differing} differ")
    print(*(f"not compared: {name}" for name in missing), sep="\n", end="\n" if missing else "")
    sys.exit(1 if wrong or missing else 0)


if __name__ == "__main__":
    main()
