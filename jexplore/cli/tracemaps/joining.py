"""The commands `jexplore merge-maps` and `jexplore station`."""

import collections
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from jexplore.cli.output.console import say, working
from jexplore.cli.output.terminal import show_line, show_table
from jexplore.config import InputError
from jexplore.report.tables import aligned_table
from jexplore.tracemap.merging.limits import Limits

REFUSED = 1  # exit status of maps that do not become one
TRACED = "btm"  # what every run calls its map


@dataclasses.dataclass(frozen=True)
class MapsOptions:
    """Options of commands that take maps and write one file."""

    maps: Positional[tuple[str, ...]] = ()
    """Files of the maps, such as btm.json (required). The result lies in the frame of the first."""
    names: tuple[str, ...] = ()
    """Names of the maps in the output; by default those of their files, btm.json by its folder."""
    out: str | None = None
    """Write into this file, such as map.json, or page.html of station, which needs one."""
    overwrite: bool = False
    """Replace an existing file."""

    def read(self, command: str) -> dict[str, Any]:
        """Return the maps by name, once all files are checked. A map whose path is typed otherwise is the same one."""
        from jexplore.tracemap.json_form import read_btm

        again = [path for i, path in enumerate(self.maps) if any(_are_one(path, other) for other in self.maps[:i])]
        if again:
            raise InputError(f"{command}: expected every map once, got {again[0]} again")
        if self.names and len(self.names) != len(self.maps):
            wanted = f"expected a name for each of {len(self.maps)} maps, got {len(self.names)}"
            raise InputError(f"{command}: --names: {wanted}")
        names = self.names or [_name(Path(path).expanduser().resolve()) for path in self.maps]
        for i, name in enumerate(names):
            if name in names[:i]:
                both = f"{self.maps[names.index(name)]} and {self.maps[i]}"
                raise InputError(f'{command}: {both} are both called "{name}": call them otherwise with --names')
        if self.out is not None:
            self._check_out()
        return {name: read_btm(path) for name, path in zip(names, self.maps)}

    def _check_out(self):
        path = Path(self.out or "").expanduser()
        if any(_are_one(one, path) for one in self.maps):
            raise InputError(f"--out {self.out} is one of the maps: name another file")
        if path.is_dir():
            raise InputError(f"--out {self.out} must be a file, and is a folder")
        if path.exists() and not self.overwrite:
            raise InputError(f"--out {self.out} is there already: name another file, or replace it with --overwrite")
        if not path.absolute().parent.is_dir():
            raise InputError(f"--out {self.out}: there is no folder {path.absolute().parent}")

    def write(self, text: str) -> None:
        """Write the file, and tell so."""
        from jexplore.report.store import atomic

        with atomic(Path(self.out or "").expanduser()) as part:
            part.write_text(text, encoding="utf-8", errors="backslashreplace")  # arguments may be no UTF-8
        print(f"wrote {self.out}")


def _comparing(maps):
    """Show progress of merging, as `console.working`."""
    return working((len(maps) - 1) ** 2, "pairs of maps", "jexplore: comparing maps")


@dataclasses.dataclass(frozen=True)
class MergeMaps(MapsOptions):
    """Make one Behavioral Trace Map of two or more that have no common frame.

    Prints what became of each map. Where they have not enough in common, or could be laid on each other in more than
    one way, says so, writes nothing and ends with status 1.
    """

    partial: bool = False
    """Write the map that most maps are in even if some do not fit; nothing where no two fit."""
    min_common: int = 3
    """Least number of nodes that two maps must have in common."""
    limits: Limits = dataclasses.field(default_factory=Limits)

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.report.store import json_text
        from jexplore.tracemap.json_form import to_json
        from jexplore.tracemap.merging.merge import merge_maps

        if len(self.maps) < 2:
            raise InputError(f"merge-maps: expected files of two maps or more, got {len(self.maps)}")
        maps = self.read("merge-maps")
        with _comparing(maps) as on_progress:
            how: Any = {"min_common": self.min_common, "limits": self.limits, "on_progress": on_progress}
            found = merge_maps(list(maps.values()), list(maps), **how)
        show_table(_merge_table(found, maps))
        for note in found.notes:
            show_line(note)
        if found.left and not (self.partial and len(found.nodes) > 1):
            return say(f"jexplore: {_reason(found)}; nothing was written", REFUSED)
        if self.out is not None:
            self.write(json_text(to_json(found.map)))
        return say(f"jexplore: {_reason(found)}", REFUSED) if found.left else 0


@dataclasses.dataclass(frozen=True)
class Station(MapsOptions):
    """Make one web page of robots' Behavioral Trace Maps, for an operator: drawn, with routes for any robot.

    Several maps are merged as by `jexplore merge-maps`; the others are shown next to the global map. The page works
    without a network.
    """

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies.traces.station import page_from, panels_of

        if not self.maps:
            raise InputError("station: expected files of one map or more: jexplore station btm.json --out page.html")
        if self.out is None:
            raise InputError("expected --out: jexplore station btm.json --out page.html")
        maps = self.read("station")
        with _comparing(maps) as on_progress:
            panels, said = panels_of(list(maps.values()), list(maps), on_progress)
        page = page_from(panels, said)
        show_table(_panel_table(panels))
        for line in [f"{panel.name}: {panel.note}" for panel in panels if panel.note] + said:
            show_line(line)
        self.write(page)
        return 0


def _name(path):
    return path.parent.name if path.stem == TRACED and path.parent.name else path.stem


def _are_one(path, other):
    try:
        return os.path.samefile(path, other)
    except OSError:  # one is not there
        return os.path.abspath(path) == os.path.abspath(other)


def _merge_table(found, maps):
    rows, count = [], collections.Counter(node for nodes in found.nodes.values() for node in set(nodes.values()))
    for name, btm in maps.items():
        shared = [node for node in found.nodes.get(name, {}).values() if count[node] > 1]
        move = found.moves.get(name)
        frame = "" if move is None else f"turned {move.turn_deg:.0f}°, moved {move.x_m:.1f}, {move.y_m:.1f} m"
        what = "merged" if shared and name not in found.left else "left apart"
        rows.append([name, *map(str, (len(btm.nodes), len(btm.links), len(shared))), what, frame])
    whole = map(str, (len(found.map.nodes), len(found.map.links), found.matched))
    rows.append(["together", *whole, found.outcome.value, ""])
    head = ["map", "nodes", "links", "matched nodes", "what", "frame"]
    return aligned_table(head, rows, left=("map", "what", "frame"))


def _reason(found):
    left = ", ".join(found.left)
    if found.outcome.name == "AMBIGUOUS":
        return f"ambiguous: {left} could be laid on the other maps in more than one way"
    return f"not enough in common: {left} cannot be told to show the place of the other maps"


def _panel_table(panels):
    rows = []
    for panel in panels:
        followed = sum(link.end >= 0 for link in panel.map.links)
        left = len(panel.map.links) - followed
        rows.append([panel.name, ", ".join(panel.maps), *map(str, (len(panel.map.nodes), followed, left))])
    head = ["panel", "maps", "nodes", "searched links", "un-searched"]
    return aligned_table(head, rows, left=("panel", "maps"))
