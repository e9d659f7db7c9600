"""The network as one module with one call, as DDP and FSDP wrap it."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor, nn

from ..network import Conditions, Network, add_residuals
from .step import Inputs

__all__ = ["TrainedNetwork"]


class TrainedNetwork(nn.Module):
    """Predicts the velocity of noisy latents, conditions included; gradients reach adapters and projections."""

    _no_split_modules: ClassVar[list[str]] = ["JointTransformerBlock", "SelfAttentionBlock"]
    """Classes of the modules that FSDP shards one by one; ``accelerate`` reads this name."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, inputs: Inputs) -> Tensor:
        """Return the velocity, shaped like ``inputs.sample``."""
        network = self.network
        residuals = network.encode_layout(inputs.layout)
        if inputs.points is not None:
            residuals = add_residuals(residuals, network.encode_points(inputs.points))
        text, pooled = network.encode_text(inputs.text, inputs.pooled)
        conditions = Conditions(residuals, text, pooled, network.encode_view(inputs.ids))
        velocity: Tensor = network(
            inputs.sample, inputs.timestep, conditions, inputs.mask, disable_temporal=inputs.single_frames
        )
        return velocity
