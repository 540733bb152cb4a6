"""The command `jexplore segment`."""

import dataclasses
import functools
from collections.abc import Sequence

from tyro.conf import Positional

from jexplore.cli.options import OutOptions, fields_of
from jexplore.cli.output.console import Out, working
from jexplore.config import InputError


@dataclasses.dataclass(frozen=True)
class Segment(OutOptions):
    """Divide maps into rooms, and score the rooms.

    Prints a Markdown table of scores a variant and writes segments.png, scores.parquet and run.json.
    """

    maps: Positional[tuple[str, ...]] = ()
    """Divide these maps, named as for `jexplore worlds`: map.png@0.05 (metres a pixel), map.yaml, or generators such as
    office#3 (required)."""
    truth: tuple[str, ...] | None = None
    """Score against these pictures of the maps with doorways closed by lines, in the same order and size. Generators
    know their rooms."""
    variant: tuple[str, ...] = ("voronoi",)
    """Divide by these variants: voronoi (default: the best on maps that it was not chosen on), distance, morphological,
    maoris, or those of the paper: thrun, wurm, holz."""
    partial: bool = False
    """Also segment the maps that an exploring robot has when it first knows 25, 50 and 75 % of what it will know."""
    cell_m: float = 0.05
    """Make the edge of a cell this long, in metres."""
    ratio: float = 0.65
    """By voronoi a pass is a door if its clearance is below this share of that of the rooms at either side."""
    narrowing: float = 0.9
    """Or below this share of the clearance on both sides, as far from it as it is wide; 0: only by the ratio."""
    smallest_m2: float = 2.0
    """By voronoi join rooms smaller than this, in square metres, to the room that they open to."""
    clutter_m: float = 1.0
    """By voronoi, distance, morphological and maoris look through obstacles in the open whose bounding box has a
    diagonal shorter than this, in metres, such as legs of tables."""
    prominence_m: float = 0.15
    """By thrun, wurm and holz the clearance must rise by this much on both sides of a critical point, in metres; 0
    takes any local minimum."""
    gamma: float = 3.0
    """By thrun, wurm and holz two obstacle cells must be this far apart, in cells, to have a Voronoi edge between
    them."""
    seed: int = 0
    """Draw the episodes that make partial maps from this seed."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.engine.backend import use_compilation_cache
        from jexplore.report.plots.maps import rooms_figure
        from jexplore.studies.room_variants import RoomSettings
        from jexplore.studies.segmentation import SHARES, segment_maps

        with Out(self, arguments) as out:
            if not self.maps:
                raise InputError("expected a map: map.png@0.05 (metres a pixel), map.yaml, or a generator: office#3")
            use_compilation_cache()
            with working(len(self.maps) * (1 + len(SHARES) * self.partial), "maps") as on_progress:
                how = fields_of(self, " ".join(("truth partial cell_m seed", *RoomSettings.__dataclass_fields__)))
                found = segment_maps(self.maps, variants=self.variant, **how, on_progress=on_progress)
            record = out.record(scores=found.scores.to_dict("records"))
            figure = functools.partial(rooms_figure, found.pictures, found.scores)
            files = {"scores.parquet": found.scores, "segments.png": figure}
            text = found.to_markdown()
            for _, row in found.scores[found.scores["overflow"] > 0].iterrows():
                what = f"{row['overflow']} edges, nodes, peaks or passes did not fit"
                text += f"warning: {row['map']}: {row['variant']}: {what}\n"
            return out.finish(record, files, text)
