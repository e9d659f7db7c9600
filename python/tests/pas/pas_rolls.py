"""Reset-and-Roll by its rules, without the loop of the package."""

from collections.abc import Callable

import numpy as np
from diffusers import FlowMatchEulerDiscreteScheduler
from pas_base import Array
from pskel.models.pas import FrameCondition

Network = Callable[[Array, Array, Array, list[FrameCondition]], Array]


def table(steps: int) -> tuple[Array, Array]:
    """Sigmas and timesteps of the Stable Diffusion 3.5 scheduler."""
    scheduler = FlowMatchEulerDiscreteScheduler(shift=3.0)
    scheduler.set_timesteps(steps)
    return scheduler.sigmas.numpy(), scheduler.timesteps.numpy()


def roll_out(
    network: Network,
    references: list[Array],
    conditions: list[FrameCondition],
    noise: list[list[Array]],
    guidance: float,
    steps: int,
) -> list[Array]:
    """Reset-and-Roll, step by step: L - 1 references, then a frame per list of noise (one for each roll)."""
    sigmas, timesteps = table(steps)
    length = len(references) + 1
    per_roll = steps // length
    cache, finished_references = list(references), length - 1
    frames = []
    for step, draws in enumerate(noise):
        current = length - 1 + step
        latents, known, is_full = cache, finished_references, len(cache) == length
        for roll, fresh in enumerate(draws):
            if is_full or roll:
                latents, known = latents[1:], max(known - 1, 0)
            latents = [*latents, fresh]
            shown = conditions[current + roll - length + 1 : current + roll + 1]
            for call in range(steps - per_roll, steps):
                own = [call - j * per_roll for j in range(length)]
                index = [steps - 1 if j < known else min(max(own[j], 0), steps - 1) for j in range(length)]
                arguments = np.stack(latents), timesteps[index], sigmas[index]
                velocity = network(*arguments, shown)
                if guidance != 1.0:
                    without = network(*arguments, [frame.without("layout", "action") for frame in shown])
                    velocity = without + np.float32(guidance) * (velocity - without)
                latents = [
                    x + (sigmas[i + 1] - sigmas[i]) * v if j >= known and own[j] >= 0 else x
                    for j, (x, i, v) in enumerate(zip(latents, index, velocity))
                ]
            if roll == 0:  # it has seen no forecast
                cache, finished_references = latents, known
        frames.append(latents[0])
    return frames
