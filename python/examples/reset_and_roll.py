"""Generate frames in closed loop with Reset-and-Roll and a PyTorch function as the network.

The network here predicts the velocity toward the reduced color maps, so the frames become those maps.

python reset_and_roll.py town:seed=7,frames=20,size=113x200 out
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pskel
import torch

SIZE = (28, 50)


def denoise(latents: Any, timesteps: Any, sigmas: Any, conditions: list[torch.Tensor]) -> npt.NDArray[np.float32]:
    """Predicts `noise - clean` of flow matching, `[F, V, C, h, w]`, from the clean frames that the conditions show."""
    noisy, clean = torch.from_numpy(latents), torch.stack(conditions)
    sigma = torch.from_numpy(sigmas).clamp(min=1e-3)[:, None, None, None, None]
    return ((noisy - clean) / sigma).numpy()


def main(name: str, out: Path, frames: int = 3) -> list[npt.NDArray[np.float32]]:
    log = pskel.Log(name)
    if not (out / "skeleton").exists():
        pskel.build(log, out / "skeleton")
    renderer = pskel.Renderer(pskel.Skeleton(out / "skeleton"), out_size=SIZE, maps=["color"])

    def condition(scene: pskel.Scene) -> torch.Tensor:
        color = torch.from_numpy(renderer.render(scene)["color"])
        return color.permute(0, 3, 1, 2).float() / 127.5 - 1.0

    views = len(log[0].cameras)
    loop = pskel.ResetAndRoll(denoise, (views, 3, *SIZE), window=4, steps=8)
    simulation = pskel.Simulation(log, ego="lane_change", actors="idm", steps=2 * (loop.references + frames))
    made = []
    for number, _ in enumerate(simulation):
        now = simulation.committed.map(condition)
        if number < loop.references:
            loop.add_reference(now.value, now)  # the first frames are known
            continue
        forecasts = [forecast.map(condition) for forecast in simulation.forecast(loop.forecasts)]
        made.append(loop.step(now, forecasts))
        error = float(np.abs(made[-1] - now.value.numpy()).mean())
        print(f"step {simulation.index}: mean difference from the color map {error:.4f}")
    return made


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
