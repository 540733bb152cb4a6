"""Display of worlds, episodes, comparisons and trace maps: pictures by their pixels, tables, lines."""

import base64
import dataclasses
import io
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from ref.traces import CRAWLER
from ref.worlds import two_rooms

from jexplore.arrays import pictures
from jexplore.rules import Lidar
from jexplore.studies.comparison import compare
from jexplore.studies.explore import explore
from jexplore.tracemap.record import BtmMap, Link, Node

LIDAR = Lidar(n_beams=37, range_m=1.0)


def pixels(png):
    """A PNG as `[H, W, 3]`, row 0 at the bottom."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)[::-1]


def shown(html):
    """The picture in a scrap of HTML, the texts of its table, and the line below the picture."""
    (source,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    caption = re.search(r"<div>([^<]*)</div>", html)
    assert caption is not None
    return base64.b64decode(source), re.findall(r"<t[hd]>(.*?)</t[hd]>", html), caption[1]


# --- worlds


def test_a_world_shows_itself():
    world = two_rooms("a <b>\nc").replace(start=(3, 4, 90))
    assert repr(world) == "<World a <b> c; 24 x 36 cells of 0.1 m, 7 m² free>"
    png, table, caption = shown(world._repr_html_())
    assert png == world._repr_png_()
    assert len(png) < 20_000
    assert not table
    assert caption == "a &lt;b&gt; c; 24 x 36 cells of 0.1 m, 7 m² free"
    rooms = np.where(world.occupied, -1, np.arange(36)[None] > 17)
    assert repr(world.replace(name="", rooms=rooms)).startswith("<World without a name; ")
    assert repr(world.replace(rooms=rooms)).endswith(", 2 rooms>")
    assert repr(world.replace(rooms=np.where(rooms == 1, -1, rooms))).endswith(", 1 room>")


@pytest.mark.jit
def test_a_world_on_its_way_through_jax_is_told_in_one_line():
    world = two_rooms()
    told = []
    jax.jit(lambda one: told.append((repr(one), one._repr_html_(), one._repr_png_())))(world)
    for one in (jax.eval_shape(lambda: world), jax.tree.map(lambda _: None, world)):
        told.append((repr(one), one._repr_html_(), one._repr_png_()))
    for text, html, png in told:
        assert re.fullmatch(r"<World two rooms; occupied: \w+>", text)
        assert html is None
        assert png is None
    assert jax.tree.map(jnp.asarray, world)._repr_png_() == world._repr_png_()


# --- trace maps


def test_a_loop_and_an_empty_map():
    image = pixels(CRAWLER._repr_png_())
    assert max(image.shape) <= pictures.LONG_PX + 2
    loop = BtmMap((Node(0, 0.0, 0.0, "divergence"),), (Link(0, 0, 0, "searched", 0.0, 90.0),))
    assert (pixels(loop._repr_png_()) < 100).any()
    empty = BtmMap((), ())
    assert repr(empty) == "<BtmMap of 0 nodes and 0 links, 0 of them searched>"
    assert empty._repr_html_() is None
    assert empty._repr_png_() is None


# --- episodes and comparisons


@pytest.fixture(scope="module")
def episode(jit_on):
    with jit_on():
        return explore(two_rooms(), "closest", seed=2, lidar=LIDAR)


@pytest.fixture(scope="module")
def comparison(jit_on):
    with jit_on():
        return compare(two_rooms(), ["closest", "closest+recheck"], episodes=3, lidar=LIDAR)


def test_an_episode_shows_itself(episode):
    assert repr(episode) == f"<Episode {episode.title}>"
    png, table, caption = shown(episode._repr_html_())
    assert png == episode._repr_png_()
    assert dict(zip(table[:6], table[6:])) == {
        "path": f"{episode.measures['path_m']:.1f} m",
        "explored": f"{100 * episode.measures['explored_fraction']:.1f}%",
        "95 % known after": f"{episode.measures['path_m_at_95']:.1f} m",
        "plans": str(episode.measures["plans"]),
        "scans": str(episode.measures["scans"]),
        "outcome": "COMPLETE",
    }
    row, col, heading_deg = episode.start
    assert caption == f"episode 0 of seed 2, from row {row}, col {col}, heading {heading_deg}°"
    assert len(np.unique(pixels(png).reshape(-1, 3), axis=0)) > 20
    assert len(png) < 40_000


def test_what_cannot_be_drawn_falls_back_to_text(episode, comparison):
    broken = dataclasses.replace(episode, final=None)
    assert repr(broken) == repr(episode)
    assert broken._repr_html_() is None
    assert broken._repr_png_() is None
    empty = dataclasses.replace(comparison, episodes=comparison.episodes.iloc[:0])
    assert repr(empty) == "<Comparison of 0 strategies in 1 world, 0 episodes>"
    assert empty._repr_html_() is None
    assert empty._repr_png_() is None


# --- what they share


def test_long_tables_are_cut_and_texts_are_no_html():
    lines = [(str(i), "<i>") for i in range(1000)]
    html = pictures.html_of(b"png", 'a "b" & c', ("n", "x"), lines)
    assert html.count("<tr>") == 1 + pictures.MAX_TABLE_ROWS
    assert "... and 976 more rows" in html
    assert "<i>" not in html
    assert 'alt="a &quot;b&quot; &amp; c"' in html
    assert "<table>" not in pictures.html_of(b"png", "caption")
