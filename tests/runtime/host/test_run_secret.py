from __future__ import annotations

import os
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.models import MAX_CERTIFICATES_S
from hierax.runtime.host.run_secret import end_of, key_text, new_secret, read_key


def test_a_certificate_ends_after_its_time_or_never() -> None:
    assert end_of(None) is None
    lasts = timedelta(seconds=MAX_CERTIFICATES_S)
    before = datetime.now(timezone.utc)
    end = end_of(MAX_CERTIFICATES_S)
    assert end is not None
    assert before + lasts <= end <= datetime.now(timezone.utc) + lasts


@pytest.mark.parametrize("lifetime_s", [1e12, 1e300])
def test_no_certificate_ends_after_all_calendars(lifetime_s: float) -> None:
    with pytest.raises(HieraxError, match=r"a certificate cannot hold for .* s; expected an end before the year 10000"):
        end_of(lifetime_s)


def test_a_key_is_read_also_by_way_of_a_link(tmp_path: Path) -> None:
    secret = new_secret()
    path = tmp_path / "run.key"
    path.write_bytes(key_text(secret))
    path.chmod(0o600)
    (tmp_path / "link").symlink_to(path)
    assert read_key(tmp_path / "link") == secret


def test_a_key_that_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(HieraxError, match="pipe: is no file; expected the key of a run"):
        read_key(tmp_path / "pipe")
