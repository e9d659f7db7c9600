"""Folder of Stable Diffusion 1.5: which files of it are read."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import torch
from diffusers import UNet2DConditionModel

from .._files import MODEL, TOKENIZER, expect_folder, first_line
from .config import Config

__all__ = ["base_config", "expect_base", "load_unet"]

_TITLE = "Stable Diffusion 1.5"
_FREE = frozenset({"sample_size", "class_embed_type"})
"""Keys of a UNet's configuration that do not change what it computes here."""


def expect_base(base: str | os.PathLike[str], *, with_unet: bool) -> Path:
    """Check that the files to read are there; returns the folder.

    Raises ``ValueError``, which names the first missing file, and the folder.
    """
    models = ("unet", "vae", "text_encoder") if with_unet else ("vae", "text_encoder")
    return expect_folder(base, _TITLE, [*((name, MODEL) for name in models), ("tokenizer", TOKENIZER)])


def base_config(folder: Path) -> Config:
    """Read the sizes of the network from ``folder/unet/config.json``.

    Raises ``ValueError``, which names the file and the key, if it is another kind of UNet.
    """
    found, path = _unet_config(folder)
    sizes = set(Config().unet) & set(vars(Config()))
    config = Config.parse({key: found[key] for key in sizes if key in found}, str(path))
    _expect_same(config, found, path)
    return config


def load_unet(folder: Path, config: Config) -> UNet2DConditionModel:
    """Read the UNet of the folder, in single precision.

    Raises ``ValueError``, which names the file or folder, if it cannot be read or has other sizes than ``config``.
    """
    found, path = _unet_config(folder)
    _expect_same(config, found, path)
    options: dict[str, Any] = {"torch_dtype": torch.float32, "local_files_only": True, "output_loading_info": True}
    try:
        unet, info = UNet2DConditionModel.from_pretrained(folder / "unet", **options)
    except Exception as error:  # of many kinds, by what the files are
        raise ValueError(f"expected a UNet2DConditionModel, found {first_line(error)}: {folder / 'unet'}") from error
    for kind in ("missing", "unexpected"):
        if names := sorted(info[f"{kind}_keys"]):
            problem = f"{len(names)} {kind} ({names[0]})"
            raise ValueError(f"expected the weights of a UNet2DConditionModel, found {problem}: {folder / 'unet'}")
    return unet


def _unet_config(folder: Path) -> tuple[dict[str, Any], Path]:
    path = folder / "unet" / "config.json"
    try:
        found = json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"expected JSON, found {first_line(error)}: {path}") from error
    if not isinstance(found, dict):
        raise ValueError(f"expected a JSON object, found {json.dumps(found)[:40]}: {path}")
    return found, path


def _expect_same(config: Config, found: dict[str, Any], path: Path) -> None:
    with torch.device("meta"):
        expected = UNet2DConditionModel(**config.unet).config
    for key, value in expected.items():
        if key.startswith("_") or key in _FREE or key not in found:
            continue
        if _plain(found[key]) != _plain(value):
            raise ValueError(
                f"expected {key} {json.dumps(_plain(value))}, found {json.dumps(_plain(found[key]))[:60]}: {path}"
            )


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
