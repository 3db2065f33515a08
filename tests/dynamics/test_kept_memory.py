"""Memory that is used again, by several threads at once."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from dynamics.compiled.memory import Kept


def test_threads_that_take_and_let_go_never_hold_the_same():
    def work(name: int) -> int:
        wrong = 0
        for _ in range(1_000):
            mine = Kept((3, 5), np.float64)
            mine.array[:] = name
            time.sleep(0)  # another's turn
            wrong += int((mine.array != name).any())
        return wrong

    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(work, range(8))) == 0
