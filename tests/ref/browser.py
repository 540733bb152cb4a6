"""Open a page in headless Chromium, and run scripts, if it is installed."""

import html
import json
import re
import shutil
import subprocess

import pytest

# Virtual time draws no frames of its own accord.
TIMERS = "<script>window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 16);</script>"


def opener(folder):
    """A function that opens a page, text, and gives the data attributes of its body.

    Args:
      folder: an empty one, for the page and the browser's profile.
    """
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no chromium, chromium-browser or google-chrome on the path")

    def opened(text, fragment=""):
        path = folder / "page.html"
        path.write_text(text, encoding="ascii")
        command = [browser, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
        command += ["--virtual-time-budget=10000", "--dump-dom", path.as_uri() + fragment]
        dom = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
        (tag,) = re.findall(r"<body[^>]*>", dom)
        return {name: html.unescape(value) for name, value in re.findall(r'data-(\w+)="(.*?)"', tag)}

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
