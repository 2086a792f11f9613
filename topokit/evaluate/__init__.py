"""How good tracked and forecast loops are, against the true ones.

Forecasts need `pip install topokit[learn]`; nothing here imports torch before it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._localisation import TrackSummary, distance_to_hull, summarise_tracks
from ._tracking import TrackingScore, compare, score, true_loops

if TYPE_CHECKING:
    from ._bootstrap import Bootstrap, Estimate
    from ._config import EvaluationConfig, load_evaluation
    from ._forecasts import evaluate_forecasts, read_results
    from ._report import write_report

_WHERE = {
    "Bootstrap": "_bootstrap",
    "Estimate": "_bootstrap",
    "EvaluationConfig": "_config",
    "evaluate_forecasts": "_forecasts",
    "load_evaluation": "_config",
    "read_results": "_forecasts",
    "write_report": "_report",
}

__all__ = [
    "Bootstrap",
    "Estimate",
    "EvaluationConfig",
    "TrackSummary",
    "TrackingScore",
    "compare",
    "distance_to_hull",
    "evaluate_forecasts",
    "load_evaluation",
    "read_results",
    "score",
    "summarise_tracks",
    "true_loops",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(f".{_WHERE[name]}", __name__), name)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] in ("torch", "safetensors", "tqdm", "zarr", "dask"):
            raise ImportError(f"topokit.evaluate needs {error.name}: pip install 'topokit[learn,data]'") from error
        raise
