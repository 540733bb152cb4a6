"""Threads that share work: its results, and those of an interrupted one."""

import signal
import threading
import time

import pytest

from jexplore.engine.threads import IN_ROTATION, Pieces, share_out


def squares(total, most, *, seconds=0.0, fails_at=-1):
    """`Pieces` that find the squares of the first numbers, `seconds` each; with what they found and the calls made."""
    found, calls = {}, []

    def call(first, n):
        if first <= fails_at < first + n:
            raise ValueError("out of order")
        time.sleep(seconds * n)
        return [i * i for i in range(first, first + n)]

    def keep(first, n, values):
        assert threading.current_thread() is threading.main_thread()
        calls.append((first, n))
        found.update(zip(range(first, first + n), values, strict=True))

    return Pieces(total=total, most=most, call=call, keep=keep), found, calls


@pytest.mark.parametrize("workers", [1, 3])
def test_every_piece_is_done_once(workers):
    kinds, seen = [squares(50, 7), squares(0, 7), squares(3, 1)], []
    share_out([pieces for pieces, *_ in kinds], workers, seen.append)
    for pieces, found, calls in kinds:
        assert found == {i: i * i for i in range(pieces.total)}
        assert sum(n for _, n in calls) == pieces.total
        assert all(n <= pieces.most for _, n in calls)
    assert seen == sorted(seen)
    assert seen[-1] == 53


def test_a_call_takes_about_a_second():
    work, *_ = squares(1000, 64)
    assert work.take(2) == (0, 1)  # one, to begin with
    for piece_s, n in ((0.1, 10), (2.0, 1), (1e-9, 64)):
        work.piece_s = piece_s
        assert work.take(2)[1] == n
    work.next = 990
    assert [work.take(2), work.take(2), work.take(2)] == [(990, 5), (995, 3), (998, 1)]  # shared to the end


def test_works_take_turns():
    calls = []
    works = [squares(5, 1)[0] for _ in range(2)]
    for name, work in zip("ab", works):
        work.keep = lambda first, n, found, name=name: calls.append((name, first))
    share_out(works, 1, lambda done: None)
    assert calls == [(name, i) for i in range(5) for name in "ab"]


@pytest.mark.parametrize("workers", [1, 2])
def test_of_very_many_works_the_first_end_before_the_last_begin(workers):
    calls, n = [], 3 * IN_ROTATION
    works = [squares(4, 1)[0] for _ in range(n)]
    for number, work in enumerate(works):
        work.keep = lambda first, n, found, number=number: calls.append((number, first))
    share_out(works, workers, lambda done: None)
    last_begins = calls.index((n - 1, 0))
    ended = sum(first == 3 for _, first in calls[:last_begins])
    assert n - IN_ROTATION - workers <= ended < n
    assert sorted(calls) == [(number, first) for number in range(n) for first in range(4)]


def test_what_fails_in_a_thread_is_raised_and_the_rest_is_kept():
    fails, whole = squares(8, 1, fails_at=3), squares(8, 1, seconds=0.01)
    before = threading.active_count()  # other tests leave idle pools
    with pytest.raises(ValueError, match="out of order"):
        share_out([fails[0], whole[0]], 2, lambda done: None)
    assert set(fails[1]) <= {0, 1, 2}
    assert len(whole[1]) == whole[0].next  # what had begun was waited for
    assert threading.active_count() <= before


def test_an_interruption_keeps_what_is_under_way():
    work, found, _ = squares(1000, 1, seconds=0.02)

    def stop(done):
        if done >= 10:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        share_out([work], 2, stop)
    assert 10 <= len(found) == work.next < 20
    assert found == {i: i * i for i in range(work.next)}
