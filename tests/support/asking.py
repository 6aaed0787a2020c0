"""Asks a launch what runs, once for each line that comes: for a test that is elsewhere than the launch.

Started as ``python -m support.asking ENDPOINT KEY``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from hierax.runtime.host.run_secret import read_key
from hierax.runtime.transport.launch_client import LaunchClient

if __name__ == "__main__":
    with LaunchClient(sys.argv[1], secret=read_key(Path(sys.argv[2]))) as client:
        for _ in sys.stdin:
            print(json.dumps(client.ask({"ask": "ps"})), flush=True)
