"""A folder of Stable Diffusion 3.5 with random weights of a few channels, and a peer of the denoiser protocol."""

import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float32]]


def write_base(base: Path) -> Path:
    """Write an autoencoder of 16 latent channels, and text encoders of 12, 20 and 40 channels (pooled 8 and 16)."""
    import torch
    from diffusers import AutoencoderKL
    from transformers import CLIPTextConfig, CLIPTextModelWithProjection, T5Config, T5EncoderModel

    torch.manual_seed(5)
    vae = AutoencoderKL(
        down_block_types=("DownEncoderBlock2D",) * 4,
        up_block_types=("UpDecoderBlock2D",) * 4,
        block_out_channels=(8, 8, 8, 8),
        layers_per_block=1,
        norm_num_groups=4,
        latent_channels=16,
        scaling_factor=1.5305,
        shift_factor=0.0609,
        use_quant_conv=False,
        use_post_quant_conv=False,
    )
    vae.save_pretrained(base / "vae")
    for suffix, width, projection in (("", 12, 8), ("_2", 20, 16)):
        clip = CLIPTextConfig(
            vocab_size=514,
            hidden_size=width,
            intermediate_size=24,
            projection_dim=projection,
            num_hidden_layers=3,
            num_attention_heads=2,
            bos_token_id=512,
            eos_token_id=513,
            pad_token_id=513,
        )
        CLIPTextModelWithProjection(clip).save_pretrained(base / f"text_encoder{suffix}")
        write_clip_tokenizer(base / f"tokenizer{suffix}")
    t5 = T5Config(vocab_size=128, d_model=40, d_kv=8, d_ff=24, num_layers=2, num_heads=2, feed_forward_proj="gated-gelu")
    T5EncoderModel(t5).save_pretrained(base / "text_encoder_3")
    write_t5_tokenizer(base / "tokenizer_3")
    return base


def write_clip_tokenizer(folder: Path) -> None:
    """A token per byte, within and at the end of a word."""
    from tokenizers.pre_tokenizers import ByteLevel

    letters = sorted(ByteLevel.alphabet())
    tokens = [*letters, *(f"{letter}</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    folder.mkdir()
    (folder / "vocab.json").write_text(json.dumps({token: i for i, token in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    config = {"tokenizer_class": "CLIPTokenizer", "model_max_length": 77, "pad_token": "<|endoftext|>"}
    (folder / "tokenizer_config.json").write_text(json.dumps(config))


def write_t5_tokenizer(folder: Path) -> None:
    """A token per printable character of ASCII."""
    from tokenizers import Tokenizer
    from tokenizers.models import Unigram
    from tokenizers.pre_tokenizers import Metaspace
    from tokenizers.processors import TemplateProcessing

    special = ["<pad>", "</s>", "<unk>"]
    tokens = [(token, 0.0) for token in [*special, "\u2581", *map(chr, range(33, 127))]]
    tokenizer = Tokenizer(Unigram(tokens, unk_id=2))
    tokenizer.pre_tokenizer = Metaspace()
    tokenizer.post_processor = TemplateProcessing(single="$A </s>", special_tokens=[("</s>", 1)])
    folder.mkdir()
    tokenizer.save(str(folder / "tokenizer.json"))
    config = {"tokenizer_class": "T5TokenizerFast", "model_max_length": 512, "extra_ids": 0}
    names = {"pad_token": "<pad>", "eos_token": "</s>", "unk_token": "<unk>"}
    (folder / "tokenizer_config.json").write_text(json.dumps({**config, **names}))


def pack(texts: dict[str, str], tensors: dict[str, Array]) -> bytes:
    """Write a message, with its length."""
    header: dict[str, Any] = {"__metadata__": texts}
    data = b""
    for name, tensor in tensors.items():
        header[name] = {"dtype": "F32", "shape": tensor.shape, "data_offsets": [len(data), len(data) + tensor.nbytes]}
        data += tensor.astype("<f4").tobytes()
    encoded = json.dumps(header).encode()
    return struct.pack("<QQ", 8 + len(encoded) + len(data), len(encoded)) + encoded + data


def unpack(message: bytes) -> tuple[dict[str, str], dict[str, Array]]:
    """Read a message without its length."""
    from safetensors.numpy import load

    (length,) = struct.unpack_from("<Q", message)
    return json.loads(message[8 : 8 + length]).get("__metadata__", {}), load(message)


class Peer:
    """The generator's side of a denoiser process."""

    def __init__(self, arguments: list[str], errors: Path, program: str = "pskel.models.pas") -> None:
        self.errors = errors
        command = [sys.executable, "-m", program, *arguments]
        with errors.open("wb") as file:
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=file, env=os.environ)

    def ask(self, texts: dict[str, str], tensors: dict[str, Array]) -> bytes:
        """Send a message; returns the answer without its length."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(pack(texts, tensors))
        self.process.stdin.flush()
        prefix = self.process.stdout.read(8)
        assert len(prefix) == 8, self.errors.read_text()
        message = self.process.stdout.read(*struct.unpack("<Q", prefix))
        return message

    def close(self) -> int:
        """Close the connection; returns the exit status."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        rest = self.process.stdout.read()
        assert rest == b"", rest
        return self.process.wait(timeout=60)
