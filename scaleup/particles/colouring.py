"""Which component a grain is of: the loading pattern laid in the settled level bed."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from scaleup.contract import FloatArray, IntArray, Loading
from scaleup.mixing.loading import DOWN_THE_LAYERS
from scaleup.particles.pouring import Grains
from scaleup.scene.loading_file import read_loading
from scaleup.system.errors import InputError


def components_of(loading: Loading, grains: Grains, dimension: int, seed: int) -> IntArray:
    """The number of each grain's component, from 0, (n,).

    Layers are cut so that each has its share of the grains' volume, to within a grain. A file gives
    each grain one of the nearest point's components, by chance in proportion to its concentrations.
    Raises InputError if the bed holds nothing of a component, or nothing else.
    """
    points = grains.position[:, :dimension]
    if loading.pattern == "region":
        away = np.linalg.norm(points - np.array(loading.centre), axis=1)
        component = np.where(away <= loading.radius, 0, 1)
    elif loading.pattern == "file":
        assert loading.file is not None  # the model's validator has seen to it
        known, concentration = read_loading(loading.file, dimension)
        _, nearest = cKDTree(known).query(points)
        bounds = np.cumsum(concentration[:, nearest], axis=0)
        drawn = np.random.default_rng(seed).random(len(points)) * bounds[-1]
        component = (drawn >= bounds[:-1]).sum(axis=0)
    else:
        component = _layers(loading, points, grains.volume)
    shares = np.bincount(component, weights=grains.volume) / grains.volume.sum()
    for number, share in enumerate(shares, start=1):
        if share <= 0 or share >= 1:
            raise InputError(
                f"operation.loading: component {number} is {share:.0%} of the bed; there is "
                "nothing to blend"
            )
    return component.astype(np.int64)


def _layers(loading: Loading, points: FloatArray, volume: FloatArray) -> IntArray:
    axis, sign = DOWN_THE_LAYERS[loading.direction or "x"]
    order = np.argsort(sign * points[:, axis], kind="stable")
    middle = np.cumsum(volume[order]) - 0.5 * volume[order]
    cuts = np.cumsum(loading.layers)[:-1] * volume.sum()
    layer = np.empty(len(points), dtype=np.int64)
    layer[order] = np.searchsorted(cuts, middle)
    return np.array(loading.layer_components)[layer] - 1
