"""Logs with a scenario: as a file, as a dictionary, in simulations and copies."""

import json
import pickle
from pathlib import Path
from typing import Any

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
