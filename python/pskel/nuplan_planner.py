"""Planners of nuPlan for ``pskel simulate``: ``--planner "python -m pskel.nuplan_planner MODULE:CLASS"`` (docs/src/reference/interop.md).

Runs in the environment of nuplan-devkit, Python 3.9 or later; the compiled part of ``pskel`` is not needed. ``MODULE:CLASS`` is an
``AbstractPlanner``. The log must be one of nuPlan if the planner uses the map; its files are read by the devkit.
"""

from __future__ import annotations

import json
import sys
from collections import deque
from pathlib import Path
from typing import Any

from pskel import _planner
from pskel._planner import Message, PlannerError

#: Time of the history buffer, seconds.
HISTORY_S = 2.0
#: Largest difference between the vehicles of both programs, meters.
SAME_M = 1e-6


class Bridge:
    """One rollout: converts observations to a ``PlannerInput``, and the planner's trajectory to waypoints."""

    def __init__(self, planner: Any, hello: Message, map_version: str) -> None:
        from nuplan.common.actor_state.state_representation import StateSE2
        from nuplan.planning.simulation.planner.abstract_planner import PlannerInitialization

        self._planner = planner
        self._vehicle = _vehicle(hello["ego"])
        self._interval_s = 1.0 / hello["sim_hz"]
        size = round(HISTORY_S * hello["sim_hz"]) + 1
        self._egos: deque[Any] = deque(maxlen=size)
        self._observations: deque[Any] = deque(maxlen=size)
        self._track_ids: dict[str, int] = {}
        goal = hello["goal"]
        initialization = PlannerInitialization(
            route_roadblock_ids=list(hello["route"]),
            mission_goal=StateSE2(goal["x"], goal["y"], goal["heading"]) if goal else None,
            map_api=_map(hello["map"], map_version),
        )
        planner.initialize(initialization)

    def plan(self, see: Message) -> list[Message]:
        """Return the waypoints of the planner for an observation."""
        from nuplan.common.actor_state.state_representation import TimePoint
        from nuplan.planning.simulation.history.simulation_history_buffer import SimulationHistoryBuffer
        from nuplan.planning.simulation.planner.abstract_planner import PlannerInput
        from nuplan.planning.simulation.simulation_time_controller.simulation_iteration import SimulationIteration

        for state in (*see["history"], see):
            self._egos.append(self._ego(state))
            self._observations.append(self._tracks(state))
        now_us = see["t_us"]
        planned = self._planner.compute_trajectory(
            PlannerInput(
                iteration=SimulationIteration(TimePoint(now_us), see["step"]),
                history=SimulationHistoryBuffer(self._egos, self._observations, self._interval_s),
                traffic_light_data=lights(see),
            )
        )
        return [_waypoint(state, now_us) for state in planned.get_sampled_trajectory() if state.time_us > now_us]

    def _ego(self, state: Message) -> Any:
        from nuplan.common.actor_state.ego_state import EgoState
        from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D, TimePoint

        ego = state["ego"]
        return EgoState.build_from_rear_axle(
            rear_axle_pose=StateSE2(ego["x"], ego["y"], ego["heading"]),
            rear_axle_velocity_2d=StateVector2D(ego["v"], 0.0),
            rear_axle_acceleration_2d=StateVector2D(ego["a"], 0.0),
            tire_steering_angle=ego["steering"],
            time_point=TimePoint(state["t_us"]),
            vehicle_parameters=self._vehicle,
            angular_vel=ego["yaw_rate"],
        )

    def _tracks(self, state: Message) -> Any:
        for actor in state["actors"]:
            self._track_ids.setdefault(actor["track"], len(self._track_ids))
        return tracks(state, self._track_ids)


def tracks(state: Message, track_ids: dict[str, int]) -> Any:
    """Return the actors of a state as ``DetectionsTracks``; ``track_ids`` has a number for each track."""
    from nuplan.common.actor_state.agent import Agent
    from nuplan.common.actor_state.oriented_box import OrientedBox
    from nuplan.common.actor_state.scene_object import SceneObjectMetadata
    from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D
    from nuplan.common.actor_state.static_object import StaticObject
    from nuplan.common.actor_state.tracked_objects import TrackedObjects
    from nuplan.common.actor_state.tracked_objects_types import AGENT_TYPES, TrackedObjectType
    from nuplan.planning.simulation.observation.observation_type import DetectionsTracks

    known = {kind.fullname: kind for kind in TrackedObjectType}
    objects = []
    for actor in state["actors"]:
        kind = known[kind_of(actor)]
        center = StateSE2(actor["x"], actor["y"], actor["heading"])
        box = OrientedBox(center, actor["length"], actor["width"], actor["height"])
        track = actor["track"]
        metadata = SceneObjectMetadata(state["t_us"], track, track_ids[track], track, actor["category"])
        if kind in AGENT_TYPES:
            velocity = StateVector2D(actor["vx"], actor["vy"])
            objects.append(Agent(kind, box, velocity, metadata, angular_velocity=actor["yaw_rate"]))
        else:
            objects.append(StaticObject(kind, box, metadata))
    return DetectionsTracks(TrackedObjects(objects))


def kind_of(actor: Message) -> str:
    """Return an actor's nuPlan type name; categories of other data sets map by their class."""
    category: str = actor["category"]
    names = {"trafficcone": "traffic_cone", "barrier": "barrier"}
    if category in ("traffic_cone", "barrier", "czone_sign", "generic_object"):
        return category
    kinds = {"motor_vehicle": "vehicle", "pedestrian": "pedestrian", "cycle": "bicycle"}
    return kinds.get(actor["class"]) or names.get(category.rpartition(".")[2], "generic_object")


def lights(state: Message) -> list[Any]:
    """Return the lights of a state as ``TrafficLightStatusData``."""
    from nuplan.common.maps.maps_datatypes import TrafficLightStatusData, TrafficLightStatusType

    colors = [TrafficLightStatusType.deserialize(light["color"].upper()) for light in state["lights"]]
    return [
        TrafficLightStatusData(color, number, state["t_us"]) for color, number in zip(colors, light_ids(state))
    ]


def light_ids(state: Message) -> list[int]:
    """Return the numbers of the lane connectors of a state's lights."""
    try:
        return [int(light["lane_connector"]) for light in state["lights"]]
    except ValueError as error:
        raise PlannerError(f"expected lane connectors with numbers, as in maps of nuPlan, found {error}") from None


def _waypoint(state: Any, now_us: int) -> Message:
    axle = state.rear_axle
    return {
        "t": (state.time_us - now_us) / 1e6,
        "x": float(axle.x),
        "y": float(axle.y),
        "heading": float(axle.heading),
        "v": float(state.dynamic_car_state.rear_axle_velocity_2d.x),
    }


def _vehicle(ego: Message) -> Any:
    """Return the devkit's vehicle after checking that the simulation's is the same."""
    from nuplan.common.actor_state.vehicle_parameters import get_pacifica_parameters

    vehicle = get_pacifica_parameters()
    ours = {"length": vehicle.length, "width": vehicle.width, "wheelbase": vehicle.wheel_base}
    for name, value in {**ours, "rear_axle_to_center": vehicle.rear_axle_to_center}.items():
        if abs(value - ego[name]) > SAME_M:
            raise PlannerError(f"expected an ego with the {name} of nuPlan's, {value} m, found {ego[name]} m")
    return vehicle


def _map(files: Message | None, version: str) -> Any:
    """Return the devkit's map; ``None`` for a log without files of one."""
    if files is None:
        return None
    from nuplan.common.maps.nuplan_map.map_factory import get_maps_api
    from nuplan.database.maps_db import gpkg_mapsdb

    index = Path(files["root"], f"{version}.json")
    try:
        names = json.loads(index.read_text())
    except (OSError, ValueError) as error:
        raise PlannerError(f"expected an index of maps in {index}, found {error}") from None
    if files["name"] not in names:
        raise PlannerError(f"expected the map {files['name']} in {index}, found {', '.join(names)}")
    # The devkit opens all maps that it knows, and downloads missing ones.
    gpkg_mapsdb.MAP_LOCATIONS.clear()
    gpkg_mapsdb.MAP_LOCATIONS.add(files["name"])
    return get_maps_api(files["root"], version, files["name"])


def main(arguments: list[str]) -> int:
    """Run the command; returns its exit code."""
    parser = _planner.parser("nuplan_planner", "an AbstractPlanner of nuPlan", "Plan for pskel simulate with a planner of nuPlan.")
    parser.add_argument("--map-version", metavar="NAME", default="nuplan-maps-v1.0", help="index of the maps (default %(default)s)")
    given = parser.parse_args(arguments)
    lines, out = _planner.messages()

    def start(hello: Message) -> _planner.Plan:
        return Bridge(_planner.create(given.name, given.args), hello, given.map_version).plan

    return _planner.serve(start, lines, out)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
