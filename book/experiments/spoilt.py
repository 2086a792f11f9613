"""Clouds with missing points, noise and outliers: what sensors do to clean ones."""

import numpy as np
from numpy.typing import NDArray

MARGIN = 0.1  # metres around a cloud's box in which outliers lie


def spoil(
    clouds: NDArray[np.floating],
    rng: np.random.Generator,
    *,
    noise: float = 0.0,
    outliers: float = 0.0,
    keep: float = 1.0,
) -> NDArray[np.float64]:
    """Return clouds (..., P, 3) with missing points, noise and outliers, drawn for every cloud separately.

    Each coordinate gets `noise`, a standard deviation in metres. The share `outliers` of the points is anywhere in the cloud's
    box, grown by 10 cm on each side. The share `keep` stays, at least one point; these come first, in their order, and repeats
    of them replace the others. Both shares are rounded to whole points.
    """
    clouds = np.asarray(clouds, dtype=np.float64)
    n_points = clouds.shape[-2]
    places = np.broadcast_to(np.arange(n_points), clouds.shape[:-1])

    # Points that stay come first, in their order; then they are repeated.
    n_staying = max(round(keep * n_points), 1)
    is_missing = rng.permuted(places, axis=-1) >= n_staying
    order = np.argsort(is_missing, axis=-1, kind="stable")
    chosen = np.take_along_axis(order, places % n_staying, axis=-1)
    spoilt = np.take_along_axis(clouds, chosen[..., None], axis=-2) + noise * rng.standard_normal(clouds.shape)

    # Outliers lie anywhere in the box around the cloud.
    low = clouds.min(axis=-2, keepdims=True) - MARGIN
    high = clouds.max(axis=-2, keepdims=True) + MARGIN
    is_outlier = rng.permuted(places, axis=-1) < round(outliers * n_points)
    return np.where(is_outlier[..., None], rng.uniform(low, high, clouds.shape), spoilt)
