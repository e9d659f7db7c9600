#!/usr/bin/env python3
"""Scores plans over a nuPlan log with NAVSIM's own scorer, for crates/sim/tests/suite/pdm.rs.

    git -C NAVSIM archive 0a380a9 navsim | tar x -C PEER     # github.com/autonomousvision/navsim
    PYTHONPATH=PEER:NUPLAN_DEVKIT tests/peers/navsim_scores.py LOG.db MAPS --out crates/sim/tests/suite/pdm.json

NAVSIM reads frames at 2 Hz: ego and boxes of the database are interpolated linearly at these times. Velocities of road users are
fitted to their positions, since logs of pskel keep none of the database. Everything else is NAVSIM's code: metric cache with
PDM-Closed, log replay, LQR and bicycle model, scorer, two-frame comfort. One module that is not used here needs torch and is
replaced by an empty one. Prints the number of plans, and how often each sub-score is not 1.
"""
import argparse
import json
import math
import os
import shutil
import sqlite3
import sys
import tempfile
import types
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np

unused = types.ModuleType("agents_preprocessing")  # imports torch
unused.__getattr__ = lambda name: type(name, (), {})  # type: ignore[method-assign]
sys.modules["nuplan.planning.training.preprocessing.utils.agents_preprocessing"] = unused
warnings.filterwarnings("ignore")

import nuplan.database.maps_db.gpkg_mapsdb as gpkg  # noqa: E402
from navsim.common.dataclasses import Trajectory  # noqa: E402
from navsim.evaluate.pdm_score import get_trajectory_as_array, pdm_score, transform_trajectory  # noqa: E402
from navsim.planning.metric_caching.metric_cache_processor import MetricCacheProcessor  # noqa: E402
from navsim.planning.scenario_builder import navsim_scenario  # noqa: E402
from navsim.planning.simulation.planner.pdm_planner.scoring.pdm_comfort_metrics import (  # noqa: E402
    ego_is_comfortable, ego_is_two_frame_extended_comfort)
from navsim.planning.simulation.planner.pdm_planner.scoring.pdm_scorer import PDMScorer, PDMScorerConfig  # noqa: E402
from navsim.planning.simulation.planner.pdm_planner.simulation.pdm_simulator import PDMSimulator  # noqa: E402
from navsim.traffic_agents_policies.log_replay_traffic_agents import LogReplayTrafficAgents  # noqa: E402
from nuplan.planning.simulation.trajectory.trajectory_sampling import TrajectorySampling  # noqa: E402

#: Frames at which plans start, by their position in the log, and connectors whose lights are red all the time instead of the log's.
STARTS = ((8, None), (10, None), (12, None), (14, None), (16, None), (18, None), (18, (68001, 68002, 68003)))
#: Half width of the window that velocities of road users are fitted in, microseconds.
WINDOW_US = 600_000
#: Plans as (speed in m/s; negative: the ego's own, acceleration in m/s^2, curvature in 1/m, lateral offset in m after 2 s).
PLANS = ((-1, 1.2, 0.0, 0.0), (-1, 0.0, 0.0, 0.0), (0, 0.0, 0.0, 0.0), (4, 1.0, 0.0, 0.3), (8, 0.0, 0.0, 0.0), (12, 2.0, 0.0, 0.0),
         (5, 0.0, 0.05, 0.0), (6, 0.0, -0.05, 0.0), (7, 1.0, 0.0, 3.5), (3, 2.0, 0.0, -3.5), (20, 2.0, 0.0, 0.0))
SAMPLING = TrajectorySampling(num_poses=40, interval_length=0.1)
#: Columns of NAVSIM's results.
SCORES = ("no_at_fault_collisions", "drivable_area_compliance", "driving_direction_compliance", "traffic_light_compliance",
          "ego_progress", "time_to_collision_within_bound", "lane_keeping", "history_comfort")


class Database:
    """Linear interpolation of a log."""

    def __init__(self, path):
        self.db = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
        self.log, self.map = self.db.execute("SELECT logfile, map_version FROM log").fetchone()
        rows = self.db.execute(
            "SELECT l.token, l.timestamp, p.x, p.y, p.qw, p.qx, p.qy, p.qz, p.vx, p.vy, p.acceleration_x, p.acceleration_y, "
            "s.roadblock_ids "
            "FROM lidar_pc l JOIN ego_pose p ON p.token = l.ego_pose_token "
            "JOIN scene s ON s.token = l.scene_token ORDER BY l.timestamp").fetchall()
        self.tokens, self.times, self.routes = [r[0] for r in rows], [r[1] for r in rows], [r[12] for r in rows]
        yaw = [math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) for _, _, _, _, w, x, y, z, *_ in rows]
        self.ego = np.column_stack([[r[2] for r in rows], [r[3] for r in rows], np.unwrap(yaw), [r[8:12] for r in rows]])
        self.tracks = {}
        query = ("SELECT l.timestamp, hex(b.track_token), c.name, b.x, b.y, b.yaw, b.vx, b.vy, b.length, b.width, b.height "
                 "FROM lidar_box b "
                 "JOIN lidar_pc l ON l.token = b.lidar_pc_token JOIN track t ON t.token = b.track_token "
                 "JOIN category c ON c.token = t.category_token ORDER BY l.timestamp")
        for t, token, name, *values in self.db.execute(query):
            self.tracks.setdefault(token.lower(), (name, []))[1].append((t, values))

    def ego_at(self, t):
        return np.array([np.interp(t, self.times, column) for column in self.ego.T])

    def velocity(self, token, t):
        """Returns the slope of a line fitted to the positions within 0.6 s, or to two positions."""
        rows = self.tracks[token][1]
        first = sum(time < t - WINDOW_US for time, _ in rows)
        last = sum(time <= t + WINDOW_US for time, _ in rows)
        while last - first < min(2, len(rows)):
            first, last = max(first - 1, 0), min(last + 1, len(rows))
        if last - first < 2:
            return 0.0, 0.0
        times = np.array([(time - t) / 1e6 for time, _ in rows[first:last]])
        return tuple(np.polyfit(times, [values[i] for _, values in rows[first:last]], 1)[0] for i in (0, 1))

    def frame(self, t):
        """Returns a frame as NAVSIM's Scene has it."""
        x, y, heading, vx, vy, ax, ay = self.ego_at(t)
        cos, sin = math.cos(heading), math.sin(heading)
        names, boxes, velocities, tokens = [], [], [], []
        before = max(i for i, time in enumerate(self.times) if time <= t)
        after = min(before + 1, len(self.times) - 1) if self.times[before] < t else before
        for token in sorted(self.tracks):
            name, rows = self.tracks[token]
            rows = {time: values for time, values in rows}
            a, b = rows.get(self.times[before]), rows.get(self.times[after])
            if a is None or b is None:
                continue
            share = (t - self.times[before]) / (self.times[after] - self.times[before]) if after > before else 0.0
            mixed = [p + share * (q - p) for p, q in zip(a, b)]
            turn = math.remainder(b[2] - a[2], 2 * math.pi)
            bvx, bvy = self.velocity(token, t)
            bx, by, yaw, length, width, height = mixed[:2] + [a[2] + share * turn] + a[5:]
            dx, dy = bx - x, by - y
            names.append(name)
            boxes.append([cos * dx + sin * dy, cos * dy - sin * dx, 0.0, length, width, height, yaw - heading])
            velocities.append([cos * bvx + sin * bvy, cos * bvy - sin * bvx, 0.0])
            tokens.append(token)
        query = "SELECT lane_connector_id, status FROM traffic_light_status WHERE lidar_pc_token = ?"
        lights = self.db.execute(query, (self.tokens[before],))
        lights = [(id, status == "red") for id, status in lights]
        annotations = SimpleNamespace(names=names, boxes=np.array(boxes), velocity_3d=np.array(velocities), instance_tokens=tokens,
                                      track_tokens=tokens)
        status = SimpleNamespace(ego_pose=[x, y, heading], ego_velocity=[vx, vy], ego_acceleration=[ax, ay])
        return SimpleNamespace(token=f"{t:016}", timestamp=t, roadblock_ids=self.routes[before].split(), traffic_lights=lights,
                               annotations=annotations, ego_status=status)


def plan(own_mps, speed, acceleration, curvature, offset):
    """Returns eight local poses at 2 Hz, rounded so that the table has the same numbers."""
    speed = own_mps if speed < 0 else speed
    poses = []
    for t in np.arange(1, 9) * 0.5:
        station = max(0.0, speed * t + acceleration * t * t / 2)
        share = min(t / 2, 1.0)
        beside = offset * (3 * share**2 - 2 * share**3)
        slope = offset * (6 * share - 6 * share**2) / 2 / max(speed + acceleration * t, 0.5)
        heading = curvature * station
        x, y = (math.sin(heading) / curvature, (1 - math.cos(heading)) / curvature) if curvature else (station, 0.0)
        poses.append([round(x, 4), round(y + beside, 4), round(heading + math.atan(slope), 4)])
    return poses


def relative(origin, pose):
    cos, sin = math.cos(origin[2]), math.sin(origin[2])
    dx, dy = pose[0] - origin[0], pose[1] - origin[1]
    return [cos * dx + sin * dy, cos * dy - sin * dx, math.remainder(pose[2] - origin[2], 2 * math.pi)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("maps", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    database = Database(args.log)
    simulator, rows, pairs, earlier = PDMSimulator(SAMPLING), [], [], {}
    policy = LogReplayTrafficAgents(SAMPLING)
    scorers = [PDMScorer(SAMPLING, PDMScorerConfig(human_penalty_filter=on)) for on in (False, True)]
    with tempfile.TemporaryDirectory() as copy:  # the devkit writes locks beside the maps
        maps = Path(copy) / "maps"
        shutil.copytree(args.maps, maps)
        os.environ.update(NUPLAN_MAPS_ROOT=str(maps), NUPLAN_DATA_ROOT=copy)
        locations = {p.name for p in maps.iterdir() if p.is_dir()}
        gpkg.MAP_LOCATIONS = navsim_scenario.MAP_LOCATIONS = locations
        for start, red in STARTS:
            t0 = database.times[start]
            frames = [database.frame(t0 + 500_000 * i) for i in range(-3, 9)]
            for frame in frames if red else ():
                frame.traffic_lights = [(id, True) for id in red]
            metadata = SimpleNamespace(map_name=database.map, num_history_frames=4, log_name=database.log)
            scene = SimpleNamespace(scene_metadata=metadata, frames=frames, extended_detections_tracks=None,
                                    extended_traffic_light_data=None)
            scenario = navsim_scenario.NavSimScenario(scene, str(maps), "nuplan-maps-v1.0")
            cache = MetricCacheProcessor(None, True, SAMPLING).compute_metric_cache(scenario)
            ego = frames[3].ego_status.ego_pose
            reference = get_trajectory_as_array(cache.trajectory, SAMPLING, cache.ego_state.time_point)
            row = {"frame": start, "red": red, "route_lanes": sorted(cache.route_lane_ids),
                   "history": [relative(ego, f.ego_status.ego_pose) + [*f.ego_status.ego_velocity, *f.ego_status.ego_acceleration]
                               for f in frames[:4]],
                   "centerline_m": cache.centerline.length,
                   "reference": [[round(v, 7) for v in relative(ego, state[:3])] for state in reference], "plans": []}
            own = float(frames[3].ego_status.ego_velocity[0])
            for number, kind in enumerate(PLANS):
                poses = plan(own, *kind)
                trajectory = Trajectory(np.array(poses))
                results = []
                for scorer in scorers:
                    table, states = pdm_score(cache, trajectory, SAMPLING, simulator, scorer, policy)
                    results.append([float(table[name].iloc[0]) for name in SCORES])
                comfort = bool(ego_is_comfortable(states[None], np.arange(41) * 0.1).all())
                row["plans"].append({"poses": poses, "scores": results[0], "filtered": results[1],
                                     "score": float(table["pdm_score"].iloc[0]),
                                     "comfort": comfort, "end": relative(ego, states[-1, :3])})
                if not red and number in earlier and 0 < t0 - earlier[number][1] < 550_000:
                    overlap = round((t0 - earlier[number][1]) / 1e5)
                    comfortable = ego_is_two_frame_extended_comfort(states[None, :-overlap], earlier[number][2][None, overlap:],
                                                                    np.arange(41 - overlap) * 0.1)
                    pairs.append([earlier[number][0], start, number, bool(comfortable[0])])
                earlier[number] = (start, t0, states)
            rows.append(row)
    table = {"scores": SCORES, "starts": rows, "two_frame_comfort": pairs}
    args.out.write_text(json.dumps(table, separators=(",", ":")).replace('{"frame"', '\n{"frame"').replace('{"poses"', '\n{"poses"') + "\n")
    scores = np.array([p["scores"] for row in rows for p in row["plans"]])
    print(len(scores), "plans; not 1:", {n: int((scores[:, i] != 1).sum()) for i, n in enumerate(SCORES)})
    print("two-frame comfort:", sum(p[3] for p in pairs), "of", len(pairs))


if __name__ == "__main__":
    main()
