"""Draw the pictures of the documentation, each by the command that its page tells.

    python docs/pictures.py                    which pictures there are, and what draws them
    python docs/pictures.py worlds tutorial    draws these into docs/images
    python docs/pictures.py --check worlds     draws them elsewhere, and says which of those in docs/images are stale
    python docs/pictures.py --check            all but the league's and that of drift, which take minutes or hours

Pictures are kept with 256 colours at most, for they lie in the repository.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
COLOURS = 256
BLOCK = 16
"""Pixels, as pictures are compared: letters that another release of matplotlib draws half a pixel off look alike."""
MOST_APART = 0.02
"""Mean difference of grey over a picture's blocks, black to white being 1. One more panel or line of text, or curves
that run elsewhere, are above it."""
MOST_LONGER = 0.03
"""By which the sides may differ, as another release lays texts out."""


class Drawn(NamedTuple):
    """Script for some pictures of one folder of docs/images."""

    command: str  # run in an empty folder; empty: the blocks of the tutorial
    files: Mapping[str, str]  # picture in docs/images -> the file that the command writes
    is_long: bool = False  # checked only if asked for by name


DRAWN = {
    "compare": Drawn(
        "jexplore compare --episodes 30 --out drawn",
        {"compare/compare.png": "drawn/compare.png", "compare/coverage.png": "drawn/coverage.png"},
    ),
    "explore": Drawn(
        "jexplore explore --world cave --strategy closest+recheck --seed 2 --frames 80 --out drawn",
        {"explore/episode.gif": "drawn/episode.gif"},
    ),
    "worlds": Drawn(
        "jexplore worlds cave office hospital maze rooms course office#3:furniture=1 hospital#3:furniture=1 "
        "--out drawn",
        {"worlds/worlds.png": "drawn/worlds.png"},
    ),
    "segment": Drawn(
        "jexplore segment office#1 --cell-m 0.1 --partial --variant voronoi holz --out drawn",
        {"segment/segments.png": "drawn/segments.png"},
    ),
    "trace": Drawn(
        "jexplore trace --world course --robot kamui --noise-m 0.01 --out drawn", {"trace/btm.png": "drawn/btm.png"}
    ),
    "team": Drawn(
        "jexplore trace --world rooms --robots 2 --noise-m 0.01 --contact range:4 --out drawn",
        {"trace/team.png": "drawn/team.png"},
    ),
    "tutorial": Drawn(
        "",
        {
            "tutorial/worlds.png": "look/worlds.png",
            "tutorial/sweep.png": "answer/sweep.png",
            "tutorial/own_figure.png": "own_figure.png",
            "tutorial/many.png": "many/compare.png",
        },
    ),
    "drift": Drawn(
        "python benchmarks/drift.py --parts drift --out drawn", {"trace/drift.png": "drawn/drift.png"}, is_long=True
    ),
    "league": Drawn(
        "jexplore compare --league --league-seeds 40 --episodes 1 --strategies closest+recheck closest "
        "small-first+recheck learned+recheck distance-advantage+recheck tour+recheck utility+recheck random+recheck "
        "--out drawn",
        {"league/league.png": "drawn/league.png", "league/coverage.png": "drawn/coverage.png"},
        is_long=True,
    ),
}


def draw(name: str, folder: Path) -> dict[str, Path]:
    """Run the script of some pictures, in an empty folder.

    Returns:
      Picture in docs/images -> the file that was drawn now, with few colours.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for line in [DRAWN[name].command] if DRAWN[name].command else tutorial(folder):
        run(line, folder)
    drawn = {picture: folder / file for picture, file in DRAWN[name].files.items()}
    for path in drawn.values():
        if path.suffix == ".png":
            with Image.open(path) as image:
                image.convert("RGB").quantize(COLOURS, kmeans=1).save(path, optimize=True, dpi=image.info.get("dpi"))
    return drawn


def run(line: str, folder: Path) -> None:
    """Run a command of the documentation with this Python and this checkout."""
    words = shlex.split(line)
    start = {"jexplore": ["-m", "jexplore"], "python": []}[words[0]]
    files = [str(ROOT / word) if word.startswith("benchmarks/") else word for word in words[1:]]
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    subprocess.run([sys.executable, *start, *files], cwd=folder, check=True, env={**os.environ, "PYTHONPATH": path})


def tutorial(folder: Path) -> Iterator[str]:
    """Write the tutorial's files into a folder, and yield its commands; a file exists once its turn has come."""
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    for language, body in re.findall(r"^```(\w+)\n(.*?)^```$", text, re.S | re.M):
        name = re.match(r"# (\w+\.(?:py|yaml))\n", body)
        if name:
            (folder / name[1]).write_text(body, encoding="utf-8")
        elif language == "sh" and "pip install" not in body:
            yield from body.replace("\\\n", " ").splitlines()
    yield "python own_figure.py"


def blocks(path: Path) -> tuple[tuple[int, int], np.ndarray]:
    """Return size and mean greys, 0 to 1, of a picture in blocks of `BLOCK` pixels; an animation's last frame."""
    with Image.open(path) as image:
        image.seek(getattr(image, "n_frames", 1) - 1)
        small = [max(1, round(side / BLOCK)) for side in image.size]
        grey = image.convert("L").resize(small, Image.Resampling.BOX)  # type: ignore[arg-type]  # two
        return image.size, np.asarray(grey, np.float64) / 255


def difference(old: Path, new: Path) -> str | None:
    """Describe the difference of a picture from one drawn now, a line; None without any."""
    (size, was), (other, now) = blocks(old), blocks(new)
    if any(abs(a - b) > MOST_LONGER * b for a, b in zip(size, other)):
        return f"{size[0]} x {size[1]} pixels, drawn now {other[0]} x {other[1]}"
    if was.shape != now.shape:
        resized = Image.fromarray(was.astype(np.float32)).resize(now.shape[::-1], Image.Resampling.BILINEAR)
        was = np.asarray(resized, np.float64)
    apart = float(np.abs(was - now).mean())
    return f"differs by {apart:.3f} from what is drawn now, at most {MOST_APART}" if apart > MOST_APART else None


def main() -> int:
    """Run the command line's request; return 1 if a picture is stale."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[*DRAWN, []], metavar="NAME", help=", ".join(DRAWN))
    parser.add_argument("--check", action="store_true", help="compare with those in docs/images instead")
    asked = parser.parse_args()
    if not asked.names and not asked.check:
        for name, drawn in DRAWN.items():
            print(f"{name}: {', '.join(drawn.files)}\n    {drawn.command or 'the blocks of docs/tutorial.md'}")
        return 0
    stale = 0
    for name in asked.names or [name for name, drawn in DRAWN.items() if not drawn.is_long]:
        with tempfile.TemporaryDirectory() as folder:
            for picture, path in draw(name, Path(folder)).items():
                if asked.check:
                    told = difference(IMAGES / picture, path)
                    stale += told is not None
                    print(f"{picture}: {told or 'as it is drawn now'}", flush=True)
                else:
                    (IMAGES / picture).parent.mkdir(parents=True, exist_ok=True)
                    (IMAGES / picture).write_bytes(path.read_bytes())
                    print(f"drew {picture}", flush=True)
    return min(stale, 1)


if __name__ == "__main__":
    sys.exit(main())
