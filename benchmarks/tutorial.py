"""The tutorial word by word, from each of its beginnings: a fresh clone, a fresh environment, the package index.

    python benchmarks/tutorial.py                 # both, some five minutes; what is committed is what is cloned
    python benchmarks/tutorial.py --only pip      # the beginning that has this word in its first line

What hierax's own name stands for in `pip install` is a wheel built of the clone; all else comes from the index.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from support.pages import beginnings, script  # noqa: E402

TUTORIAL = "docs/tutorial.md"
TIMEOUT_S = 3600
OURS = ("VIRTUAL_ENV", "PYTHONPATH", "PYTHONHOME")
"""What of this process's environment would have its reader find what is installed here."""


def main() -> int:
    """Begin, read on, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="a word of the first line")
    options = parser.parse_args()
    page = (ROOT / TUTORIAL).read_text(encoding="utf-8")
    failed = 0
    for lines in beginnings(page):
        if options.only in lines[0]:
            with tempfile.TemporaryDirectory(prefix="hierax-tutorial-") as folder:
                failed += not _works(lines, script(page), Path(folder))
    return 1 if failed else 0


def _works(beginning: list[str], page: str, folder: Path) -> bool:
    """Whether a reader who begins so gets to the page's end."""
    clone = folder / "clone"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    environment = {name: value for name, value in os.environ.items() if name not in OURS}
    own = str(Path(sys.prefix) / "bin")
    environment["PATH"] = os.pathsep.join(each for each in environment["PATH"].split(os.pathsep) if each != own)
    environment |= {"XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder), "PYTHON": sys._base_executable}
    if not any(line.startswith("make ") for line in beginning):
        venv.create(folder / "environment", with_pip=True)
        environment["PATH"] = f"{folder / 'environment' / 'bin'}{os.pathsep}{environment['PATH']}"
        environment["PIP_FIND_LINKS"] = str(_wheel(clone, folder, environment))
    text = "\n".join(["set -e", *beginning, "date +%s.%N > ../begun", page])
    begun_s, log = time.time(), folder / "said.txt"
    with log.open("wb") as said:
        done = subprocess.run(
            ["bash", "-m", "-x", "-c", text],
            cwd=clone,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            timeout=TIMEOUT_S,
            check=False,
        )
    marked = folder / "begun"
    installed_s = float(marked.read_text()) - begun_s if marked.exists() else float("nan")
    rest_s = time.time() - begun_s - installed_s
    print(f"{beginning[0]}: exit code {done.returncode}; begun in {installed_s:.0f} s, the page took {rest_s:.0f} s")
    if done.returncode:
        print(log.read_text(encoding="utf-8", errors="replace")[-4000:])
    return done.returncode == 0


def _wheel(clone: Path, folder: Path, environment: dict[str, str]) -> Path:
    """What has pip take hierax from the clone, as an index would have it."""
    pip = str(folder / "environment" / "bin" / "pip")
    wheels = folder / "wheels"
    command = [pip, "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", "-w", str(wheels), str(clone)]
    subprocess.run(command, env=environment, check=True)
    return wheels


if __name__ == "__main__":
    sys.exit(main())
