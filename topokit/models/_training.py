"""Training: seeded, resumed from its last checkpoint after a kill, stopped early on episodes held back.

The order of windows is a function of seed and epoch alone, and everything else that matters is in `last.safetensors`: a
training that was killed and started again ends, on a CPU, with the same weights as one left alone. Sums depend on how many
threads share them, so that their number is an entry of the configuration: on one kind of machine `best.safetensors` has the
same bytes wherever it is made. `last.safetensors` has not: it holds the seconds that the training took.

Source: Antonova et al. 2021, section 5 (supervised, from the tracker's labels). Taught in chapter 11.
"""

from __future__ import annotations

import csv
import json
import math
import time
from dataclasses import asdict, dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Subset
from tqdm import tqdm

from topokit._archive import FormatError
from topokit._config import from_mapping
from topokit._cores import safe_path

from ._baselines import Normalisation, Ridge
from ._checkpoint import Model, build, describe, load_model, load_tensors, part_of, save_tensors
from ._config import TrainConfig, Windows, epoch_order, mirrored, normalisation_of, spread
from ._motion import Motion
from ._states import Window, forecast_loss

LAST, BEST, LOG = "last.safetensors", "best.safetensors", "log.csv"
_FREE = ["workers", "minutes_between_checkpoints", "out", "dataset", "start", "rehearse", "accelerator"]  # may change


def train(
    config: TrainConfig, windows: Windows, *, progress: bool = False, stop_after: int | None = None
) -> dict[str, Any]:
    """Train a model, or go on with a training that was stopped; checkpoints and the log go to `config.out`.

    Returned are the checkpoint with the smallest validation loss, that loss, epochs, steps, seconds, windows a second.

    Parameters
    ----------
    config : TrainConfig
    windows : Windows
    progress : bool
        Show a bar on stderr.
    stop_after : int, optional
        Stop after so many steps of this run, as if killed after the checkpoint there.

    Raises
    ------
    ValueError
        When there are too few windows, `out` or `start` holds another training, or the loss is no number any more.
    """
    n, held_back = len(windows.train), len(windows.validation)
    if n < config.batch or not held_back:
        few = f"{n} windows to train on and {held_back} to validate with; a batch has {config.batch}"
        raise ValueError(f"{few}, and one is needed to validate: add episodes or make the batch smaller")
    Path(config.out).mkdir(parents=True, exist_ok=True)
    threads = torch.get_num_threads()
    torch.set_num_threads(config.threads)
    try:
        with safe_path():
            return _Training(config, windows, progress).run(stop_after)
    finally:
        torch.set_num_threads(threads)


@dataclass
class Progress:
    """Where a training stands: `epoch` is running, `batch` of its batches are done, `log` has a row for each one before."""

    epoch: int = 0
    batch: int = 0
    step: int = 0
    best: float = math.inf
    best_epoch: int = -1
    seconds: float = 0.0
    finished: bool = False
    sums: dict[str, float] = field(default_factory=dict)
    log: list[dict[str, Any]] = field(default_factory=list)


class _Training:
    def __init__(self, config: TrainConfig, windows: Windows, show: bool) -> None:
        self.config, self.windows, self.show, self.out = config, windows, show, Path(config.out)
        self.progress = Progress()
        module = "lightning_fabric" if find_spec("lightning_fabric") else "lightning.fabric"  # as conda-forge has it
        try:
            fabric = import_module(module).Fabric
        except ModuleNotFoundError as error:
            raise ImportError("training needs Lightning Fabric: pip install 'topokit[learn]'") from error
        self.fabric = fabric(accelerator=config.accelerator, devices=1, precision=config.precision)
        saved = load_tensors(self.out / LAST) if (self.out / LAST).exists() else None
        if saved is None:
            normalisation = Normalisation() if config.model == "motion" else normalisation_of(windows.train)
        else:
            self._check_same(saved[0])
            normalisation = from_mapping(Normalisation, saved[0]["normalisation"], "normalisation")
        torch.manual_seed(config.seed)
        fresh = build(config.model, config.shape, normalisation, config.options)
        self.model = _begun(config) if config.start else fresh
        if self.model.learns:
            decay = config.weight_decay
            optimizer = torch.optim.AdamW(self.model.parameters(), config.learning_rate, weight_decay=decay)
            _, self.optimizer = self.fabric.setup(self.model, optimizer)
        if saved is not None:
            self._restore(*saved)
        # Workers live as long as the training: they keep the films that they have read.
        self._order: list[int] = []
        lives = {"sampler": self._order, "drop_last": True, "persistent_workers": config.workers > 0}
        self._reader = self._loader(windows.train, **lives)
        n = len(windows.train)
        self.steps_per_epoch = min(config.windows_per_epoch or n, n) // config.batch

    def run(self, stop_after: int | None) -> dict[str, Any]:
        if not self.progress.finished and self.model.learns:
            self._descend(self.progress.step + stop_after if stop_after else None)
        elif not self.progress.finished:
            if isinstance(self.model, Ridge):
                self.model.fit(self._batches())
            self._validate()
            self.progress.finished = True
            self._save(LAST)
        return self._summary()

    def _descend(self, stop: int | None) -> None:
        """Epochs until the end, early or not, or until a step."""
        progress, config = self.progress, self.config
        while progress.epoch < config.epochs and progress.epoch - progress.best_epoch <= config.patience:
            saved = began = time.monotonic()
            self.model.train()
            for window in self._batches():
                self._step(window)
                ended = time.monotonic()
                progress.seconds, began = progress.seconds + ended - began, ended
                if progress.step == stop or ended - saved > 60 * config.minutes_between_checkpoints:
                    self._save(LAST)
                    saved = ended
                if progress.step == stop:
                    return
            self._validate()
            self._save(LAST)
        progress.finished = True
        self._save(LAST)

    def _step(self, window: Window) -> None:
        progress, config = self.progress, self.config
        share = learning_rate_share(progress.step, config.epochs * self.steps_per_epoch)
        for group in self.optimizer.param_groups:
            group["lr"] = config.learning_rate * share
        seed = config.seed * 1_000_003 + progress.step
        generator = torch.Generator().manual_seed(seed)
        window = mirrored(window, torch.rand(len(window["actions"]), generator=generator) < 0.5)
        loss, parts = self._loss(window, seed)
        if not torch.isfinite(loss):
            raise ValueError(f"step {progress.step}: the loss is {loss.item()}; lower learning_rate, or check the data")
        self.optimizer.zero_grad()
        self.fabric.backward(loss)
        self.fabric.clip_gradients(self.model, self.optimizer, max_norm=config.clip)
        self.optimizer.step()
        _add(progress.sums, parts)
        progress.step += 1
        progress.batch += 1

    def _loss(self, window: Window, seed: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Of a batch: in 32 bits whatever the model computes in."""
        if isinstance(self.model, Motion):
            return self.model.loss(window, torch.Generator().manual_seed(seed))
        with self.fabric.autocast():
            predicted = self.model(window)
        return forecast_loss(predicted.each(Tensor.float), window, self.config.loss)

    @torch.no_grad()
    def _validate(self) -> None:
        """End an epoch: mean losses over the windows held back, a row of the log, the best weights so far."""
        self.model.eval()
        chosen = spread(len(self.windows.validation), self.config.validation_windows)
        sums: dict[str, float] = {}
        for number, window in enumerate(self._loader(Subset(self.windows.validation, chosen))):
            _, parts = self._loss(window, number)
            _add(sums, parts, len(window["actions"]))
        losses, progress = {name: value / len(chosen) for name, value in sums.items()}, self.progress
        row = {"epoch": progress.epoch, "step": progress.step, "seconds": round(progress.seconds, 1)}
        row |= {f"train_{name}": value / max(progress.batch, 1) for name, value in progress.sums.items()}
        progress.log.append(row | {f"validation_{name}": value for name, value in losses.items()})
        with (self.out / LOG).open("w", newline="") as handle:
            writer = csv.DictWriter(handle, progress.log[0])
            writer.writeheader()
            writer.writerows(progress.log)
        if losses["loss"] < progress.best:
            progress.best, progress.best_epoch = losses["loss"], progress.epoch
            self._save(BEST)
        progress.epoch, progress.batch, progress.sums = progress.epoch + 1, 0, {}

    def _summary(self) -> dict[str, Any]:
        progress = self.progress
        speed = progress.step * self.config.batch / progress.seconds if progress.seconds else None
        return {
            "checkpoint": str(self.out / BEST),
            "model": self.config.model,
            "parameters": sum(part.numel() for part in self.model.parameters()),
            "finished": progress.finished,
            "validation_loss": progress.best,
            "best_epoch": progress.best_epoch,
            "epochs": progress.epoch,
            "steps": progress.step,
            "seconds": round(progress.seconds, 1),
            "windows_per_second": speed and round(speed, 1),
        }

    def _batches(self) -> Any:
        """What is left of the epoch's batches, under a bar."""
        progress, config = self.progress, self.config
        order = epoch_order(len(self.windows.train), config.windows_per_epoch, config.seed, progress.epoch)
        self._order[:] = order[progress.batch * config.batch :]
        return tqdm(
            self._reader,
            f"epoch {progress.epoch + 1}",
            total=self.steps_per_epoch,
            initial=progress.batch,
            unit="batch",
            leave=False,
            disable=not self.show,
        )

    def _loader(self, data: Any, **more: Any) -> Any:
        loader = DataLoader(data, self.config.batch, num_workers=self.config.workers, **more)
        return self.fabric.setup_dataloaders(loader, move_to_device=self.model.learns)

    def _save(self, name: str) -> None:
        progress = self.progress
        weights = {f"model.{key}": part for key, part in self.model.state_dict().items()}
        config = {key: part for key, part in asdict(self.config).items() if key not in _FREE}
        more: dict[str, Any] = {"config": config, "dataset": self.windows.checksum}
        if self.config.start:
            more["start"] = Path(self.config.start).name
        if name == BEST:
            more |= {"validation_loss": progress.best, "epoch": progress.best_epoch, "steps": progress.step}
            weights = {key: part.half() for key, part in weights.items()}  # half the size
        else:
            more["progress"] = asdict(progress)
            for index, entries in self.optimizer.state_dict()["state"].items() if self.model.learns else ():
                weights |= {f"optimizer.{index}.{key}": torch.as_tensor(part) for key, part in entries.items()}
        save_tensors(self.out / name, weights, describe(self.model, self.config.model, self.config.options, **more))

    def _restore(self, document: dict[str, Any], tensors: dict[str, Tensor]) -> None:
        try:
            self.model.load_state_dict(part_of(tensors, "model."))
            self.progress = Progress(**document["progress"])
            if self.model.learns:
                whole = self.optimizer.state_dict()
                for key, part in part_of(tensors, "optimizer.").items():
                    index, name = key.split(".")
                    whole["state"].setdefault(int(index), {})[name] = part
                self.optimizer.load_state_dict(whole)
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise FormatError(f"{self.out / LAST}: not the checkpoint of a training: {error!s:.300}") from error

    def _check_same(self, document: dict[str, Any]) -> None:
        """Whether a training may go on: with this configuration, as JSON has it, and on this dataset."""
        known = asdict(TrainConfig(self.config.model)) | document.get("config", {})  # an older one may lack entries
        for name, wanted in json.loads(json.dumps(asdict(self.config))).items():
            if name not in _FREE and known[name] != wanted:
                found = f"{name} = {known[name]!r}, the configuration says {wanted!r}"
                raise ValueError(f"{self.out}: holds a training with {found}; choose another `out`, or remove that one")
        if document.get("dataset") != self.windows.checksum:
            raise ValueError(f"{self.out}: holds a training on another dataset, by its checksum; choose another `out`")


def _begun(config: TrainConfig) -> Model:
    """The model of a checkpoint, which must be of the kind and the sizes asked for."""
    model, found = load_model(config.start)
    for name in ("model", "options", "shape"):
        if found[name] != (wanted := json.loads(json.dumps(asdict(config)[name]))):
            raise ValueError(f"{config.start}: its {name} is {found[name]!r}, and the configuration says {wanted!r}")
    return model


def learning_rate_share(step: int, steps: int) -> float:
    """Of the largest learning rate: up along a line over 2 % of the steps, down along a cosine to 1 %."""
    warm = max(1, steps // 50)
    if step < warm:
        return (step + 1) / warm
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(1.0, (step - warm) / max(1, steps - warm))))


def _add(sums: dict[str, float], parts: Window, weight: int = 1) -> None:
    for name, part in parts.items():
        sums[name] = sums.get(name, 0.0) + weight * float(part)
