"""End of a command on a signal, also while a program compiles and Python cannot call the handler.

A handler runs in the main thread, and only between two steps of Python. A program that is being compiled keeps that
thread in C++ for minutes, or keeps it waiting for threads that are. So a separate thread receives every signal:

- Ctrl-C (SIGINT) is answered at once. Work in progress comes to its end, and finished work is written; a second one
  ends the process immediately.
- SIGTERM, as from a batch system, and SIGHUP, of a lost connection, end the process within two seconds.

The stored part of a run is consistent at every moment, so that a process may end at any.
"""

import contextlib
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time

from jexplore.cli.output.console import say, tell, under_way
from jexplore.engine.threads import interruption

SOON_S = 0.3  # what has ended by then needs no answer; interruptions closer than this are one: some tools send two
GRACE_S = 0.8  # in which SIGTERM may end a run in an orderly way
LAST_S = 1.0  # at most, for the last words, however slow the folder or the reader of stderr is


class Signals:
    """Listens for what ends this process."""

    ended_by: list[int]
    """Numbers of signals that have ended this process, the last one at the end."""

    def __init__(self) -> None:
        self.ended_by, self._heard, self._dropped = [int(signal.SIGINT)], None, 0
        self._over = threading.Event()

    def listen(self) -> None:
        """Begin to listen. State shared among this process's threads must be settled before."""
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) == signal.SIG_DFL:  # not under nohup
                signal.signal(number, self._handle)
        sys.unraisablehook = self._repeat
        ears, self._mouth = socket.socketpair()
        self._mouth.setblocking(False)
        signal.set_wakeup_fd(self._mouth.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._hear, args=(ears,), daemon=True).start()

    def end(self) -> None:
        """Stop answering: the command is over."""
        self._over.set()

    def _handle(self, number, frame):
        self.ended_by.append(number)
        raise KeyboardInterrupt

    def _repeat(self, unraisable):
        """Raise an interruption again, a little later, that Python dropped.

        Python drops exceptions that nobody can catch, as in the function that jax calls after every garbage collection.
        """
        if unraisable.exc_type is KeyboardInterrupt:
            self._dropped += 1
            threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
        else:
            sys.__unraisablehook__(unraisable)

    def _hear(self, ears):
        while True:
            number = ears.recv(1)[0]
            if number == signal.SIGINT:
                self._interrupt()
            elif number in (getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")):
                _later(GRACE_S, self._quit, number)

    def _interrupt(self):
        now = time.monotonic()
        if self._dropped:
            self._dropped -= 1
        elif self._heard is None:
            self._heard = now
            interruption.hear()
            _later(SOON_S, self._answer)
        elif now - self._heard > SOON_S:
            self._quit(int(signal.SIGINT))

    def _answer(self):
        if not self._over.is_set():
            tell("jexplore: interrupted: what is under way comes to its end first; Ctrl-C once more ends at once")

    def _quit(self, number):
        """End the process, wherever its main thread is."""
        words = threading.Thread(target=_last_words, args=(number,), daemon=True)
        words.start()
        words.join(LAST_S)
        os._exit(number + 128)


def _later(seconds, act, *args):
    timer = threading.Timer(seconds, act, args)
    timer.daemon = True
    timer.start()


def _last_words(number):
    for child in multiprocessing.active_children():
        child.kill()
    for out in list(under_way):
        with contextlib.suppress(Exception):  # the main thread may be just about to do the same
            out.say_kept()
            out.run.release()
    name = "a second Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
    say(f"jexplore: ended at once by {name}", number + 128)
