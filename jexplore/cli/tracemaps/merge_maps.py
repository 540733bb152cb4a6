"""The command `jexplore merge-maps`."""

import collections
import dataclasses
from collections.abc import Sequence

from tyro.conf import Positional

from jexplore.cli.output.console import say
from jexplore.cli.output.terminal import show_line, show_table
from jexplore.cli.tracemaps.files import comparing, file_out, names_of
from jexplore.config import InputError
from jexplore.report.tables import aligned_table
from jexplore.tracemap.merging.limits import Limits

REFUSED = 1  # exit status of maps that do not become one


@dataclasses.dataclass(frozen=True)
class MergeMaps:
    """Make one Behavioral Trace Map of two or more that have no common frame.

    Prints what became of each map. Where they have not enough in common, or could be laid on each other in more than
    one way, says so, writes nothing and ends with status 1.
    """

    maps: Positional[tuple[str, ...]] = ()
    """Files of the maps, such as btm.json. The result lies in the frame of the first."""
    names: tuple[str, ...] = ()
    """Names of the maps in the output; by default those of their files, btm.json by its folder."""
    out: str | None = None
    """Write the map into this file; by default it is not written."""
    overwrite: bool = False
    """Replace an existing file."""
    partial: bool = False
    """Write the map that most maps are in even if some do not fit; nothing where no two fit."""
    min_common: int = 3
    """Least number of nodes that two maps must have in common."""
    limits: Limits = dataclasses.field(default_factory=Limits)

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.report import store
        from jexplore.tracemap import json_form
        from jexplore.tracemap.merging.merge import merge_maps

        if len(self.maps) < 2:
            raise InputError(f"merge-maps: expected files of two maps or more, got {len(self.maps)}")
        names = names_of("merge-maps", self.maps, self.names)
        out = None if self.out is None else file_out(self.out, self.maps, overwrite=self.overwrite)
        maps = [json_form.read_btm(path) for path in self.maps]
        with comparing(len(maps)) as on_progress:
            found = merge_maps(maps, names, min_common=self.min_common, limits=self.limits, on_progress=on_progress)
        show_table(_table(found, dict(zip(names, maps))))
        for note in found.notes:
            show_line(note)
        if found.left and not (self.partial and len(found.nodes) > 1):
            return say(f"jexplore: {_reason(found)}; nothing was written", REFUSED)
        if out is not None:
            store.write_json(json_form.to_json(found.map), out)
            print(f"wrote {self.out}")
        return say(f"jexplore: {_reason(found)}", REFUSED) if found.left else 0


def _table(found, maps):
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
