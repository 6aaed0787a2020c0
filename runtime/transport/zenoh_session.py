"""Opening and closing Zenoh sessions, and what they leave behind."""

import atexit
import base64
import fcntl
import ipaddress
import json
import os
import re
import resource
import secrets
import shutil
import socket
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, TypeAlias

import zenoh

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.run_secret import USER, certificates_of, dictionary, issued, pems_of, token_of
from hierax.runtime.host.zenoh_settings import names_file
from hierax.runtime.transport.port import TransportError
from hierax.schemas.limits import MAX_MESSAGE_BYTES, MAX_QUESTION_BYTES

OWN_ADDRESS = "127.0.0.1"  # where this machine alone reaches itself
LOOPBACK = (
    f"tcp/{OWN_ADDRESS}:0"  # where a session listens unless told otherwise: a free port that no other machine reaches
)

Links: TypeAlias = Literal["all", "told"]
"""To whom a peer has links: `all` it hears of, or only whom it is `told` to connect to and who connect to it.

Of two it is always one that opens the link, the one with the greater id as Zenoh compares them. Where both do, each may
close the one that the other keeps: among five that came at once, that left two unlinked for good in half of all tries.
So those that are told have ids that are smaller than those that Zenoh draws."""

ZenohConfig: TypeAlias = "str | Mapping[str, Any] | None"
"""Zenoh's own configuration: the path of a JSON5 file, JSON5 text in braces, or a map."""

LOGGED = (
    "error,zenoh::api::session=off,zenoh::net::protocol::gossip=off,zenoh_transport::unicast::establishment=off,"
    "zenoh_codec=off,zenoh::net::routing::hat::peer=off,zenoh_transport::unicast::universal::transport=off,"
    "zenoh::bug=off,zenoh::net::routing::dispatcher::resource=off"
)
"""What Zenoh prints, where RUST_LOG says nothing.

While a session's first links come up, its threads may be overtaken by messages for keys that they are about to
declare to it, gossip may come over a link that has just gone, and who dials again while the other side is yet closing
the link before numbers its keys anew, over the numbers that it had: Zenoh drops that and calls it an error. It is no
more than greetings, which are said again until they are answered, and news that come again by another link. A link
that could not be opened is tried again, as when the other side has not yet noticed that the last one was cut, or is
just closing it; what cannot be reached for good is an error of ours. Bytes that are none of Zenoh's are refused with a
line for each connection, with which anybody who reaches a port could fill a log; as could who declares what it may not,
and takes it back: then Zenoh says that it knows nothing of it. What is taken back over a link that has just gone is to
Zenoh a bug of its own; it goes with the link.
"""

_OF_LINKS = (
    "zenoh_link_tcp::unicast=debug,zenoh_link_tls::unicast=debug,zenoh_link_unixsock_stream::unicast=debug,"
    "zenoh_transport::unicast::establishment::accept=debug"
)
_OF_LISTS = "zenoh::net::routing::interceptor::access_control=trace"
READ_VERSIONS = "1.10."
"""Of Zenoh's versions those that print what lists say of messages in words that are known: with other words members
might be told of as if they were refused. With other versions nobody is."""


def log_links() -> None:
    """Have Zenoh print the links that come in, for `watch.refused`; to be called before a session is opened."""
    zenoh.init_log_from_env_or(f"{LOGGED},{_OF_LINKS}")


def log_refusals() -> None:
    """Likewise, and what Zenoh's lists of who may do what say of each message: for a session that hears few."""
    lists = f",{_OF_LISTS}" if version("eclipse-zenoh").startswith(READ_VERSIONS) else ""
    zenoh.init_log_from_env_or(f"{LOGGED},{_OF_LINKS}{lists}")


RUNTIME = "(net: (worker_threads: 8))"
"""Zenoh's threads, where ZENOH_RUNTIME says nothing. With one thread for its network's life, as is its default, a
session hangs for good where others come and go while its first links open (eclipse-zenoh/zenoh#2581, up to 1.10.2):
the thread waits for a lock whose owner waits for what that thread is to do. A thread that sleeps costs 15 kB."""

LEASE_MS = 1000
LOW_LATENCY_BYTES = 32 * 1024
"""What a low-latency link surely carries at once. Zenoh loses a longer message without a word (from 48 KiB on,
with its key and header)."""

LONGEST_BYTES = MAX_MESSAGE_BYTES + 64 * 1024
"""How much of a message Zenoh puts together, its key and header among it; the rest of a longer one is dropped."""

LONGEST_SHORT_BYTES = MAX_QUESTION_BYTES + 64 * 1024
"""Likewise, where links are low-latency ones: questions are the longest that such a process hears."""

LINKS_S = 10.0  # how long another session of a process may take to have the links that the one before has
LINKS_LOOK_S = 0.02
LINGER_S = 1.0  # how long what was said in a session may be on its way when another one is used

CLOSE_TIMEOUT_S = 1.0
EXIT_TIMEOUT_S = 3.0  # how long the interpreter's end waits for sessions that were not closed by then
CALLBACKS_END_S = 0.5
_CLOSING = "zenoh-close"  # the name of threads that close a session

POOL_BYTES = 16 << 20
"""What each session that sends large messages has in shared memory, and locks, as do those that receive from it."""

LOCKED_BYTES = 4 * POOL_BYTES  # what a process may have to lock: its own pool and those of some neighbours

_QUOTED_LINE = re.compile(r"\s*\d*\s*\|")
_QUOTED_TEXT = re.compile(r"(invalid (?:type|value): \w+) (?:`[^`]*`|\"(?:\\.|[^\"\\])*\")")

_ADMISSION = "transport/auth/usrpwd"
ENCRYPTION = "transport/link/tls"
_ACCESS = "access_control"

_ID_FROM = 1 << 62  # so that the first digit of what follows is not 0, which Zenoh refuses

_SHARED_MEMORY = Path("/dev/shm")
_IPC_LOCK = 14  # the capability with which limits on locked memory do not count

_LOW_LATENCY = "transport/unicast/lowlatency"
_BATCH = "transport/link/tx/batch_size"


def open_session(
    listen: Sequence[str] = (LOOPBACK,),  # Zenoh endpoints
    connect: Sequence[str] = (),  # likewise
    zenoh_config: ZenohConfig = None,  # Zenoh's own; it wins over ours, and over the file that ZENOH_CONFIG names
    shared_memory: bool = True,  # whether large messages may go through shared memory
    mode: Literal["peer", "client"] = "peer",  # a ``client`` links as it connects, a ``peer`` by `links` too
    links: Links = "all",
    # Links to others that want the same are written to at once, by the thread that sends, without priorities. They
    # carry messages of up to `LOW_LATENCY_BYTES`, and whoever sends to a peer that reads no more waits as soon as the
    # buffers between them are full. Links to others are as ever.
    low_latency: bool = False,
    secret: str = "",  # links are to sessions alone that have the same; empty: to any that have none
    role: str = "",  # whose certificate it shows, where the secret is not that of one role already
    access: Mapping[str, Any] | None = None,  # where links are encrypted, Zenoh's list of who may do what; None: all
) -> zenoh.Session:
    """Open a session. Raises `TransportError` if Zenoh refuses the settings, or cannot listen."""
    zenoh.init_log_from_env_or(LOGGED)
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)
    ours: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": 10_000,
        "connect/retry": {"period_init_ms": 10, "period_max_ms": 200, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "scouting/gossip/autoconnect": {"router": [], "peer": [] if links == "told" else ["router", "peer"]},
        # where one of two listens nowhere, it has to be that one
        "scouting/gossip/autoconnect_strategy": {
            "peer": {"to_router": "always", "to_peer": "greater-zid" if listen else "always"}
        },
        "scouting/delay": 0,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": LONGEST_SHORT_BYTES if low_latency else LONGEST_BYTES,
        "transport/shared_memory/enabled": shared_memory and not shared_memory_fault(),
    }
    if links == "told":
        ours["id"] = _small_id()
    if low_latency:
        ours["transport/unicast/qos/enabled"] = False  # Zenoh has one or the other
    try:
        with dictionary(secret) as file:
            if secret:
                ours[_ADMISSION] = {"user": USER, "password": token_of(secret), "dictionary_file": file}
            if certificates_of(secret):
                ours |= encrypted(issued(secret, role, [address_of(endpoint)[0] for endpoint in listen]), access)
            config = _configured(ours, zenoh_config)
            _set_low_latency(config, low_latency)
            return _opened(config)
    except HieraxError as error:
        raise TransportError(str(error)) from None
    except zenoh.ZError as error:
        raise _refusal(error) from None


def check_settings(zenoh_config: ZenohConfig, low_latency: bool = False) -> None:
    """Raises `TransportError` if Zenoh, or what `low_latency` needs, refuses a user's settings, of which no session is
    opened."""
    try:
        _set_low_latency(_given(zenoh_config), low_latency)
    except zenoh.ZError as error:
        raise _refusal(error) from None


def _refusal(error: zenoh.ZError) -> TransportError:
    """What Zenoh says, whose own words may quote a password."""
    lines = [line for line in str(error).splitlines() if not _QUOTED_LINE.match(line)]
    return TransportError("Zenoh: " + _QUOTED_TEXT.sub(r"\1 …", " ".join(lines)))


def _small_id() -> str:
    """An id that is smaller than what Zenoh draws: it compares the last of the bytes that are written here first."""
    return f"{_ID_FROM + secrets.randbelow(_ID_FROM):x}{0:016x}"


def encrypted(secret: str, access: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Settings with which links are encrypted, and both ends show certificates: this one that of a role, whose secret
    it is. No others are taken, and each is let do what a list says. One that has come to its end ends its links."""
    root, shown, private = (base64.b64encode(each.encode()).decode() for each in pems_of(secret))
    ends = {
        f"{end}_{what}_base64": value
        for end in ("listen", "connect")
        for what, value in (("certificate", shown), ("private_key", private))
    }
    return {
        "transport/link/protocols": ["tls"],
        # a client of Zenoh's also trusts the web's authorities: the name says that this is the run's
        ENCRYPTION: {
            "root_ca_certificate_base64": root,
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
            **ends,
        },
        **({} if access is None else {_ACCESS: access}),
    }


def _opened(config: zenoh.Config) -> zenoh.Session:
    """A session; without shared memory where the machine has none after all."""
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if "shm" not in str(error):
            raise
        config.insert_json5("transport/shared_memory/enabled", "false")
        return zenoh.open(config)


def shared_memory_fault(folder: Path | None = None, locked_bytes: int | None = None) -> str:
    """Why large messages do not go through shared memory here, by folder and bytes to be locked; empty: they do."""
    folder = folder or _SHARED_MEMORY
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"{folder} cannot be written"
    free = shutil.disk_usage(folder).free
    if free < POOL_BYTES:
        return f"{free >> 10} KiB are free in {folder}, {POOL_BYTES >> 10} KiB are needed"
    limit = _lockable() if locked_bytes is None else locked_bytes
    if limit is not None and limit < LOCKED_BYTES:
        return f"a process may lock {limit >> 10} KiB of memory (ulimit -l), {LOCKED_BYTES >> 10} KiB may be needed"
    return ""


def allows_shared_memory(zenoh_config: ZenohConfig) -> bool:
    """Whether Zenoh's own configuration, which `open_session` has taken, leaves shared memory on."""
    return bool(_given(zenoh_config).get_json("transport/shared_memory/enabled") == "true")


def _lockable() -> int | None:
    """How many bytes this process may lock; None: any number."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    try:
        capabilities = int(re.findall(r"CapEff:\s*([0-9a-f]+)", Path("/proc/self/status").read_text())[0], 16)
    except (OSError, IndexError):
        capabilities = 0
    return None if limit == resource.RLIM_INFINITY or capabilities >> _IPC_LOCK & 1 else limit


def close_session(session: zenoh.Session) -> bool:
    """Close a session; whether it was within `CLOSE_TIMEOUT_S`, beyond which nothing is waited for.

    Closing can hang beside a peer that is stopped, until Zenoh itself gives up; the process may then end all the same.
    """
    closed = threading.Event()

    def close() -> None:
        with suppress(zenoh.ZError):
            session.close()  # type: ignore[no-untyped-call]
            closed.set()

    threading.Thread(target=close, name=_CLOSING, daemon=True).start()
    return closed.wait(CLOSE_TIMEOUT_S)


@atexit.register
def _await_threads() -> None:
    """Wait until sessions are closed, and their callbacks have ended: a thread of Zenoh's that comes back into an
    interpreter which ends aborts the process. Callbacks of sessions that stay open sleep, and do no harm."""
    for name, patience_s in ((_CLOSING, EXIT_TIMEOUT_S), ("(pyo3-closure)", CALLBACKS_END_S)):
        until_s = time.monotonic() + patience_s
        for thread in threading.enumerate():
            if thread.name.endswith(name):
                thread.join(max(until_s - time.monotonic(), 0.0))


def await_links(session: zenoh.Session, before: zenoh.Session) -> None:
    """Wait until a session is linked to all that another one of this process is linked to; not for long."""
    until_s = time.monotonic() + LINKS_S
    while {*before.info.peers_zid()} - {session.zid()} - {*session.info.peers_zid()} and time.monotonic() < until_s:
        time.sleep(LINKS_LOOK_S)


def endpoint_at(host: str | None = None, secret: str = "", port: int = 0) -> str:
    """Where a session of a run listens, at an address of this machine, or else on its loopback; 0: at a free port.
    Raises `TransportError` if others could not tell by the address which machine it is."""
    address = host or OWN_ADDRESS
    with suppress(ValueError):
        if ipaddress.ip_address(address).is_unspecified:
            raise TransportError(f"{address} is no address that others could link to; expected one of this machine's")
        address = f"[{address}]" if ":" in address else address
    return f"{'tls' if certificates_of(secret) else 'tcp'}/{address}:{port}"


def door_at(path: str) -> str:
    """The endpoint of a socket of this machine's, where a session listens."""
    return f"unixsock-stream/{path}"


def knocking_at(path: str) -> str:
    """The same for a session that connects to it as soon as somebody listens, and again when the link broke."""
    return f"{door_at(path)}#exit_on_failure=false"


def address_of(endpoint: str) -> tuple[str, int]:
    """The address, or name, of an endpoint's machine, and its port."""
    address, _, port = endpoint.partition("/")[2].rpartition(":")
    return address.strip("[]"), int(port)


def free_endpoint(host: str | None = None, secret: str = "") -> str:
    """One that is free now, as `endpoint_at` has them. Raises `TransportError` if the machine has no such address."""
    address, _ = address_of(endpoint_at(host, secret))
    try:
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as probe:
            probe.bind((address, 0))
            return endpoint_at(host, secret, probe.getsockname()[1])
    except OSError as error:
        raise TransportError(f"cannot listen at {address!r}: {error.strerror or error}") from error


def remove_orphaned_segments() -> int:
    """Remove the shared-memory segments of sessions that are gone; how many there were.

    Zenoh holds a shared lock on each segment in use and removes orphans only when the next session opens, so the last
    one would stay.
    """
    return sum([_is_orphaned(path, remove=True) for path in sorted(_SHARED_MEMORY.glob("*.zenoh"))])


def orphaned_segments(folder: Path = _SHARED_MEMORY) -> list[Path]:
    return [path for path in sorted(folder.glob("*.zenoh")) if _is_orphaned(path)]


def _is_orphaned(path: Path, remove: bool = False) -> bool:
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return False  # gone already, or another user's, or a link, which may lead anywhere
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if remove:
            path.unlink()
    except OSError:
        return False  # in use
    finally:
        os.close(descriptor)
    return True


def _configured(ours: Mapping[str, Any], zenoh_config: ZenohConfig) -> zenoh.Config:
    """The user's configuration, with ours where it says nothing."""
    config: zenoh.Config = _given(zenoh_config)
    default = zenoh.Config()
    if ENCRYPTION in ours and config.get_json(ENCRYPTION) != default.get_json(ENCRYPTION):
        ours = {path: value for path, value in ours.items() if path != _ACCESS}  # by names that ours alone have
    for path, value in ours.items():
        if config.get_json(path) == default.get_json(path):
            config.insert_json5(path, json.dumps(value))
    return config


def _set_low_latency(config: zenoh.Config, low_latency: bool) -> None:
    if config.get_json(_LOW_LATENCY) == "true":
        what = f"Zenoh's settings have {_LOW_LATENCY}, with which long messages get lost"
        raise TransportError(f"{what}; leave it out: low_latency: true in the deployment takes care of that")
    if low_latency and config.get_json(_BATCH) != zenoh.Config().get_json(_BATCH):
        what = f"Zenoh's settings have {_BATCH}, which bounds what low-latency links carry"
        raise TransportError(f"{what}; leave it out, or low_latency: true")
    config.insert_json5(_LOW_LATENCY, json.dumps(low_latency))


def _given(zenoh_config: ZenohConfig) -> Any:
    if zenoh_config is None:
        return zenoh.Config.from_env() if os.environ.get("ZENOH_CONFIG") else zenoh.Config()
    if isinstance(zenoh_config, Mapping):
        return zenoh.Config.from_json5(json.dumps(zenoh_config))
    return zenoh.Config.from_file(zenoh_config) if names_file(zenoh_config) else zenoh.Config.from_json5(zenoh_config)
