"""A replay: one episode as the frames of a page."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from jexplore.report.page.packing import base64_of, change, packed_numbers, runs

_BY_FRAME = "steps", "heading_deg", "target"
STATE, FRONTIER, OWN_ROOM = 3, 4, 8
"""Of the code of a cell: the bits of its state (0 unknown, 1 free, 2 occupied); whether it is a frontier cell that can
be reached; whether the strategy takes it for a part of the room that the robot is in."""


@dataclasses.dataclass(frozen=True, eq=False)
class RobotReplay:
    """A robot in an episode of n steps as F frames. Numpy arrays, on the host."""

    rows: np.ndarray
    """`[n + 1]` int, the robot's cell at the start and after each step."""
    cols: np.ndarray
    """`[n + 1]` int"""
    steps: np.ndarray
    """`[F]` int, steps made before each frame, increasing; the last one n."""
    heading_deg: np.ndarray
    """`[F]` int"""
    target: np.ndarray
    """`[F, 2]` int, row and col of what the robot goes to next; -1 for none."""


@dataclasses.dataclass(frozen=True, eq=False)
class ReplayData(RobotReplay):
    """An episode and its first robot; what the page shows besides is made from them.

    Raises:
      ValueError: steps that do not increase up to the last one, or a step of more than one cell.
    """

    world: str
    strategy: str
    which: str
    """Of the run: its seed, its settings, or whatever tells it from others of its world and strategy."""
    episode: int
    """Its number in the run."""
    outcome: str
    cell_m: float
    truth: np.ndarray
    """`[H, W]` bool, True where the world is occupied."""
    rooms: np.ndarray | None
    """`[H, W]` int, number of the true room; -1 outside rooms. None for a world without."""
    until: np.ndarray
    """`[F]` int, steps made when it has ended to go there."""
    known_m2: np.ndarray
    """`[F]`"""
    changes: tuple[bytes, ...]
    """`[F]` what changed in the map of codes, see `packing.runs`; at first from all 0."""
    has_own_room: bool = False
    """True if the strategy has a room of its own."""
    others: tuple[RobotReplay, ...] = ()
    """The robots of a team besides this one."""
    clock_m: np.ndarray | None = None
    """`[F]` of a team, its clock, metres; steps then need not increase. None: a robot alone."""

    def __post_init__(self) -> None:
        steps = len(self.rows) - 1
        least = 1 if self.clock_m is None else 0
        if not len(self.steps) or (np.diff(self.steps) < least).any() or self.steps[0] < 0 or self.steps[-1] != steps:
            raise ValueError(f"expected steps that increase up to {steps}, got {list(self.steps)[:20]}")
        if np.abs(np.diff([self.rows, self.cols])).max(initial=0) > 1:
            raise ValueError("expected rows and cols of neighbouring cells, got a jump")

    def maps(self) -> Iterator[np.ndarray]:
        """Yield the codes of all cells, frame by frame: `[H, W]` uint8. The same array, changed in place."""
        image = np.zeros(self.truth.shape, np.uint8)
        for found in self.changes:
            change(image, found)
            yield image

    def thinned(self, most: int) -> "ReplayData":
        """Return the same replay with at most `most` frames, evenly chosen, the last among them."""
        frames = len(self.steps)
        if frames <= most:
            return self
        chosen = evenly(frames - 1, most)
        changes = tuple(changes_of(image for i, image in enumerate(self.maps()) if i in chosen))
        clock_m = None if self.clock_m is None else self.clock_m[chosen]
        parts: dict[str, Any] = {"changes": changes, "clock_m": clock_m}
        parts |= {"until": self.until[chosen], "known_m2": self.known_m2[chosen], **_frames_of(self, chosen)}
        others = tuple(dataclasses.replace(other, **_frames_of(other, chosen)) for other in self.others)
        return dataclasses.replace(self, **parts, others=others)


def _frames_of(robot, chosen):
    return {name: getattr(robot, name)[chosen] for name in _BY_FRAME}


def changes_of(images: Iterable[np.ndarray]) -> Iterator[bytes]:
    """Yield `ReplayData.changes` of maps of codes, uint8, which may be one array that changes."""
    before = None
    for image in images:
        before = np.zeros_like(image) if before is None else before
        yield runs(before, image)
        before[...] = image


def evenly(steps: int, most: int) -> list[int]:
    """Return at most `most` of the numbers from 0 to `steps`, evenly spaced, the last one among them."""
    return np.unique(np.linspace(steps, 0, min(most, steps + 1)).round().astype(int)).tolist()


def _image(codes):
    return base64_of(runs(np.zeros_like(codes), codes))


def _world(replay):
    rooms = None if replay.rooms is None else np.where(replay.rooms < 0, 0, 1 + replay.rooms % 15).astype(np.uint8)
    return {
        "name": str(replay.world),
        "shape": list(replay.truth.shape),
        "cell_m": float(replay.cell_m),
        "truth": _image(replay.truth.astype(np.uint8)),
        "rooms": None if rooms is None or not rooms.any() else _image(rooms),
    }


def _way(robot: Any) -> dict[str, Any]:
    """Return the way of a robot, and its state in every frame."""
    moves = 3 * (1 + np.diff(robot.rows)) + 1 + np.diff(robot.cols)
    return {
        "start": [int(robot.rows[0]), int(robot.cols[0])],
        "moves": base64_of(moves.astype(np.uint8).tobytes()),
        **{name: packed_numbers(getattr(robot, name)) for name in _BY_FRAME},
    }


def page_data(replays: Sequence[ReplayData]) -> dict[str, Any]:
    """Return the data for the page: `worlds`, each once, and `replays`, plain JSON types.

    A replay's `moves` are a byte a step, 3 * (1 + rows up) + (1 + cols right); its `changes` lie end to end, `sizes`
    bytes a frame.
    """
    worlds, numbers, found = [], {}, []
    for replay in replays:
        # One world's name may stand for two worlds, if they came as objects.
        key = replay.world, replay.cell_m, replay.truth.shape, replay.truth.tobytes()
        if key not in numbers:
            numbers[key] = len(worlds)
            worlds.append(_world(replay))
        found.append(
            {
                "world": numbers[key],
                **{name: str(getattr(replay, name)) for name in ("strategy", "which", "outcome")},
                "episode": int(replay.episode),
                **_way(replay),
                "until": packed_numbers(replay.until),
                "others": [_way(other) for other in replay.others],
                "clock_m": None if replay.clock_m is None else packed_numbers(replay.clock_m, 0.01, "clock_m"),
                "known_m2": packed_numbers(replay.known_m2, 0.01, "known_m2"),
                "sizes": packed_numbers([len(part) for part in replay.changes]),
                "changes": base64_of(b"".join(replay.changes)),
                "has_own_room": bool(replay.has_own_room),
            }
        )
    return {"worlds": worlds, "replays": found}
