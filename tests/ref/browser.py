"""Pages of one file: their data, read by another decoder; opened in headless Chromium, if it is installed."""

import base64
import html
import json
import re
import shutil
import struct
import subprocess

import numpy as np
import pytest

# Virtual time draws no frames of its own accord.
TIMERS = "<script>window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 16);</script>"


def data_of(text):
    (found,) = re.findall(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)
    return json.loads(found)


def unpacked(packed):
    """Return an array of a page, by `struct`: numbers, NaN or infinity."""
    raw = base64.b64decode(packed["base64"])
    bits = {"i2": 16, "i4": 32}[packed["type"]]
    whole = struct.unpack(f"<{len(raw) * 8 // bits}{'h' if bits == 16 else 'i'}", raw)
    special = {-(2 ** (bits - 1)): np.nan, 2 ** (bits - 1) - 1: np.inf}
    return np.array([special.get(value, value * packed["step"]) for value in whole]).reshape(packed["shape"])


def assert_alone(text, sources=()):
    """Assert that a page asks for nothing outside; `sources` are those of its pictures."""
    text = re.sub(r'(?<="application/json">).*?(?=</script>)', "", text, flags=re.S)  # base64 may hold anything
    text = re.sub(r"base64,[A-Za-z0-9+/=]*", "", text)
    assert re.findall(r'\bsrc\s*=\s*"?([^">]*)', text) == list(sources)
    calls = r"https?:|(?<![\w.:])//\w|\bhref\s*=|url\(|fetch\(|XMLHttp|import\(|DecompressionStream"
    assert not re.findall(rf"{calls}|@import|@font-face", text)
    assert "default-src 'none'" in text
    assert "{{" not in text


def opener(folder):
    """A function that opens a page, text, and gives the data attributes of its body, where no error may stand.

    It takes what follows the page's address as well, and a scenario: a script at the page's end.

    Args:
      folder: an empty one, for the page and the browser's profile.
    """
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no chromium, chromium-browser or google-chrome on the path")

    def opened(text, fragment="", scenario=""):
        text = text.replace("<style>", TIMERS + "<style>", 1).replace("</body>", scenario + "</body>")
        path = folder / "page.html"
        path.write_text(text, encoding="ascii")
        command = [browser, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
        command += ["--virtual-time-budget=10000", "--dump-dom", path.as_uri() + fragment]
        dom = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
        (tag,) = re.findall(r"<body[^>]*>", dom)
        found = {name: html.unescape(value) for name, value in re.findall(r'data-(\w+)="(.*?)"', tag)}
        assert "error" not in found, found["error"]
        return found

    return opened


def answers(folder, script, given):
    """Return the result of a script's function `answer(given)`, run by node if installed, else by the browser.

    Args:
      folder: an empty one.
      script: JavaScript.
      given: plain JSON types.
    """
    program, asked = shutil.which("node"), json.dumps(given).replace("<", "\\u003c")
    if program is None:
        write = "document.body.dataset.answer = JSON.stringify(answer(given));"
        found = opener(folder)(
            f'<body><script>"use strict";\n{script}\nconst given = {asked};\n{write}</script></body>'
        )
        return json.loads(found["answer"])
    path = folder / "script.js"
    text = f'"use strict";\n{script}\nconst given = {asked};\nconsole.log(JSON.stringify(answer(given)));\n'
    path.write_text(text, encoding="ascii")
    return json.loads(subprocess.run([program, path], capture_output=True, text=True, check=True, timeout=120).stdout)
