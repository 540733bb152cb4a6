"""What a compiled program launches on a device, read from the texts that XLA writes: kernels, copies, loops, graphs."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from jexplore.bench.ahead.hlo import Module

WIDE = 64  # bytes that a kernel moves of every lane, from which on it should be more than a single block
_STEP = re.compile(r"^( *)(\d+): (k\w+) +\[[^\]]*\] ?(.*)$")
_NOTHING = re.compile(r"^ *No thunks\. *", re.MULTILINE)  # stands before what follows, on its line
_GRID = re.compile(r"^(\S+) grid: \[(\d+), (\d+), (\d+)\] threads: \[(\d+), (\d+), (\d+)\]")
_INFO = re.compile(r'profile_annotation: "([^"]*)"\s+thunk_id: (\d+)')
_ENTRY = re.compile(r"\.entry ([\w$]+)")


class Launch(NamedTuple):
    """A kernel, or a copy."""

    name: str  # of the instruction of the program
    kernel: str  # of the code, which several instructions may share; "" for a copy
    blocks: int  # 0 for a copy, which the device's own engine makes
    threads: int = 0  # of all blocks


class Graph(NamedTuple):
    """Launches that are handed over together: a CUDA graph."""

    steps: list["Step"]


class Loop(NamedTuple):
    """A loop."""

    name: str  # of the instruction
    scope: str  # names of the parts of the program that it lies in, as "decide/map/wave"
    trips: int | None  # turns, where the compiler knows them; else the condition is computed on the device
    condition: list["Step"]
    body: list["Step"]


Step = Launch | Graph | Loop


def read(thunks: str, metadata: str, module: Module) -> list[Step]:
    """The launches of a program.

    Args:
      thunks: text of `*.thunk_sequence_after_thunk_passes.txt`.
      metadata: text of `*.thunk_metadata.txt`.
      module: `hlo.Module` of the program.

    Raises:
      ValueError: a line that is none of those known.
    """
    names = {int(number): name for name, number in _INFO.findall(metadata)}
    lines = [line for line in _NOTHING.sub("", thunks).splitlines() if line.strip()]
    steps, end = _block(lines, 0, 0, names, module)
    if end < len(lines):
        raise ValueError(f"expected a launch, got {lines[end]!r}")
    return steps


def _block(lines, at, indent, names, module):
    """Steps of one depth, from line `at` on: `(steps, the line after them)`."""
    steps = []
    while at < len(lines):
        found = _STEP.match(lines[at])
        if found is None or len(found[1]) != indent:
            break
        number, kind, rest = int(found[2]), found[3], found[4]
        name = names.get(number, "")
        at += 1
        if kind == "kWhile":
            at = _marker(lines, at, "condition:")
            condition, at = _block(lines, at, indent + 4, names, module)
            at = _marker(lines, at, "body:")
            body, at = _block(lines, at, indent + 4, names, module)
            trips, scope = module.loops.get(name, (None, ""))
            steps.append(Loop(name, scope, trips, condition, body))
        elif at < len(lines) and (below := _STEP.match(lines[at])) and len(below[1]) > indent:
            inner, at = _block(lines, at, len(below[1]), names, module)
            steps += [Graph(inner)] if kind == "kCommandBuffer" else inner
        else:
            grid = _GRID.match(rest)
            sizes = [int(n) for n in grid.groups()[1:]] if grid else [0] * 6
            blocks, threads = math.prod(sizes[:3]), math.prod(sizes)
            steps.append(Launch(name, grid[1] if grid else "", blocks, threads))
    return steps, at


def _marker(lines, at, text):
    if at >= len(lines) or lines[at].strip() != text:
        raise ValueError(f"expected {text!r}, got {lines[at] if at < len(lines) else 'the end'!r}")
    return at + 1


def walk(steps: Iterable[Step]) -> Iterator[Step]:
    """Every step, those of loops and graphs included, outermost first."""
    for step in steps:
        yield step
        if isinstance(step, Graph):
            yield from walk(step.steps)
        elif isinstance(step, Loop):
            yield from walk([*step.condition, *step.body])


def loops(steps: Iterable[Step]) -> list[Loop]:
    """Every loop whose turns the compiler does not know."""
    return [step for step in walk(steps) if isinstance(step, Loop) and step.trips is None]


def host_decided(steps: Iterable[Step]) -> list[Loop]:
    """The loops among them that the host goes round, waiting for the device before every turn: those in no graph."""
    found = []
    for step in steps:
        if isinstance(step, Loop):
            found += [step] * (step.trips is None) + host_decided([*step.condition, *step.body])
    return found


def per_turn(steps: Iterable[Step]) -> int:
    """Kernels and copies of one pass over some steps.

    Loops of known length count as often as they go round; of the others only one look at the condition.
    """
    total = 0
    for step in steps:
        if isinstance(step, Launch):
            total += 1
        elif isinstance(step, Graph):
            total += per_turn(step.steps)
        elif step.trips is None:
            total += per_turn(step.condition)
        else:
            total += step.trips * per_turn(step.body)
    return total


def per_iteration(loop: Loop) -> int:
    """Kernels and copies of one turn of a loop, its condition included."""
    return per_turn(loop.condition) + per_turn(loop.body)


def single_blocks(steps: Iterable[Step], module: Module, n_lanes: int) -> list[str]:
    """Instructions whose kernel is a single block and moves much of every lane (`WIDE`), sorted by name."""
    one = {step.name for step in walk(steps) if isinstance(step, Launch) and step.blocks == 1}
    wide = (name for name in one if module.traffic(name).n_bytes >= WIDE * n_lanes)
    return sorted(name for name in wide if module.has_axis(name, n_lanes))


def cas_loops(kernels: Mapping[str, str], steps: Iterable[Step]) -> list[str]:
    """Instructions that write by compare-and-swap, again and again until nobody came in between; sorted by name.

    Args:
      kernels: name of a kernel -> its PTX.
      steps: launches of the program.
    """
    slow = {name for name, text in kernels.items() if re.search(r"\batom\S*\.cas\b", text)}
    return sorted({step.name for step in walk(steps) if isinstance(step, Launch) and step.kernel in slow})


def instructions_of(ptx: str) -> int:
    """Instructions of a kernel, loops gone round once: those that a thread executes, where it has none."""
    lines = (line.strip() for line in ptx[ptx.find("{") + 1 :].splitlines())
    return sum(line.endswith(";") and not line.startswith((".", "//")) for line in lines)


def kernel_of(ptx: str) -> str:
    """Name of the kernel in a PTX text; "" for none."""
    found = _ENTRY.search(ptx)
    return found[1] if found else ""
