"""Work that the cores of a CPU share: threads take turns at calls of compiled programs, each about a second long.

XLA lets go of the interpreter lock while a program runs.
"""

import dataclasses
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait

import jax
import jax.numpy as jnp
from jax import lax

CALL_S = 1.0  # seconds that a call should take: how often progress moves, and how long Ctrl-C waits


def in_turn(piece, capacity, count):
    """Pieces of work one after the other, in one program.

    Args:
      piece: function of int32 i: `(result, last)`, pytrees of arrays.
      capacity: n, most pieces. Static.
      count: int32, pieces to be done.

    Returns:
      `(results, last)`: results with a leading axis of n, zeros from `count` on; `last` of the last piece done.
    """

    def one(i, state):
        result, last = piece(i)
        return jax.tree.map(lambda all_, new: all_.at[i].set(new), state[0], result), last

    result, last = jax.eval_shape(piece, 0)
    results = jax.tree.map(lambda a: jnp.zeros((capacity, *a.shape), a.dtype), result)
    return lax.fori_loop(0, count, one, (results, jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), last)))


@dataclasses.dataclass(kw_only=True)
class Work:
    """Pieces of work of one kind, of which a call does several. A subclass says how."""

    pieces: int
    most: int  # in one call on one device
    n_devices: int = 1
    next: int = dataclasses.field(default=0, init=False)
    piece_s: float | None = dataclasses.field(default=None, init=False)  # seconds a piece and device, once known

    def call(self, first, n):
        """Does n pieces: `(found, seconds)`. Threads call it."""
        raise NotImplementedError

    def keep(self, first, n, found):
        """Keeps what a call has found. The thread that calls `run` calls it."""
        raise NotImplementedError

    def take(self, workers):
        """The next pieces, `(first, number)`: one a device at first, then as many as take about a second."""
        left, d = self.pieces - self.next, self.n_devices
        n = 1 if self.piece_s is None else int(CALL_S / max(self.piece_s, 1e-6))
        n = min(left, d * max(1, min(n, self.most, -(-left // (workers * d)))))
        first = self.next
        self.next += n
        return first, n


def run(works, workers, on_progress):
    """Does all pieces of some works, all works in turn, so that what is interrupted has done a part of each.

    Args:
      works: list of `Work`.
      workers: threads.
      on_progress: called with the number of pieces done so far, from the calling thread.

    Raises:
      KeyboardInterrupt: after the calls under way have ended; what they found has been kept.
    """
    waiting, running, done = [work for work in works if work.pieces], {}, 0
    pool = ThreadPoolExecutor(workers)

    def finish(future):
        work, first, n = running.pop(future)
        found, seconds = future.result()
        work.keep(first, n, found)
        work.piece_s = seconds * work.n_devices / n
        return n

    try:
        while waiting or running:
            while waiting and len(running) < workers:
                work = waiting.pop(0)
                first, n = work.take(workers)
                running[pool.submit(work.call, first, n)] = work, first, n
                if work.next < work.pieces:
                    waiting.append(work)
            done += sum(finish(future) for future in wait(running, return_when=FIRST_COMPLETED).done)
            on_progress(done)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for future in [future for future in running if not future.cancelled() and future.exception() is None]:
            finish(future)
