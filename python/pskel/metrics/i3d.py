"""I3D (Carreira and Zisserman, 2017), the network of the Fréchet video distance."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from .weights import read_weights

_SIZE = 224
_CLASSES = 400
# Channels of the branches of the mixed blocks: 1x1; 1x1 and 3x3; 1x1 and 3x3; 1x1 behind the pooling.
_MIXED = {
    "3b": (64, 96, 128, 16, 32, 32),
    "3c": (128, 128, 192, 32, 96, 64),
    "4b": (192, 96, 208, 16, 48, 64),
    "4c": (160, 112, 224, 24, 64, 64),
    "4d": (128, 128, 256, 24, 64, 64),
    "4e": (112, 144, 288, 32, 64, 64),
    "4f": (256, 160, 320, 32, 128, 128),
    "5b": (256, 160, 320, 32, 128, 128),
    "5c": (384, 192, 384, 48, 128, 128),
}


class I3D(nn.Module):
    """Logits of Kinetics-400 for clips [N, 3, T, 224, 224] from -1 to 1, at least 10 frames: [N, 400], means over time.

    Parameter names follow the published `i3d_pretrained_400.pt`, whose padding is as in TensorFlow.
    """

    def __init__(self) -> None:
        super().__init__()
        self.Conv3d_1a_7x7 = _Unit(3, 64, 7, 2)
        self.Conv3d_2b_1x1 = _Unit(64, 64, 1)
        self.Conv3d_2c_3x3 = _Unit(64, 192, 3)
        channels = 192
        for name, widths in _MIXED.items():
            self.add_module(f"Mixed_{name}", _Mixed(channels, widths))
            channels = widths[0] + widths[2] + widths[4] + widths[5]
        self.logits = nn.ModuleDict({"conv3d": nn.Conv3d(channels, _CLASSES, 1)})

    @classmethod
    def load(cls, path: str | os.PathLike[str], device: torch.device | str = "cpu") -> I3D:
        """Read weights of `torch.save(state_dict)`; raises ValueError with the names of tensors that do not fit."""
        network = cls()
        network.load_state_dict(read_weights(path, network.state_dict()))
        return network.eval().to(device)

    def forward(self, clips: Tensor) -> Tensor:
        """Return the logits of clips."""
        x = _pool(self.Conv3d_1a_7x7(clips), (1, 3, 3), (1, 2, 2))
        x = _pool(self.Conv3d_2c_3x3(self.Conv3d_2b_1x1(x)), (1, 3, 3), (1, 2, 2))
        before = {"4b": ((3, 3, 3), (2, 2, 2)), "5b": ((2, 2, 2), (2, 2, 2))}
        for name in _MIXED:
            if name in before:
                x = _pool(x, *before[name])
            x = self.get_submodule(f"Mixed_{name}")(x)
        x = self.logits["conv3d"](functional.avg_pool3d(x, (2, 7, 7), stride=1))
        means: Tensor = x.squeeze(-1).squeeze(-1).mean(dim=2)
        return means


def video_features(network: I3D, clips: Sequence[np.ndarray], batch: int = 4) -> np.ndarray:
    """Return the features [N, 400], float32, of N clips [T, H, W, 3], uint8, on the device of the network.

    As in the FVD of *Point as Skeleton*: levels from -1 to 1, resized to 224x224 bilinearly without smoothing, logits.
    """
    device = next(network.parameters()).device
    found = []
    with torch.inference_mode():
        for start in range(0, len(clips), batch):
            frames = torch.from_numpy(np.stack(clips[start : start + batch])).to(device).permute(0, 1, 4, 2, 3)
            levels = frames.flatten(0, 1).float() / 255 * 2 - 1
            resized = functional.interpolate(levels, size=(_SIZE, _SIZE), mode="bilinear")
            batched = resized.reshape(*frames.shape[:3], _SIZE, _SIZE).transpose(1, 2)
            found.append(network(batched).float().cpu().numpy())
    return np.concatenate(found) if found else np.zeros((0, _CLASSES), np.float32)


class _Unit(nn.Module):
    """Convolution, batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int, side: int, stride: int = 1) -> None:
        super().__init__()
        self.conv3d = nn.Conv3d(inputs, outputs, side, stride, bias=False)
        self.bn = nn.BatchNorm3d(outputs, eps=0.001, momentum=0.01)

    def forward(self, x: Tensor) -> Tensor:
        side, stride = self.conv3d.kernel_size, self.conv3d.stride
        return functional.relu(self.bn(self.conv3d(_padded(x, side, stride))))


class _Mixed(nn.Module):
    """Inception block of four branches."""

    def __init__(self, inputs: int, widths: tuple[int, int, int, int, int, int]) -> None:
        super().__init__()
        self.b0 = _Unit(inputs, widths[0], 1)
        self.b1a, self.b1b = _Unit(inputs, widths[1], 1), _Unit(widths[1], widths[2], 3)
        self.b2a, self.b2b = _Unit(inputs, widths[3], 1), _Unit(widths[3], widths[4], 3)
        self.b3b = _Unit(inputs, widths[5], 1)

    def forward(self, x: Tensor) -> Tensor:
        pooled = _pool(x, (3, 3, 3), (1, 1, 1))
        return torch.cat([self.b0(x), self.b1b(self.b1a(x)), self.b2b(self.b2a(x)), self.b3b(pooled)], dim=1)


def _pool(x: Tensor, side: tuple[int, int, int], stride: tuple[int, int, int]) -> Tensor:
    return functional.max_pool3d(_padded(x, side, stride), side, stride)


def _padded(x: Tensor, side: Sequence[int], stride: Sequence[int]) -> Tensor:
    """Pad with zeros so that the output has ceil(size / stride), the extra one at the end ("same" of TensorFlow)."""
    missing = [max(k - (n % s or s), 0) for n, k, s in zip(x.shape[2:], side, stride, strict=True)]
    ends = [(total // 2, total - total // 2) for total in missing]
    return functional.pad(x, [pad for end in reversed(ends) for pad in end])
