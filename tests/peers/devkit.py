#!/usr/bin/env python3
"""Reads a data set in nuScenes layout with the official development kit and checks its consistency.

    pip install nuscenes-devkit
    tests/peers/devkit.py DIR [--version v1.0-town]

Loads all tables and the map expansion, walks all samples, their data and annotations both ways, projects the LiDAR
points of each sample into each of its cameras, and looks up the ego's position on the map. Prints counts as JSON and exits 1
if a check fails.
"""
import argparse
import json
import os
import sys

import numpy as np
from nuscenes.map_expansion import arcline_path_utils, map_api
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud


def walk(nusc, table, first, count):
    """Returns the chain of records from the first on; checks its back links and its length."""
    chain, token, before = [], first, ""
    while token:
        record = nusc.get(table, token)
        assert record["prev"] == before, f"{table} {token} says {record['prev']!r} came before, not {before!r}"
        chain.append(record)
        before, token = token, record["next"]
    assert len(chain) == count, f"{len(chain)} of {count} in a chain of {table}"
    return chain


def check_scene(nusc, scene, counts):
    samples = walk(nusc, "sample", scene["first_sample_token"], scene["nbr_samples"])
    assert samples[-1]["token"] == scene["last_sample_token"]
    for sample in samples:
        lidar = sample["data"]["LIDAR_TOP"]
        cameras = [channel for channel in sample["data"] if channel.startswith("CAM")]
        assert len(cameras) == 6, cameras
        for channel, token in sample["data"].items():
            path, boxes, intrinsic = nusc.get_sample_data(token)
            assert os.path.getsize(path) > 0
            assert (intrinsic is not None) == channel.startswith("CAM")
            counts["boxes in " + ("cameras" if channel.startswith("CAM") else "lidar")] += len(boxes)
        points = LidarPointCloud.from_file(os.path.join(nusc.dataroot, nusc.get("sample_data", lidar)["filename"]))
        assert points.nbr_points() > 1000 and np.isfinite(points.points).all()
        counts["points"] += points.nbr_points()
        for channel in cameras:
            seen, depths, image = nusc.explorer.map_pointcloud_to_image(lidar, sample["data"][channel])
            assert seen.shape[1] == depths.shape[0] > 0, f"no point in {channel}"
            assert (seen[0] < image.size[0]).all() and (seen[1] < image.size[1]).all() and (depths > 0).all()
            counts["points in images"] += seen.shape[1]
        for token in sample["anns"]:
            box = nusc.get_box(token)
            assert (box.wlh > 0).all() and np.isfinite(nusc.box_velocity(token)[:2]).any() or len(samples) == 1 \
                or nusc.get("sample_annotation", token)["prev"] == nusc.get("sample_annotation", token)["next"] == ""
            counts["annotations"] += 1
    for channel in samples[0]["data"]:
        first = samples[0]["data"][channel]
        while nusc.get("sample_data", first)["prev"]:
            first = nusc.get("sample_data", first)["prev"]
        of_scene = {sample["token"] for sample in samples}
        all_data = [d for d in nusc.sample_data if d["channel"] == channel and d["sample_token"] in of_scene]
        times = [d["timestamp"] for d in walk(nusc, "sample_data", first, len(all_data))]
        assert times == sorted(times), channel


def points_in_boxes(nusc, counts):
    """Checks the stated number of points of each annotation against the kit's count, within 2."""
    from nuscenes.utils.geometry_utils import points_in_box
    for sample in nusc.sample:
        lidar = sample["data"]["LIDAR_TOP"]
        path, boxes, _ = nusc.get_sample_data(lidar)
        points = LidarPointCloud.from_file(path).points[:3]
        for box in boxes:
            stated = nusc.get("sample_annotation", box.token)["num_lidar_pts"]
            found = int(points_in_box(box, points).sum())
            assert abs(stated - found) <= 2, f"{stated} points stated, {found} found in {box.token}"
            counts["points in boxes"] += found


def check_map(nusc, location, counts):
    if location not in map_api.locations:
        map_api.locations.append(location)  # the kit knows only four locations
    town = map_api.NuScenesMap(nusc.dataroot, location)
    for layer in town.layer_names:
        counts["map " + layer] = len(getattr(town, layer))
    for layer in town.non_geometric_polygon_layers:
        for record in getattr(town, layer):
            tokens = record["polygon_tokens"] if layer == "drivable_area" else [record["polygon_token"]]
            for token in tokens:
                polygon = town.extract_polygon(token)
                assert polygon.area > 0, f"an empty polygon in {layer}"
                counts["invalid polygons"] += not polygon.is_valid
    for layer in town.non_geometric_line_layers:
        for record in getattr(town, layer):
            assert town.extract_line(record["line_token"]).length > 0
    lanes = {lane["token"] for lane in town.lane + town.lane_connector}
    for token in lanes:
        path = town.get_arcline_path(token)
        poses = arcline_path_utils.discretize_lane(path, 0.5)
        steps = np.linalg.norm(np.diff(np.array(poses)[:, :2], axis=0), axis=1)
        assert (steps < 0.51).all(), f"a gap of {steps.max()} m in lane {token}"
        for following in town.get_outgoing_lane_ids(token):
            gap = np.linalg.norm(np.array(town.get_arcline_path(following)[0]["start_pose"][:2]) - poses[-1][:2])
            assert gap < 0.1, f"{gap} m from {token} to {following}"
            assert token in town.get_incoming_lane_ids(following)
            counts["links of lanes"] += 1
    width, height = town.canvas_edge
    mask = nusc.map[0]["mask"]
    assert mask.mask().shape == (round(height * 10), round(width * 10)), mask.mask().shape
    for sample in nusc.sample:
        data = nusc.get("sample_data", sample["data"]["LIDAR_TOP"])
        x, y, _ = nusc.get("ego_pose", data["ego_pose_token"])["translation"]
        assert mask.is_on_mask(x, y).all(), f"the ego is off the picture's white at {x}, {y}"
        assert town.record_on_point(x, y, "drivable_area"), f"the ego is off the road at {x}, {y}"
        counts["ego on a lane"] += bool(town.get_closest_lane(x, y, radius=2))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("dir")
    parser.add_argument("--version", default="v1.0-town")
    args = parser.parse_args()
    nusc = NuScenes(version=args.version, dataroot=args.dir, verbose=False)
    from collections import Counter
    counts = Counter({table: len(getattr(nusc, table)) for table in nusc.table_names})
    for instance in nusc.instance:
        chain = walk(nusc, "sample_annotation", instance["first_annotation_token"], instance["nbr_annotations"])
        assert chain[-1]["token"] == instance["last_annotation_token"]
        assert all(record["instance_token"] == instance["token"] for record in chain)
    for scene in nusc.scene:
        check_scene(nusc, scene, counts)
        check_map(nusc, nusc.get("log", scene["log_token"])["location"], counts)
    points_in_boxes(nusc, counts)
    print(json.dumps(counts, indent=1))


if __name__ == "__main__":
    try:
        main()
    except AssertionError as error:
        sys.exit(f"expected what the kit expects, found {error}")
