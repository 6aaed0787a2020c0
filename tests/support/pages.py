"""What a page of the documentation has its reader type.

In a page, a block `console` holds commands behind `$ `; what else stands in it is output. A block with a title is
a file: ``title="NAME"`` makes it, ``title="at the end of NAME"`` adds to it. A page is run by one shell in an empty
folder. Blocks without a language are ways to begin: the reader takes one of them.
"""

from __future__ import annotations

import re

FENCE = re.compile(r'^```(\w*)(?: title="([^"]+)")?\n(.*?)^```', re.DOTALL | re.MULTILINE)
ADDED = "at the end of "


def script(text: str) -> str:
    """All commands and files of a page, for bash."""
    lines = ["set -e"]
    for language, title, body in FENCE.findall(text):
        if language == "console":
            lines += [line[2:] for line in body.splitlines() if line.startswith("$ ")]
        elif title:
            name = title.removeprefix(ADDED)
            lines.append(f"cat {'>>' if title.startswith(ADDED) else '>'} {name} << 'END_OF_FILE'\n{body}END_OF_FILE")
    return "\n".join(lines) + "\n"


def beginnings(text: str) -> list[list[str]]:
    """The ways to begin, as lines: of the blocks without a language, those that install something."""
    blocks = [body.splitlines() for language, _, body in FENCE.findall(text) if not language]
    return [lines for lines in blocks if any(line.startswith("pip install ") for line in lines)]
