"""The labels of a dataset: the tracked loops in every frame of every episode, stored as `topokit.io.state_arrays` describes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from topokit._archive import FormatError, load_archive
from topokit._config import checked, load
from topokit.io import Episode, check_states

from ._folder import NumberedFiles

KIND = "topokit-labels"
ABOUT = "labels.json"


@checked
class LabelSettings:
    """The settings with which a set of labels was made."""

    schema: Literal[2]
    observation: Literal["full", "observed", "camera"]  #: the points that were tracked
    #: number of first points of an observation that were tracked; None for all
    n_points: Annotated[int, Field(ge=4)] | None
    options: Mapping[str, Any]  #: the options of the tracker, `topokit.SeqPH`
    versions: Mapping[str, str]  #: the versions of the packages that made the labels


class Labels(NumberedFiles):
    """One set of labels of a dataset, in a folder beside its episodes: `Dataset.labels`."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, ABOUT)
        self.settings = load(LabelSettings, folder / ABOUT)  #: the settings with which the labels were made
        self.options = dict(self.settings.options)  #: the options of the tracker

    def cloud(self, episode: Episode) -> NDArray[np.float32]:
        """Return the cloud that was tracked in an episode, (T, n, 3) metres: all vertices, or the first observed points."""
        if self.settings.observation == "full":
            return episode.points
        return episode.observed[:, : self.settings.n_points]

    def arrays(self, number: int, clouds: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return the arrays of labels of an episode (`topokit.io.state_arrays`), given its cloud (T, n, 3) that was tracked."""
        path = self.path_of(number)
        _, arrays = load_archive(path, KIND)
        try:
            check_states(arrays, clouds)
        except (KeyError, ValueError) as error:
            raise FormatError(f"{path}: {error}; remove the file and label again") from error
        return arrays
