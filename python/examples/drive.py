"""Drive through a log with a simple policy: follow the route at the current speed, brake for actors ahead.

python drive.py town:seed=7,frames=40,size=113x200 out
"""

import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pskel
import pskel.gym


def policy(observation: dict[str, Any]) -> npt.NDArray[np.float32]:
    """Returns waypoints every half second."""
    speed = float(observation["ego"][0])
    present = observation["actors"][observation["actors"][:, 6] > 0]
    blocked = (present[:, 0] > 0) & (present[:, 0] < 8 + 2 * speed) & (np.abs(present[:, 1]) < 1.5)
    if blocked.any():
        speed *= 0.5
    stations = speed * 0.5 * np.arange(1, 9)
    route = np.vstack([[0.0, 0.0], observation["route"]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))])
    x, y = np.interp(stations, along, route[:, 0]), np.interp(stations, along, route[:, 1])
    heading = np.arctan2(np.diff(y, prepend=0.0), np.maximum(np.diff(x, prepend=0.0), 1e-3))
    return np.column_stack([x, y, heading]).astype(np.float32)


def main(name: str, out: Path, steps: int = 20) -> float:
    if not (out / "skeleton").exists():
        pskel.build(pskel.Log(name), out / "skeleton")
    env: gymnasium.Env[Any, Any] = gymnasium.make("pskel/Drive-v0", log=name, skeleton=out / "skeleton", steps=steps)
    observation, info = env.reset(seed=1, options={"frame": 0})
    total, ended = 0.0, False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        total, ended = total + float(reward), terminated or truncated
    progress = info["metrics"]["progress_m"]
    print(f"{progress:.1f} m in {info['metrics']['seconds']:.1f} s, reward {total:.2f}")
    return float(total)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
