"""Logs with a scenario: as a file, as a dictionary, in simulations and copies."""

import json
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pskel
import pytest

TOWN = "town:seed=3,frames=4,hz=5,size=45x80"


def scenario() -> dict[str, Any]:
    at = {"in": {"ego": {"after_s": 0.0}}, "x_m": 9.0, "y_m": 1.0}
    insert = {"insert": {"category": "vehicle.car", "size_m": [4.0, 1.8, 1.5], "at": at}}
    return {"changes": [{"track": "new", "action": insert}]}


def tracks(log: pskel.Log, frame: int = 0) -> list[str]:
    return [actor.track for actor in log[frame].actors]


def test_dictionaries_files_and_copies_agree(tmp_path: Path) -> None:
    plain, edited = pskel.Log(TOWN), pskel.Log(TOWN, scenario=scenario())
    assert sorted([*tracks(plain), "new"]) == tracks(edited)
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps(scenario()))
    for log in (pskel.Log(TOWN, scenario=path), pskel.Log(TOWN, scenario=str(path)), pickle.loads(pickle.dumps(edited))):
        assert tracks(log, 3) == tracks(edited, 3)
    assert tracks(pskel.Log(TOWN, scenario={})) == tracks(plain)


def test_tracks_are_those_of_the_frames() -> None:
    log = pskel.Log(TOWN, scenario=scenario())
    listed = {track["track"]: track for track in log.tracks}
    assert sorted(listed) == sorted({actor.track for scene in log for actor in scene.actors})
    new = listed["new"]
    assert (new["category"], new["size_m"], new["frames"], new["path_m"]) == ("vehicle.car", [4.0, 1.8, 1.5], 4, 0.0)
    assert new["t_us"] == [log.times_us[0], log.times_us[-1]]
    moving = max(log.tracks, key=lambda track: track["path_m"])
    places = [actor.global_from_box[:2, 3] for scene in log for actor in scene.actors if actor.track == moving["track"]]
    length = sum(math.dist(a, b) for a, b in zip(places, places[1:], strict=False))
    assert moving["path_m"] > 1 and abs(moving["path_m"] - length) < 0.6


def test_plans_are_scored() -> None:
    name = "town:seed=7,frames=32,hz=5,size=45x80"
    log = pskel.Log(name)
    t_us = log.times_us[8]

    def pose(later_s: float) -> list[float]:
        """Return the recorded ego's x, y and heading in its frame at the start."""
        later = np.linalg.inv(log.at(t_us).ego) @ log.at(t_us + round(later_s * 1e6)).ego
        return [later[0, 3], later[1, 3], math.atan2(later[1, 0], later[0, 0])]

    recorded = [pose(0.5 * i) for i in range(1, 9)]
    aside = [[x, y + 12 * i / 8, heading] for i, (x, y, heading) in enumerate(recorded, 1)]
    scores = pskel.score_plans(log, [recorded, aside, [[0.0, 0.0, 0.0]] * 8], t_us)
    table = np.array([np.asarray(values) for values in scores.values()])
    assert table.shape == (11, 3) and (table >= 0).all() and (table <= 1).all()
    assert scores["drivable_area_compliance"].tolist()[:2] == [1, 0]
    assert scores["pdms"][0] > 0.8 and scores["epdms"][0] > 0.8 and scores["pdms"][1] == 0
    assert scores["ego_progress"][0] > scores["ego_progress"][2]
    # A car that stands in the way costs the plan its score.
    at = {"in": {"ego": {"t_us": t_us}}, "x_m": 12.0, "y_m": 0.0}
    insert = {"insert": {"category": "vehicle.car", "size_m": [4.0, 1.8, 1.5], "at": at}}
    blocked = pskel.Log(name, scenario={"changes": [{"track": "new", "action": insert}]})
    collided = pskel.score_plans(blocked, [recorded], t_us)
    assert collided["no_at_fault_collisions"][0] == 0 and collided["epdms"][0] == 0
    forgiven = pskel.score_plans(blocked, [recorded], t_us, human_filter=True)
    assert forgiven["no_at_fault_collisions"][0] == 1
    for plans, time, message in (
        ([recorded[:7]], t_us, "at least 4 s"),
        ([recorded], log.times_us[0], "1.5 s after the first frame"),
        ([[[float("nan")] * 3] * 8], t_us, "finite"),
        (recorded, t_us, "expected plans"),
    ):
        with pytest.raises(ValueError, match=message):
            pskel.score_plans(log, plans, time)


def test_wrong_scenarios_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unknown field moves"):
        pskel.Log(TOWN, scenario={"moves": []})
    with pytest.raises(ValueError, match="expected a track of log"):
        pskel.Log(TOWN, scenario={"changes": [{"track": "nobody", "action": "remove"}]})
    with pytest.raises(ValueError, match="without points of files"):
        pskel.Log(TOWN, scenario={"replace": {"a": {"file": "car.ply"}}})
    with pytest.raises(ValueError, match="--scenario FILE"):
        pskel.drive(pskel.Log(TOWN, scenario=scenario()))
    with pytest.raises(pskel.Error, match="none.json"):
        pskel.Log(TOWN, scenario=tmp_path / "none.json")
