"""Work that threads share is all done, once and in order, and in a forked process as well."""

import os
import threading

import pytest
import torch

from loops.threads import in_threads


@pytest.fixture(params=[1, 2, 3])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.mark.parametrize("blocks", [0, 1, 2, 7])
def test_parts_are_the_whole(threads, blocks):
    parts = in_threads(lambda which: list(range(*which)), blocks)
    assert sum(parts, []) == list(range(blocks))
    assert len(parts) == max(1, min(threads, blocks))


def test_threads_work_at_the_same_time_and_are_kept(threads):
    together = threading.Barrier(threads, timeout=60)

    def part(which: tuple[int, int]) -> int:
        together.wait()
        return threading.get_ident()

    assert len({*in_threads(part, threads), *in_threads(part, threads)}) == threads


def test_what_goes_wrong_in_a_part_is_raised(threads):
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda which: 1 // (which[1] - 3), 3)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork")
def test_a_forked_process_has_threads_of_its_own(threads):
    in_threads(sum, threads)
    child = os.fork()
    if child == 0:
        done = in_threads(lambda which: which[1], 3)[-1] == 3
        os._exit(0 if done else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
