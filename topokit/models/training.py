"""Training: seeded, resumed from its last checkpoint after a kill, stopped early on episodes held back.

The order of windows is a function of seed and epoch alone, and everything else that matters is in `last.safetensors`: a
training that was killed and started again ends, on a CPU, with the same weights as one left alone.

Source: Antonova et al. 2021, section 5 (supervised, from the tracker's labels). Taught in chapter 10.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Iterator, Mapping, Sized
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset, Sampler, Subset, default_collate
from tqdm import tqdm

from topokit._archive import FormatError

from .augment import mirrored, spoilt
from .base import Normalisation, PredictiveModel
from .baselines import Ridge
from .checkpoint import describe, load_tensors, save_tensors
from .config import TrainConfig
from .losses import LossWeights, forecast_loss
from .registry import build
from .states import target_states

__all__ = ["Windows", "open_windows", "train"]

LAST, BEST, LOG = "last.safetensors", "best.safetensors", "log.csv"
_FREE = ("workers", "minutes_between_checkpoints", "out", "dataset", "accelerator", "devices")  # may change on the way


@dataclass(frozen=True, eq=False)
class Windows:
    """What is trained on: two splits without a common episode, and the checksum of the dataset that they are from."""

    train: Dataset[dict[str, Tensor]]
    validation: Dataset[dict[str, Tensor]]
    checksum: str = ""


@dataclass
class Progress:
    """Where a training stands: `epoch` is running, `batch` of its batches are done."""

    epoch: int = 0
    batch: int = 0
    step: int = 0
    best: float = math.inf
    best_epoch: int = -1
    seconds: float = 0.0
    finished: bool = False
    sums: dict[str, float] = field(default_factory=dict)


class EpochSampler(Sampler[int]):
    """The windows of an epoch in an order that seed and epoch decide, the share of one of `world` processes, from `start` on."""

    def __init__(self, n: int, count: int | None, seed: int, rank: int = 0, world: int = 1) -> None:
        self.n, self.count, self.seed, self.rank, self.world = n, min(count or n, n), seed, rank, world
        self.epoch, self.start = 0, 0

    def __len__(self) -> int:
        return self.count // self.world

    def __iter__(self) -> Iterator[int]:
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        order = torch.randperm(self.n, generator=generator)[: len(self) * self.world]
        yield from order[self.rank :: self.world][self.start :].tolist()


def train(
    config: TrainConfig, windows: Windows, *, progress: bool = False, stop_after: int | None = None
) -> dict[str, Any]:
    """Train a model, or go on with a training that was stopped; checkpoints and the log go to `config.out`.

    Parameters
    ----------
    config : TrainConfig
    windows : Windows
    progress : bool
        Show a bar on stderr.
    stop_after : int, optional
        Stop after so many steps of this run, as if killed after the checkpoint there (for tests).

    Returns
    -------
    dict
        The checkpoint with the smallest validation loss, that loss, epochs, steps, seconds, windows a second.

    Raises
    ------
    ValueError
        When there are fewer windows than a batch holds, the output directory holds a training of another configuration or
        other data, or the loss is no number any more.
    FormatError
        When the checkpoint to go on from is damaged.
    """
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    if _length(windows.train) < config.batch or _length(windows.validation) < 1:
        raise ValueError(
            f"{_length(windows.train)} windows to train on and {_length(windows.validation)} to validate with; "
            f"a batch has {config.batch}, and one is needed to validate: add episodes or make the batch smaller"
        )
    return _Training(config, windows, out, progress).run(stop_after)


def open_windows(config: TrainConfig) -> Windows:
    """The windows of a dataset that `topokit generate` made, split by episode or as `config.split` says.

    Raises
    ------
    ValueError
        When the configuration names no dataset.
    FileNotFoundError, FormatError
        When the dataset or its labels are missing or damaged.
    """
    from topokit.data import Dataset as Episodes
    from topokit.data import WindowDataset

    if not config.dataset:
        raise ValueError("the configuration names no dataset")
    episodes, shape = Episodes(config.dataset), config.shape
    parts = episodes.split(**config.split)
    options: dict[str, Any] = {
        "history": shape.history,
        "horizon": shape.horizon,
        "n_points": shape.points,
        "slots": shape.slots,
    }
    train, validation = (
        WindowDataset(episodes, parts[name], **options, **config.windows) for name in ("train", "validation")
    )
    return Windows(train, validation, episodes.checksum())


class Batch:
    """A batch of windows, opaque to Fabric, which would round the coordinates of a dict of tensors to 16 bits."""

    def __init__(self, window: Mapping[str, Tensor]) -> None:
        self.window = window


class Objective(nn.Module):
    """A model and its loss, which is taken in 32 bits whatever the model computes in."""

    def __init__(self, model: PredictiveModel, weights: LossWeights) -> None:
        super().__init__()
        self.model, self.weights = model, weights

    def forward(self, batch: Batch, seed: int, shown: Batch | None = None) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of a batch and its parts; `seed` decides which steps the log-likelihood looks at.

        `shown` is the batch as the model sees it, if it is not shown as it is.
        """
        window = batch.window
        predicted, now = self.model((shown or batch).window)
        generator = torch.Generator().manual_seed(seed)
        with torch.autocast(predicted.birth.device.type, enabled=False):
            now = None if now is None else now.float()
            return forecast_loss(predicted.float(), window, self.weights, now=now, generator=generator)


class _Training:
    def __init__(self, config: TrainConfig, windows: Windows, out: Path, show: bool) -> None:
        self.config, self.windows, self.out, self.show = config, windows, out, show
        self.fabric = _fabric(config)
        saved = load_tensors(out / LAST) if (out / LAST).exists() else None
        if saved is not None:
            self._check_same(saved[0])
            entries = saved[0]["normalisation"]
            normalisation = Normalisation(tuple(entries["origin"]), entries["scale"], entries["value"])
        else:
            normalisation = measure(windows.train)
        torch.manual_seed(config.seed)
        self.raw = build(config.model, config.shape, normalisation, config.options)
        self.progress = Progress()
        self.sampler = EpochSampler(
            _length(windows.train),
            config.windows_per_epoch,
            config.seed,
            self.fabric.global_rank,
            self.fabric.world_size,
        )
        self.steps_per_epoch = len(self.sampler) // config.batch
        self.model: Any = Objective(self.raw, config.loss)
        if self.raw.learns:
            optimizer = torch.optim.AdamW(self.raw.parameters(), config.learning_rate, weight_decay=config.weight_decay)
            self.model, self.optimizer = self.fabric.setup(self.model, optimizer)
        if saved is not None:
            self._restore(*saved)

    # -- the work -----------------------------------------------------------------------------------------------------------

    def run(self, stop_after: int | None) -> dict[str, Any]:
        if not self.progress.finished:
            if self.raw.learns:
                if not self._descend(stop_after):
                    return self.answer()
            else:
                self._solve()
        return self.answer()

    def _solve(self) -> None:
        """A model without gradient descent: fit what is to be fitted, and validate once."""
        if isinstance(self.raw, Ridge):
            self.raw.fit(self._bar(self._loader(self.windows.train, self.sampler), "ridge"))
        losses = self.validate()
        self.progress.best, self.progress.best_epoch, self.progress.finished = losses["loss"], 0, True
        self._log({"epoch": 0, "step": 0, **{f"validation_{name}": value for name, value in losses.items()}})
        self._save(BEST)
        self._save(LAST)

    def _descend(self, stop_after: int | None) -> bool:
        """Epochs until the end, early or not; False when interrupted by `stop_after`."""
        state, config = self.progress, self.config
        began, done = time.monotonic(), 0
        saved = began
        while state.epoch < config.epochs and state.epoch - state.best_epoch <= config.patience:
            self.sampler.epoch, self.sampler.start = state.epoch, state.batch * config.batch
            self.model.train()
            for window in self._bar(self._loader(self.windows.train, self.sampler), f"epoch {state.epoch + 1}"):
                self._step(window)
                done += 1
                now = time.monotonic()
                state.seconds, began = state.seconds + now - began, now
                if done == stop_after or now - saved > 60 * config.minutes_between_checkpoints:
                    self._save(LAST)
                    saved = now
                if done == stop_after:
                    return False
            losses = self.validate()
            self._end_of_epoch(losses)
            self._save(LAST)
            saved = began = time.monotonic()
        state.finished = True
        self._save(LAST)
        return True

    def _step(self, window: Mapping[str, Tensor]) -> None:
        state = self.progress
        for group in self.optimizer.param_groups:
            group["lr"] = self.config.learning_rate * _share(state.step, self.config.epochs * self.steps_per_epoch)
        seed = self.config.seed * 1_000_003 + state.step
        generator = torch.Generator().manual_seed(seed)
        if self.config.mirror:
            which = torch.rand(len(window["actions"]), generator=generator) < 0.5
            window = mirrored(window, which.to(window["actions"].device))
        loss, parts = self.model(Batch(window), seed, Batch(spoilt(window, self.config.spoil, generator)))
        if not torch.isfinite(loss):
            raise ValueError(f"step {state.step}: the loss is {loss.item()}; lower learning_rate, or look at the data")
        self.optimizer.zero_grad()
        self.fabric.backward(loss)
        self.fabric.clip_gradients(self.model, self.optimizer, max_norm=self.config.clip)
        self.optimizer.step()
        for name, part in {"loss": loss.detach(), **parts}.items():
            state.sums[name] = state.sums.get(name, 0.0) + float(part)
        state.step += 1
        state.batch += 1

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Mean losses over the windows held back."""
        self.raw.eval()
        n, most = _length(self.windows.validation), self.config.validation_windows
        few = Subset(self.windows.validation, _spread(n, most))
        sums: dict[str, float] = {}
        for number, window in enumerate(self._loader(few, None)):
            loss, parts = self.model(Batch(window), number)
            for name, part in {"loss": loss, **parts}.items():
                sums[name] = sums.get(name, 0.0) + float(part) * len(window["actions"])
        return {name: value / len(few) for name, value in sums.items()}

    def _end_of_epoch(self, losses: dict[str, float]) -> None:
        state = self.progress
        row = {"epoch": state.epoch, "step": state.step, "seconds": round(state.seconds, 1)}
        row |= {f"train_{name}": value / max(state.batch, 1) for name, value in state.sums.items()}
        self._log(row | {f"validation_{name}": value for name, value in losses.items()})
        if losses["loss"] < state.best:
            state.best, state.best_epoch = losses["loss"], state.epoch
            self._save(BEST)
        state.epoch, state.batch, state.sums = state.epoch + 1, 0, {}

    def answer(self) -> dict[str, Any]:
        """What `train` returns."""
        state = self.progress
        return {
            "checkpoint": str(self.out / BEST),
            "model": self.config.model,
            "parameters": sum(part.numel() for part in self.raw.parameters()),
            "finished": state.finished,
            "validation_loss": state.best,
            "best_epoch": state.best_epoch,
            "epochs": state.epoch,
            "steps": state.step,
            "seconds": round(state.seconds, 1),
            "windows_per_second": round(state.step * self.config.batch / state.seconds, 1) if state.seconds else None,
        }

    # -- files --------------------------------------------------------------------------------------------------------------

    def _save(self, name: str) -> None:
        if self.fabric.global_rank:
            return
        weights = {f"model.{key}": part for key, part in self.raw.state_dict().items()}
        more: dict[str, Any] = {"config": self.config.as_dict(), "dataset": self.windows.checksum}
        if name == BEST:
            more |= {
                "validation_loss": self.progress.best,
                "epoch": self.progress.best_epoch,
                "steps": self.progress.step,
            }
            if self.config.half:
                weights = {key: part.half() for key, part in weights.items()}
        else:
            more["progress"] = asdict(self.progress)
            if self.raw.learns:
                for index, entries in self.optimizer.state_dict()["state"].items():
                    weights |= {f"optimizer.{index}.{key}": torch.as_tensor(part) for key, part in entries.items()}
        save_tensors(self.out / name, weights, describe(self.raw, self.config.model, self.config.options, **more))

    def _restore(self, document: dict[str, Any], tensors: dict[str, Tensor]) -> None:
        try:
            self.raw.load_state_dict(
                {k.removeprefix("model."): t for k, t in tensors.items() if k.startswith("model.")}
            )
            if self.raw.learns:
                whole = self.optimizer.state_dict()
                for key, part in tensors.items():
                    if key.startswith("optimizer."):
                        _, index, name = key.split(".")
                        whole["state"].setdefault(int(index), {})[name] = part
                self.optimizer.load_state_dict(whole)
            self.progress = Progress(**document["progress"])
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise FormatError(f"{self.out / LAST}: not the checkpoint of a training: {error}") from error
        if (self.out / LOG).exists():  # rows of steps that were lost
            with (self.out / LOG).open(newline="") as handle:
                rows = [row for row in csv.DictReader(handle) if int(row["epoch"]) < self.progress.epoch]
            self._write_log(rows)

    def _check_same(self, document: dict[str, Any]) -> None:
        now = TrainConfig.from_dict(self.config.as_dict()).as_dict()
        before = TrainConfig(self.config.model).as_dict() | document.get("config", {})  # an older one may lack entries
        for name in now:
            was, new = before.get(name), now[name]
            if name not in _FREE and _plain(was) != _plain(new):
                raise ValueError(
                    f"{self.out}: holds a training with {name} = {was!r}, the configuration says {new!r}; "
                    "choose another `out`, or remove that one"
                )
        if document.get("dataset") != self.windows.checksum:
            raise ValueError(
                f"{self.out}: holds a training on another dataset (its checksum differs); choose another `out`"
            )

    def _log(self, row: dict[str, Any]) -> None:
        if self.fabric.global_rank:
            return
        rows: list[dict[str, Any]] = []
        if (self.out / LOG).exists() and row["epoch"]:
            with (self.out / LOG).open(newline="") as handle:
                rows = list(csv.DictReader(handle))
        self._write_log([*rows, row])

    def _write_log(self, rows: list[dict[str, Any]]) -> None:
        with (self.out / LOG).open("w", newline="") as handle:
            writer = csv.DictWriter(handle, list(rows[0]) if rows else ["epoch"])
            writer.writeheader()
            writer.writerows(rows)

    # -- data ---------------------------------------------------------------------------------------------------------------

    def _loader(self, data: Dataset[dict[str, Tensor]], sampler: Sampler[int] | None) -> Any:
        loader: DataLoader[dict[str, Tensor]] = DataLoader(
            data, self.config.batch, sampler=sampler, num_workers=self.config.workers, drop_last=sampler is not None
        )
        return self.fabric.setup_dataloaders(loader, use_distributed_sampler=False, move_to_device=self.raw.learns)

    def _bar(self, loader: Any, what: str) -> Any:
        total, initial = self.steps_per_epoch, self.progress.batch
        return tqdm(loader, what, total=total, initial=initial, unit="batch", leave=False, disable=not self.show)


def measure(data: Dataset[dict[str, Tensor]], most: int = 200) -> Normalisation:
    """Where the coordinates and filtration values of some windows lie."""
    n = _length(data)
    window = default_collate([data[i] for i in _spread(n, most)])
    clouds, target = window["clouds"], target_states(window)
    origin = clouds.mean(dim=(0, 1, 2))
    deaths = target.death[target.presence > 0]
    value = float(deaths.mean()) if len(deaths) else Normalisation.value
    return Normalisation((float(origin[0]), float(origin[1]), float(origin[2])), float((clouds - origin).std()), value)


def _spread(n: int, most: int) -> list[int]:
    """At most so many of n numbers, evenly spaced."""
    return [i * n // min(n, most) for i in range(min(n, most))]


def _share(step: int, steps: int) -> float:
    """Of the learning rate: up along a line over 2 % of the steps, down along a cosine to 1 %."""
    warm = max(1, steps // 50)
    if step < warm:
        return (step + 1) / warm
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(1.0, (step - warm) / max(1, steps - warm))))


def _plain(value: Any) -> Any:
    """Lists for tuples, so that what went through JSON compares equal."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, (list, tuple)) else value


def _length(data: Dataset[Any]) -> int:
    assert isinstance(data, Sized)
    return len(data)


def _fabric(config: TrainConfig) -> Any:
    try:
        Fabric = import_module("lightning_fabric").Fabric
    except ModuleNotFoundError:  # conda-forge has it as a part of `lightning`
        Fabric = import_module("lightning.fabric").Fabric
    fabric = Fabric(accelerator=config.accelerator, devices=config.devices, precision=config.precision)
    fabric.launch()
    return fabric
