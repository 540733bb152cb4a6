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


def test_a_table_that_fits_is_drawn_as_it_is(shown):
    assert shown(100, TABLE) == [
        "world                          strategy         path m  95 % interval  outcomes",
        "─" * 95,
        "cave:width_m=6.4,height_m=6.4  closest            6.81    [2.0, 23.5]  COMPLETE 3",
        "cave:width_m=6.4,height_m=6.4  closest+recheck    4.27    [0.9, 21.3]  COMPLETE 2, STEP_LIMIT 1",
        "",
    ]


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


def test_lines_between_tables_stay_and_headings_lose_their_hashes(shown):
    table = aligned_table(["a"], [["1"]], left=[])
    text = f"## Orderings\n\nA [bold] claim of eight words that holds :smile:\n\n{table}\nend"
    folded = ["A [bold] claim of eight words", "that holds :smile:"]
    assert shown(30, text) == ["Orderings", "", *folded, "", "a", "─", "1", "", "end"]


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


def help_of(command, capsys, monkeypatch, columns=100):
    """`{option: its text on one line}`, and the whole page."""
    monkeypatch.setenv("COLUMNS", str(columns))
    assert main.main([command, "--help"]) == 0
    page = capsys.readouterr().out
    assert "╭─ options ─" in page
    lines = [line.strip("│").rstrip() for line in page.splitlines() if line.startswith("│")]
    texts, option = {}, ""
    for line in lines:
        found = re.match(r" (--[\w.-]+)(?: \S.*?)?(?:  +(?=\S)|$)", line)
        if found:
            option = found[1]
            texts[option] = line[found.end() :].strip()
        elif texts and line.startswith("    ") and not set(line.strip()) <= {"─"}:
            texts[option] = f"{texts[option]} {line.strip()}".strip()
    return texts, page


def test_every_option_is_explained_in_whole_sentences():
    for command in (*main.COMMANDS.values(), Lidar, Rules):
        texts = options.field_texts(command)
        for field in dataclasses.fields(command):
            if not dataclasses.is_dataclass(field.default_factory):
                said = texts[field.name]
                assert said.endswith("."), (command, field.name, said)
                assert said[0].isupper(), (command, field.name, said)
                assert len(said.split()) > 2, (command, field.name, said)


def test_an_option_that_switches_off_says_what_it_does(capsys, monkeypatch):
    texts, page = help_of("explore", capsys, monkeypatch)
    assert max(map(len, page.splitlines())) <= 100
    for nothing in ("default: None", "default: True", "default: False", "default: )", "{None}"):
        assert nothing not in page
    negative = {option: text for option, text in texts.items() if ".no-" in option or option.startswith("--no-")}
    assert negative.pop("--lidar.no-echo").startswith("A beam that nothing stops")  # no switch
    assert negative == {
        "--no-report": "Leave out report.html.",
        "--rules.no-look-around": "A robot that arrives at a live target does not turn to look all round.",
    }
    assert not options.parse_options(["explore", "--rules.no-look-around"], main.COMMANDS).rules.look_around


def test_a_text_over_several_lines_is_one_paragraph():
    texts = options.field_texts(main.COMMANDS["explore"])
    assert texts["world"].startswith("Explore this world: ")
    assert "lidar" not in texts
    assert all("\n" not in text and "  " not in text for text in texts.values())


class Timer:
    """A timer that rings when it is told to, if it has not been cancelled."""

    def __init__(self, seconds, act):
        assert seconds == console.PATIENCE_S
        self.act = act

    def start(self):
        self.is_on = True

    def cancel(self):
        self.is_on = False

    def ring(self):
        if self.is_on:
            self.act()


def test_slow_work_is_named_once(monkeypatch, capsys):
    made = []
    monkeypatch.setattr(console.threading, "Timer", lambda *given: made.append(Timer(*given)) or made[-1])
    with console.working(10, "runs"):
        made[-1].ring()
    with console.working(10, "runs"):
        pass
    made[-1].ring()  # after its end
    with console.working(10, "runs") as on_progress:
        on_progress(0)  # the first is under way: nothing compiles any more
        made[-1].ring()
    with console.note_if_slow("never") as call_off:
        call_off()
        made[-1].ring()
    assert capsys.readouterr().err == f"{console.COMPILING}\n"
