"""Units of systemd's for a user's own services: the launch, and a timer that asks for its health."""

import re
from pathlib import Path

from hierax.runtime.tools.services import ANSWER_S, STOP_S, Service, Written, executable, head

_PLAIN = re.compile(r"[\w./:=@,+-]+")


def units(service: Service) -> list[Written]:
    """The launch's unit, and those of its health."""
    name = service.name
    how = f"systemctl --user link $PWD/{name}*.service $PWD/{name}*.timer && systemctl --user enable --now {name}"
    launch = f"{head('systemd', how)}{_launch(service)}"
    health = f"{head('systemd')}{_health(service)}"
    return [
        Written(f"{name}.service", launch),
        Written(f"{name}-health.service", health),
        Written(f"{name}-health.timer", f"{head('systemd')}{_timer(service)}"),
    ]


def _launch(service: Service) -> str:
    name, deployment = service.name, service.deployment
    file = deployment.path.stem if service.is_shipped else str(deployment.path.resolve())
    is_own = service.settings or not service.is_shipped  # then relative paths mean what they did as they were accepted
    folder = _escaped(str(Path.cwd())) if is_own else f"%S/{name}"
    limit = f"LimitRTPRIO={service.priority}\n" if service.priority else ""
    command = _command(service.launch(file, "STATE")).replace(" STATE/", f" %S/{name}/")
    # what raises would raise again: it is tried some times, what was killed goes on
    return f"""\
[Unit]
Description={_escaped(f"hierax: {deployment.name}")}
Wants={name}-health.timer
StartLimitIntervalSec=600
StartLimitBurst=5

[Service]
Type=exec
ExecStart={command}
WorkingDirectory={folder}
StateDirectory={name}
StateDirectoryMode=0700
UMask=0077
NoNewPrivileges=yes
{limit}Restart=on-failure
RestartSec=2
SuccessExitStatus=130
KillMode=mixed
TimeoutStopSec={STOP_S}

[Install]
WantedBy=default.target
"""


def _health(service: Service) -> str:
    again = f'[ "$$SERVICE_RESULT" = success ] || systemctl --user try-restart {service.name}.service'
    return f"""\
[Unit]
Description=Whether {service.name} answers; else it is started again

[Service]
Type=oneshot
ExecStart={_command(service.health("--within", "0"))}
ExecStopPost=/bin/sh -c '{again}'
TimeoutStartSec={ANSWER_S}
"""


def _timer(service: Service) -> str:
    return f"""\
[Unit]
Description=Asks {service.name} for its health
PartOf={service.name}.service

[Timer]
OnActiveSec={service.start_s}
OnUnitInactiveSec={service.start_s}
"""


def _command(arguments: list[str]) -> str:
    return " ".join(_quoted(each) for each in (str(executable()), *arguments))


def _quoted(argument: str) -> str:
    """An argument as a unit has it."""
    if _PLAIN.fullmatch(argument):
        return argument
    text = argument.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{_escaped(text).replace("$", "$$")}"'


def _escaped(text: str) -> str:
    return text.replace("%", "%%")
