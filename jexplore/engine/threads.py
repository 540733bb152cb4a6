"""Work that the cores of a CPU share: threads take turns at calls of compiled programs, each about a second long.

XLA lets go of the interpreter lock while a program runs.
"""

import collections
import dataclasses
import time
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

CALL_S = 1.0  # seconds that a call should take: how often progress moves, and how long Ctrl-C waits
LOST_S = 0.5  # seconds after which an interruption that was heard, but has not come as an exception, is taken for lost
IN_ROTATION = 64  # kinds that are under way at a time: each ends, and can be kept, before many others begin


class Interruption:
    """When a process was last interrupted. The exception that Python raises for it is lost where it falls into C."""

    since: float | None = None

    def hear(self) -> None:
        """Note an interruption, from any thread."""
        self.since = time.monotonic()

    def raise_if_lost(self) -> None:
        """Raise what was heard and has not come.

        Raises:
          KeyboardInterrupt: it was heard `LOST_S` ago.
        """
        if self.since is not None and time.monotonic() - self.since > LOST_S:
            raise KeyboardInterrupt


interruption = Interruption()


@dataclasses.dataclass
class Pieces:
    """Pieces of work of one kind, of which a call does several."""

    total: int
    most: int  # in one call
    call: Callable[[int, int], Any]  # (first, n) -> found: does n pieces; threads call it
    keep: Callable[[int, int, Any], object]  # (first, n, found): keeps it; the thread of `share_out` calls this
    phase: int = 0  # nothing of a later phase is begun before all of this one is
    next: int = dataclasses.field(default=0, init=False)
    piece_s: float | None = dataclasses.field(default=None, init=False)  # seconds a piece, once known

    def take(self, workers: int) -> tuple[int, int]:
        """Cut off the next call, `(first, number)`: one piece at first, then as many as take about a second.

        Only whole pieces: an episode is never cut.
        """
        left = self.total - self.next
        n = 1 if self.piece_s is None else int(CALL_S / max(self.piece_s, 1e-6))
        n = min(left, max(1, min(n, self.most, -(-left // workers))))
        first = self.next
        self.next += n
        return first, n

    def timed(self, first: int, n: int) -> tuple[Any, float]:
        """Do some pieces: `(found, seconds)`."""
        began = time.perf_counter()
        return self.call(first, n), time.perf_counter() - began


def share_out(
    kinds: Iterable[Pieces],
    workers: int,
    on_progress: Callable[[int], object],
    give_up: Callable[[], object] = lambda: None,
) -> None:
    """Process all pieces of some kinds, in the order given: each call is cut off as one of the `workers` becomes free.

    Those of a phase are processed in rotation, `IN_ROTATION` at a time: an interrupted one has a part of each, or, with
    very many kinds, some whole ones. `on_progress` is called with the number of finished pieces, from the calling
    thread; `give_up` when it ends early, to make running calls return. An interruption is raised after running calls
    have ended; their results are kept.
    """
    waiting: collections.deque[Pieces] = collections.deque()
    running: dict[Future[tuple[Any, float]], tuple[Pieces, int, int]] = {}
    done = 0
    later = collections.deque(sorted((pieces for pieces in kinds if pieces.total), key=lambda pieces: pieces.phase))
    pool = ThreadPoolExecutor(workers)

    def finish(future: Future[tuple[Any, float]]) -> int:
        pieces, first, n = running.pop(future)
        found, seconds = future.result()
        pieces.keep(first, n, found)
        pieces.piece_s = seconds / n
        return n

    try:
        while waiting or running or later:
            while (waiting or later) and len(running) < workers:
                while later and (not waiting or (later[0].phase == waiting[0].phase and len(waiting) < IN_ROTATION)):
                    waiting.append(later.popleft())
                pieces = waiting.popleft()
                first, n = pieces.take(workers)
                running[pool.submit(pieces.timed, first, n)] = pieces, first, n
                if pieces.next < pieces.total:
                    waiting.append(pieces)
            done += sum(finish(future) for future in wait(running, return_when=FIRST_COMPLETED).done)
            on_progress(done)
            interruption.raise_if_lost()
    except BaseException:
        interruption.since = None
        give_up()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for future in [future for future in running if not future.cancelled() and future.exception() is None]:
            finish(future)
