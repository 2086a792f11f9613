"""Clouds as a worse sensor would see them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_MARGIN = 0.1  # metres around a cloud's box in which outliers lie


def spoil(
    clouds: NDArray[np.floating],
    rng: np.random.Generator,
    *,
    noise: ArrayLike = 0.0,
    outliers: ArrayLike = 0.0,
    keep: ArrayLike = 1.0,
) -> NDArray[np.float64]:
    """Return clouds with points missing, noise and outliers, every cloud for itself.

    Parameters
    ----------
    clouds : (..., P, 3) array
    rng : numpy.random.Generator
    noise : float or array that broadcasts to the leading axes of `clouds`
        Standard deviation of each coordinate, metres.
    outliers : float or such an array
        Share of the points that are anywhere in the cloud's box, which is grown by 10 cm on each side.
    keep : float or such an array
        Share of the points that are kept, at least one. They come first, in the order in which they were; repeats of them, in
        their order, stand for the others.

    Returns
    -------
    (..., P, 3) float64
    """
    clouds = np.asarray(clouds, dtype=np.float64)
    noise, outliers, keep = (
        np.broadcast_to(amount, clouds.shape[:-2])[..., None] for amount in (noise, outliers, keep)
    )
    places = np.broadcast_to(np.arange(clouds.shape[-2]), clouds.shape[:-1])
    left = np.maximum(np.round(keep * clouds.shape[-2]), 1).astype(np.int64)
    order = np.argsort(rng.permuted(places, axis=-1) >= left, axis=-1, kind="stable")  # kept ones first, as they were
    kept = np.take_along_axis(order, places % left, axis=-1)
    spoilt = np.take_along_axis(clouds, kept[..., None], axis=-2) + noise[..., None] * rng.standard_normal(clouds.shape)
    low, high = clouds.min(axis=-2, keepdims=True) - _MARGIN, clouds.max(axis=-2, keepdims=True) + _MARGIN
    wild = rng.permuted(places, axis=-1) < np.round(outliers * clouds.shape[-2])
    return np.where(wild[..., None], rng.uniform(low, high, clouds.shape), spoilt)
