"""The different numbers of an array."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.number[Any])


def distinct(numbers: NDArray[Number]) -> NDArray[Number]:
    """The different numbers of an array of any shape in rising order, shape [k].

    As `np.unique` alone finds them; but NumPy 2.3 and 2.4 hash then, which takes ten times as long
    as sorting. Where equal ones are to be counted, they sort.
    """
    found: NDArray[Number] = np.unique(numbers, return_counts=True)[0]
    return found
