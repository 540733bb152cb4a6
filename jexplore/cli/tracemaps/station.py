"""The command `jexplore station`."""

import dataclasses
from collections.abc import Sequence

from tyro.conf import Positional

from jexplore.cli.output.terminal import show_line, show_table
from jexplore.cli.tracemaps.files import comparing, file_out, names_of
from jexplore.config import InputError
from jexplore.report.tables import aligned_table


@dataclasses.dataclass(frozen=True)
class Station:
    """Make one web page of robots' Behavioral Trace Maps, for an operator: drawn, with routes for any robot.

    Several maps are merged as by `jexplore merge-maps`; the others are shown next to the global map. The page works
    without a network.
    """

    maps: Positional[tuple[str, ...]] = ()
    """Files of the maps, such as btm.json. The global map lies in the frame of the first."""
    names: tuple[str, ...] = ()
    """Call the maps so; by default by their files, btm.json by its folder."""
    out: str | None = None
    """Write the page into this file, such as page.html."""
    overwrite: bool = False
    """Replace an existing file."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.report import store
        from jexplore.studies.traces.station import page_from, panels_of
        from jexplore.tracemap import json_form

        if not self.maps:
            raise InputError("station: expected files of one map or more: jexplore station btm.json --out page.html")
        names = names_of("station", self.maps, self.names)
        if self.out is None:
            raise InputError("expected --out: jexplore station btm.json --out page.html")
        out = file_out(self.out, self.maps, overwrite=self.overwrite)
        maps = [json_form.read_btm(path) for path in self.maps]
        with comparing(len(maps)) as on_progress:
            panels, said = panels_of(maps, names, on_progress)
        page = page_from(panels, said)
        with store.atomic(out) as part:
            part.write_text(page, encoding="ascii")
        show_table(_table(panels))
        for line in [f"{panel.name}: {panel.note}" for panel in panels if panel.note] + said:
            show_line(line)
        print(f"wrote {self.out}")
        return 0


def _table(panels):
    rows = []
    for panel in panels:
        followed = sum(link.end >= 0 for link in panel.map.links)
        left = len(panel.map.links) - followed
        rows.append([panel.name, ", ".join(panel.maps), *map(str, (len(panel.map.nodes), followed, left))])
    head = ["panel", "maps", "nodes", "searched links", "un-searched"]
    return aligned_table(head, rows, left=("panel", "maps"))
