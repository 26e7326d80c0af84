"""Normalisation statistics of each feature, keys and shapes as in LeRobot's `meta/stats.json`. Pure.

Quantiles are exact, over all values. LeRobot estimates its own with a histogram, and those of a whole data
set by weighting the quantiles of the episodes.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
Stats = dict[str, list[Any]]


def stats(column: NDArray[Any]) -> Stats:
    """Return the statistics of a column (k,) or (k, n), k > 0: lists of n numbers (or of 1).

    `count` is the number of frames.
    """
    rows = column.reshape(len(column), -1)
    wide = rows.astype(np.float64)
    found: Stats = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
    found |= {"mean": wide.mean(axis=0).tolist(), "std": wide.std(axis=0).tolist(), "count": [len(rows)]}
    quantiles = np.quantile(wide, list(QUANTILES.values()), axis=0)
    return found | {name: row.tolist() for name, row in zip(QUANTILES, quantiles, strict=True)}


def flat(of: Mapping[str, Stats]) -> dict[str, list[Any]]:
    """Return the statistics as columns of `meta/episodes`: stats/FEATURE/KEY."""
    return {f"stats/{name}/{key}": value for name, each in of.items() for key, value in each.items()}
