"""A planner of nuPlan that records its inputs; runs in the environment of nuplan-devkit."""

import json
import math
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from nuplan.common.actor_state.ego_state import EgoState
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks
from nuplan.planning.simulation.planner.abstract_planner import AbstractPlanner
from nuplan.planning.simulation.planner.idm_planner import IDMPlanner
from nuplan.planning.simulation.planner.simple_planner import SimplePlanner
from nuplan.planning.simulation.trajectory.interpolated_trajectory import InterpolatedTrajectory

KINDS = {
    "simple": lambda: SimplePlanner(8.0, 0.25, np.array([1.0, 0.0]), max_velocity=5.0),
    "idm": lambda: IDMPlanner(10.0, 1.0, 1.5, 1.0, 3.0, 16, 0.5, 40.0),
}


class Recorder(AbstractPlanner):
    """Plans with the devkit's planner ``kind``, writes its inputs to ``seen``, and fails as FAILS
    (environment) requests."""

    def __init__(self, kind: str, seen: str) -> None:
        self._planner = KINDS[kind]()
        self._seen = Path(seen)
        self._fails = os.environ.get("FAILS", "")

    def name(self) -> str:
        return "recorder"

    def observation_type(self) -> Any:
        return DetectionsTracks

    def initialize(self, initialization: Any) -> None:
        goal = initialization.mission_goal
        about = {
            "route": initialization.route_roadblock_ids,
            "goal": [goal.x, goal.y, goal.heading] if goal else None,
            "map": initialization.map_api.map_name if initialization.map_api else None,
        }
        self._write("w", about)
        self._planner.initialize(initialization)

    def compute_planner_trajectory(self, current_input: Any) -> Any:
        print("planners may print")
        history = current_input.history
        states = [
            {**_ego(ego), "tracks": sorted((_track(track) for track in tracks.tracked_objects), key=lambda track: track["track"])}
            for ego, tracks in zip(history.ego_states, history.observations)
        ]
        lights = [[light.lane_connector_id, light.status.name, light.timestamp] for light in current_input.traffic_light_data]
        iteration = current_input.iteration
        index = iteration.index
        self._write("a", {"index": index, "t_us": iteration.time_us, "states": states, "lights": lights, "interval": history.sample_interval})
        if self._fails and index >= 3:
            return self._fail(history.current_state[0])
        return self._planner.compute_planner_trajectory(current_input)

    def _fail(self, ego: EgoState) -> Any:
        if self._fails == "raises":
            raise RuntimeError("no checkpoint\nline 2")
        if self._fails == "hangs":
            time.sleep(60)
        if self._fails == "dies":
            os._exit(3)
        states = [ego]
        for i in range(1, 9):
            state = list(states[-1])
            state[0] += 50_000 if self._fails == "short" else 100_000
            state[1] = math.nan if self._fails == "not finite" else state[1]
            states.append(EgoState.deserialize(state, ego.car_footprint.vehicle_parameters))
        return InterpolatedTrajectory(states if self._fails == "not finite" else states[:2])

    def _write(self, mode: str, value: Any) -> None:
        with self._seen.open(mode) as file:
            print(json.dumps(value), file=file)


def _ego(ego: EgoState) -> dict[str, Any]:
    car = ego.dynamic_car_state
    return {
        "t_us": ego.time_us,
        "pose": [ego.rear_axle.x, ego.rear_axle.y, ego.rear_axle.heading],
        "motion": [car.rear_axle_velocity_2d.x, car.rear_axle_acceleration_2d.x, car.angular_velocity, ego.tire_steering_angle],
    }


def _track(track: Any) -> dict[str, Any]:
    box = track.box
    return {
        "track": track.track_token,
        "kind": track.tracked_object_type.fullname,
        "box": [box.center.x, box.center.y, box.center.heading, box.length, box.width, box.height],
        "velocity": [track.velocity.x, track.velocity.y],
    }
