"""Reads a scene with nuplan-devkit, and with NAVSIM if it is there: ``navsim_reader.py SCENE BLOBS``. Prints what it found as JSON."""

import json
import pickle
import sys
from pathlib import Path
from typing import Any

from nuplan.database.utils.pointclouds.lidar import LidarPointCloud
from nuplan.common.maps.maps_datatypes import TrafficLightStatuses
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks


def _tracks(tracks: Any) -> list[Any]:
    assert isinstance(tracks, DetectionsTracks)
    return sorted(
        [t.track_token, t.tracked_object_type.fullname, *map(float, (t.center.x, t.center.y, t.center.heading, t.velocity.x, t.velocity.y))]
        for t in tracks.tracked_objects
    )


def main(scene_path: Path, blobs: Path) -> dict[str, Any]:
    scene = pickle.loads(scene_path.read_bytes())
    assert all(isinstance(lights, TrafficLightStatuses) for lights in scene["extended_traffic_light_data"])
    with (blobs / scene["frames"][-1]["lidar_path"]).open("rb") as file:
        points = LidarPointCloud.from_buffer(file, "pcd").points
    found: dict[str, Any] = {"future": [_tracks(tracks) for tracks in scene["extended_detections_tracks"]]}
    found["points"] = {"shape": list(points.shape), "sum": [float(row.sum(dtype=float)) for row in points]}
    try:
        from navsim.common.dataclasses import Scene, SensorConfig
    except ImportError:
        return found
    from navsim.planning.scenario_builder.navsim_scenario import NavSimScenario

    Scene._build_map_api = classmethod(lambda cls, name: None)
    cameras = {name: name in ("cam_f0", "cam_b0", "lidar_pc") for name in vars(SensorConfig.build_no_sensors())}
    loaded = Scene.load_from_disk(scene_path, blobs, SensorConfig(**cameras))
    scenario = NavSimScenario(loaded, "", "")
    given = loaded.get_agent_input()
    found["navsim"] = {
        "token": scenario.token,
        "route": scenario.get_route_roadblock_ids(),
        "now": _tracks(scenario.get_tracked_objects_at_iteration(0)),
        "past": [_tracks(tracks) for tracks in scenario.get_past_tracked_objects(0, 1.5)],
        "later": [_tracks(scenario.get_tracked_objects_at_iteration(i)) for i in range(1, 9)],
        "ego": [float(value) for value in scenario.get_ego_state_at_iteration(0)],
        "poses": [[float(value) for value in status.ego_pose] for status in given.ego_statuses],
        "points": [list(lidar.lidar_pc.shape) for lidar in given.lidars],
        "images": [list(cameras.cam_f0.image.shape) for cameras in given.cameras],
        "front": [int(cameras.cam_f0.image.sum()) for cameras in given.cameras],
    }
    return found


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), Path(sys.argv[2]))))
