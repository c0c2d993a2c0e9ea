"""Independent parts at once: their order, their errors, and how many there are."""

import threading

import numpy as np
import pytest
from omnislip import _core
from omnislip.gap.side_by_side import side_by_side
from threadpoolctl import threadpool_info


@pytest.fixture
def two_threads():
    before = _core.most_threads()
    _core.limit_threads(2)
    yield
    _core.limit_threads(before)


def test_results_come_in_the_order_of_the_items(two_threads):
    """The first waits for the second."""
    second = threading.Event()

    def work(item):
        assert second.wait(10.0) if item == 0 else second.set() is None
        return item**2

    assert side_by_side(work, range(5)) == [0, 1, 4, 9, 16]


def test_no_more_threads_than_an_engine_may_use():
    before = _core.most_threads()
    _core.limit_threads(1)
    try:
        names = side_by_side(lambda _: threading.current_thread().name, range(20))
    finally:
        _core.limit_threads(before)
    assert len(set(names)) == 1


def test_an_error_is_that_of_the_work(two_threads):
    def work(item):
        raise ValueError(f"item {item}")

    with pytest.raises(ValueError, match="item 0"):
        side_by_side(work, range(3))


def test_nothing_gives_nothing():
    assert side_by_side(lambda item: item, []) == []


def test_linear_algebra_does_not_compete_with_what_runs_side_by_side():
    """In tests, too, whatever they import first."""
    np.linalg.inv(np.eye(2))
    found = [one["num_threads"] for one in threadpool_info() if one["internal_api"] == "openblas"]
    assert found
    assert set(found) == {1}
