"""What is wrong with this machine, and how it is mended."""

import os
import platform
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, requires, version
from operator import eq, ge, gt, le, lt, ne
from pathlib import Path
from typing import NamedTuple

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.streams import python_code

FINE, NOTE, WRONG = "fine", "note", "wrong"
IMPORT_TIMEOUT_S = 60.0
_IMPORTED_AS = {"eclipse-zenoh": "zenoh", "opencv-python-headless": "cv2", "pyyaml": "yaml"}
_MARK = "hierax-doctor:"
_IMPORTER = f"""
import importlib
for name in sys.argv:
    try:
        importlib.import_module(name)
    except BaseException as error:
        print({_MARK!r} + name + ":" + type(error).__name__ + ": " + " ".join(str(error).split()), flush=True)
"""
_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)\s*(?:\[[^]]*\])?\s*([^;]*)(?:;(.*))?")
_BOUND = re.compile(r"(>=|<|==|>|<=|!=)\s*([0-9.]+)")
_COMPARISONS = {">=": ge, "<=": le, ">": gt, "<": lt, "==": eq, "!=": ne}
_EXTRA = re.compile(r"""extra\s*==\s*["']([^"']+)["']""")
OLDEST_PYTHON = (3, 10)
NEWEST_PYTHON = (3, 11)  # the versions that hierax is tested with
FREE_SHARED_BYTES = 64 << 20
FREE_MEMORY_BYTES = 512 << 20
OPEN_FILES = 1024
PROCESSES = 1024
BUSY_LOAD = 2.0  # how many programs may want each core before times say little
LOOP_TIMEOUT_S = 10.0


class Finding(NamedTuple):
    """What was found in one place."""

    check: str  # what was looked at
    state: str  # `FINE`, `NOTE` (worth knowing) or `WRONG`
    what: str  # what is there
    mend: str = ""  # what to do about it; empty where nothing is to be done


def check_packages(wanted: Iterable[str] | None = None) -> Iterator[Finding]:
    """What hierax needs is installed, in versions that do, and can be imported."""
    lacking: dict[str, list[str]] = {}
    sound: dict[str, str] = {}
    for requirement in (requires("hierax") or ()) if wanted is None else wanted:
        match = _REQUIREMENT.fullmatch(requirement.strip())
        if match is None:
            continue
        extra = _EXTRA.search(match[3] or "")
        fault = _fault(match[1], match[2])
        if fault and extra is None:
            yield Finding("package", WRONG, *fault)
        elif fault and extra is not None and extra[1] != "dev":
            lacking.setdefault(extra[1], []).append(match[1])
        elif extra is None:
            sound[_IMPORTED_AS.get(match[1].lower(), match[1].replace("-", "_").lower())] = match[1]
    faults = _import_faults(list(sound)) if sound else {}
    for module, name in sound.items():
        if module in faults:
            mend = f"pip install --force-reinstall {name}; or install the library of the system that it misses"
            yield Finding("package", WRONG, f"{name} cannot be imported: {faults[module]}", mend)
        else:
            yield Finding("package", FINE, f"{name} {version(name)}")
    for extra_name, names in sorted(lacking.items()):
        mend = f"where it is wanted: pip install 'hierax[{extra_name}]'"
        yield Finding("package", NOTE, f"extra {extra_name!r}: {', '.join(names)} not installed", mend)


def _fault(name: str, bounds: str) -> tuple[str, str] | None:
    """What is wrong with a package, and how it is mended."""
    mend = f"pip install '{name}{bounds.strip()}'"
    try:
        found = version(name)
    except PackageNotFoundError:
        return f"{name} is not installed", mend
    for comparison, bound in _BOUND.findall(bounds):
        if not _COMPARISONS[comparison](_numbers(found), _numbers(bound)):
            return f"{name} {found}: expected {bounds.strip()}", mend
    return None


def _import_faults(modules: Sequence[str]) -> dict[str, str]:
    """Why modules cannot be imported, of those that cannot; tried in another process, as some of them print."""
    command = python_code(_IMPORTER, *modules)
    done = subprocess.run(command, capture_output=True, text=True, timeout=IMPORT_TIMEOUT_S, check=False)
    faults = dict(line[len(_MARK) :].split(":", 1) for line in done.stdout.splitlines() if line.startswith(_MARK))
    if done.returncode:  # one has ended the process
        faults.setdefault(modules[0], f"the process that imported it ended with code {done.returncode}")
    return faults


def _numbers(text: str) -> list[int]:
    """The first three numbers of a version."""
    return [int(part) for part in [*re.findall(r"\d+", text), 0, 0, 0][:3]]


def check_python(found: tuple[int, int] | None = None) -> Iterator[Finding]:
    """Python's version, and what `hierax launch` needs of the system."""
    now = found or (sys.version_info.major, sys.version_info.minor)
    text = platform.python_version() if found is None else ".".join(map(str, now))
    what = f"Python {text} ({sys.executable})"
    tested = " and ".join(".".join(map(str, each)) for each in (OLDEST_PYTHON, NEWEST_PYTHON))
    if now < OLDEST_PYTHON:
        yield Finding("python", WRONG, what, f"install Python {tested}; hierax is tested with these")
    elif now > NEWEST_PYTHON:
        yield Finding("python", NOTE, what, f"hierax is tested with {tested}; pybullet has to be built from source")
    else:
        yield Finding("python", FINE, what)
    if not sys.platform.startswith("linux"):
        yield Finding("system", WRONG, f"{platform.system()}: `hierax launch` needs Linux", "use `hierax run` here")
        return
    try:
        os.close(os.pidfd_open(os.getpid()))
    except OSError as error:
        what = f"{platform.system()} {platform.release()}: processes cannot be watched: pidfd_open: {error.strerror}"
        yield Finding("system", WRONG, what, "Linux 5.3 or newer is needed, and a container that allows pidfd_open")
    else:
        yield Finding("system", FINE, f"{platform.system()} {platform.release()}, {platform.machine()}")


def check_machine(load: float | None = None, cores: int | None = None) -> Iterator[Finding]:
    """Processor cores, who else wants them, and memory."""
    count = cores or len(os.sched_getaffinity(0))
    busy = os.getloadavg()[0] if load is None else load
    what = f"{count} cores, {busy:.1f} programs want them"
    if count == 1:
        yield Finding("cores", NOTE, f"{what}: the processes of a launch take turns", "give the container more of them")
    elif busy > BUSY_LOAD * count:
        yield Finding("cores", NOTE, f"{what}: epochs take longer than they need", "measure when the machine is idle")
    else:
        yield Finding("cores", FINE, what)
    try:
        free = int(re.findall(r"MemAvailable:\s+(\d+)", Path("/proc/meminfo").read_text())[0]) << 10
    except (OSError, IndexError):
        return
    what = f"{_size(free)} of memory free; each node's process takes some 60 MB and what it loads"
    yield _judged("memory", free >= FREE_MEMORY_BYTES, what, "end other programs, or add memory")


def check_limits(files: int | None = None, processes: int | None = None) -> Iterator[Finding]:
    """How many files and processes this user may have."""
    for name, kind, least, given, flag in (
        ("open files", resource.RLIMIT_NOFILE, OPEN_FILES, files, "-n"),
        ("processes", resource.RLIMIT_NPROC, PROCESSES, processes, "-u"),
    ):
        limit = resource.getrlimit(kind)[0] if given is None else given
        if limit == resource.RLIM_INFINITY or limit >= least:
            shown = "any number of" if limit == resource.RLIM_INFINITY else limit
            yield Finding("limits", FINE, f"{shown} {name}")
        else:
            mend = f"ulimit {flag} {least}, or more in /etc/security/limits.conf"
            yield Finding("limits", WRONG, f"at most {limit} {name}; large hierarchies need more", mend)


def check_shared_memory(folder: Path = Path("/dev/shm"), locked_bytes: int | None = None) -> Iterator[Finding]:
    """Where large messages go, and what launches that were killed have left there."""
    from hierax.runtime.transport.zenoh_session import orphaned_segments, shared_memory_fault

    if not os.access(folder, os.W_OK | os.X_OK):
        mend = f"mount a tmpfs at {folder} that can be written; without it large messages are copied through sockets"
        yield Finding("shared memory", WRONG, f"{folder} cannot be written", mend)
        return
    fault = shared_memory_fault(folder, locked_bytes)
    if "lock" in fault:
        mend = "ulimit -l unlimited, or memlock in /etc/security/limits.conf; until then large messages are copied"
        yield Finding("shared memory", NOTE, fault, mend)
    free = shutil.disk_usage(folder).free
    mend = f"mount -o remount,size=512M {folder}; for a container: docker run --shm-size=512m"
    yield _judged("shared memory", free >= FREE_SHARED_BYTES, f"{_size(free)} free in {folder}", mend)
    orphans = orphaned_segments(folder)
    if orphans:
        size = _size(sum(path.stat().st_size for path in orphans if path.exists()))
        what = f"{len(orphans)} segments ({size}) of launches that were killed: {orphans[0]} …"
        yield Finding("shared memory", WRONG, what, "hierax doctor --mend removes them, as does the next launch")


def check_loopback() -> Iterator[Finding]:
    """Whether two processes of a launch would find each other; multicast is not needed."""
    from hierax.runtime.host.run_secret import new_secret
    from hierax.runtime.transport.hub import Hub
    from hierax.runtime.transport.launch_client import LaunchClient
    from hierax.schemas.keys import Keys

    settings = os.environ.get("ZENOH_CONFIG")
    begun = time.monotonic()
    try:
        keys, secret = Keys("doctor", f"p{os.getpid()}"), new_secret()
        hub = Hub(keys, None, None, secret=secret)
        try:
            hub.serve(lambda question, reply: reply(question))
            with LaunchClient(hub.endpoint, keys=keys, secret=secret) as client:
                client.ask({"doctor": True}, LOOP_TIMEOUT_S)
        finally:
            hub.close()
    except HieraxError as error:
        mend = "allow programs to listen and connect at 127.0.0.1 (firewall, container without `lo`)"
        if settings:
            mend = f"mend or unset ZENOH_CONFIG={settings}; or {mend}"
        yield Finding("network", WRONG, f"Zenoh over 127.0.0.1: {error}", mend)
        return
    what = f"Zenoh over 127.0.0.1 answers in {1e3 * (time.monotonic() - begun):.0f} ms; multicast is not needed"
    yield Finding("network", FINE, what)
    if settings:
        yield Finding("network", NOTE, f"ZENOH_CONFIG={settings} changes Zenoh's settings for every launch")


def check_folders() -> Iterator[Finding]:
    """Where launches are registered, and where their logs are."""
    from hierax.runtime.host.run_folder import known_folders, runs_folder, unwritable
    from hierax.runtime.launch.run_file import known_runs

    try:
        runs = known_runs()
    except HieraxError as error:
        yield Finding("folders", WRONG, str(error), "set XDG_RUNTIME_DIR to a folder of your own")
        return
    what = ", ".join(f"{each.run} ({each.hierarchy})" for each in runs) or "no launch runs"
    yield Finding("launches", FINE, what)
    folder = runs_folder()
    why = unwritable(folder)
    if why:
        mend = "make it yours, or set XDG_STATE_HOME to a folder that can be written"
        yield Finding("folders", WRONG, f"{why}: launches leave no logs", mend)
        return
    kept = known_folders()
    size = sum(path.stat().st_size for each in kept for path in each.rglob("*") if path.is_file())
    yield Finding("folders", FINE, f"logs of {len(kept)} launches ({_size(size)}) in {folder}")


def _judged(check: str, is_fine: bool, what: str, mend: str) -> Finding:
    return Finding(check, FINE, what) if is_fine else Finding(check, WRONG, what, mend)


def _size(count: int) -> str:
    for power, unit in ((30, "GB"), (20, "MB"), (10, "kB")):
        if count >= 1 << power:
            return f"{count / (1 << power):.3g} {unit}"
    return f"{count} bytes"


def check_leftovers() -> Iterator[Finding]:
    """Processes and folders of launches that were killed."""
    from hierax.runtime.tools.leftovers import orphaned_processes, unused_folders

    found = list(orphaned_processes())
    if found:
        pids = " ".join(str(each.pid) for each in found)
        what = f"{len(found)} processes of nodes whose launch is gone, and that have not ended: {pids}"
        yield Finding("leftovers", WRONG, what, f"hierax doctor --mend ends them, or: kill -9 {pids}")
    folders = list(unused_folders())
    if folders:
        what = f"{len(folders)} folders with checkpoints of launches that were killed: {folders[0]} …"
        yield Finding("leftovers", WRONG, what, "hierax doctor --mend removes them")
    if not found and not folders:
        yield Finding("leftovers", FINE, "nothing was left behind")


CHECKS: Mapping[str, Callable[[], Iterator[Finding]]] = {
    "python": check_python,
    "packages": check_packages,
    "machine": check_machine,
    "limits": check_limits,
    "shared memory": check_shared_memory,
    "network": check_loopback,
    "folders": check_folders,
    "leftovers": check_leftovers,
}


def examine(checks: Mapping[str, Callable[[], Iterator[Finding]]] = CHECKS) -> Iterator[Finding]:
    """All findings; what cannot be looked at is one, too."""
    for name, check in checks.items():
        try:
            yield from check()
        except (OSError, subprocess.SubprocessError) as error:  # noqa: PERF203 - each for itself
            yield Finding(name, NOTE, f"cannot be looked at: {error}")


def mend() -> list[str]:
    """Remove what launches that were killed have left behind; what was done."""
    from hierax.runtime.tools.leftovers import end_process, orphaned_processes, unused_folders
    from hierax.runtime.transport.zenoh_session import remove_orphaned_segments

    done: list[str] = []
    for each in orphaned_processes():
        end_process(each)
        done.append(f"ended process {each.pid}")
    segments = remove_orphaned_segments()
    if segments:
        done.append(f"removed {segments} segments of shared memory")
    for folder in unused_folders():
        shutil.rmtree(folder)
        done.append(f"removed {folder}")
    return done
