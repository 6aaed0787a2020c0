"""`hierax launch --sync`: the folder of a deployment file is copied to the hosts that are reached by `ssh`, with the
system's `rsync` over that `ssh`, before anything is started there.

Nothing is deleted there, and nothing outside of the copy is touched: links are copied as links, and what is a link
there where a file or a folder comes is replaced, not followed.
"""

import shlex
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import Host, shipped
from hierax.runtime.host.run_folder import runs_folder
from hierax.runtime.launch.hosts import needed_hosts
from hierax.runtime.launch.keeper_link import UNREACHED, HostError, shell_path, ssh_to, unreached
from hierax.runtime.launch.run_file import launch_folders

LEFT_OUT = (".git", "__pycache__", ".venv")  # wherever they are
SILENT_S = 60  # how long nothing may pass until it is given up

# what the shell there says on standard error, as of two failures `rsync` gives now the one's exit code, now the other's
_ENTERED, _NO_RSYNC = "-- hierax: entered --", "-- hierax: no rsync --"
_CUT_SHORT = (12, UNREACHED)  # exit codes where `ssh` has ended
_WILD = "*?["


def copied(deployment: Deployment, own: Iterable[Path], notify: Callable[[str], None]) -> Deployment:
    """A deployment whose folder has been copied to its hosts, where processes run in the copy. `own`: what the launch
    writes, which is left out, as are keys and logs of all launches.

    Raises `HieraxError` if there is nothing to copy, or no host to copy it to, and `HostError`, for the first host in
    the file to which it cannot be copied.
    """
    folder = deployment.path.resolve().parent
    _check_folder(deployment, folder)
    needed = needed_hosts(deployment)
    if not needed:
        raise HieraxError(f"--sync: no node of {deployment.path} is placed on a host that is reached by ssh")
    left_out = [*LEFT_OUT, *_within(folder, (*own, runs_folder().parent, *launch_folders()))]
    hosts = dict(deployment.hosts)
    for name in needed:
        host = hosts[name] = replace(hosts[name], folder=hosts[name].folder or str(folder))
        _copy(folder, host, left_out)
        notify(f"host {name} has a copy of {folder} in {host.folder}")
    return replace(deployment, hosts=hosts)


def _check_folder(deployment: Deployment, folder: Path) -> None:
    what = ""
    if deployment.path.resolve() in (path.resolve() for path in shipped().values()):
        what = "comes with hierax, which every host has of its own"
    elif folder in (Path("/"), Path.home().resolve()):
        what = f"is in {folder}, all of which would be copied"
    if what:
        raise HieraxError(f"--sync: {deployment.path} {what}; expected a deployment file in a folder of its own")


def _within(folder: Path, paths: Iterable[Path]) -> list[str]:
    """Those that are in a folder, as patterns of `rsync`."""
    resolved = (path.resolve() for path in paths)
    return [_pattern(path.relative_to(folder)) for path in resolved if folder in path.parents]


def _pattern(path: Path) -> str:
    text = f"/{path}"  # from the folder that is copied on
    if any(sign in text for sign in _WILD):  # without such a sign a backslash stands for itself
        text = "".join(f"\\{sign}" if sign in f"\\{_WILD}" else sign for sign in text)
    return text


def _copy(folder: Path, host: Host, left_out: Iterable[str]) -> None:
    try:
        done = subprocess.run(
            rsync_command(folder, host, left_out),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
            start_new_session=True,  # no terminal at which `ssh` could ask something
        )
    except OSError as error:
        raise _uncopied(folder, host, f"`rsync` cannot be started here: {error.strerror or error}") from error
    if done.returncode == 0:
        return
    lines = [line.strip() for line in done.stderr.decode(errors="replace").splitlines()]
    if _ENTERED not in lines and done.returncode in _CUT_SHORT:
        raise unreached(host, _most_telling(lines))
    if _NO_RSYNC in lines:
        raise _uncopied(folder, host, "there is no `rsync` there")
    raise _uncopied(folder, host, f"`rsync` has failed (exit code {done.returncode}){_most_telling(lines)}")


def _uncopied(folder: Path, host: Host, why: str) -> HostError:
    expected = f"expected {folder} to be copied to {host.folder} there by `rsync`, on both machines (--sync)"
    return HostError(host, f"{why}; {expected}")


def rsync_command(folder: Path, host: Host, left_out: Iterable[str]) -> list[str]:
    """What copies a folder to a host's. Owners stay as they are there, as do modes of what is there already, so that a
    home that is named as the folder is not opened to others.

    `rsync` writes the name of a host behind the words of `-e`. The destination stands among these already, in any form
    that `ssh` takes; so what it writes is the name of a script, and it begins in the folder, as the shell there finds
    that."""
    there = shell_path(host.folder)
    entering = f"echo '{_ENTERED}' >&2; mkdir -p -- {there} && cd -- {there} > /dev/null || exit 1"
    script = f"{entering}; command -v rsync > /dev/null || {{ echo '{_NO_RSYNC}' >&2; exit 1; }}; exec \"$@\""
    shell = f"exec sh -c {shlex.quote(script)}"
    times = ["--times", "--omit-dir-times", "--modify-window=-1"]  # two versions of a second are none that is the same
    options = ["--recursive", "--links", *times, "--executability", f"--timeout={SILENT_S}"]
    without = [f"--exclude={pattern}" for pattern in left_out]
    return ["rsync", *options, *without, "-e", _words([*ssh_to(host), shell]), f"{folder}/", "hierax:./"]


def _words(words: Iterable[str]) -> str:
    """As `rsync` takes a command apart: by quotes that are doubled within, and no backslashes."""
    return " ".join("'" + word.replace("'", "''") + "'" for word in words)


def _most_telling(lines: Iterable[str]) -> str:
    """The last line before those that say that it has failed, which follow every failure."""
    said = [line for line in lines if line and line != _ENTERED]
    telling = [line for line in said if not line.startswith("rsync error:") and "unexpectedly closed" not in line]
    return f": {(telling or said)[-1]:.200}" if said else ""
