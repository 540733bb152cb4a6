"""Examples in help texts, and what completes commands and options."""

import re
import shlex
import shutil
import subprocess

import pytest

from jexplore.cli import main, options


@pytest.mark.parametrize("name", main.COMMANDS)
def test_examples_of_help_are_commands(name, capsys):
    for example in options.EXAMPLES[name]:
        command, *rest = shlex.split(example)
        assert command == name
        assert type(options.parse_options([name, *rest], main.COMMANDS)) is main.COMMANDS[name]
    assert main.main([name, "--help"]) == 0
    assert f"  jexplore {options.EXAMPLES[name][0]}\n" in capsys.readouterr().out


@pytest.mark.parametrize("name", main.COMMANDS)
def test_options_that_complete_are_those_of_the_help(name, capsys):
    main.main([name, "--help"])
    told = re.findall(r"^│ (--[\w.-]+)", capsys.readouterr().out, re.M)
    assert sorted(options.option_names(main.COMMANDS[name])) == sorted(told)


@pytest.mark.skipif(not shutil.which("bash"), reason="needs bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("exp", ["explore"]),
        ("explore --lidar.r", ["--lidar.range-m"]),
        ("merge-m", ["merge-maps"]),
        ("--comp", ["--completion"]),
        ("xyz", []),
    ],
)
def test_bash_completes(words, expected, capsys):
    assert main.main(["--completion"]) == 0
    line = f"{capsys.readouterr().out}\nCOMP_WORDS=(jexplore {words}); COMP_CWORD={len(words.split())}; _jexplore\n"
    ran = subprocess.run(["bash", "-c", line + 'printf "%s\\n" "${COMPREPLY[@]}"'], capture_output=True, text=True)
    assert ran.stdout.split() == expected
    assert ran.stderr == ""
