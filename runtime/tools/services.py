"""What starts a deployment as a service: one `hierax launch` that begins its run or goes on with it, and how it is
asked for its health. `hierax.runtime.tools.systemd`, `compose` and `kubernetes` write it down for each."""

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import read_text, shipped
from hierax.runtime.deployment.secrets import public_settings, secret_values
from hierax.runtime.host.scheduling import REAL_TIME
from hierax.runtime.host.zenoh_settings import names_file
from hierax.schemas.rates import EVERY_EPOCH

IMAGE = "hierax"
USER = 10001  # who a container runs as; deploy/Containerfile has the same
STATE = "/state"  # in a container, the folder that stays
FOLDER = "/etc/hierax"  # in a container, where a deployment file is that comes from outside
STOP_S = 30  # how long a launch may take to end
LOOK_S = 30  # how often it is asked for its health
ANSWER_S = 20  # how long that may take
SHARED_MEMORY = "512Mi"  # what lies there are large arrays on their way, of which each process lends 128 MiB at most

_LABEL_CHARS = 52  # of a name of Kubernetes's, which puts some more behind


@dataclass(frozen=True)
class Service:
    """A deployment as it is to be started by others."""

    deployment: Deployment
    settings: Sequence[str] = ()  # as `--set` has them
    seed: int = 0
    epochs: int | None = None  # None: as the file says
    image: str = IMAGE  # what a container is made from

    @property
    def name(self) -> str:
        """What it is called there: small letters, digits and hyphens."""
        label = re.sub(r"[^a-z0-9]+", "-", self.deployment.name.lower()).strip("-")
        return f"hierax-{label[:_LABEL_CHARS].strip('-')}"

    @property
    def is_shipped(self) -> bool:
        """Whether its file comes with hierax."""
        path = self.deployment.path
        return shipped().get(path.stem) == path

    @property
    def file_name(self) -> str:
        """How a container has its file."""
        return f"{self.name}.yaml"

    @property
    def is_secret(self) -> bool:
        """Whether its file has something secret in it."""
        return bool(secret_values(self.deployment.zenoh))

    def launch(self, file: str, state: str) -> list[str]:
        """The arguments of `hierax`; file and folder as they are where it is started."""
        given = [argument for text in self.settings for argument in ("--set", text)]
        epochs = [] if self.epochs is None else ["--epochs", str(self.epochs)]
        folders = ["--resume", f"{state}/run", "--output", f"{state}/output"]
        return ["launch", file, *folders, "--seed", str(self.seed), *epochs, *given]

    def health(self, *within: str) -> list[str]:
        """Likewise, of a look at it."""
        return ["health", "--run", self.deployment.name, *within]

    @property
    def in_container(self) -> list[str]:
        """The arguments of `hierax` in a container. Raises `HieraxError` if nodes run on hosts that `ssh` has to reach:
        it is not in the image, nor are its keys."""
        for node, host in self.deployment.placed.items():
            if not self.deployment.hosts[host].is_here:
                what = f"node {node} runs on host {host}, which ssh reaches; a container has neither ssh nor your keys"
                raise HieraxError(f"{self.deployment.path}: {what}; expected no such place, or `hierax export systemd`")
        own = self.deployment.path.stem if self.is_shipped else f"{FOLDER}/{self.file_name}"
        return self.launch(own, STATE)

    @property
    def text(self) -> str:
        """Its file. Raises `HieraxError` if what is in it leads to another one."""
        zenoh = self.deployment.zenoh
        if names_file(zenoh):
            what = f"zenoh: {zenoh} is a file of this machine; a container needs the settings themselves, as a map"
            raise HieraxError(f"{self.deployment.path}: {what}")
        return read_text(self.deployment.path)

    @property
    def cores(self) -> float | None:
        """How many cores its nodes may take by their budgets and rates; None: no budget is known."""
        terms, turns = self.deployment.terms, self.deployment.roster.turns
        world_hz = terms[self.deployment.roster.world].rate_hz
        shares = [
            each.budget_ms / 1e3 * rate_hz / turns.get(name, EVERY_EPOCH).every
            for name, each in terms.items()
            if each.budget_ms is not None and (rate_hz := each.rate_hz or world_hz) is not None
        ]
        return sum(shares) if shares else None

    @property
    def start_s(self) -> int:
        """How long it may take until it answers."""
        return int(self.deployment.start_timeout_s) + LOOK_S

    @property
    def priority(self) -> int:
        """The highest real-time priority that a node asks for; 0: none does."""
        asked = [each.scheduling for each in self.deployment.terms.values() if each.scheduling is not None]
        return max((int(str(each["priority"])) for each in asked if each["policy"] in REAL_TIME), default=0)


def check_settings(deployment: Deployment, settings: Sequence[str]) -> None:
    """Raise `HieraxError` if one is secret: it would stand in a file that many can read."""
    hidden = [kept for kept in public_settings(settings, deployment.zenoh) if "=" not in kept]
    if hidden:
        raise HieraxError(f"--set {hidden[0]}: it is secret, and would stand in the command; write it into the file")


@dataclass(frozen=True)
class Written:
    """A file for whoever starts services."""

    name: str
    text: str
    is_secret: bool = False  # for its user alone


def head(kind: str, *lines: str) -> str:
    """What a file begins with."""
    return "".join(f"# {line}\n" for line in (f"Written by `hierax export {kind}`.", *lines))


def executable() -> Path:
    """This installation's `hierax`. Raises `HieraxError` if it has none."""
    found = Path(sys.executable).parent / "hierax"
    if not found.exists():
        raise HieraxError(f"{found}: there is no such command, which the units are to start")
    return found
