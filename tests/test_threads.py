"""Threads that share work: what is done, what is kept when it is stopped."""

import dataclasses
import signal
import threading
import time

import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.engine import threads


@dataclasses.dataclass(kw_only=True)
class Squares(threads.Work):
    """Squares of the first numbers; `seconds` a piece."""

    seconds: float = 0.0
    fails_at: int = -1
    found: dict = dataclasses.field(default_factory=dict)
    calls: list = dataclasses.field(default_factory=list)

    def call(self, first, n):
        if first <= self.fails_at < first + n:
            raise ValueError("out of order")
        time.sleep(self.seconds * n)
        return [i * i for i in range(first, first + n)], max(self.seconds * n, 1e-9)

    def keep(self, first, n, found):
        assert threading.current_thread() is threading.main_thread()
        self.calls.append((first, n))
        self.found |= dict(zip(range(first, first + n), found, strict=True))


@pytest.mark.parametrize("workers", [1, 3])
def test_every_piece_is_done_once(workers):
    works, seen = [Squares(pieces=50, most=7), Squares(pieces=0, most=7), Squares(pieces=3, most=1)], []
    threads.run(works, workers, seen.append)
    for work in works:
        assert work.found == {i: i * i for i in range(work.pieces)}
        assert sum(n for _, n in work.calls) == work.pieces
        assert all(n <= work.most for _, n in work.calls)
    assert seen == sorted(seen)
    assert seen[-1] == 53


def test_a_call_takes_about_a_second():
    work = Squares(pieces=1000, most=64, n_devices=2)
    assert work.take(2) == (0, 2)  # one a device, to begin with
    for piece_s, n in ((0.1, 20), (2.0, 2), (1e-9, 128)):
        work.piece_s = piece_s
        assert work.take(2)[1] == n
    work.next = 990
    assert [work.take(2), work.take(2), work.take(2)] == [(990, 6), (996, 2), (998, 2)]  # shared to the end


def test_works_take_turns():
    calls = []
    works = [Squares(pieces=5, most=1) for _ in range(2)]
    for name, work in zip("ab", works):
        work.keep = lambda first, n, found, name=name: calls.append((name, first))
    threads.run(works, 1, lambda done: None)
    assert calls == [(name, i) for i in range(5) for name in "ab"]


def test_what_fails_in_a_thread_is_raised_and_the_rest_is_kept():
    works = [Squares(pieces=8, most=1, fails_at=3), Squares(pieces=8, most=1, seconds=0.01)]
    with pytest.raises(ValueError, match="out of order"):
        threads.run(works, 2, lambda done: None)
    assert set(works[0].found) <= {0, 1, 2}
    assert len(works[1].found) == works[1].next  # what had begun was waited for
    assert threading.active_count() < 10


def test_an_interruption_keeps_what_is_under_way():
    work = Squares(pieces=1000, most=1, seconds=0.02)

    def stop(done):
        if done >= 10:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        threads.run([work], 2, stop)
    assert 10 <= len(work.found) == work.next < 20
    assert work.found == {i: i * i for i in range(work.next)}


@pytest.mark.jit
def test_pieces_in_turn_in_one_program():
    results, last = threads.in_turn(lambda i: ({"square": i * i, "pair": jnp.stack([i, -i])}, i), 6, 4)
    assert results["square"].tolist() == [0, 1, 4, 9, 0, 0]
    np.testing.assert_array_equal(results["pair"][:4, 1], [0, -1, -2, -3])
    assert int(last) == 3
