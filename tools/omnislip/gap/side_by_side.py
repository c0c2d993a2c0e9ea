"""Independent parts of the workflow at once.

The engine uses all cores by itself, but between its calls is linear algebra that uses one. Numpy
and the engine let other threads run meanwhile.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from omnislip import _core

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return the results of work on all items, in their order, by as many threads as an engine."""
    with ThreadPoolExecutor(_core.most_threads()) as pool:
        return list(pool.map(work, items))
