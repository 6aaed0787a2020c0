"""Ctrl-C is answered in a line from the first import to the process's end."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BEGIN = """
import builtins, os, signal, sys
from hierax.runtime.commands.ctrl_c import guarded
from hierax.runtime.commands.entry import entry

def press():
    os.kill(os.getpid(), signal.SIGINT)
"""
WHILE_IMPORTING = """
usual = builtins.__import__
def importing(name, *more):
    if name == "typer":
        press()
    return usual(name, *more)
builtins.__import__ = importing
entry()
"""
MADE_AN_ERROR = """
def main(arguments):
    try:
        press()
    except KeyboardInterrupt:
        raise ImportError("a library says") from None
guarded(main)
"""
TWICE = """
def main(arguments):
    try:
        press()
    finally:
        press()
guarded(main)
"""
BEFORE = """
import os, signal
import importlib.abc, sys

class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "hierax.runtime.commands.ctrl_c":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
import hierax.runtime.commands.entry
"""
WHERE_NOTHING_CAN_BE_RAISED = """
import time
class Last:
    def __del__(self):
        press()
def main(arguments):
    Last()
    while True:
        time.sleep(60)
guarded(main)
"""
WHERE_A_LIBRARY_DROPS_IT = """
import time
def main(arguments):
    try:
        press()
    except BaseException:
        pass
    while True:
        time.sleep(60)
guarded(main)
"""
ANSWERED = """
import atexit
atexit.register(lambda: print(signal.getitimer(signal.ITIMER_REAL), "until it comes again", file=sys.stderr))
def main(arguments):
    try:
        press()
    except KeyboardInterrupt:
        return 0
guarded(main)
"""
IN_TEXT_THAT_IS_RUN = """
def main(arguments):
    try:
        exec("press()", globals())
    except KeyboardInterrupt:
        return 3
guarded(main)
"""
AT_THE_END = """
import atexit
atexit.register(press)
guarded(lambda arguments: 0)
"""


@pytest.mark.parametrize(
    ("when", "code", "said"),
    [
        (BEFORE, -2, ""),
        (WHILE_IMPORTING, 130, "interrupted\n"),
        (MADE_AN_ERROR, 130, "interrupted\n"),
        (TWICE, 130, ""),
        (WHERE_NOTHING_CAN_BE_RAISED, 130, "interrupted\n"),
        (WHERE_A_LIBRARY_DROPS_IT, 130, "interrupted\n"),
        (ANSWERED, 0, "(0.0, 0.0) until it comes again\n"),
        (AT_THE_END, -2, ""),
    ],
)
def test_no_traceback_answers_it(when: str, code: int, said: str) -> None:
    command = [sys.executable, "-c", when if when is BEFORE else BEGIN + when]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (code, said)


def test_one_that_was_answered_within_text_that_was_run_is_not_what_the_process_ends_of(tmp_path: Path) -> None:
    (tmp_path / "pressed.py").write_text(BEGIN + IN_TEXT_THAT_IS_RUN)
    command = [sys.executable, "-m", "pressed"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (3, "")
