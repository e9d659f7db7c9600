"""Reset-and-Roll with a window of two frames, by its rules, and with the loop of the package."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import diffusers
import numpy as np
from image_base import Array, Peer, unpack
from pskel.models.pas_image import FrameCondition

WINDOW = 2
Network = Callable[[Array, Array, Array, list[FrameCondition]], Array]


class Table:
    """Levels of DDIM, and its update in double precision."""

    def __init__(self, steps: int) -> None:
        scheduler = diffusers.DDIMScheduler(
            beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear", steps_offset=1, set_alpha_to_one=False
        )
        scheduler.set_timesteps(steps)
        self.steps = steps
        self.timesteps = scheduler.timesteps.numpy()
        alphas = scheduler.alphas_cumprod.double().numpy()
        self.before = alphas[self.timesteps]
        self.after = alphas[np.maximum(self.timesteps - 1000 // steps, 0)]
        self.sigmas = np.sqrt(1.0 - self.before).astype(np.float32)

    def update(self, index: int, x: Array, noise: Array) -> Array:
        a, b = np.sqrt(self.before[index]), np.sqrt(1.0 - self.before[index])
        clean = (x.astype(np.float64) - b * noise) / a
        after = self.after[index]
        updated: Array = (np.sqrt(after) * clean + np.sqrt(1.0 - after) * noise).astype(np.float32)
        return updated


def roll_out(
    network: Network,
    reference: Array,
    conditions: list[FrameCondition],
    noise: list[list[Array]],
    steps: int,
    guidance: float,
) -> list[Array]:
    """Reset-and-Roll, step by step: a reference, then a frame per list of noise (one for each roll)."""
    table = Table(steps)
    per_roll = steps // WINDOW
    cache, finished_references = [reference], 1
    frames = []
    for step, draws in enumerate(noise):
        current = 1 + step
        latents, known, is_full = cache, finished_references, len(cache) == WINDOW
        for roll, fresh in enumerate(draws):
            if is_full or roll:
                latents, known = latents[1:], max(known - 1, 0)
            latents = [*latents, fresh]
            shown = conditions[current + roll - 1 : current + roll + 1]
            shown = [replace(condition, is_reference=j < known) for j, condition in enumerate(shown)]
            for call in range(steps - per_roll, steps):
                own = [call - j * per_roll for j in range(WINDOW)]
                index = [steps - 1 if j < known else own[j] for j in range(WINDOW)]
                arguments = np.stack(latents), table.timesteps[index].astype(np.float32), table.sigmas[index]
                output = network(*arguments, shown)
                if guidance != 1.0:
                    without = network(*arguments, [frame.without("layout", "action") for frame in shown])
                    output = without + np.float32(guidance) * (output - without)
                latents = [x if j < known else table.update(index[j], x, output[j]) for j, x in enumerate(latents)]
            if roll == 0:  # it has seen no forecast
                cache, finished_references = latents, known
        frames.append(latents[0])
    return frames


def run_loop(
    network: Network,
    reference: Array,
    condition: Callable[[int], FrameCondition],
    count: int,
    steps: int,
    guidance: float,
) -> list[Array]:
    """The same by ``pskel.ResetAndRoll``, along a log whose states carry the number of their frame."""
    import pskel

    simulation = pskel.Simulation(pskel.Log("town:seed=7,frames=40,size=113x200"), ego="replay", steps=76)
    loop = pskel.ResetAndRoll(
        network,
        reference.shape,
        window=WINDOW,
        steps=steps,
        sampler="ddim",
        prediction="epsilon",
        guidance=guidance,
        seed=3,
    )
    frames: list[Array] = []
    for number, _ in enumerate(simulation):
        now = simulation.committed.map(lambda _: replace(condition(number), is_reference=number < loop.references))
        if number < loop.references:
            loop.add_reference(reference, now)
            continue
        forecasts = simulation.forecast(loop.forecasts)
        ahead = [forecast.map(lambda _: condition(number + 1 + i)) for i, forecast in enumerate(forecasts)]
        frames.append(loop.step(now, ahead))
        if len(frames) == count:
            break
    return frames


def through(peer: Peer) -> Network:
    """The denoiser process as a function."""

    def network(latents: Array, timesteps: Array, sigmas: Array, conditions: list[FrameCondition]) -> Array:
        def maps(condition: FrameCondition) -> Array:
            shape = condition.points.array.shape
            waves = np.full((shape[0], 16, *shape[2:]), 0.5, np.float32)  # the network does not use them
            return np.concatenate([condition.points.array, waves], axis=1)

        tensors = {
            "latents": latents,
            "timesteps": timesteps,
            "sigmas": sigmas,
            "points": np.stack([maps(condition) for condition in conditions]),
            "layout": np.stack([condition.layout.array for condition in conditions]),
            "action": np.stack([condition.action for condition in conditions]),
            "cameras": np.stack([condition.cameras for condition in conditions]),
        }
        texts: dict[str, Any] = {
            "ask": "predict",
            "references": json.dumps([condition.is_reference for condition in conditions]),
            "prompts": json.dumps([condition.prompt for condition in conditions]),
        }
        return unpack(peer.ask(texts, tensors))[1]["prediction"]

    return network
