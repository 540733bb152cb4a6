"""Output of commands: tables that fit a terminal, Markdown elsewhere, bars and lines, help texts, warnings."""

import dataclasses
import io
import re
import sys
import warnings

import pytest

from jexplore.cli import main, options
from jexplore.cli.output import console, terminal
from jexplore.config import InputWarning
from jexplore.report.tables import aligned_table
from jexplore.rules import Lidar, Rules

HEAD = ["world", "strategy", "path m", "95 % interval", "outcomes"]
ROWS = [
    ["cave:width_m=6.4,height_m=6.4", "closest", "6.81", "[2.0, 23.5]", "COMPLETE 3"],
    ["cave:width_m=6.4,height_m=6.4", "closest+recheck", "4.27", "[0.9, 21.3]", "COMPLETE 2, STEP_LIMIT 1"],
]
TABLE = aligned_table(HEAD, ROWS, left=["world", "strategy", "outcomes"])


class Screen(io.StringIO):
    """A terminal."""

    encoding = "utf-8"

    def isatty(self):
        return True


@pytest.fixture
def shown(monkeypatch):
    """Return a function for the text shown by a terminal with a number of columns, without colours."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")

    def show(width, text):
        monkeypatch.setenv("COLUMNS", str(width))
        screen = Screen()
        terminal.show_table(text, file=screen)
        return [line.rstrip() for line in re.sub(r"\x1b\[\d*m", "", screen.getvalue()).splitlines()]

    return show


def test_a_wide_table_folds_and_is_cut_into_parts_that_begin_alike(shown):
    assert shown(54, TABLE) == [
        "                                     path         95 %",
        "world               strategy            m     interval",
        "─" * 54,
        "cave:width_m=6.4,h  closest          6.81  [2.0, 23.5]",
        "eight_m=6.4",
        "cave:width_m=6.4,h  closest+recheck  4.27  [0.9, 21.3]",
        "eight_m=6.4",
        "",
        "world              strategy         outcomes",
        "─" * 54,
        "cave:width_m=6.4,  closest          COMPLETE 3",
        "height_m=6.4",
        "cave:width_m=6.4,  closest+recheck  COMPLETE 2,",
        "height_m=6.4                        STEP_LIMIT 1",
        "",
    ]


def test_elsewhere_it_is_the_markdown_itself(capsys):
    terminal.show_table(TABLE)
    assert capsys.readouterr().out == TABLE + "\n"


# --- progress


def test_a_log_gets_lines_and_no_carriage_returns(monkeypatch, capfd):
    monkeypatch.setattr(console, "SILENCE_S", 0)
    monkeypatch.setattr(console, "PATIENCE_S", 1e-9)
    with console.progress_of(200, "episodes") as update:
        for done in (0, 20, 200):
            update(done)
    said = capfd.readouterr().err
    shares = [line.partition(" [")[0] for line in said.splitlines()]
    assert shares == ["jexplore:  10%| 20/200 episodes", "jexplore: 100%| 200/200 episodes"]
    assert "\r" not in said


def test_quick_work_and_work_that_stands_still_say_nothing(capfd):
    with console.progress_of(10, "maps") as update:
        for done in range(1, 11):
            update(done)
    assert capfd.readouterr().err == ""


def test_a_terminal_gets_a_bar(monkeypatch):
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(console, "PATIENCE_S", 0)
    with console.progress_of(3, "maps") as update:
        for done in range(1, 4):
            update(done)
    assert "\r" in screen.getvalue()
    assert "maps/s" in screen.getvalue()


def test_without_stderr_there_is_no_progress(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stderr", None)
    with console.progress_of(3, "maps") as update:
        update(0)
        update(2)
    assert capsys.readouterr().out == ""


# --- warnings


def test_a_warning_about_what_was_given_is_one_line_and_said_once(capsys):
    with terminal.plain_warnings():
        for text in ("the map\nis odd", "the map\nis odd", "another"):
            warnings.warn(text, InputWarning, stacklevel=1)
    assert capsys.readouterr() == ("", "warning: the map is odd\nwarning: another\n")
    with pytest.warns(InputWarning, match="as before"):
        warnings.warn("as before", InputWarning, stacklevel=1)
    with terminal.plain_warnings(), pytest.raises(UserWarning, match="not ours"):  # an error in tests, shown elsewhere
        warnings.warn("not ours", UserWarning, stacklevel=1)


# --- help


def test_every_option_is_explained_in_whole_sentences():
    for command in (*main.COMMANDS.values(), Lidar, Rules):
        texts = options.field_texts(command)
        for field in dataclasses.fields(command):
            if not dataclasses.is_dataclass(field.default_factory):
                said = texts[field.name]
                assert said.endswith("."), (command, field.name, said)
                assert said[0].isupper(), (command, field.name, said)
                assert len(said.split()) > 2, (command, field.name, said)
