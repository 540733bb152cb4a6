"""Pages of many maps: worlds, paths of strategies, rooms, walks with their bounds, maps of a recording."""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from jexplore.arrays.pictures import soft_colours
from jexplore.report.plot import (
    PALETTE,
    PROGRESS,
    draw_colours,
    draw_map,
    draw_path,
    panel_in,
    scale_bar,
    ways_of,
    wrapped_text,
)
from jexplore.report.plots.looks import legend_below

LONG_IN = 3.0  # longer side of a map on a page, unless said otherwise
MAX_WALKS = 12  # panels of a page of bounds
ROOMS_IN = 4.2  # longer side of a map of rooms
WALL, FLOOR, GRAPH = "#3c3c3c", "#ebebeb", "#5a5a5a"
MARKS = (  # what, marker, colour, for the legend
    ("critical", "o", "#d00000", "critical point"),
    ("found", "o", "#007a33", "door found"),
    ("missed", "s", "#d00000", "door missed"),
    ("extra", "x", "#c04000", "rooms touch where no door is"),
)
P_FREE = 0.25  # greatest share of hits of a cell that is drawn as free


class MapPanel(NamedTuple):
    """One map of a page."""

    title: str  # its lines are wrapped
    shape: tuple[int, ...]  # rows and columns of cells
    draw: Callable[[Axes], Any]  # draws the map; artists with labels go to the legend


def maps_page(panels: Sequence[MapPanel], n_cols: int | None = None, long_in: float = LONG_IN) -> tuple[Figure, Any]:
    """Draw maps in rows of `n_cols`, by default of up to four, each with a title and a scale bar.

    Return the page and its axes. `long_in` is the longer side of a map, inches. A place without a panel stays empty.
    """
    count = len(panels)
    n_cols = n_cols or (count if count <= 3 else min(4, math.ceil(math.sqrt(count))))
    rows = [panels[i : i + n_cols] for i in range(0, count, n_cols)]
    sizes = [panel_in([panel.shape for panel in row if panel], long_in) for row in rows]
    width, heights = max(size[0] for size in sizes), [size[1] for size in sizes]
    titles = [
        "\n".join(wrapped_text(line, int(11 * width), max_lines=2) for line in panel.title.split("\n")) if panel else ""
        for panel in panels
    ]
    lines = 1 + max(title.count("\n") for title in titles)
    size = (max(width * n_cols + 0.3, 3.6), sum(heights) + (0.3 + 0.17 * lines) * len(rows))
    page = Figure(figsize=size, layout="constrained")
    grid = page.subplots(len(rows), n_cols, squeeze=False, gridspec_kw={"height_ratios": heights})
    for ax, panel, title in itertools.zip_longest(grid.flat, panels, titles):
        if not panel:
            ax.set_visible(False)
            continue
        panel.draw(ax)
        scale_bar(ax)
        ax.set_title(title, fontsize=9, parse_math=False)
    return page, grid


def worlds_figure(worlds: Sequence[tuple[str, Any]]) -> Figure:
    """Draw a contact sheet of floor plans with their names: rooms, start, free area, number of rooms."""
    panels = []
    for name, world in worlds:
        n_rooms = 0 if world.rooms is None else len(np.unique(world.rooms[world.rooms >= 0]))
        rooms = f", {n_rooms} room{'s' if n_rooms > 1 else ''}" if n_rooms else ""
        title = f"{' '.join(name.split())}\n{world.free_m2:.0f} m² free{rooms}"
        panels.append(MapPanel(title, world.shape, functools.partial(_draw_world, world=world)))
    return maps_page(panels)[0]


def _draw_world(ax, world):
    world.plot(ax).set(xlabel="", ylabel="")


def paths_figure(entries: Sequence[tuple[str, Sequence[tuple[str, Any, Any, Any, float, float]]]]) -> Figure:
    """Draw the map as each strategy saw it with its path: a row, of any length, a world, a column a strategy.

    `entries` are `(world name, panels)`; a panel is `(strategy, state, rows, cols, cell_m, path_m)`: the final map `[H,
    W]` uint8, the cells driven `[N]` (see `ways_of`), the edge of a cell and the path length, metres.
    """
    n_cols = max(len(panels) for _, panels in entries)
    panels: list[Any] = []
    for _, own in entries:
        for strategy, state, rows, cols, cell_m, path_m in own:
            draw = functools.partial(_draw_paths, state=state, ways=ways_of(rows, cols), cell_m=cell_m)
            panels.append(MapPanel(f"{strategy}\n{path_m:.1f} m", np.shape(state), draw))
        panels += [None] * (n_cols - len(own))
    page, grid = maps_page(panels, n_cols)
    for line, (world, own) in zip(grid, entries):
        _, tall_in = panel_in([np.shape(panel[1]) for panel in own], LONG_IN)
        line[0].set_ylabel(wrapped_text(world, int(12 * tall_in), max_lines=3), fontsize=9, parse_math=False)
    page.set_figheight(page.get_figheight() + 0.6)
    share = min(0.62, 3.6 / page.get_figwidth())
    place = {"location": "bottom", "shrink": share, "fraction": 0.03, "pad": 0.03, "aspect": 30, "anchor": (0, 0)}
    bar = page.colorbar(ScalarMappable(cmap=PROGRESS), ax=list(grid.flat), **place)
    bar.set_ticks([0, 1], labels=["start", "end of the path"], fontsize=8)
    bar.outline.set_visible(False)
    style = {"frameon": False, "fontsize": 8, "ncols": 2, "borderaxespad": 0.0}
    marks = grid[0, 0].get_legend_handles_labels()[0][:2]
    bar.ax.legend(handles=marks, loc="center left", bbox_to_anchor=(1.1, 0.5), **style)
    return page


def _draw_paths(ax, state, ways, cell_m):
    draw_map(ax, state, cell_m)
    for rows, cols in ways:
        draw_path(ax, np.asarray(rows), np.asarray(cols), cell_m)


def bounds_figure(found: Any) -> Figure:
    """Draw the walks of the first starts, with the cells that make their lower bounds, on the true floor plans."""
    maps, panels = {str(world.name): world for world in found.worlds}, []
    for number, row in enumerate(found.table.to_dict("records")[:MAX_WALKS]):
        world, own = maps[str(row["world"])], found.walks[found.walks["start"] == number]
        way = (own["row"], own["col"]) if len(own) else ([row["start_row"]], [row["start_col"]])
        draw = functools.partial(_draw_bound, world=world, way=way, witnesses=found.witnesses[number])
        panels.append(MapPanel(f"{row['world']}\n{_between(row)}", world.shape, draw))
    page, _ = maps_page(panels)
    legend_below(page)
    return page


def _draw_bound(ax, world, way, witnesses):
    _draw_paths(ax, np.where(world.occupied, 2, 1), [way], world.cell_m)
    y, x = (witnesses.T + 0.5) * world.cell_m
    style: Any = {"ls": "none", "marker": "D", "ms": 3.5, "mfc": PALETTE[5], "mec": "white", "mew": 0.5}
    ax.plot(x, y, zorder=5, label="cell that the lower bound is made of", **style)


def _between(row):
    """Return the part of a title that states a row's bounds."""
    if not np.isfinite(row["high_m"]):
        return f"{row['status']}, at least {row['low_m']:.1f} m" if row["low_m"] else row["status"]
    return f"{row['low_m']:.1f} to {row['high_m']:.1f} m, {row['status']}"


def scans_figure(before: Any, odometry: Any, after: Any, poses: Any) -> Figure:
    """Draw the map by odometry next to the map found, each with its way: `ScanMap`s, and `[N, 3]` poses."""
    panels = []
    for title, drawn, way in (("odometry alone", before, odometry), ("matched scans", after, poses)):
        draw = functools.partial(_draw_scan_map, drawn=drawn, way=np.asarray(way))
        panels.append(MapPanel(title, drawn.grid.hits.shape, draw))
    return maps_page(panels, 2, long_in=5.0)[0]


def _draw_scan_map(ax, drawn, way):
    hits, misses = np.asarray(drawn.grid.hits), np.asarray(drawn.grid.misses)
    state = np.select([hits + misses == 0, hits > P_FREE * (hits + misses)], [0, 2], 1)
    draw_map(ax, state, drawn.cell_m, drawn.origin_m)
    ax.plot(way[:, 0], way[:, 1], color=PALETTE[3], linewidth=0.6)


def draw_segments(ax: Axes, picture: Any) -> AxesImage:
    """Draw rooms in colours; rings at found doors, squares at missed ones, crosses at contacts without a door.

    The paper's variants also show the Voronoi graph as thin lines, critical points as dots.
    """
    width = picture.label.shape[1]
    count = int(picture.label.max()) + 1
    rgb = np.where(picture.free[..., None], _bytes(FLOOR), _bytes(WALL))
    if count:
        colours = np.array(soft_colours(count), np.uint8)
        rooms = picture.label >= 0
        rgb[rooms] = colours[picture.label[rooms]]
    rgb.reshape(-1, 3)[picture.lines] = _bytes(GRAPH)
    artist = draw_colours(ax, rgb, picture.cell_m, interpolation="nearest")
    for colour, label in ((WALL, "wall or unknown"), (FLOOR, "floor of no room")):
        ax.plot([], [], "s", color=colour, label=label)
    if len(picture.lines):
        ax.plot([], [], color=GRAPH, label="Voronoi graph")
    critical = np.stack([picture.critical // width, picture.critical % width], axis=-1)
    for what, marker, colour, label in MARKS:
        at, size = (critical, 2) if what == "critical" else (getattr(picture.doors, what), 6)
        row, col = (at.T + 0.5) * picture.cell_m
        style = {"color": colour, "markersize": size, "markerfacecolor": "none", "markeredgewidth": 1.3}
        ax.plot(col, row, marker, linestyle="", label=label if len(at) else None, **style)
    return artist


def _bytes(colour):
    return np.array([round(255 * value) for value in to_rgb(colour)], np.uint8)


def rooms_figure(pictures: Sequence[Any], scores: Any) -> Figure:
    """Draw pictures and their scores: a row for every map and known share, and a column for every variant."""
    panels = []
    for picture, (_, row) in zip(pictures, scores.iterrows()):
        share = "" if picture.explored == 1 else f", {picture.explored:.0%} known"
        doors = f"doors: {row['doors_missed']:.0f} missed, {row['doors_extra']:.0f} too many"
        agreement = "" if np.isnan(row["mcc"]) else f", MCC {row['mcc']:.2f}\n{doors}"
        title = f"{picture.name}{share}\n{picture.variant}: {int(row['rooms'])} rooms{agreement}"
        panels.append(MapPanel(title, picture.label.shape, functools.partial(draw_segments, picture=picture)))
    page, _ = maps_page(panels, len({picture.variant for picture in pictures}), ROOMS_IN)
    legend_below(page)
    return page
