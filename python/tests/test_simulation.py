"""The closed loop from Python."""

from typing import Any

import numpy as np
import pskel
import pytest

LOG = "town:seed=7,frames=20,size=113x200"


@pytest.fixture(scope="module")
def drive() -> pskel.Log:
    return pskel.Log(LOG)


def straight(observation: dict[str, Any], seconds: float = 4.0) -> np.ndarray[Any, Any]:
    """Waypoints straight ahead at the current speed, every half second."""
    times = np.arange(0.5, seconds + 0.1, 0.5)
    return np.column_stack([observation["ego"]["v"] * times, 0 * times, 0 * times])


def test_the_ego_follows_the_plans(drive: pskel.Log) -> None:
    simulation = pskel.Simulation(drive, steps=20)
    seen = []
    for observation in simulation:
        seen.append(observation["step"])
        assert simulation.needs_plan
        simulation.act(straight(observation))
        assert not simulation.needs_plan
    assert seen == list(range(0, 20, 2)) and simulation.index == 20 and simulation.done
    start = pskel.Simulation(drive, steps=1)
    way = np.linalg.inv(start.scene.ego) @ simulation.scene.ego[:, 3]
    speed = start.observation["ego"]["v"]
    np.testing.assert_allclose(way[:2], [2.0 * speed, 0.0], atol=1e-6)
    metrics = simulation.metrics
    assert metrics["steps"] == 20 and metrics["collisions"] == []


def test_plans_in_the_global_frame_are_the_same(drive: pskel.Log) -> None:
    here, there = (pskel.Simulation(drive, steps=10) for _ in range(2))
    for observation, _ in zip(here, there, strict=True):
        plan = straight(observation)
        here.act(plan)
        ego = observation["ego"]
        cos, sin = np.cos(ego["heading"]), np.sin(ego["heading"])
        x, y = plan[:, 0] * cos - plan[:, 1] * sin + ego["x"], plan[:, 0] * sin + plan[:, 1] * cos + ego["y"]
        there.act(np.column_stack([x, y, plan[:, 2] + ego["heading"]]), frame="global")
    np.testing.assert_allclose(here.scene.ego, there.scene.ego, atol=1e-9)


def test_built_in_policies_need_no_plan(drive: pskel.Log) -> None:
    simulation = pskel.Simulation(drive, ego="replay", steps=10)
    assert len(list(simulation)) == 5 and not simulation.needs_plan
    np.testing.assert_allclose(simulation.scene.ego, drive.at(simulation.scene.t_us).ego, atol=1e-9)


def test_a_resumed_simulation_continues_with_the_same_states(drive: pskel.Log) -> None:
    whole = pskel.Simulation(drive, ego="lane_change", actors="idm", steps=20)
    while whole.index < 8:
        assert whole.step()
    resumed = pskel.Simulation(drive, ego="lane_change", actors="idm", steps=20, saved=whole.save())
    while whole.step():
        assert resumed.step()
    assert whole.save() == resumed.save()


def test_forecasts_are_no_past(drive: pskel.Log) -> None:
    simulation = pskel.Simulation(drive, ego="lane_change", steps=20)
    simulation.step()
    before = simulation.save()
    forecasts = simulation.forecast(3)
    assert simulation.save() == before
    assert [f.value.t_us - simulation.scene.t_us for f in forecasts] == [200_000, 400_000, 600_000]
    committed = simulation.committed.map(lambda scene: scene.t_us)
    assert isinstance(committed, pskel.Committed) and committed.value == simulation.scene.t_us
    assert isinstance(forecasts[0].map(id), pskel.Forecast)
    with pytest.raises(TypeError):
        pskel.Committed(3)  # type: ignore[call-arg]


def test_bad_plans_are_rejected_and_change_nothing(drive: pskel.Log) -> None:
    simulation = pskel.Simulation(drive, steps=4)
    before = simulation.save()
    good = straight(simulation.observation)
    for plan, options, message in [
        (good[:, :2], {}, r"waypoints \[N, 3\] or \[N, 5\], found \[8, 2\]"),
        (good[0], {}, r"found \[3\]"),
        (good * np.nan, {}, "finite waypoints"),
        (good[:0], {}, "1 to 10000 waypoints, found 0"),
        (good, {"dt": 0.0}, "dt above 0 s"),
        (good, {"frame": "world"}, "frame ego or global"),
        (good[:1], {"dt": 0.1}, "a trajectory of at least 0.2 s"),
        (good * 1000 + 100, {}, "m/s"),
    ]:
        with pytest.raises(ValueError, match=message):
            simulation.act(plan, **options)  # type: ignore[arg-type]
    with pytest.raises(pskel.SimulationError, match="expected a plan for step 0, found none: call act"):
        simulation.step()
    assert simulation.save() == before
    simulation.act(good)
    with pytest.raises(ValueError, match="unexpected plan for step 0: it has one"):
        simulation.act(good)
    assert simulation.step() and simulation.index == 1


def test_bad_options_are_rejected(drive: pskel.Log) -> None:
    for options, message in [
        ({"ego": "fly"}, "ego to be one of replay, straight"),
        ({"actors": "fly"}, "actors to be one of"),
        ({"tracking": "fly"}, "tracking to be one of"),
        ({"steps": 0}, "at least one step"),
        ({"sim_hz": 10.0, "plan_hz": 3.0}, "multiple of the plans"),
        ({"start_us": 0}, "expected a start from"),
        ({"saved": "{}"}, "missing field"),
    ]:
        with pytest.raises(ValueError, match=message):
            pskel.Simulation(drive, **options)  # type: ignore[arg-type]
    saved = pskel.Simulation(drive, ego="straight", steps=5).save()
    with pytest.raises(pskel.SimulationError, match="saved state"):
        pskel.Simulation(drive, ego="cosine", steps=5, saved=saved)


def test_an_ego_drives_on_after_the_log(drive: pskel.Log) -> None:
    steps = 10 + (drive.times_us[-1] - drive.times_us[0]) // 100_000
    simulation = pskel.Simulation(drive, ego="lane_change", steps=steps)
    beyond = []
    while simulation.step():
        beyond.append(simulation.is_beyond_log)
    assert beyond == sorted(beyond) and len(beyond) == steps and beyond[-1] and not beyond[0]
    assert simulation.scene.t_us > drive.times_us[-1]
    replayed = pskel.Simulation(drive, ego="replay", steps=300)
    while replayed.step():
        assert not replayed.is_beyond_log
    assert replayed.done and replayed.index < steps
