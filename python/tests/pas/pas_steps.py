"""Training steps of the paper's authors: inputs of the fixture as arguments of ours."""

import json
import os
from pathlib import Path
from typing import Any, NamedTuple

import torch
from pskel.models.pas import Config, added_time_ids, load
from pskel.models.pas.training.draws import Draws
from pskel.models.pas.training.module import TrainedNetwork
from pskel.models.pas.training.step import Batch, StepOptions, Texts
from safetensors.torch import load_file

SHARED = Path(os.environ.get("PSKEL_SHARED", Path(__file__).parents[4] / "shared"))
FIXTURES = Path(os.environ.get("PSKEL_FIXTURES", SHARED / "fixtures"))
NETWORK, STEPS = FIXTURES / "pas-network", FIXTURES / "pas-train"

Tensors = dict[str, torch.Tensor]


class Case(NamedTuple):
    """A case of ``meta.json``."""

    name: str
    file: str
    prefixes: list[str]
    """Prefix of each step in the file."""
    meta: dict[str, Any]
    batch: Tensors
    tensors: Tensors
    """Of the steps."""

    @property
    def options(self) -> StepOptions:
        """As the authors' code reads its configuration; a missing key, or a misspelt one, has no effect."""
        config = self.meta["training_config"]
        return StepOptions(
            drop_text=1.0 - config.get("text_prompt_condition_ratio", 1.0),
            drop_boxes=1.0 - config.get("3dbox_condition_ratio", 1.0),
            drop_map=1.0 - config.get("hdmap_condition_ratio", 1.0),
            drop_action=1.0 - config.get("action_condition_ratio", 1.0),
            drop_depth=config.get("depth_mask_ratio", 0.1),
            drop_color=config.get("clr_mask_ratio", 0.1),
            single_frames=config.get("image_generation_ratio", 0.0),
            input_scale_std=config.get("reference_frame_scale_std", 0.0),
            input_offset_std=config.get("reference_frame_offset_std", 0.0),
            with_points=not self.name.endswith("layout"),
        )


def read_meta() -> dict[str, Any]:
    meta: dict[str, Any] = json.loads((STEPS / "meta.json").read_text())
    return meta


def read_case(name: str) -> Case:
    """Read a case; cases of dropouts have the batch of nuScenes."""
    meta = read_meta()["cases"][name]
    file, _, part = name.partition(".")
    tensors = load_file(STEPS / f"{file}.safetensors")
    batch = load_file(STEPS / "nuscenes.safetensors") if file == "dropouts" else tensors
    first = f"{part}." if part else ""
    prefixes = [first] if file == "dropouts" else [f"{first}step{i}." for i in range(meta["steps"])]
    return Case(name, file, prefixes, meta, _below(batch, "batch."), tensors)


def _below(tensors: Tensors, prefix: str) -> Tensors:
    return {name[len(prefix) :]: tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def step_of(case: Case, index: int) -> Tensors:
    """The tensors of a step, without their prefix."""
    return _below(case.tensors, case.prefixes[index])


def batch_of(case: Case) -> Batch:
    raw = case.batch
    leading = raw["images"].shape[:3]
    kind: Any = "fx,0,cx,fy" if case.file == "nuplan" else "fx,fy,cx,cy"
    cameras = raw["camera_intrinsics"], raw["image_size"], raw["camera_transforms"]
    ids = added_time_ids(*cameras, raw["ego_transforms"], raw["fps"], camera_numbers=kind)
    empty = raw["depth_bins"] == 0
    return Batch(
        images=raw["images"],
        boxes=raw["boxes"],
        map=raw["map"],
        color=raw["color"],
        depth_bins=torch.where(empty, 0, raw["depth_bins"].to(torch.int16)),
        bin_count=256,
        ids=ids,
        mask=raw["crossview_mask"].bool(),
        texts=("", *(f"caption {i}" for i in range(leading.numel()))),
        caption=torch.arange(1, 1 + leading.numel()).view(leading),
    )


def texts_of(case: Case) -> Texts:
    raw = case.batch
    return Texts(
        torch.cat([raw["empty_hidden_states"][None], raw["text_hidden_states"].flatten(0, 2)]),
        torch.cat([raw["empty_pooled"][None], raw["text_pooled"].flatten(0, 2)]),
    )


def draws_of(step: Tensors) -> Draws:
    """The draws of a step; the layout stage has none for depth and color, and uses none."""
    unused = torch.ones_like(step["draw.text"])
    return Draws(**{name: step.get(f"draw.{name}", unused) for name in Draws._fields})


def network_of() -> TrainedNetwork:
    return TrainedNetwork(load(NETWORK / "weights.safetensors", Config.read(NETWORK / "config.json")).train())
