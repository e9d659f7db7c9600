"""Train a small network to paint images from condition tensors.

python train.py town:seed=7,frames=8,size=113x200 out
"""

import sys
from pathlib import Path

import numpy as np
import pskel
import torch
from pskel.torch import ConditionDataset
from torch import nn
from torch.utils.data import DataLoader


def moved(scene: pskel.Scene, generator: np.random.Generator) -> pskel.Scene:
    """Moves the ego sideways; images of a town follow."""
    return scene.move_ego(left_m=float(generator.uniform(-1.0, 1.0)))


def main(name: str, out: Path, epochs: int = 2, workers: int = 1) -> list[float]:
    if not (out / "skeleton").exists():
        pskel.build(pskel.Log(name), out / "skeleton")
    torch.manual_seed(0)
    dataset = ConditionDataset([(name, str(out / "skeleton"))], out_size=(56, 100), augment=moved)
    start = "spawn" if workers else None
    loader = DataLoader(dataset, batch_size=2, shuffle=True, num_workers=workers, multiprocessing_context=start)
    network = nn.Sequential(nn.Conv2d(26, 32, 5, padding=2), nn.ReLU(), nn.Conv2d(32, 3, 5, padding=2))
    optimizer = torch.optim.AdamW(network.parameters(), lr=1e-3)
    losses = []
    for epoch in range(epochs):
        dataset.set_epoch(epoch)
        total = 0.0
        for batch in loader:
            conditions = torch.cat([batch["points"], batch["layout"]], dim=3).flatten(0, 2)
            images = batch["images"].flatten(0, 2).float() / 255.0
            loss = nn.functional.mse_loss(network(conditions), images)
            optimizer.zero_grad()
            torch.autograd.backward(loss)
            optimizer.step()
            total += loss.item()
        losses.append(total / len(loader))
        print(f"epoch {epoch}: mean squared error {losses[-1]:.4f}")
    return losses


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
