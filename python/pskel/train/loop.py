"""The training: from a configuration to weights."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import torch

from .checkpoint import (
    compare,
    last_checkpoint,
    load_modules,
    load_players,
    read_state,
    remove_partial,
    save_checkpoint,
)
from .config import Config
from .data.sampling import Sampler
from .data.sources import open_data
from .errors import LossError, TrainError, first_line
from .loader import Batch, Loader, statistics_clips
from .outputs import Outputs, claim_folder
from .parallel import LostError, Processes, full, is_lost, start_processes
from .players import LossOf, Players
from .progress import Progress
from .task import Task, create_task, recipe_of
from .validation import validate

__all__ = ["train"]


def train(config: Config, data: Sequence[str], out: Path, *, resume: bool = False, command: str = "") -> None:
    """Train a network, and write everything to a folder. Every process of a training calls it.

    ``command`` is stored with the weights. Raises ``TrainError``, whose text is one line, if the training
    cannot begin or go on; checkpoints so far remain.
    """
    processes = start_processes()
    progress = Progress(config.train.steps, config.train.batch * config.train.accumulate * processes.count,
                        active=processes.is_main)  # fmt: skip
    lock = _claim(out, processes, resume=resume)
    run = None
    try:
        run = _Run(config, data, out, processes, progress, resume=resume, command=command)
        run.go()
    except (RuntimeError, MemoryError) as error:
        raise _explained(error, config, run, processes) from error
    finally:
        progress.pause()
        if run is not None:
            run.close()
        if lock is not None:
            lock.close()


def _claim(out: Path, processes: Processes, *, resume: bool) -> BinaryIO | None:
    """Claim the output folder in the main process; a failure ends all."""
    lock = None
    with processes.agreed():
        if processes.is_main:
            lock = claim_folder(out, resume=resume)
            remove_partial(out)
    return lock


class _Run:
    """A training of this process."""

    def __init__(
        self,
        config: Config,
        specs: Sequence[str],
        out: Path,
        processes: Processes,
        progress: Progress,
        *,
        resume: bool,
        command: str,
    ) -> None:
        self.config, self.out, self.processes, self.progress = config, out, processes, progress
        self.step = 0
        self.command = command
        self.outputs: Outputs | None = None
        self._skipped: Counter[str] = Counter()
        if processes.device.type == "cpu":
            progress.say("no GPU found: the training runs on the CPU, which takes 20 to 100 times as long")
        self.data = open_data(specs, config.data, recipe_of(config), processes, progress.say)
        with processes.agreed():
            torch.manual_seed(config.train.seed)
            self.task: Task = create_task(config)
        self.about = self._about()
        state = self._start(resume=resume)
        # Workers are forked before modules are moved to the device, and before this process renders anything.
        sampler = Sampler(self.data.train, self.data.shares, config.train.seed)
        self.loader = Loader(self.task, sampler, config.train, processes, self.step, config.train.steps)
        self.players = Players(self.task, config.train, processes)
        if state is not None:
            load_players(self.players, state, processes.device)
        if processes.is_main:
            self.outputs = Outputs(out, self.about, self.step)
            if not self.outputs.has_board:
                progress.say("TensorBoard is not installed (pip install tensorboard): no events are written")
            if config.train.validate and not self.data.validation:
                progress.say(
                    "no frames are held out (data.hold_out, data.hold_out_logs): validation is on clips of the training"
                )

    def _about(self) -> dict[str, Any]:
        """Return the configuration that a checkpoint is compared by."""
        train = self.config.train
        about: dict[str, Any] = self.config.to_json()
        about["data"]["recipe"] = self.data.recipe
        about["clips"] = self.data.to_json()
        about["batches_per_step"] = train.accumulate * self.processes.count
        if train.shard == "fsdp":
            about["processes"] = self.processes.count
        return about

    def _start(self, *, resume: bool) -> dict[str, Any] | None:
        """Restore the state before modules are moved or divided, or take the statistics of the data."""
        train = self.config.train
        modules = {player.name: player.module for player in self.task.players}
        last = self.processes.share_object(last_checkpoint(self.out)) if resume else None
        if last is not None:
            with self.processes.agreed():
                self.step = compare(self.about, last)
                state = read_state(last, self.processes, sharded=train.shard == "fsdp")
            self.task.load_state(state["task"])
            load_modules(modules, state, buffers_only=train.shard == "fsdp")
            self.progress.say(f"resumed from {last.name}")
            return state
        if resume:
            self.progress.say("no checkpoint found: the training begins")
        self.progress.say("taking statistics of the data")
        sampler = Sampler(self.data.train, self.data.shares, train.seed)
        with self.processes.agreed(), statistics_clips(sampler, train) as clips:
            self.task.prepare(clips)
        self.task.load_state(self.processes.share_object(self.task.state()))
        return None

    def go(self) -> None:
        """Take all steps."""
        train = self.config.train
        if self.step:
            self._complete()
        while self.step < train.steps:
            batches = self.loader.step()
            self._note_skipped(batches)
            losses = self.players.learn([batch.content for batch in batches], self.step)
            means, norms = self._reduced(losses, batches)
            rates = self.players.update(self.step)
            self.step += 1
            if self.outputs is not None:
                extra = {f"{name}.gradient_norm": value for name, value in norms.items()}
                extra |= {f"{name}.learning_rate": value for name, value in rates.items()}
                self.outputs.loss(self.step, means | extra)
            self.progress.step(self.step, next(iter(means.values()), math.nan))
            if self.step % train.checkpoint == 0 or self.step == train.steps:
                save_checkpoint(self.out, self.step, self.about, self.task, self.players, self.processes)
                self._write_weights()
            if self._is_validated():
                self._validate()
        self._end()

    def _is_validated(self) -> bool:
        """Return whether there is a validation after this step."""
        train = self.config.train
        return train.validate > 0 and (self.step % train.validate == 0 or self.step == train.steps)

    def _complete(self) -> None:
        """Do what a killed process may have left out after the checkpoint that is resumed from."""
        self._write_weights()
        is_done = self.outputs is not None and self.outputs.has_scores(self.step)
        if self._is_validated() and not self.processes.share_object(is_done):
            self._validate()

    def _reduced(
        self, losses: Mapping[str, LossOf], batches: Sequence[Batch]
    ) -> tuple[dict[str, float], dict[str, float]]:
        """Return losses over all processes and norms of gradients. Raises ``LossError`` if one is not finite."""
        norms = self.players.norms(self.step)
        bad = [name for name, each in losses.items() if not math.isfinite(each.loss)]
        clips = ", ".join(name for batch in batches for name in batch.clips)
        found = self.processes.gather((losses, bad, clips))
        wrong = [(names[0], clips) for _, names, clips in found if names]
        what = "loss"
        if not wrong and (names := [name for name, norm in norms.items() if not math.isfinite(norm)]):
            wrong, what = [(names[0], "; ".join(clips for _, _, clips in found))], "gradient"
        if wrong:
            name, clips = wrong[0]
            last = last_checkpoint(self.out)
            advice = "lower train.learning_rate, set train.clip_norm or raise train.warmup"
            kept = "" if last is None else f"; {last.name} remains"
            raise LossError(
                f"the {what} of {name} is not finite in step {self.step + 1}, clips {clips}: {advice}{kept}"
            )
        return _means([each for each, _, _ in found]), norms

    def _write_weights(self) -> None:
        with self.players.evaluated() as modules, torch.no_grad():
            tensors, header = self.task.weights(modules)
            whole = {name: full(tensor).detach().cpu() for name, tensor in tensors.items()}
            if self.outputs is not None:  # here, since the tensors may be those of the modules
                self.outputs.weights(whole, {**header, "training": json.dumps(self._provenance())})

    def _provenance(self) -> dict[str, Any]:
        """Return what the header of the weights says of their training."""
        logs = sorted({clip_set.reader.log for clip_set in self.data.train})
        return {"seed": self.config.train.seed, "steps": self.step, "logs": logs, "command": self.command}

    def _validate(self) -> None:
        self.progress.pause()
        with self.players.evaluated() as modules:
            found = validate(self.task, modules, self.data, self.config, self.processes)
        if self.outputs is not None:
            self.outputs.validation(self.step, found.scores, found.picture)
        for text in found.skipped:
            self.progress.say(f"validation leaves out {text}")
        scores = ", ".join(f"{name} {value:.4g}" for name, value in found.scores.items())
        self.progress.say(f"validation after step {self.step}: {scores or 'no scores'}")

    def _note_skipped(self, batches: Sequence[Batch]) -> None:
        for text in (text for batch in batches for text in batch.skipped):
            if not self._skipped:
                self.progress.say(f"left out: {text}; others are counted at the end")
            self._skipped[text.split(", such as")[0]] += 1

    def _end(self) -> None:
        total: Counter[str] = Counter()
        for counts in self.processes.gather(self._skipped):
            total += counts
        for text, count in sorted(total.items()):
            self.progress.say(f"left out {count} times: {text}")
        self.progress.say(f"trained {self.step} steps: {self.out / 'weights.safetensors'}")

    def close(self) -> None:
        """End workers, and close files."""
        self.loader.close()
        if self.outputs is not None:
            self.outputs.close()


def _means(of_processes: Sequence[Mapping[str, LossOf]]) -> dict[str, float]:
    """Return mean losses and numbers over processes, as columns of the table."""
    columns: dict[str, list[float]] = {}
    for losses in of_processes:
        for name, each in losses.items():
            columns.setdefault(f"{name}.loss", []).append(each.loss)
            for key, value in each.numbers.items():
                columns.setdefault(f"{name}.{key}", []).append(value)
    return {name: math.fsum(values) / len(values) for name, values in columns.items()}


def _explained(error: BaseException, config: Config, run: _Run | None, processes: Processes) -> BaseException:
    """Return an error in one line for lost processes and a lack of memory, else the error."""
    step = 0 if run is None else run.step
    if is_lost(error):
        return LostError.create(processes.rank)
    text = str(error)
    if "DataLoader worker" in text:
        return TrainError(
            f"a process that reads clips was killed, out of memory? reduce train.workers ({first_line(error)})"
        )
    if "Expected to have finished reduction" in text:
        return TrainError(
            f"a trained parameter had no gradient in step {step}: such a task needs unused_parameters = True"
        )
    if isinstance(error, torch.OutOfMemoryError) or "DefaultCPUAllocator" in text or isinstance(error, MemoryError):
        train = config.train
        advice = []
        if train.batch > 1:
            advice.append(f"train.batch below {train.batch} (and train.accumulate above {train.accumulate})")
        if config.data.frames > 1:
            advice.append(f"data.frames below {config.data.frames}")
        advice.append("fewer data.cameras or a smaller size in the recipe")
        if train.precision == "f32":
            advice.append('train.precision = "bf16"')
        if train.optimizer == "adamw":
            advice.append('train.optimizer = "adamw8bit"')
        if train.shard == "none" and processes.count > 1:
            advice.append('train.shard = "fsdp"')
        memory = _memory(processes.device)
        return TrainError(
            f"{memory} is not enough in step {step + 1}: use {', '.join(advice)} ({first_line(error)[:160]})"
        )
    return error


def _memory(device: torch.device) -> str:
    if device.type != "cuda":
        return "main memory"
    total = torch.cuda.get_device_properties(device).total_memory
    return f"GPU memory ({total / 2**30:.0f} GiB)"
