"""``hierax keys``: keys of a launch for others, who may not do all that its own user may."""

import os
from datetime import datetime, timedelta, timezone
from enum import Enum
from pathlib import Path
from typing import Annotated

from hierax.runtime.commands.errors import OK, CommandError
from hierax.runtime.commands.options import Format, RunOptions, argument, offers, option
from hierax.runtime.commands.show import print_json
from hierax.runtime.commands.which_launch import launch_meant
from hierax.runtime.host.private_files import FILE_MODE, errors_named
from hierax.runtime.host.run_secret import certificates_of, issued, key_text, may_issue
from hierax.schemas.access import OPERATOR, READER

LONGEST_S = 366 * 86_400.0


class Role(str, Enum):
    """What whoever has a key may do."""

    reader = READER
    operator = OPERATOR


@offers("run", "connect", "key", "output_format")
def keys(
    file: Annotated[Path, argument("FILE", "Where the key is written, for you alone.", dir_okay=False)],
    options: RunOptions,
    role: Annotated[Role, option("--role")] = Role.reader,
    expires: Annotated[str, option("--expires")] = "8h",
) -> int:
    """Make a key of a launch with --host, by which others come in and may do what its role says, for some time."""
    from hierax.runtime.recording.topics import read_duration

    launch = launch_meant(options.run, options.connect, options.key)
    if not certificates_of(launch.secret):
        raise CommandError(f"the launch at {launch.endpoint} has no certificates, so no roles; launch it with --host")
    if not may_issue(launch.secret):
        raise CommandError(f"the key is one role's; others are made by the key of the run, of {launch.endpoint}")
    lasts_s = read_duration(expires, "--expires")
    if lasts_s > LONGEST_S:
        raise CommandError(f"--expires {expires}: expected a year at most")
    until = datetime.now(timezone.utc) + timedelta(seconds=lasts_s)
    with errors_named(file), open(file, "xb", opener=_opened_for_one) as made:
        made.write(key_text(issued(launch.secret, role.value, until=until)))
    if options.output_format is Format.json:
        told = {"file": str(file), "role": role.value, "until": until.isoformat(), "endpoint": launch.endpoint}
        print_json(told)
    else:
        print(f"{role.value} until {until.astimezone():%Y-%m-%d %H:%M:%S}: --connect {launch.endpoint} --key {file}")
    return OK


def _opened_for_one(path: str, flags: int) -> int:
    return os.open(path, flags, FILE_MODE)
