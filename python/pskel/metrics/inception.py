"""Inception v3 with the weights and the preprocessing of FID, by torchmetrics and torch-fidelity."""

from __future__ import annotations

import os

import numpy as np
import torch
from torch import nn

from ..models._files import first_line


def load_inception(path: str | os.PathLike[str], device: torch.device | str = "cpu") -> nn.Module:
    """Read the weights of `pt_inception-2015-12-05-6726825d.pth` (torch-fidelity); raises ValueError for another file."""
    from torchmetrics.image.fid import NoTrainInceptionV3

    if not os.path.isfile(path):
        raise FileNotFoundError(f"cannot read {path}: no such file")
    try:
        network = NoTrainInceptionV3("inception-v3-compat", ["2048"], os.fspath(path))
    except Exception as error:
        found = f"another file ({first_line(error)})"
        raise ValueError(f"{path}: expected weights of Inception by torch-fidelity, found {found}") from error
    moved: nn.Module = network.to(device)
    return moved


def image_features(network: nn.Module, images: np.ndarray, batch: int = 32) -> np.ndarray:
    """Return the features [N, 2048], float32, of images [N, H, W, 3], uint8, as torchmetrics' `FrechetInceptionDistance`."""
    device = next(network.parameters()).device
    found = []
    with torch.inference_mode():
        for start in range(0, len(images), batch):
            levels = torch.from_numpy(images[start : start + batch]).to(device).permute(0, 3, 1, 2)
            found.append(network(levels).float().cpu().numpy())
    return np.concatenate(found) if found else np.zeros((0, 2048), np.float32)
