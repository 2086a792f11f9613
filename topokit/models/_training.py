"""Training: seeded, stopped early on episodes held back, and continued from the last whole epoch after a kill.

The order of windows and all that is random depend on the seed, the epoch and the step alone. Everything else that matters is in
`last.safetensors`. So a training that was killed and started again ends, on a CPU, with the same weights as one left alone.
Sums depend on how many threads share them; their number is therefore an entry of the configuration.

Source: Antonova et al. 2021, section 5 (supervised, from the tracker's labels). Taught in chapter 13.
"""

from __future__ import annotations

import codecs
import csv
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Subset, default_collate
from tqdm import tqdm

from topokit._archive import FormatError, atomic_file
from topokit._config import from_mapping

from ._baselines import Model, Normalisation, Ridge
from ._checkpoint import MODELS, build, describe, load_model, load_tensors, save_tensors
from ._config import TrainConfig, Windows, spread
from ._motion import Motion
from ._states import StateTensors, Window, forecast_loss


def train(
    config: TrainConfig, out: str | Path, windows: Sequence[Any] | None = None, *, progress: bool = False
) -> dict[str, Any]:
    """Train a model, or go on with a training that was stopped; nothing is written outside of the folder `out`.

    The answer names the checkpoint with the smallest validation loss, that loss, epochs, steps, seconds, and windows a second.

    Parameters
    ----------
    config : TrainConfig
    out : path
        Folder for the checkpoints and the log.
    windows : pair of torch data sets, optional
        Windows to train on and windows to validate with; those that the configuration names when not given. A third entry, a
        checksum, identifies where they are from.
    progress : bool
        Show a bar on stderr.
    """
    windows = config.open_windows() if windows is None else Windows(*windows)
    n_train = len(windows.train)
    n_validation = len(windows.validation)
    if n_train < config.batch or not n_validation:
        few = f"{n_train} windows to train on and {n_validation} to validate with; a batch has {config.batch}"
        raise ValueError(f"{few}, and one is needed to validate: add episodes or make the batch smaller")
    out = Path(out).expanduser()
    out.mkdir(parents=True, exist_ok=True)
    threads = torch.get_num_threads()
    torch.set_num_threads(config.threads)
    try:
        return _Training(config, out, windows, progress).run()
    finally:
        torch.set_num_threads(threads)


@dataclass
class Progress:
    """The progress of a training, after whole epochs: `log` has a row for each of them."""

    epoch: int = 0
    step: int = 0
    best: float = math.inf
    best_epoch: int = -1
    seconds: float = 0.0
    log: list[dict[str, Any]] = field(default_factory=list)


class _Training:
    def __init__(self, config: TrainConfig, out: Path, windows: Windows, show: bool) -> None:
        self.config = config
        self.windows = windows
        self.show = show
        self.out = out
        self.last = out / "last.safetensors"
        self.best = out / "best.safetensors"
        self.progress = Progress()

        # An earlier run left a checkpoint: go on from there, with its normalisation.
        saved = load_tensors(self.last) if self.last.exists() else None
        normalisation = Normalisation()
        if saved:
            self._check_same(saved[0])
            normalisation = from_mapping(Normalisation, saved[0]["normalisation"], "normalisation")
        elif not issubclass(MODELS[config.model], Motion):
            normalisation = normalisation_of(windows.train)

        torch.manual_seed(config.seed)
        self.model: Model = build(config.model, config.shape, normalisation, config.options)
        if config.start:
            self.model, _ = load_model(config.start)
        if self.model.learns:
            # The fused optimiser is a few times as fast on a CPU.
            parameters = self.model.parameters()
            self.optimizer = torch.optim.AdamW(parameters, config.learning_rate, weight_decay=1e-4, fused=True)
        if saved:
            self._restore(*saved)
        n = len(windows.train)
        self.steps_per_epoch = min(config.windows_per_epoch or n, n) // config.batch

    def run(self) -> dict[str, Any]:
        """Train until all epochs are done, or the validation loss has not fallen for too long; a baseline has one epoch."""
        config = self.config
        progress = self.progress
        epochs = config.epochs if self.model.learns else 1
        while progress.epoch < epochs and progress.epoch - progress.best_epoch <= config.patience:
            sums: dict[str, float] = {}
            if self.model.learns:
                sums = self._train_epoch()
            elif isinstance(self.model, Ridge):
                self.model.fit(self._batches())
            self._end_epoch(sums)
        return {
            "checkpoint": str(self.best),
            "model": config.model,
            "parameters": sum(part.numel() for part in self.model.parameters()),
            "validation_loss": progress.best,
            "best_epoch": progress.best_epoch,
            "epochs": progress.epoch,
            "steps": progress.step,
            "seconds": round(progress.seconds, 1),
            "windows_per_second": round(progress.step * config.batch / max(progress.seconds, 1e-9), 1),
        }

    def _train_epoch(self) -> dict[str, float]:
        """Take the steps of an epoch, and return the sums of their losses."""
        sums: dict[str, float] = {}
        self.model.train()
        start = time.monotonic()
        for window in self._batches():
            _add(sums, self._step(window))
        self.progress.seconds += time.monotonic() - start
        return sums

    def _batches(self) -> Any:
        """Return the batches of the epoch, under a bar; their order depends on the seed and the epoch alone."""
        config = self.config
        windows = self.windows.train
        epoch = self.progress.epoch
        generator = torch.Generator().manual_seed(config.seed * 1_000_003 + epoch)
        order = torch.randperm(len(windows), generator=generator)[: config.windows_per_epoch].tolist()
        loader = DataLoader(windows, config.batch, sampler=order, drop_last=True, num_workers=config.workers)
        return tqdm(loader, f"epoch {epoch + 1}", unit="batch", leave=False, disable=not self.show)

    def _step(self, window: Window) -> dict[str, Tensor]:
        """Take a step along the gradient of a batch, of which half is seen in the mirror."""
        config = self.config
        step = self.progress.step
        share = learning_rate_share(step, config.epochs * self.steps_per_epoch)
        for group in self.optimizer.param_groups:
            group["lr"] = config.learning_rate * share
        seed = config.seed * 1_000_003 + step
        turns = torch.rand(len(window["actions"]), generator=torch.Generator().manual_seed(seed)) < 0.5
        loss, parts = self._loss(mirrored(window, turns), seed)
        if not torch.isfinite(loss):
            raise ValueError(f"step {step}: the loss is {loss.item()}; lower learning_rate, or check the data")
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        self.optimizer.step()
        self.progress.step += 1
        return parts

    def _loss(self, window: Window, seed: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss of a batch and its parts."""
        if isinstance(self.model, Motion):
            return self.model.loss(window, torch.Generator().manual_seed(seed))
        return forecast_loss(self.model(window), window, **self.config.loss)

    def _end_epoch(self, sums: dict[str, float]) -> None:
        """Validate, log, and write the checkpoints: the best one first, so that `last` is never ahead of it."""
        progress = self.progress
        losses = self._validate()
        row = {"epoch": progress.epoch, "step": progress.step, "seconds": round(progress.seconds, 1)}
        row |= {f"train_{name}": value / self.steps_per_epoch for name, value in sums.items()}
        row |= {f"validation_{name}": value for name, value in losses.items()}
        progress.log.append(row)
        with atomic_file(self.out / "log.csv") as file:
            writer = csv.DictWriter(codecs.getwriter("utf-8")(file), row)
            writer.writeheader()
            writer.writerows(progress.log)
        description = self._description()
        if losses["loss"] < progress.best:
            progress.best = losses["loss"]
            progress.best_epoch = progress.epoch
            weights = {name: part.half() for name, part in self.model.state_dict().items()}  # half the size
            reached = {"validation_loss": progress.best, "epoch": progress.epoch, "steps": progress.step}
            save_tensors(self.best, weights, description | reached)
        progress.epoch += 1
        tensors = dict(self.model.state_dict())
        if self.model.learns:
            for index, entries in self.optimizer.state_dict()["state"].items():
                tensors |= {f"optimizer.{index}.{name}": value for name, value in entries.items()}
        save_tensors(self.last, tensors, description | {"progress": asdict(progress)})

    @torch.no_grad()
    def _validate(self) -> dict[str, float]:
        """Return the mean losses over the windows held back."""
        self.model.eval()
        chosen = spread(len(self.windows.validation), self.config.validation_windows)
        loader = DataLoader(Subset(self.windows.validation, chosen), self.config.batch, num_workers=self.config.workers)
        sums: dict[str, float] = {}
        for number, window in enumerate(loader):
            _, parts = self._loss(window, number)
            _add(sums, parts, len(window["actions"]))
        return {name: value / len(chosen) for name, value in sums.items()}

    def _description(self) -> dict[str, Any]:
        """Return the description of a checkpoint. Its configuration lacks what may change when a training goes on."""
        free = ("workers", "dataset", "start")
        config = {key: value for key, value in asdict(self.config).items() if key not in free}
        description = describe(self.model) | {"config": config, "dataset": self.windows.checksum}
        if self.config.start:
            description["start"] = Path(self.config.start).name
        return description

    def _restore(self, description: dict[str, Any], tensors: dict[str, Tensor]) -> None:
        """Go on from `last.safetensors`: weights, the optimiser's state, progress."""
        self.progress = Progress(**description["progress"])
        weights = {name: part for name, part in tensors.items() if not name.startswith("optimizer.")}
        self.model.load_state_dict(weights)
        if self.model.learns:
            state = self.optimizer.state_dict()
            shapes = dict(enumerate(part.shape for part in self.model.parameters()))
            for name in tensors.keys() - weights.keys():
                _, index, key = name.split(".")
                # The fused optimiser reads beyond the end of a moment that is smaller than its weights.
                if key != "step" and tensors[name].shape != shapes.get(int(index)):
                    raise FormatError(f"{self.last}: {name} has not the shape of its weights; remove the file")
                state["state"].setdefault(int(index), {})[key] = tensors[name]
            self.optimizer.load_state_dict(state)

    def _check_same(self, description: dict[str, Any]) -> None:
        """Refuse to go on with another configuration, or on another dataset."""
        config = json.loads(json.dumps(asdict(self.config))) | {"dataset": self.windows.checksum}
        for name, value in {**description["config"], "dataset": description["dataset"]}.items():
            if config.get(name) != value:
                other = f"{name} = {value!r} and not {config.get(name)!r}"
                raise ValueError(f"{self.last}: a training with {other}; name another folder, or remove that one")


def normalisation_of(data: Any) -> Normalisation:
    """Return where the coordinates and filtration values of some windows lie."""
    window = default_collate([data[i] for i in spread(len(data), 200)])
    clouds = window["clouds"]  # (B, h, P, 3)
    target = StateTensors.from_labels(window)
    origin = clouds.mean(dim=(0, 1, 2))
    deaths = target.death[target.presence > 0]
    value = float(deaths.mean()) if len(deaths) else Normalisation().value
    return Normalisation(tuple(origin.tolist()), float((clouds - origin).std()), value)


def mirrored(window: Window, which: Tensor) -> dict[str, Tensor]:
    """Return a batch of windows, those where `which` (B,) is true seen in the mirror x -> -x.

    Scenes are alike left and right of the plane x = 0: the mirror image of an episode could have happened. In it the two
    grippers exchange their places.
    """
    flipped = dict(window)
    places = ["clouds", "triangles", "past_triangles", "grippers", "actions"]  # of windows with labels
    places += ["cloud", "points", "flow", "target", "future"]  # of scenes
    for name in window.keys() & set(places):
        image = window[name][which] * window[name].new_tensor([-1.0, 1.0, 1.0])
        if name in ("grippers", "actions"):
            image = image.flip(-2)
        flipped[name] = window[name].clone()
        flipped[name][which] = image
    return flipped


def learning_rate_share(step: int, steps: int) -> float:
    """Return the share of the largest learning rate: it rises over 2 % of the steps, then falls along a cosine to 1 %."""
    warm = max(1, steps // 50)
    if step < warm:
        return (step + 1) / warm
    done = min(1.0, (step - warm) / max(1, steps - warm))
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * done))


def _add(sums: dict[str, float], parts: Window, weight: int = 1) -> None:
    """Add a batch's losses to their sums."""
    for name, part in parts.items():
        sums[name] = sums.get(name, 0.0) + weight * float(part)
