"""``hierax init``: first poses of a scene folder's objects, by clicking corners on a page."""

from pathlib import Path
from typing import Annotated

import typer

from hierax.runtime.commands.errors import CommandError, notify


def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A scene in the BOP format, DATASET/SPLIT/000001.")],
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page; 0: any that is free.")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace first poses that are there already.")] = False,
) -> int:
    """Click the corners of objects in a scene's first picture; their poses go to first_poses.json in its folder."""
    from hierax.nodes.tracking.clicking.page import Page
    from hierax.nodes.tracking.clicking.session import Session
    from hierax.nodes.tracking.datasets.bop import BopScene
    from hierax.nodes.tracking.datasets.first_poses import check_writable, objects_of, write_first_poses

    scene = BopScene(folder)
    path = check_writable(scene, overwrite)
    session = Session(scene, objects_of(scene))
    page = Page(session, port)
    notify(f"click at {page.address} (Ctrl-C ends it, and writes nothing)")
    page.until_done()
    if not session.found:
        raise CommandError(f"{path}: not written, as no pose was accepted")
    write_first_poses(path, scene, session.found)
    print(f"{path}: {len(session.found)} first poses")
    return 0
